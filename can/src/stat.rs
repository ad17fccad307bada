//! Bus statistics from received frames: load, rate and jitter of each identifier, errors, heartbeats, losses; and
//! findings with remedies ([`Report::findings`]). Works live or on a recording, and reads no clock. Memory is bounded,
//! but it allocates and is not for real-time cycles.

mod emergency;
mod finding;
mod heartbeat;
mod interval;
mod life;
mod report;
mod sdo;

use std::time::Duration;

pub use emergency::{CODES_MAX, Emergencies, EmergencyStat};
pub use finding::{DuplicateSign, Finding, Limits, Severity};
pub use heartbeat::Heartbeat;
pub use interval::{Interleaved, Intervals};
pub use life::Life;
use report::ratio;
pub use report::{Errors, IdStat, Report};
pub use sdo::{Aborts, SdoStat};

use crate::bits::{Bits, Rates, bounds};
use crate::canopen::{Message, NmtCommand, NmtState, NodeId};
use crate::cia402::dictionary::Address;
use crate::fault::{class, controller};
use crate::link::{Origin, Received};
use crate::{AnyFrame, BusState, ErrorFrame};

/// Maximum identifiers with separate statistics; further ones are counted together.
pub const IDS_MAX: usize = 4096;

/// 1017h.
const PRODUCER_HEARTBEAT: Address = Address::new(0x1017, 0);

/// Window of the peak load.
const WINDOW: Duration = Duration::from_millis(100);

impl Report {
    /// Findings, by descending severity.
    pub fn findings(&self, limits: &Limits) -> Vec<Finding> {
        finding::judge(self, limits)
    }
}

/// Collects statistics of a bus.
#[derive(Clone, Debug)]
pub struct Meter {
    report: Report,
    start: Option<Duration>,
    now: Duration,
    window: (Duration, Duration),
    /// Frames lost by the interface.
    lost: u64,
}

impl Meter {
    /// A meter with these bit rates; without them it computes no load.
    pub fn new(rates: Option<Rates>) -> Self {
        Self {
            report: Report {
                rates,
                ..Report::default()
            },
            start: None,
            now: Duration::ZERO,
            window: (Duration::ZERO, Duration::ZERO),
            lost: 0,
        }
    }

    /// Handles a received frame.
    pub fn handle_frame(&mut self, received: &Received) {
        self.handle_time(received.at);
        self.report.dropped = self.report.dropped.max(received.dropped.into());
        match &received.frame {
            AnyFrame::Error(frame) => self.error(frame),
            AnyFrame::Classic(_) | AnyFrame::Fd(_) => self.frame(received),
        }
    }

    /// Advances time, which detects missing frames. Decreasing times are ignored.
    pub fn handle_time(&mut self, now: Duration) {
        let start = *self.start.get_or_insert(now);
        self.now = self.now.max(now);
        self.report.span = self.now.saturating_sub(start);
    }

    /// Sets the total number of frames that could not be sent.
    pub const fn handle_refused(&mut self, frames: u64) {
        self.report.refused = frames;
    }

    /// Sets the total number of frames lost by the socket, also after the last received frame.
    pub fn handle_dropped(&mut self, frames: u64) {
        self.report.dropped = self.report.dropped.max(frames);
    }

    /// Sets the total number of frames lost by the interface before any socket.
    pub const fn handle_lost(&mut self, frames: u64) {
        self.lost = frames;
    }

    /// Sets state and error counters of the interface.
    pub const fn handle_state(&mut self, state: Option<BusState>, counters: Option<(u16, u16)>) {
        if state.is_some() {
            self.report.state = state;
        }
        if counters.is_some() {
            self.report.counters = counters;
        }
    }

    /// The statistics so far.
    pub fn report(&self) -> Report {
        let mut report = self.report.clone();
        report.silent = self.silent();
        report
            .sdos
            .values_mut()
            .for_each(|sdo| *sdo = sdo.at(self.now));
        report.dropped += self.lost;
        report.peak_load = self.peak(self.window.1);
        report
    }

    fn silent(&self) -> Vec<(NodeId, Duration)> {
        let nodes = self.report.heartbeats.iter();
        nodes
            .filter_map(|(node, beat)| {
                let silence = self.now.saturating_sub(beat.intervals.last()?);
                (silence > beat.timeout()?).then_some((*node, silence))
            })
            .collect()
    }

    fn peak(&self, window: Duration) -> f64 {
        let load = ratio(window, WINDOW).unwrap_or(0.0);
        // A frame counts at its end, so a window can slightly exceed its length.
        self.report.peak_load.max(load.min(1.0))
    }

    fn frame(&mut self, received: &Received) {
        let (frame, at) = (&received.frame, received.at);
        let busy = self.wire_time(frame);
        self.report.frames += 1;
        self.report.sent += u64::from(received.origin != Origin::Bus);
        if at >= self.window.0.saturating_add(WINDOW) {
            self.report.peak_load = self.peak(self.window.1);
            self.window = (at, Duration::ZERO);
        }
        self.window.1 += busy;
        self.identifier(frame, busy, at);
        if let AnyFrame::Classic(frame) = frame {
            self.message(&Message::decode(frame), at, received.origin != Origin::Bus);
        }
    }

    fn wire_time(&mut self, frame: &AnyFrame) -> Duration {
        let Some(rates) = self.report.rates else {
            return Duration::ZERO;
        };
        let bits = Bits::of(frame);
        let busy = bits.time(rates);
        let (least, most) = match frame {
            AnyFrame::Classic(frame) => {
                let (least, most) = bounds(frame);
                let time = |nominal| Bits { nominal, data: 0 }.time(rates);
                (time(least), time(most))
            }
            AnyFrame::Fd(_) | AnyFrame::Error(_) => (busy, busy),
        };
        self.report.busy += busy;
        self.report.busy_bounds.0 += least;
        self.report.busy_bounds.1 += most;
        busy
    }

    fn identifier(&mut self, frame: &AnyFrame, busy: Duration, at: Duration) {
        let Some(id) = frame.id() else { return };
        let may_add = self.report.ids.len() < IDS_MAX;
        let stat = match self.report.ids.get_mut(&id) {
            Some(stat) => stat,
            None if may_add => self.report.ids.entry(id).or_default(),
            None => {
                self.report.other_ids += 1;
                return;
            }
        };
        stat.frames += 1;
        stat.bytes += frame.data().len() as u64;
        stat.busy += busy;
        stat.intervals.record(at);
    }

    fn message(&mut self, message: &Message, at: Duration, is_own: bool) {
        let report = &mut self.report;
        match message {
            Message::Heartbeat(node, state, _) => {
                self.heartbeat(*node, *state, at);
                self.beat(*node).own = is_own;
            }
            Message::Tpdo(node, number) => {
                report.lives.entry(*node).or_default().pdo(*number, at);
            }
            Message::Sync(_) => {
                let (own, others) = &mut report.sync_sources;
                *(if is_own { own } else { others }) += 1;
                report.syncs.record(at);
            }
            Message::Emergency(node, emergency) => {
                let emergencies = report.emergencies.entry(*node).or_default();
                emergencies.handle(emergency, at);
            }
            Message::SdoRequest(node, message) => {
                let sdo = report.sdos.entry(*node).or_default();
                sdo.handle_request(message, at);
            }
            Message::SdoResponse(node, message) => {
                let sdo = report.sdos.entry(*node).or_default();
                if let Some((PRODUCER_HEARTBEAT, [low, high, ..])) =
                    sdo.handle_response(message, at)
                {
                    let period = Duration::from_millis(u16::from_le_bytes([low, high]).into());
                    self.beat(*node).write(period, at);
                }
            }
            Message::Nmt(command, node) => self.nmt(*command, *node, at),
            Message::Time(..)
            | Message::Rpdo(..)
            | Message::Guard(_)
            | Message::Lss(..)
            | Message::Unknown => {}
        }
    }

    fn beat(&mut self, node: NodeId) -> &mut Heartbeat {
        let beats = &mut self.report.heartbeats;
        beats.entry(node).or_insert(Heartbeat::new())
    }

    fn heartbeat(&mut self, node: NodeId, state: NmtState, at: Duration) {
        let is_known = !matches!(state, NmtState::Other(_));
        self.report.canopen += u64::from(is_known);
        self.beat(node).handle(state, at);
        self.report.lives.entry(node).or_default().report(state, at);
        if state == NmtState::BootUp
            && let Some(emergencies) = self.report.emergencies.get_mut(&node)
        {
            emergencies.clear_all();
        }
    }

    /// A command explains the states of the nodes, a reset their boot-up.
    fn nmt(&mut self, command: NmtCommand, node: Option<NodeId>, at: Duration) {
        self.report.canopen += u64::from(!matches!(command, NmtCommand::Other(_)));
        let lives = self.report.lives.iter_mut();
        lives
            .filter(|(number, _)| node.is_none_or(|node| node == **number))
            .for_each(|(_, life)| life.command(command, at));
        if matches!(
            command,
            NmtCommand::ResetNode | NmtCommand::ResetCommunication
        ) {
            let beats = self.report.heartbeats.iter_mut();
            let meant = beats.filter(|(number, _)| node.is_none_or(|node| node == **number));
            meant.for_each(|(_, beat)| beat.command(command, at));
        }
    }

    fn error(&mut self, frame: &ErrorFrame) {
        let errors = &mut self.report.errors;
        let has = |class| u64::from(frame.class() & class != 0);
        errors.frames += 1;
        errors.unacknowledged += u64::from(frame.is_unacknowledged());
        let on_the_wire = frame.class() & (class::PROTOCOL | class::BUS_ERROR) != 0;
        errors.protocol += u64::from(on_the_wire && !frame.is_unacknowledged());
        errors.lost_arbitration += has(class::LOST_ARBITRATION);
        errors.bus_off += has(class::BUS_OFF);
        errors.restarts += has(class::RESTARTED);
        errors.timeouts += has(class::TX_TIMEOUT);
        errors.transceiver += has(class::TRANSCEIVER);
        let overflow = frame.data[1] & controller::RX_OVERFLOW != 0;
        errors.controller_overflows += u64::from(overflow) & has(class::CONTROLLER);
        let counters = frame.counters().map(|(t, r)| (t.into(), r.into()));
        self.handle_state(frame.state(), counters);
    }
}

#[cfg(test)]
mod tests;
