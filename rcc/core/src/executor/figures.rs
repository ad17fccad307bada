//! Counters of one net, written by the thread that evaluates it and read by any thread at any time. They
//! depend on a clock and are therefore not recorded.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use takt_rt::Nanos;

/// Evaluations in a row, each longer than the period of the net's thread, after which the net is ended.
pub const RUNAWAY_AFTER: u32 = 10;

/// Budget of nets in a thread of that period: four fifths.
#[must_use]
pub fn budget(period: Duration) -> Duration {
    period * 4 / 5
}

/// Counters of one net. One thread stores, with plain relaxed stores; any thread loads, and may see
/// a cycle in one figure and not yet in another.
#[derive(Debug, Default)]
pub struct NetCounters {
    cycles: AtomicU64,
    overruns: AtomicU64,
    over_budget: AtomicU64,
    sum_ns: AtomicU64,
    /// Of the shortest, plus one; 0 before the first.
    min_ns_and_one: AtomicU64,
    max_ns: AtomicU64,
}

/// What [`NetCounters`] held at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NetCounts {
    /// Cycles in which the net was evaluated.
    pub cycles: u64,
    /// Of these, cycles of the thread that were over only after the next should have begun.
    pub overruns: u64,
    /// Of these, evaluations that took longer than the net's budget.
    pub over_budget: u64,
    /// Shortest time of an evaluation.
    pub min: Duration,
    /// Mean time of an evaluation.
    pub mean: Duration,
    /// Longest time of an evaluation, whatever interrupted it included.
    pub max: Duration,
}

impl NetCounters {
    /// Counts an evaluation that took so long.
    pub(super) fn evaluated(&self, took: Nanos, budget: Nanos) {
        let ns = u64::try_from(took.0).unwrap_or(0);
        add(&self.cycles, 1);
        add(&self.over_budget, u64::from(took > budget));
        add(&self.sum_ns, ns);
        let min = self.min_ns_and_one.load(Ordering::Relaxed);
        if min == 0 || ns < min - 1 {
            let one_more = ns.saturating_add(1);
            self.min_ns_and_one.store(one_more, Ordering::Relaxed);
        }
        if ns > self.max_ns.load(Ordering::Relaxed) {
            self.max_ns.store(ns, Ordering::Relaxed);
        }
    }

    /// Counts a cycle of the thread that ended too late.
    pub(super) fn overran(&self) {
        add(&self.overruns, 1);
    }

    /// The figures as of now.
    #[must_use]
    pub fn read(&self) -> NetCounts {
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let cycles = load(&self.cycles);
        let mean_ns = load(&self.sum_ns).checked_div(cycles).unwrap_or(0);
        NetCounts {
            cycles,
            overruns: load(&self.overruns),
            over_budget: load(&self.over_budget),
            min: Duration::from_nanos(load(&self.min_ns_and_one).saturating_sub(1)),
            mean: Duration::from_nanos(mean_ns),
            max: Duration::from_nanos(load(&self.max_ns)),
        }
    }
}

/// For counters with one writer: no read-modify-write needed.
fn add(counter: &AtomicU64, amount: u64) {
    let sum = counter.load(Ordering::Relaxed).wrapping_add(amount);
    counter.store(sum, Ordering::Relaxed);
}
