//! The report of bus statistics. It is filled by a [`Meter`](super::Meter) and judged elsewhere.

use std::collections::BTreeMap;
use std::time::Duration;

use super::{Emergencies, Heartbeat, Interleaved, Intervals, Life, SdoStat};
use crate::bits::Rates;
use crate::canopen::{NodeId, SYNC};
use crate::{BusState, Id};

/// Statistics of one identifier.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IdStat {
    /// Frames.
    pub frames: u64,
    /// Bytes of data.
    pub bytes: u64,
    /// Time on the wire.
    pub busy: Duration,
    /// Intervals between frames.
    pub intervals: Intervals,
}

/// Counts from error frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Errors {
    /// Error frames in all.
    pub frames: u64,
    /// Protocol violations on the wire.
    pub protocol: u64,
    /// Frames of this host without acknowledgement.
    pub unacknowledged: u64,
    /// Lost arbitrations; not an error.
    pub lost_arbitration: u64,
    /// Receive overflows of the controller.
    pub controller_overflows: u64,
    /// Number of bus-off events.
    pub bus_off: u64,
    /// Number of restarts.
    pub restarts: u64,
    /// Transmit timeouts of the driver.
    pub timeouts: u64,
    /// Transceiver errors: cut or shorted wires.
    pub transceiver: u64,
}

/// Statistics of a bus.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Bit rates for the load.
    pub rates: Option<Rates>,
    /// Duration of the measurement.
    pub span: Duration,
    /// Frames, without error frames.
    pub frames: u64,
    /// Frames that this host sent.
    pub sent: u64,
    /// Statistics by identifier.
    pub ids: BTreeMap<Id, IdStat>,
    /// Frames of identifiers beyond [`IDS_MAX`](super::IDS_MAX).
    pub other_ids: u64,
    /// Time on the wire with actual stuff bits.
    pub busy: Duration,
    /// Time on the wire without stuff bits, and with the maximum of stuff bits.
    pub busy_bounds: (Duration, Duration),
    /// Peak load in windows of 0.1 s, 0 to 1.
    pub peak_load: f64,
    /// Counts from error frames.
    pub errors: Errors,
    /// State of this host's controller, if reported.
    pub state: Option<BusState>,
    /// Transmit and receive error counters, if reported.
    pub counters: Option<(u16, u16)>,
    /// Nodes that send heartbeats.
    pub heartbeats: BTreeMap<NodeId, Heartbeat>,
    /// Nodes whose heartbeat is missing at the end, with its age.
    pub silent: Vec<(NodeId, Duration)>,
    /// The emergencies of each node.
    pub emergencies: BTreeMap<NodeId, Emergencies>,
    /// The life cycle of each node.
    pub lives: BTreeMap<NodeId, Life>,
    /// SYNC messages, if they are those of two producers.
    pub syncs: Interleaved,
    /// SYNC messages of this host and of others.
    pub sync_sources: (u64, u64),
    /// The SDO dialogues of each node.
    pub sdos: BTreeMap<NodeId, SdoStat>,
    /// Frames typical of CANopen: heartbeats and NMT commands.
    pub canopen: u64,
    /// Frames lost by this host's sockets and interface.
    pub dropped: u64,
    /// Frames that this host could not send.
    pub refused: u64,
}

impl Report {
    /// Mean bus load, 0 to 1; `None` without bit rate or time.
    pub fn load(&self) -> Option<f64> {
        self.rates?;
        ratio(self.busy, self.span)
    }

    /// Jitter of SYNC: range of the intervals relative to their mean.
    pub fn sync_jitter(&self) -> Option<f64> {
        let intervals = self.ids.get(&SYNC)?.intervals;
        let width = intervals.longest().saturating_sub(intervals.shortest());
        (intervals.count() >= 10).then(|| ratio(width, intervals.mean()))?
    }
}

/// `None` if `whole` is zero.
pub(super) fn ratio(part: Duration, whole: Duration) -> Option<f64> {
    (!whole.is_zero()).then(|| part.as_secs_f64() / whole.as_secs_f64())
}
