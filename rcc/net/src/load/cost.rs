//! Adds up the cost bound of a net from those of its primitives. Which of them count is decided by the activation.

use std::collections::HashMap;
use std::time::Duration;

use crate::cost::{Cost, CostShare, NetCost, number};
use crate::definition::Definition;

/// Cost bound of one activation test, ns. Clearing the outputs of an inactive fragment costs less
/// than the skipped steps.
const GUARD_NS: f64 = 20.0;

/// Name of the activation tests among the shares.
const GUARD: &str = "inActive";

impl NetCost {
    /// Adds up primitives and activation tests. `None` instead of a number of array elements marks
    /// primitives that are never active together with the rest; their code is fetched all the same.
    pub(crate) fn of<'d>(
        primitives: impl Iterator<Item = (&'d Definition, Option<usize>)>,
        guards: usize,
    ) -> Self {
        let mut sums: HashMap<*const Definition, (&Definition, usize, usize)> = HashMap::new();
        for (definition, elements) in primitives {
            let (_, count, sum) = sums.entry(definition).or_insert((definition, 0, 0));
            *count += usize::from(elements.is_some());
            *sum += elements.unwrap_or(0);
        }
        let share = |(definition, count, elements): (&Definition, usize, usize)| {
            let Cost {
                first_ns,
                ns,
                element_ns,
            } = definition.cost;
            CostShare {
                primitive: definition.name.clone(),
                count,
                elements,
                cost: span(first_ns + ns * number(count) + element_ns * number(elements)),
            }
        };
        let mut shares: Vec<CostShare> = sums.into_values().map(share).collect();
        if guards > 0 {
            shares.push(CostShare {
                primitive: GUARD.to_owned(),
                count: guards,
                elements: 0,
                cost: span(GUARD_NS * number(guards)),
            });
        }
        shares.sort_by(|a, b| {
            b.cost
                .cmp(&a.cost)
                .then_with(|| a.primitive.cmp(&b.primitive))
        });
        let total = shares.iter().map(|share| share.cost).sum();
        Self { total, shares }
    }
}

/// A duration from ns, rounded up.
fn span(ns: f64) -> Duration {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "out-of-range values saturate"
    )]
    Duration::from_nanos(ns.ceil() as u64)
}
