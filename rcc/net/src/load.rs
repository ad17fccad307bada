//! From net text to plan: parse, resolve, sort, build. This runs off the real-time path and reports
//! all faults at once. The executor owns the plan afterwards.

mod activation;
mod build;
mod builder;
mod context;
mod cost;
mod failure;
mod findings;
mod graph;
mod inter;
mod origin;
mod parts;
mod ports;
mod resolve;
mod resolved;
mod sort;
mod taps;

use std::time::Duration;

use crate::fault::{FAULTS_MAX, Fault, FaultKind, Rejection};
use crate::finding::Finding;
use crate::limits::Limits;
use crate::plan::Plan;
use crate::text::{self, Fragment};
use parts::{Effects, inherited};
use resolved::Resolved;

pub use builder::Build;
pub use context::LoadContext;

/// The text of a net as a syntax tree.
#[derive(Debug)]
pub struct Parsed<'t> {
    tree: Fragment<'t>,
    faults: Vec<Fault>,
}

impl<'t> Parsed<'t> {
    /// Parses a net. Its faults are reported when it is built.
    #[must_use]
    pub fn new(text: &'t str, limits: &Limits) -> Self {
        let mut faults = Vec::new();
        let tree = text::parse(text, limits, &mut faults);
        Self { tree, faults }
    }
}

/// A net that is parsed, resolved and sorted. It can be built for several periods: which one it gets may depend on the devices
/// that its plan commands.
#[derive(Debug)]
pub struct Sorted<'t> {
    context: LoadContext<'t>,
    resolved: Resolved<'t>,
    /// The order of evaluation; `None` if the text could not be parsed completely.
    order: Option<Vec<u32>>,
    faults: Vec<Fault>,
}

impl<'t> Sorted<'t> {
    /// Resolves all names of a net and sorts it.
    #[must_use]
    pub fn new(parsed: &'t Parsed<'t>, context: &LoadContext<'t>) -> Self {
        let mut faults = parsed.faults.clone();
        let is_readable = faults.is_empty();
        let resolved = resolve::resolve(&parsed.tree, context, &mut faults);
        let order = is_readable.then(|| {
            sort::order(&resolved.graph()).unwrap_or_else(|unordered| {
                faults.push(resolved.cycle_fault(&unordered.cycle));
                // Only for the parameter faults; the plan is discarded.
                unordered.units
            })
        });
        if order.is_none() {
            // A part that cannot be parsed makes links look missing and ports unconnected.
            faults.retain(|f| !is_consequence(&f.kind));
        }
        Self {
            context: *context,
            resolved,
            order,
            faults,
        }
    }

    /// Builds the plan for a period, with that bound on the cost of a cycle.
    ///
    /// # Errors
    /// All faults of the net, in text order.
    pub fn build(&self, period: Duration, cost: Option<Duration>) -> Result<Plan, Rejection> {
        self.build_with(period, cost, |_, _| ())
            .map(|(plan, ())| plan)
    }

    /// Builds the plan, and analyses the net if it has no faults.
    fn build_with<T>(
        &self,
        period: Duration,
        cost: Option<Duration>,
        analyse: impl Fn(&Resolved<'_>, &[Effects]) -> T,
    ) -> Result<(Plan, T), Rejection> {
        let limits = Limits {
            cost,
            ..self.context.limits
        };
        let context = LoadContext {
            period,
            limits,
            ..self.context
        };
        let mut faults = self.faults.clone();
        let order = self.order.as_deref();
        let plan = order.and_then(|it| build::build(&self.resolved, it, &context, &mut faults));
        faults.retain(|f| f.kind != inherited());
        match plan {
            Some((plan, effects)) if faults.is_empty() => {
                Ok((plan, analyse(&self.resolved, &effects)))
            }
            _ => {
                faults.sort_by_key(|f| f.at.start);
                faults.dedup();
                faults.truncate(FAULTS_MAX);
                Err(Rejection { faults })
            }
        }
    }
}

/// Checks a net and builds its plan.
pub fn load(text: &str, context: &LoadContext<'_>) -> Result<Plan, Rejection> {
    let parsed = Parsed::new(text, &context.limits);
    Sorted::new(&parsed, context).build(context.period, context.limits.cost)
}

/// As [`load`], and looks for what is probably not meant in a net without faults.
///
/// # Errors
/// All faults of the net, in text order.
pub fn check(text: &str, context: &LoadContext<'_>) -> Result<(Plan, Vec<Finding>), Rejection> {
    let parsed = Parsed::new(text, &context.limits);
    Sorted::new(&parsed, context).build_with(context.period, context.limits.cost, findings::find)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoDevices;
    use crate::registry::Registry;

    const NET: &str = "{p=Core::CycleTime(),out=Core::DoubleNetcommOut(inValue=p.outValue,Key='p'),
        never=Core::BooleanValue(),outTerminate=never.outValue}";

    #[test]
    fn sorted_net_builds_for_each_period() {
        let registry = Registry::core();
        let ms = Duration::from_millis;
        let context = |period| LoadContext {
            registry: &registry,
            devices: &NoDevices,
            period,
            limits: Limits::default(),
        };
        let (parsed, any) = (Parsed::new(NET, &Limits::default()), context(ms(1)));
        let sorted = Sorted::new(&parsed, &any);
        for period in [ms(1), ms(4), ms(20)] {
            let values = |mut plan: Plan| {
                let moment = crate::Moment {
                    cycle: 1,
                    ..crate::Moment::default()
                };
                plan.evaluate(&crate::Image::default(), moment);
                (plan.period(), plan.outbox_words().collect::<Vec<_>>())
            };
            let again = values(sorted.build(period, None).unwrap());
            assert_eq!(again, values(load(NET, &context(period)).unwrap()));
            assert_eq!(again.0, period);
        }
        assert!(sorted.build(ms(1), Some(Duration::from_nanos(1))).is_err());
        assert!(sorted.build(ms(1), Some(ms(1))).is_ok());
    }
}
