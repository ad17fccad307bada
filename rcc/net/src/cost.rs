//! What a net costs at most: the sum of what is declared or was measured of its primitives, over its longest
//! activation. A bound to refuse nets by, known before they run; what they really take is for their executor to observe.

use std::collections::HashMap;
use std::time::Duration;

use crate::definition::Definition;

/// What one test whether a fragment is active costs at most, ns. Clearing what an inactive one leaves
/// to others costs less than the steps that are skipped for it.
const GUARD_NS: f64 = 20.0;
/// Name that the tests of activation have among the shares.
const GUARD: &str = "inActive";

/// What a primitive of one type costs at most on a host, ns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// What the first one in a net costs beside the rest: its code comes from memory.
    pub first_ns: f64,
    /// One step of each.
    pub ns: f64,
    /// Each array element at its in and out ports.
    pub element_ns: f64,
}

impl Cost {
    /// What one of them costs beside others of its type, ns.
    pub(crate) fn of_one(&self, elements: usize) -> f64 {
        self.ns + self.element_ns * number(elements)
    }
}

/// What the primitives of one type make of the cost of a net.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CostShare {
    /// Name of the type.
    pub primitive: String,
    /// How many of them count: those of the longest activation.
    pub count: usize,
    /// Array elements at the in and out ports of those.
    pub elements: usize,
    /// What they cost in one cycle at most.
    pub cost: Duration,
}

/// What one cycle of a net costs at most.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NetCost {
    /// All together.
    pub total: Duration,
    /// By type, the heaviest first.
    pub shares: Vec<CostShare>,
}

impl NetCost {
    /// Adds up primitives and tests of activation. Given are the elements of their arrays, or nothing of
    /// those that are never active together with the rest; their code is brought from memory all the same.
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

    /// The heaviest types with their parts of the whole, such as
    /// ``20 `KUKA::LWR::InvKin` 83 %, 7 `Motion::Track` 9 %``.
    #[must_use]
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

/// A time of so many ns, rounded up.
fn span(ns: f64) -> Duration {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "what does not fit saturates: far too much, or nothing"
    )]
    Duration::from_nanos(ns.ceil() as u64)
}

fn number(count: usize) -> f64 {
    #[expect(
        clippy::cast_precision_loss,
        reason = "Limits bounds it far below 2^53"
    )]
    let number = count as f64;
    number
}
