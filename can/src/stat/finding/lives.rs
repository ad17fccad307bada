//! Findings about the life cycle of nodes: several with one number, PDOs in the wrong state, and two producers of SYNC.

use super::{DuplicateSign, Finding};
use crate::canopen::NodeId;
use crate::stat::Report;

/// Answers in pairs, and changes of state without command, that are no coincidence.
const ANSWERS: u32 = 2;
const STATES: u32 = 3;
/// Boot-ups right after another that are a loop of one node instead.
const TWINS: std::ops::Range<u32> = 1..3;
/// Stray PDOs of a node that are no coincidence.
const STRAY: u32 = 3;
/// SYNC messages of each source that are no test by hand.
const SYNCS: u64 = 5;

/// Several nodes with that number; returns whether there are.
pub(super) fn duplicate(report: &Report, node: NodeId, found: &mut Vec<Finding>) -> bool {
    let life = report.lives.get(&node).copied().unwrap_or_default();
    let beat = report.heartbeats.get(&node);
    let twins = beat.map_or(0, |beat| beat.twins);
    let sdo = report.sdos.get(&node).filter(|sdo| sdo.is_sdo());
    let doubled = sdo.map_or(0, |sdo| sdo.doubled);
    let sign = if doubled >= ANSWERS {
        DuplicateSign::Answers(doubled)
    } else if life.beats.is_found() {
        DuplicateSign::Heartbeats
    } else if life.flips >= STATES {
        DuplicateSign::States(life.flips)
    } else if TWINS.contains(&twins) {
        DuplicateSign::BootUps(twins)
    } else {
        return false;
    };
    found.push(Finding::Duplicate { node, sign });
    true
}

pub(super) fn stray_pdos(report: &Report, found: &mut Vec<Finding>) {
    for (node, life) in &report.lives {
        let (frames, last) = life.stray_pdos;
        if let Some((number, state)) = last.filter(|_| frames >= STRAY && report.canopen > 0) {
            let node = *node;
            found.push(Finding::StrayPdos {
                node,
                frames,
                number,
                state,
            });
        }
    }
}

/// Two producers of SYNC; returns whether there are.
pub(super) fn two_syncs(report: &Report, found: &mut Vec<Finding>) -> bool {
    let (own, others) = report.sync_sources;
    let own = own >= SYNCS && others >= SYNCS;
    let period = report.syncs.period();
    if own || period.is_some() {
        found.push(Finding::TwoSyncs { own, period });
        return true;
    }
    false
}
