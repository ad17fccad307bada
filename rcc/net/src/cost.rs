//! Cost bounds of nets: the sum of the declared or measured costs of a net's primitives, over its
//! longest activation. The bound is known before a net runs and decides whether it is accepted; the
//! executor measures what nets really take.

use std::collections::HashMap;
use std::time::Duration;

use crate::definition::Definition;

/// Cost bound of one activation test, ns. Clearing the outputs of an inactive fragment costs less
/// than the skipped steps.
const GUARD_NS: f64 = 20.0;
/// Name of the activation tests among the shares.
const GUARD: &str = "inActive";

/// Cost bound of a primitive of one type on a host, ns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Additional cost of the first one in a net: its code comes from memory.
    pub first_ns: f64,
    /// One step of each.
    pub ns: f64,
    /// Each array element at its in and out ports.
    pub element_ns: f64,
}

impl Cost {
    /// Cost of one further primitive of its type, ns.
    pub(crate) fn of_one(&self, elements: usize) -> f64 {
        self.ns + self.element_ns * number(elements)
    }
}

/// Contribution of the primitives of one type to the cost of a net.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CostShare {
    /// Name of the type.
    pub primitive: String,
    /// Number of primitives that count: those of the longest activation.
    pub count: usize,
    /// Array elements at their in and out ports.
    pub elements: usize,
    /// Their cost bound in one cycle.
    pub cost: Duration,
}

/// Cost bound of one cycle of a net.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NetCost {
    /// The total.
    pub total: Duration,
    /// By type, the most expensive first.
    pub shares: Vec<CostShare>,
}

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

    /// The most expensive types with their percentages, such as
    /// ``20 `KUKA::LWR::InvKin` 83 %, 7 `Motion::Track` 9 %``.
    pub fn heaviest(&self, most: usize) -> String {
        let part = |share: &CostShare| {
            let whole = self.total.as_nanos().max(1);
            let percent = (share.cost.as_nanos() * 100 + whole / 2) / whole;
            format!("{} `{}` {percent} %", share.count, share.primitive)
        };
        let shown: Vec<String> = self.shares.iter().take(most).map(part).collect();
        shown.join(", ")
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

fn number(count: usize) -> f64 {
    count as f64
}
