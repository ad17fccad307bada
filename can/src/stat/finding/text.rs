//! Findings as text: the cause, in one line. The remedy is a text of its own.

use std::fmt;
use std::time::Duration;

use super::{DuplicateSign, Finding};
use crate::cia402::error_text;

impl fmt::Display for DuplicateSign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Answers(times) => write!(f, "{times} SDO requests were answered twice"),
            Self::BootUps(times) => write!(f, "{times} boot-ups right after another"),
            Self::States(times) => {
                write!(f, "its state changed {times} times without a command")
            }
            Self::Heartbeats => f.write_str("its heartbeats are two interleaved sequences"),
        }
    }
}

impl fmt::Display for Finding {
    #[expect(clippy::too_many_lines, reason = "a table of texts")]
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |span: &Duration| span.as_secs_f64() * 1e3;
        match self {
            Self::BusOff { times, still: true } => {
                write!(f, "the controller is off the bus (went off {times} times)")
            }
            Self::BusOff { times, .. } => write!(f, "the controller was off the bus {times} times"),
            Self::Alone { frames } => {
                write!(
                    f,
                    "no node acknowledges: {frames} transmission attempts failed"
                )
            }
            Self::NothingButErrors { errors } => write!(f, "{errors} errors and no good frame"),
            Self::Nothing { span } => write!(f, "no frame in {:.1} s", span.as_secs_f64()),
            Self::Disturbed { errors, frames } => {
                write!(f, "{errors} errors on the wire, {frames} good frames")
            }
            Self::Wires { times } => write!(f, "the transceiver complained {times} times"),
            Self::Weak { state, counters } => {
                write!(f, "the controller is {state}")?;
                match counters {
                    Some((t, r)) => write!(f, " (errors: {t} sending, {r} receiving)"),
                    None => Ok(()),
                }
            }
            Self::Load {
                load, limit, most, ..
            } => {
                let (load, limit) = (load * 1e2, limit * 1e2);
                write!(f, "load {load:.1} %, limit {limit:.0} %")?;
                match most {
                    Some((id, part)) => write!(f, "; {id} is {:.0} % of it", part * 1e2),
                    None => Ok(()),
                }
            }
            Self::HeartbeatMissing {
                node,
                silence,
                period,
                own,
            } => {
                let (silence, period) = (ms(silence), ms(period));
                let whose = if *own { " of this host" } else { "" };
                write!(
                    f,
                    "node {node}: no heartbeat{whose} for {silence:.0} ms, was every {period:.0} ms"
                )
            }
            Self::HeartbeatLate { node, times, own } => {
                let whose = if *own { " of this host" } else { "" };
                write!(f, "node {node}: heartbeat{whose} late {times} times")
            }
            Self::BootLoop { node, times } => write!(
                f,
                "node {node}: restarts again and again, {times} times without a reset command"
            ),
            Self::Duplicate { node, sign } => {
                write!(f, "several nodes have number {node}: {sign}")
            }
            Self::StrayPdos {
                node,
                frames,
                number,
                state,
            } => write!(
                f,
                "node {node}: sends TPDOs while it is {state}: {frames} frames, last TPDO{number}"
            ),
            Self::EmergencyStorm {
                node,
                code,
                times,
                rate,
            } => {
                let text = error_text(*code);
                write!(
                    f,
                    "node {node}: storm of emergencies {code:04X}h {text}: {times} times, {rate:.0}/s"
                )
            }
            Self::TwoSyncs { own, period } => {
                f.write_str("two producers send SYNC")?;
                if *own {
                    f.write_str(", this host is one of them")?;
                }
                match period {
                    Some(period) => write!(f, ", each every {:.3} ms", ms(period)),
                    None => Ok(()),
                }
            }
            Self::Rebooted { node, times } => {
                write!(f, "node {node}: started again {times} times")
            }
            Self::Emergency { node, code, times } => {
                let text = error_text(*code);
                write!(
                    f,
                    "node {node}: emergency {code:04X}h {text}, {times} times"
                )
            }
            Self::EmergencyEnded { node, code, times } => {
                let text = error_text(*code);
                write!(
                    f,
                    "node {node}: emergency {code:04X}h {text}, {times} times, withdrawn since"
                )
            }
            Self::SdoUnanswered {
                node,
                times,
                address,
                ..
            } => {
                write!(f, "node {node}: no answer to {times} SDO requests")?;
                address.map_or(Ok(()), |address| write!(f, ", last {address}"))
            }
            Self::SdoAbsent { nodes, first } => {
                write!(
                    f,
                    "{nodes} nodes from {first} on received SDO requests and are absent"
                )
            }
            Self::SdoRefused {
                node,
                times,
                last: (address, code),
            } => write!(
                f,
                "node {node}: refused {times} SDO requests, last {address}: {code}"
            ),
            Self::SdoGivenUp {
                node,
                times,
                last: (address, code),
            } => write!(
                f,
                "node {node}: a client gave up {times} SDO transfers, last {address}: {code}"
            ),
            Self::SdoRepeated { node, times } => write!(
                f,
                "node {node}: {times} SDO requests repeated before their answer"
            ),
            Self::SdoUnsolicited { node, times } => {
                write!(
                    f,
                    "node {node}: {times} SDO answers that belong to no request"
                )
            }
            Self::SyncJitter { jitter, period } => {
                let (jitter, period) = (jitter * 1e2, ms(period));
                write!(f, "SYNC jitters by {jitter:.1} % of its {period:.3} ms")
            }
            Self::Dropped { frames } => {
                write!(f, "{frames} received frames lost: not read in time")
            }
            Self::ControllerOverflow { times } => {
                write!(f, "the controller lost received frames {times} times")
            }
            Self::Refused { frames } => write!(f, "{frames} frames not sent: queue full"),
        }
    }
}
