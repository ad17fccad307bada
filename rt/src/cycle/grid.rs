//! The time grid of a cycle: its slots, and how far a followed clock may move them. The statistics record its ticks, so
//! it depends on no other part of the loop. It reads no clock.

use std::time::Duration;

use crate::{Nanos, servo::Estimate};

/// A followed clock moves a slot by at most this part of a period, 0.5 %. Devices and the cycle budget
/// rely on the resulting minimum distance of slots.
pub(super) const STEER_PART: i64 = 200;

/// One cycle to run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tick {
    /// Number of its slot in the grid, from 0; skipped slots have numbers too.
    pub index: u64,
    /// Slots skipped just before this one.
    pub missed: u32,
    /// Logical time: exactly the first slot's plus `index` periods, whatever clock the grid follows.
    pub time: Nanos,
    /// Start of the slot on the grid. The same as `time` unless the grid follows a device's clock.
    pub scheduled: Nanos,
    /// Time at which the thread woke for it.
    pub woken: Nanos,
    /// Distance of the wake-up from its nominal time on the followed clock, while that is known.
    pub phase_error: Option<Nanos>,
}

/// A grid of instants `start + n · period` and its next slot. It reads no clock.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grid {
    period_ns: i64,
    pub(super) index: u64,
    /// Logical time of the next slot.
    time: Nanos,
    /// Start of the next slot without a followed clock: a period after the one before.
    unsteered: Nanos,
    deadline: Nanos,
}

impl Grid {
    /// A grid whose slot 0 is at `start`. A period of zero is taken as 1 ns.
    pub fn new(start: Nanos, period: Duration) -> Self {
        Self {
            period_ns: Nanos::from(period).0.max(1),
            index: 0,
            time: start,
            unsteered: start,
            deadline: start,
        }
    }

    /// Start of the next slot: sleep until then, unless it has passed.
    pub fn deadline(&self) -> Nanos {
        self.deadline
    }

    /// Distance between two slots.
    pub fn period(&self) -> Nanos {
        Nanos(self.period_ns)
    }

    /// Returns the slot to serve at `now`: the next one, or, if it has ended, the one that contains `now`.
    /// The phase stays.
    pub fn next(&mut self, now: Nanos) -> Tick {
        let missed = self.over(now);
        self.advance(missed);
        let tick = Tick {
            index: self.index,
            missed: u32::try_from(missed).unwrap_or(u32::MAX),
            time: self.time,
            scheduled: self.deadline,
            woken: now,
            phase_error: None,
        };
        self.advance(1);
        tick
    }

    /// Skips, uncounted, the slots that began before `now`: for a late start.
    pub fn skip_to(&mut self, now: Nanos) {
        let over = self.over(now);
        self.advance(over);
        if self.deadline < now {
            self.advance(1);
        }
    }

    /// Moves the next slot towards the nearest instant at which the clock of `estimate` shows
    /// `n · period + phase`, by 0.5 % of a period at most. Once aligned, slots follow that clock's rate. Only the last
    /// call before a slot counts.
    pub fn steer(&mut self, estimate: &Estimate, phase: Nanos) {
        let error = estimate.phase_error(self.unsteered, self.period(), phase);
        let most = self.period_ns / STEER_PART;
        self.deadline = self.unsteered - Nanos(error.0.clamp(-most, most));
    }

    /// Number of slots, from the next on, that have ended by `now`.
    fn over(&self, now: Nanos) -> i64 {
        let late = (now - self.deadline).0;
        // The usual case avoids the division.
        if late < self.period_ns {
            0
        } else {
            late / self.period_ns
        }
    }

    fn advance(&mut self, slots: i64) {
        let span = Nanos(slots.saturating_mul(self.period_ns));
        self.index = self.index.saturating_add(slots.unsigned_abs());
        self.time += span;
        self.deadline += span;
        self.unsteered = self.deadline;
    }
}
