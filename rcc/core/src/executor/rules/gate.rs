//! The gate of a rule: its nets begin in the cycle nearest to an instant that is given later, or not at all. The controller opens it
//! by one atomic word, which the net thread reads at the beginning of each cycle; neither waits for the other.
//!
//! ```text
//!   closed ──open_at──▶ open at T ──cycle nearest to T──▶ begun
//!     │                    │  └─the thread missed that cycle─▶ the rule fails
//!     └────────release─────┴──▶ released: the rule never fires
//! ```

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

use takt_rt::Nanos;

const CLOSED: i64 = i64::MAX;
const RELEASED: i64 = i64::MIN;
const BEGUN: i64 = i64::MIN + 1;

/// The cycle in which the nets of a gated rule began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Begun {
    /// Number of the cycle in its thread.
    pub cycle: u64,
    /// Its nominal begin on `CLOCK_MONOTONIC`, to which set-points refer.
    pub begin: Nanos,
    /// When the thread woke for it.
    pub woken: Nanos,
}

/// What a gate says about a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Not this cycle.
    Wait,
    /// This cycle is the nearest.
    Due,
    /// The nearest cycle was missed.
    Late,
    /// Never.
    Released,
}

/// When the nets of a rule may begin.
#[derive(Debug)]
pub struct Gate {
    /// Period of its nets, and that in cycles of their thread.
    period: Nanos,
    every: u64,
    /// The instant, or one of the words above.
    at: AtomicI64,
    /// Those of [`Begun`]; valid once `at` is [`BEGUN`] and the rule has fired.
    cycle: AtomicU64,
    begin: AtomicI64,
    woken: AtomicI64,
}

impl Gate {
    /// A closed gate for nets of this period, which is so many cycles of their thread.
    #[must_use]
    pub fn new(period: Nanos, every: u64) -> Self {
        Self {
            period,
            every: every.max(1),
            at: AtomicI64::new(CLOSED),
            cycle: AtomicU64::new(0),
            begin: AtomicI64::new(0),
            woken: AtomicI64::new(0),
        }
    }

    /// Opens it: the nets begin in the cycle nearest to this instant of `CLOCK_MONOTONIC`. Returns whether it was closed.
    pub fn open_at(&self, at: Nanos) -> bool {
        let at = at.0.clamp(BEGUN + 1, CLOSED - 1);
        self.replace(CLOSED, at)
    }

    /// Releases it. Returns whether the nets had not begun; from then on they do not.
    pub fn release(&self) -> bool {
        loop {
            let now = self.at.load(Ordering::Acquire);
            if now == BEGUN {
                return false;
            }
            if now == RELEASED || self.replace(now, RELEASED) {
                return true;
            }
        }
    }

    /// The cycle in which the nets began; `None` before, and if they could not.
    #[must_use]
    pub fn begun(&self) -> Option<Begun> {
        // Written last: 0 is "never".
        let cycle = self.cycle.load(Ordering::Acquire);
        (cycle != 0).then(|| Begun {
            cycle,
            begin: Nanos(self.begin.load(Ordering::Relaxed)),
            woken: Nanos(self.woken.load(Ordering::Relaxed)),
        })
    }

    fn replace(&self, from: i64, to: i64) -> bool {
        let (order, failed) = (Ordering::AcqRel, Ordering::Acquire);
        self.at.compare_exchange(from, to, order, failed).is_ok()
    }

    /// Judges a cycle that begins at `begin`. [`Verdict::Due`] is given once, and not after a release.
    pub(super) fn pass(&self, cycle: u64, begin: Nanos) -> Verdict {
        let at = self.at.load(Ordering::Acquire);
        let half = self.period.0 / 2;
        match at {
            CLOSED => return Verdict::Wait,
            RELEASED | BEGUN => return Verdict::Released,
            _ => {}
        }
        if begin.0 < at.saturating_sub(half) {
            return Verdict::Wait;
        }
        if begin.0 >= at.saturating_add(self.period.0 - half) {
            return Verdict::Late;
        }
        if !cycle.is_multiple_of(self.every) {
            return Verdict::Wait;
        }
        if self.replace(at, BEGUN) {
            Verdict::Due
        } else {
            Verdict::Released
        }
    }

    /// The nets begin in this cycle.
    pub(super) fn note(&self, begun: Begun) {
        self.begin.store(begun.begin.0, Ordering::Relaxed);
        self.woken.store(begun.woken.0, Ordering::Relaxed);
        self.cycle.store(begun.cycle, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn gate(every: u64) -> Gate {
        Gate::new(Nanos(MS * every.cast_signed()), every)
    }

    #[test]
    fn gate_is_due_once_in_nearest_cycle() {
        // The grid is off by 400 us and by 600 us from the instant.
        for (shift, nearest) in [(400_000, 10), (600_000, 9)] {
            let gate = gate(1);
            let begin = |cycle: i64| Nanos(cycle * MS + shift);
            assert_eq!(gate.pass(8, begin(8)), Verdict::Wait);
            assert!(gate.open_at(Nanos(10 * MS)));
            assert!(!gate.open_at(Nanos(11 * MS)), "an instant is final");
            let due: Vec<_> = (8..13_i64)
                .filter(|cycle| gate.pass(cycle.cast_unsigned(), begin(*cycle)) == Verdict::Due)
                .collect();
            assert_eq!(due, [nearest]);
            assert!(!gate.release());
        }
    }

    #[test]
    fn gate_of_slower_nets_waits_for_their_cycle() {
        let gate = gate(4);
        gate.open_at(Nanos(9 * MS));
        let verdict = |cycle: i64| gate.pass(cycle.cast_unsigned(), Nanos(cycle * MS));
        assert_eq!(verdict(7), Verdict::Wait);
        assert_eq!(verdict(8), Verdict::Due);
    }

    #[test]
    fn gate_missed_or_released_never_is_due() {
        let missed = gate(1);
        missed.open_at(Nanos(10 * MS));
        assert_eq!(missed.pass(9, Nanos(9 * MS)), Verdict::Wait);
        assert_eq!(missed.pass(11, Nanos(11 * MS)), Verdict::Late);
        let slow = gate(4);
        slow.open_at(Nanos(9 * MS));
        assert_eq!(slow.pass(9, Nanos(9 * MS)), Verdict::Wait);
        assert_eq!(slow.pass(12, Nanos(12 * MS)), Verdict::Late);
        let released = gate(1);
        released.open_at(Nanos(10 * MS));
        assert!(released.release() && released.release());
        assert_eq!(released.pass(10, Nanos(10 * MS)), Verdict::Released);
        assert_eq!(released.begun(), None);
    }
}
