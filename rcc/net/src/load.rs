//! From net text to plan: parse, resolve, sort, build. This runs off the real-time path and reports
//! all faults at once. The executor owns the plan afterwards.

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

/// The context in which a net is loaded.
#[derive(Clone, Copy)]
pub struct LoadContext<'c> {
    /// The available primitives.
    pub registry: &'c Registry,
    /// The available devices.
    pub devices: &'c dyn Devices,
    /// Time from one cycle of the net to the next.
    pub period: Duration,
    /// Bounds on the net.
    pub limits: Limits,
}

impl std::fmt::Debug for LoadContext<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LoadContext")
            .field("period", &self.period)
            .finish_non_exhaustive()
    }
}

/// Checks a net and builds its plan.
///
/// # Errors
/// All faults of the net, in text order.
pub fn load(text: &str, context: &LoadContext<'_>) -> Result<Plan, Rejection> {
    let mut faults = Vec::new();
    let tree = text::parse(text, &context.limits, &mut faults);
    let readable = faults.is_empty();
    let resolved = resolve::resolve(&tree, context, &mut faults);
    let mut plan = None;
    // A part that cannot be parsed would make links look missing and ports unconnected.
    if readable {
        match sort::order(&resolved.graph()) {
            Ok(order) => plan = build::build(&resolved, &order, context, &mut faults),
            Err(unordered) => {
                faults.push(resolved.cycle_fault(&unordered.cycle));
                // Only for the parameter faults; the plan is discarded.
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

/// Whether a fault may be only a consequence of a part that could not be parsed.
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
