//! From net text to plan: read, resolve, sort, build. Runs off the real-time path and reports all
//! faults at once. What happens to a plan afterwards is its executor's business.

mod activation;
mod build;
mod builder;
mod graph;
mod inter;
mod resolve;
mod sort;
mod taps;

use std::time::Duration;

use crate::device::Devices;
use crate::fault::{FAULTS_MAX, FaultKind, Rejection};
use crate::limits::Limits;
use crate::plan::Plan;
use crate::registry::Registry;
use crate::text;

pub use builder::Build;

/// What a net is loaded against.
#[derive(Clone, Copy)]
pub struct LoadContext<'c> {
    /// The primitives there are.
    pub registry: &'c Registry,
    /// The devices there are.
    pub devices: &'c dyn Devices,
    /// Time from one cycle of the net to the next.
    pub period: Duration,
    /// How large the net may be.
    pub limits: Limits,
}

impl std::fmt::Debug for LoadContext<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LoadContext")
            .field("period", &self.period)
            .finish_non_exhaustive()
    }
}

/// Checks a net and makes it ready.
///
/// # Errors
/// All faults of the net, in the order of its text.
pub fn load(text: &str, context: &LoadContext<'_>) -> Result<Plan, Rejection> {
    let mut faults = Vec::new();
    let tree = text::parse(text, &context.limits, &mut faults);
    let readable = faults.is_empty();
    let resolved = resolve::resolve(&tree, context, &mut faults);
    let mut plan = None;
    // An unreadable part would make links look missing and ports unconnected.
    if readable {
        match sort::order(&resolved.graph()) {
            Ok(order) => plan = build::build(&resolved, &order, context, &mut faults),
            Err(unordered) => {
                faults.push(resolved.cycle_fault(&unordered.cycle));
                // Only for the faults of parameters; the plan is worth nothing.
                build::build(&resolved, &unordered.units, context, &mut faults);
            }
        }
    } else {
        faults.retain(|f| !is_consequence(&f.kind));
    }
    faults.retain(|f| f.kind != build::inherited());
    match plan {
        Some(plan) if faults.is_empty() => Ok(plan),
        _ => {
            faults.sort_by_key(|f| f.at.start);
            faults.dedup();
            faults.truncate(FAULTS_MAX);
            Err(Rejection { faults })
        }
    }
}

/// Whether a fault may be there only because a part of the text could not be read.
const fn is_consequence(kind: &FaultKind) -> bool {
    matches!(
        kind,
        FaultKind::UnknownChild { .. }
            | FaultKind::UnknownOutPort { .. }
            | FaultKind::UnknownInPort { .. }
            | FaultKind::NotConnected { .. }
            | FaultKind::NoTerminate
    )
}
