//! Derives findings from bus statistics by pure functions, so that each can be tested by its cause.

mod dialogues;
mod lives;
mod remedy;
mod text;

use std::time::Duration;

use super::Report;
use crate::canopen::{NmtState, NodeId};
use crate::cia402::dictionary::{AbortCode, Address};
use crate::{BusState, Id};

/// Limits of the statistics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Mean load that leaves too little reserve for bursts, 0 to 1.
    pub load_warning: f64,
    /// Mean load at which low priorities starve, 0 to 1.
    pub load_failure: f64,
    /// Errors on the wire per thousand frames.
    pub errors_per_thousand: f64,
    /// SYNC jitter relative to its period.
    pub sync_jitter: f64,
    /// Tolerated time without any frame.
    pub silence: Duration,
}

impl Default for Limits {
    /// Load of 60 % and 90 %, one error per thousand frames, SYNC within 10 %, one second of silence.
    fn default() -> Self {
        Self {
            load_warning: 0.6,
            load_failure: 0.9,
            errors_per_thousand: 1.0,
            sync_jitter: 0.1,
            silence: Duration::from_secs(1),
        }
    }
}

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Communication fails.
    Failure,
    /// Communication works, but not reliably.
    Warning,
}

/// A finding about a bus.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// The controller is or was bus-off.
    BusOff {
        /// How often.
        times: u64,
        /// Whether it still is.
        still: bool,
    },
    /// No node acknowledges frames of this host.
    Alone {
        /// Unacknowledged frames.
        frames: u64,
    },
    /// Errors and no good frame.
    NothingButErrors {
        /// How many.
        errors: u64,
    },
    /// No frame.
    Nothing {
        /// Duration of the measurement.
        span: Duration,
    },
    /// Errors between good frames.
    Disturbed {
        /// Errors on the wire.
        errors: u64,
        /// Good frames.
        frames: u64,
    },
    /// The transceiver reported cut or shorted wires.
    Wires {
        /// How often.
        times: u64,
    },
    /// The controller is error-passive or in error-warning.
    Weak {
        /// Its state.
        state: BusState,
        /// Counters of transmit and receive errors.
        counters: Option<(u16, u16)>,
    },
    /// High bus load.
    Load {
        /// Mean load, 0 to 1.
        load: f64,
        /// Exceeded limit.
        limit: f64,
        /// Its severity.
        severity: Severity,
        /// The identifier with the most load, and its fraction of the load.
        most: Option<(Id, f64)>,
    },
    /// A node's heartbeat stopped.
    HeartbeatMissing {
        /// The node.
        node: NodeId,
        /// Time since the last one.
        silence: Duration,
        /// Its period before.
        period: Duration,
        /// It is that of this host.
        own: bool,
    },
    /// A node's heartbeat was late and recovered.
    HeartbeatLate {
        /// The node.
        node: NodeId,
        /// How often.
        times: u32,
        /// It is that of this host.
        own: bool,
    },
    /// A node restarts again and again without an observed reset.
    BootLoop {
        /// The node.
        node: NodeId,
        /// How often.
        times: u32,
    },
    /// Several nodes have one number.
    Duplicate {
        /// The number.
        node: NodeId,
        /// What shows it.
        sign: DuplicateSign,
    },
    /// A node sends TPDOs in a state in which it must not.
    StrayPdos {
        /// The node.
        node: NodeId,
        /// How many.
        frames: u32,
        /// Number of the last one, from 1.
        number: u8,
        /// The state.
        state: NmtState,
    },
    /// A node repeats an emergency at a high rate.
    EmergencyStorm {
        /// The node.
        node: NodeId,
        /// Its code.
        code: u16,
        /// Number of occurrences.
        times: u32,
        /// Occurrences per second.
        rate: f64,
    },
    /// Two producers send SYNC.
    TwoSyncs {
        /// Whether this host is one of them.
        own: bool,
        /// The period of each, if it is the same.
        period: Option<Duration>,
    },
    /// A node restarted during operation without an observed reset.
    Rebooted {
        /// The node.
        node: NodeId,
        /// How often.
        times: u32,
    },
    /// An active emergency of a node.
    Emergency {
        /// The node.
        node: NodeId,
        /// Its code.
        code: u16,
        /// Number of occurrences.
        times: u32,
    },
    /// A past emergency of a node, cleared or ended by its restart.
    EmergencyEnded {
        /// The node.
        node: NodeId,
        /// Its code.
        code: u16,
        /// Number of occurrences.
        times: u32,
    },
    /// A node does not respond to SDO requests.
    SdoUnanswered {
        /// The node.
        node: NodeId,
        /// How many.
        times: u32,
        /// Object of the last one.
        address: Option<Address>,
        /// Whether it answered none or some.
        severity: Severity,
    },
    /// SDO requests to nodes that never responded: a bus scan.
    SdoAbsent {
        /// How many.
        nodes: usize,
        /// The lowest of them.
        first: NodeId,
    },
    /// A node aborted SDO requests.
    SdoRefused {
        /// The node.
        node: NodeId,
        /// How many.
        times: u32,
        /// The last one.
        last: (Address, AbortCode),
    },
    /// A client aborted SDO transfers of a node, other than after a timeout.
    SdoGivenUp {
        /// The node.
        node: NodeId,
        /// How many.
        times: u32,
        /// The last one.
        last: (Address, AbortCode),
    },
    /// A client repeats requests before the response.
    SdoRepeated {
        /// The node.
        node: NodeId,
        /// How often.
        times: u32,
    },
    /// A node sends unsolicited SDO responses.
    SdoUnsolicited {
        /// The node.
        node: NodeId,
        /// How many.
        times: u32,
    },
    /// SYNC is irregular.
    SyncJitter {
        /// Range of the intervals relative to their mean.
        jitter: f64,
        /// Mean interval.
        period: Duration,
    },
    /// This host's sockets lost frames.
    Dropped {
        /// How many.
        frames: u64,
    },
    /// This host's controller lost frames.
    ControllerOverflow {
        /// How often.
        times: u64,
    },
    /// This host could not send frames, as the queue was full.
    Refused {
        /// How many.
        frames: u64,
    },
}

/// What shows that several nodes have one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DuplicateSign {
    /// So many SDO requests were answered twice.
    Answers(u32),
    /// So many boot-ups came in pairs.
    BootUps(u32),
    /// The state in its heartbeats changed so often without a command.
    States(u32),
    /// Its heartbeats are two interleaved sequences.
    Heartbeats,
}

impl Finding {
    /// Its severity.
    pub const fn severity(&self) -> Severity {
        match self {
            Self::BusOff { still: true, .. }
            | Self::Alone { .. }
            | Self::NothingButErrors { .. }
            | Self::Nothing { .. }
            | Self::Wires { .. }
            | Self::HeartbeatMissing { .. }
            | Self::BootLoop { .. }
            | Self::Duplicate { .. }
            | Self::EmergencyStorm { .. }
            | Self::TwoSyncs { .. }
            | Self::Dropped { .. }
            | Self::ControllerOverflow { .. }
            | Self::Refused { .. } => Severity::Failure,
            Self::Load { severity, .. } | Self::SdoUnanswered { severity, .. } => *severity,
            Self::BusOff { still: false, .. }
            | Self::Disturbed { .. }
            | Self::Weak { .. }
            | Self::HeartbeatLate { .. }
            | Self::Rebooted { .. }
            | Self::StrayPdos { .. }
            | Self::Emergency { .. }
            | Self::EmergencyEnded { .. }
            | Self::SdoAbsent { .. }
            | Self::SdoRefused { .. }
            | Self::SdoGivenUp { .. }
            | Self::SdoRepeated { .. }
            | Self::SdoUnsolicited { .. }
            | Self::SyncJitter { .. } => Severity::Warning,
        }
    }

    /// A stable name without spaces, for programs.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::BusOff { .. } => "bus-off",
            Self::Alone { .. } => "alone",
            Self::NothingButErrors { .. } => "nothing-but-errors",
            Self::Nothing { .. } => "nothing",
            Self::Disturbed { .. } => "disturbed",
            Self::Wires { .. } => "wires",
            Self::Weak { .. } => "weak",
            Self::Load { .. } => "load",
            Self::HeartbeatMissing { .. } => "heartbeat-missing",
            Self::HeartbeatLate { .. } => "heartbeat-late",
            Self::Rebooted { .. } => "rebooted",
            Self::BootLoop { .. } => "boot-loop",
            Self::Duplicate { .. } => "duplicate",
            Self::StrayPdos { .. } => "stray-pdos",
            Self::EmergencyStorm { .. } => "emergency-storm",
            Self::TwoSyncs { .. } => "two-sync-producers",
            Self::Emergency { .. } => "emergency",
            Self::EmergencyEnded { .. } => "emergency-withdrawn",
            Self::SdoUnanswered { .. } => "sdo-unanswered",
            Self::SdoAbsent { .. } => "sdo-absent",
            Self::SdoRefused { .. } => "sdo-refused",
            Self::SdoGivenUp { .. } => "sdo-given-up",
            Self::SdoRepeated { .. } => "sdo-repeated",
            Self::SdoUnsolicited { .. } => "sdo-unasked",
            Self::SyncJitter { .. } => "sync-jitter",
            Self::Dropped { .. } => "dropped",
            Self::ControllerOverflow { .. } => "controller-overflow",
            Self::Refused { .. } => "refused",
        }
    }
}

/// Sorts by descending severity.
pub(super) fn judge(report: &Report, limits: &Limits) -> Vec<Finding> {
    let mut found = Vec::new();
    controller(report, &mut found);
    wire(report, limits, &mut found);
    load(report, limits, &mut found);
    nodes(report, limits, &mut found);
    host(report, &mut found);
    found.sort_by_key(Finding::severity);
    found
}

fn controller(report: &Report, found: &mut Vec<Finding>) {
    let errors = &report.errors;
    let still = report.state == Some(BusState::BusOff);
    if still || errors.bus_off > 0 {
        found.push(Finding::BusOff {
            times: errors.bus_off.max(1),
            still,
        });
    }
    if errors.unacknowledged > 0 {
        found.push(Finding::Alone {
            frames: errors.unacknowledged,
        });
    }
    if let Some(state @ (BusState::ErrorWarning | BusState::ErrorPassive)) = report.state {
        found.push(Finding::Weak {
            state,
            counters: report.counters,
        });
    }
}

fn wire(report: &Report, limits: &Limits, found: &mut Vec<Finding>) {
    let errors = &report.errors;
    let received = report.frames - report.sent.min(report.frames);
    if errors.transceiver > 0 {
        found.push(Finding::Wires {
            times: errors.transceiver,
        });
    }
    if errors.protocol > 0 && received == 0 {
        found.push(Finding::NothingButErrors {
            errors: errors.protocol,
        });
    } else if report.frames == 0 && errors.frames == 0 && report.span >= limits.silence {
        found.push(Finding::Nothing { span: report.span });
    }
    let per_thousand = errors.protocol as f64 * 1e3 / report.frames.max(1) as f64;
    if received > 0 && per_thousand >= limits.errors_per_thousand {
        found.push(Finding::Disturbed {
            errors: errors.protocol,
            frames: report.frames,
        });
    }
}

fn load(report: &Report, limits: &Limits, found: &mut Vec<Finding>) {
    let Some(load) = report.load() else { return };
    let (limit, severity) = match load {
        _ if load >= limits.load_failure => (limits.load_failure, Severity::Failure),
        _ if load >= limits.load_warning => (limits.load_warning, Severity::Warning),
        _ => return,
    };
    let most = report.ids.iter().max_by_key(|(_, stat)| stat.busy);
    let most = most.and_then(|(id, stat)| Some((*id, super::ratio(stat.busy, report.busy)?)));
    found.push(Finding::Load {
        load,
        limit,
        severity,
        most,
    });
}

fn nodes(report: &Report, limits: &Limits, found: &mut Vec<Finding>) {
    for (node, silence) in &report.silent {
        let beat = report.heartbeats.get(node);
        found.push(Finding::HeartbeatMissing {
            node: *node,
            silence: *silence,
            period: beat.map(super::Heartbeat::period).unwrap_or_default(),
            own: beat.is_some_and(|beat| beat.own),
        });
    }
    for (node, beat) in &report.heartbeats {
        let node = *node;
        let is_duplicate = lives::duplicate(report, node, found);
        if beat.gaps > 0 && !is_duplicate {
            let (times, own) = (beat.gaps, beat.own);
            found.push(Finding::HeartbeatLate { node, times, own });
        }
        if let Some(times) = beat.boot_loop() {
            found.push(Finding::BootLoop { node, times });
        } else if beat.reboots > 0 {
            let times = beat.reboots;
            found.push(Finding::Rebooted { node, times });
        }
    }
    lives::stray_pdos(report, found);
    dialogues::emergencies(report, found);
    dialogues::sdos(report, found);
    if lives::two_syncs(report, found) {
        return;
    }
    if let Some(jitter) = report.sync_jitter().filter(|j| *j > limits.sync_jitter) {
        let sync = report.ids.get(&crate::canopen::SYNC);
        let period = sync.map(|stat| stat.intervals.mean()).unwrap_or_default();
        found.push(Finding::SyncJitter { jitter, period });
    }
}

fn host(report: &Report, found: &mut Vec<Finding>) {
    if report.dropped > 0 {
        found.push(Finding::Dropped {
            frames: report.dropped,
        });
    }
    if report.errors.controller_overflows > 0 {
        found.push(Finding::ControllerOverflow {
            times: report.errors.controller_overflows,
        });
    }
    if report.refused > 0 {
        found.push(Finding::Refused {
            frames: report.refused,
        });
    }
}
