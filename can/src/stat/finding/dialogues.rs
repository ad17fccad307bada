//! Findings about emergencies and SDO dialogues. Ignores frames with these identifiers on a bus without CANopen.

use super::{Finding, Severity};
use crate::canopen::NodeId;
use crate::stat::{Report, SdoStat};

/// Maximum emergencies of a node that still count on a bus without other CANopen frames. Cars and power bases send
/// cyclic data with these identifiers.
const EMERGENCIES_MAX: u64 = 16;
/// Number of unanswered requests in a row after which a node counts as dead.
const DEAD: u32 = 3;
/// Number of requested but absent nodes that indicates a scan.
const SCAN: usize = 4;

/// Whether there are signs of CANopen on this bus.
fn is_canopen(report: &Report) -> bool {
    report.canopen > 0
        || report
            .sdos
            .values()
            .any(|sdo| sdo.answered > 0 && sdo.is_sdo())
}

pub(super) fn emergencies(report: &Report, found: &mut Vec<Finding>) {
    for (node, emergencies) in &report.emergencies {
        if !is_canopen(report) && emergencies.frames > EMERGENCIES_MAX {
            continue;
        }
        let node = *node;
        found.extend(emergencies.codes().iter().map(|seen| {
            let (code, times) = (seen.code, seen.times);
            if let Some(rate) = seen.storm() {
                Finding::EmergencyStorm {
                    node,
                    code,
                    times,
                    rate,
                }
            } else if seen.is_present {
                Finding::Emergency { node, code, times }
            } else {
                Finding::EmergencyEnded { node, code, times }
            }
        }));
    }
}

pub(super) fn sdos(report: &Report, found: &mut Vec<Finding>) {
    // The node sent no response and is not visible otherwise.
    let is_absent = |node: &NodeId, sdo: &SdoStat| {
        sdo.answered == 0 && sdo.unsolicited == 0 && !report.heartbeats.contains_key(node)
    };
    let sdos = || report.sdos.iter().filter(|(_, sdo)| sdo.is_sdo());
    let mut absent = sdos().filter(|(node, sdo)| is_absent(node, sdo) && sdo.unanswered > 0);
    let count = absent.clone().count();
    let scan = absent.next().filter(|_| count >= SCAN);
    if let Some((first, _)) = scan {
        let (nodes, first) = (count, *first);
        found.push(Finding::SdoAbsent { nodes, first });
    }
    for (node, sdo) in sdos() {
        if scan.is_none() || !is_absent(node, sdo) {
            of_node(*node, sdo, found);
        }
    }
    let without = report
        .sdos
        .iter()
        .filter(|(_, sdo)| !sdo.is_sdo() && sdo.requests == 0);
    for (node, sdo) in without.filter(|(node, _)| report.heartbeats.contains_key(node)) {
        unsolicited(*node, sdo, found);
    }
}

fn of_node(node: NodeId, sdo: &SdoStat, found: &mut Vec<Finding>) {
    if sdo.unanswered > 0 {
        let is_dead = sdo.answered == 0 && sdo.unanswered >= DEAD;
        found.push(Finding::SdoUnanswered {
            node,
            times: sdo.unanswered,
            address: sdo.unanswered_last,
            severity: if is_dead {
                Severity::Failure
            } else {
                Severity::Warning
            },
        });
    }
    if let (times, Some(last)) = sdo.refused {
        found.push(Finding::SdoRefused { node, times, last });
    }
    if let (times, Some(last)) = sdo.given_up {
        found.push(Finding::SdoGivenUp { node, times, last });
    }
    if sdo.repeats > 0 {
        let times = sdo.repeats;
        found.push(Finding::SdoRepeated { node, times });
    }
    unsolicited(node, sdo, found);
}

fn unsolicited(node: NodeId, sdo: &SdoStat, found: &mut Vec<Finding>) {
    if sdo.unsolicited > 0 {
        let times = sdo.unsolicited;
        found.push(Finding::SdoUnsolicited { node, times });
    }
}
