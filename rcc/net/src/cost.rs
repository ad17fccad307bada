//! Cost bounds of nets: the sum of the declared or measured costs of a net's primitives, over its
//! longest activation. The bound is known before a net runs and decides whether it is accepted; the
//! executor measures what nets really take.

use std::time::Duration;

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

pub(crate) fn number(count: usize) -> f64 {
    count as f64
}
