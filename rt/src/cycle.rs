//! The heartbeat: an absolute time grid, and a loop that sleeps from slot to slot of it.
//!
//! It does not follow another clock, and never catches up: slots missed are skipped and counted, since
//! a burst of late cycles would send a burst of old set-points.

use std::{ops::ControlFlow, time::Duration};

use crate::{Nanos, linux::clock, stats::StatsWriter};

/// One cycle about to be run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tick {
    /// Number of its slot in the grid, from 0; skipped slots have numbers too.
    pub index: u64,
    /// Slots skipped just before this one.
    pub missed: u32,
    /// When the slot began, on the grid.
    pub scheduled: Nanos,
    /// When the thread came to serve it.
    pub woken: Nanos,
}

/// A grid of instants `start + n · period`, and which of them comes next. Reads no clock.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grid {
    period_ns: i64,
    index: u64,
    deadline: Nanos,
}

impl Grid {
    /// A grid whose slot 0 is at `start`. A period of zero is taken as 1 ns.
    pub fn new(start: Nanos, period: Duration) -> Self {
        Self {
            period_ns: Nanos::from(period).0.max(1),
            index: 0,
            deadline: start,
        }
    }

    /// When the next slot begins: sleep until then, unless it has passed.
    pub fn deadline(&self) -> Nanos {
        self.deadline
    }

    /// The distance between two slots.
    pub fn period(&self) -> Nanos {
        Nanos(self.period_ns)
    }

    /// Takes the slot to serve at `now`: the next, or, if that one and others are over, the one
    /// that `now` lies in. The phase stays.
    pub fn next(&mut self, now: Nanos) -> Tick {
        let missed = self.over(now);
        self.advance(missed);
        let tick = Tick {
            index: self.index,
            missed: u32::try_from(missed).unwrap_or(u32::MAX),
            scheduled: self.deadline,
            woken: now,
        };
        self.advance(1);
        tick
    }

    /// Leaves out, uncounted, the slots that began before `now`: for a late start.
    pub fn skip_to(&mut self, now: Nanos) {
        let over = self.over(now);
        self.advance(over);
        if self.deadline < now {
            self.advance(1);
        }
    }

    /// How many slots, from the next on, have ended by `now`.
    fn over(&self, now: Nanos) -> i64 {
        let late = (now - self.deadline).0;
        // Nearly always, and then without the division.
        if late < self.period_ns {
            0
        } else {
            late / self.period_ns
        }
    }

    fn advance(&mut self, slots: i64) {
        self.index = self.index.saturating_add(slots.unsigned_abs());
        self.deadline += Nanos(slots.saturating_mul(self.period_ns));
    }
}

/// Runs `body` once per slot of a grid until it breaks; returns the number of cycles run.
///
/// Slot 0 is at `start`, or one period from now. If `start` lies in the past, the first cycle is the
/// next slot of that grid. Each cycle is recorded in `stats`, after the body. The sleep is left out when
/// the next slot has begun already. Allocates nothing; ends early only if the kernel refuses to sleep
/// ([`sleep_until`](crate::sleep_until)), since going on would be an endless loop at top priority.
pub fn run_cycles(
    period: Duration,
    start: Option<Nanos>,
    stats: &mut StatsWriter,
    mut body: impl FnMut(&Tick) -> ControlFlow<()>,
) -> u64 {
    let mut now = clock::monotonic();
    let mut grid = Grid::new(start.unwrap_or_else(|| now + period.into()), period);
    grid.skip_to(now);
    for cycles in 0.. {
        if now < grid.deadline() {
            if clock::sleep_until(grid.deadline()).is_err() {
                return cycles;
            }
            now = clock::monotonic();
        }
        let tick = grid.next(now);
        let flow = body(&tick);
        now = clock::monotonic();
        stats.record(&tick, now);
        if flow.is_break() {
            return cycles + 1;
        }
    }
    u64::MAX
}

#[cfg(test)]
mod tests {
    use super::*;

    use proptest::prelude::*;

    const PERIOD: Duration = Duration::from_nanos(100);

    fn tick(index: u64, missed: u32, scheduled: i64, woken: i64) -> Tick {
        Tick {
            index,
            missed,
            scheduled: Nanos(scheduled),
            woken: Nanos(woken),
        }
    }

    #[test]
    fn table_of_wake_ups() {
        let mut grid = Grid::new(Nanos(1000), PERIOD);
        let table = [
            tick(0, 0, 1000, 1000),  // on the dot
            tick(1, 0, 1100, 1199),  // late by almost a period
            tick(2, 0, 1200, 1201),  // the grid keeps its phase
            tick(4, 1, 1400, 1400),  // late by exactly a period: slot 3 is over
            tick(5, 0, 1500, 1499),  // early, as after a refused sleep: the slot all the same
            tick(15, 9, 2500, 2555), // a long outage
            tick(16, 0, 2600, 2600),
        ];
        for expected in table {
            assert_eq!(
                grid.deadline(),
                expected.scheduled - Nanos(100 * i64::from(expected.missed))
            );
            assert_eq!(grid.next(expected.woken), expected);
        }
    }

    #[test]
    fn a_late_start_misses_nothing() {
        for (now, index, deadline) in [
            (999, 0, 1000),
            (1000, 0, 1000),
            (1001, 1, 1100),
            (1100, 1, 1100),
            (1350, 4, 1400),
        ] {
            let mut grid = Grid::new(Nanos(1000), PERIOD);
            grid.skip_to(Nanos(now));
            assert_eq!(grid.deadline(), Nanos(deadline), "from {now}");
            assert_eq!(
                grid.next(Nanos(deadline)),
                tick(index, 0, deadline, deadline)
            );
        }
    }

    #[test]
    fn absurd_clocks_saturate() {
        let mut grid = Grid::new(Nanos(i64::MIN), Duration::ZERO);
        assert_eq!(grid.period(), Nanos(1));
        assert_eq!(grid.next(Nanos::MAX).missed, u32::MAX);
        let mut grid = Grid::new(Nanos::MAX, Duration::MAX);
        assert_eq!(grid.next(Nanos::MAX).scheduled, Nanos::MAX);
        assert_eq!(grid.next(Nanos::MAX).index, 1);
    }

    proptest! {
        /// Against the definition: slots that ended before the wake-up are missed, no other.
        #[test]
        fn every_slot_is_served_or_counted(
            start in -1_000_000_i64..1_000_000,
            period in 1_u64..5_000,
            steps in proptest::collection::vec(0_i64..20_000, 1..50),
        ) {
            let mut grid = Grid::new(Nanos(start), Duration::from_nanos(period));
            let period = i64::try_from(period).unwrap();
            let (mut now, mut slots) = (start, 0);
            for step in steps {
                now = (now + step).max(grid.deadline().0);
                let tick = grid.next(Nanos(now));
                slots += u64::from(tick.missed) + 1;
                prop_assert_eq!(slots, tick.index + 1);
                prop_assert_eq!(tick.scheduled.0, start + i64::try_from(tick.index).unwrap() * period);
                prop_assert!((0..period).contains(&(now - tick.scheduled.0)));
                prop_assert_eq!(grid.deadline(), tick.scheduled + Nanos(period));
            }
        }
    }

    #[test]
    fn the_loop_runs_the_grid_and_stops_when_told() {
        let (mut writer, reader) = crate::stats::pair();
        let mut ticks = Vec::new();
        let cycles = run_cycles(Duration::from_micros(50), None, &mut writer, |tick| {
            ticks.push(*tick);
            if ticks.len() == 20 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        let snapshot = reader.snapshot();
        assert_eq!((cycles, snapshot.cycles), (20, 20));
        let missed: u64 = ticks.iter().map(|tick| u64::from(tick.missed)).sum();
        assert_eq!(snapshot.overruns, missed);
        assert_eq!(ticks[19].index, 19 + missed);
        assert!(ticks.iter().all(|tick| tick.woken >= tick.scheduled));
    }

    #[test]
    fn a_start_in_the_past_keeps_its_phase() {
        let (mut writer, reader) = crate::stats::pair();
        let start = clock::monotonic() - Nanos::from_millis(10);
        let mut first = None;
        run_cycles(
            Duration::from_micros(100),
            Some(start),
            &mut writer,
            |tick| {
                first = Some(*tick);
                ControlFlow::Break(())
            },
        );
        let first = first.unwrap();
        assert_eq!((first.scheduled - start).0 % 100_000, 0);
        assert!(first.index >= 100);
        assert_eq!(reader.snapshot().overruns, u64::from(first.missed));
    }
}
