//! Cyclic execution: an absolute time grid, and a loop that sleeps from slot to slot of it.
//!
//! The grid runs on the host's clock, or keeps a phase to a device's clock ([`Follow`]). Then it moves
//! smoothly: only the start times of slots change, never their number.
//!
//! It never catches up: missed slots are skipped and counted, since a burst of late cycles would send a
//! burst of stale set-points.

mod follow;
mod grid;

use std::{ops::ControlFlow, time::Duration};

pub use self::{
    follow::Follow,
    grid::{Grid, Tick},
};
use crate::{Nanos, flight::FlightRecorder, linux::clock, stats::StatsWriter};

/// Runs `body` once per slot of the host's clock: [`Cycles::run`] with a period and a start only.
pub fn run_cycles(
    period: Duration,
    start: Option<Nanos>,
    stats: &mut StatsWriter,
    body: impl FnMut(&Tick) -> ControlFlow<()>,
) -> u64 {
    let cycles = Cycles {
        start,
        ..Cycles::every(period)
    };
    cycles.run(stats, body)
}

/// The cycles of a thread: period, start and clock.
#[derive(Debug)]
pub struct Cycles<'a> {
    /// Distance between two slots.
    pub period: Duration,
    /// Start of slot 0; `None` for one period from the call. If it lies in the past, the first cycle is
    /// the next slot of that grid.
    pub start: Option<Nanos>,
    /// The device's clock to follow; `None` for the host's.
    pub follow: Option<Follow>,
    /// Records missed slots and state changes of the followed clock.
    pub flight: Option<&'a FlightRecorder>,
}

impl Cycles<'_> {
    /// A cycle every `period` of the host's clock.
    pub fn every(period: Duration) -> Self {
        Self {
            period,
            start: None,
            follow: None,
            flight: None,
        }
    }

    /// Runs `body` once per slot until it breaks; returns the number of cycles run.
    ///
    /// Each cycle is recorded in `stats` after the body. An estimate that the body writes takes effect in
    /// the next slot. There is no sleep if the next slot has already begun. It does not allocate, and ends
    /// early only if the kernel rejects the sleep ([`sleep_until`](crate::sleep_until)): continuing would
    /// be an endless loop at top priority.
    pub fn run(
        mut self,
        stats: &mut StatsWriter,
        mut body: impl FnMut(&Tick) -> ControlFlow<()>,
    ) -> u64 {
        let mut now = clock::monotonic();
        let start = self.start.unwrap_or_else(|| now + self.period.into());
        let mut grid = Grid::new(start, self.period);
        grid.skip_to(now);
        for cycles in 0.. {
            if let Some(follow) = &mut self.follow {
                follow.steer(&mut grid, now, self.flight);
            }
            if now < grid.deadline() {
                if clock::sleep_until(grid.deadline()).is_err() {
                    return cycles;
                }
                now = clock::monotonic();
            }
            let mut tick = grid.next(now);
            let follow = self.follow.as_ref();
            tick.phase_error = follow.and_then(|follow| follow.phase_error(&grid, &tick));
            stats.note_stall(&tick);
            let flow = body(&tick);
            now = clock::monotonic();
            stats.record(&tick, now);
            self.note(&tick, stats);
            if flow.is_break() {
                return cycles + 1;
            }
        }
        u64::MAX
    }

    fn note(&self, tick: &Tick, stats: &mut StatsWriter) {
        if let Some(error) = tick.phase_error {
            stats.record_phase(error);
        }
        if let (Some(flight), 1..) = (self.flight, tick.missed) {
            flight.note(tick.index, "cycle", "missed slots", tick.missed.into());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{grid::STEER_PART, *};
    use crate::servo::Estimate;

    use proptest::prelude::*;

    const PERIOD: Duration = Duration::from_nanos(100);

    fn tick(index: u64, missed: u32, scheduled: i64, woken: i64) -> Tick {
        Tick {
            index,
            missed,
            time: Nanos(scheduled),
            scheduled: Nanos(scheduled),
            woken: Nanos(woken),
            phase_error: None,
        }
    }

    #[test]
    fn grid_wake_ups_match_table() {
        let mut grid = Grid::new(Nanos(1000), PERIOD);
        let table = [
            tick(0, 0, 1000, 1000),  // on time
            tick(1, 0, 1100, 1199),  // late by almost a period
            tick(2, 0, 1200, 1201),  // the grid keeps its phase
            tick(4, 1, 1400, 1400),  // late by exactly a period: slot 3 is over
            tick(5, 0, 1500, 1499),  // early, as after a failed sleep: the same slot
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
    fn grid_late_start_misses_nothing() {
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
    fn grid_extreme_clocks_saturate() {
        let mut grid = Grid::new(Nanos(i64::MIN), Duration::ZERO);
        assert_eq!(grid.period(), Nanos(1));
        assert_eq!(grid.next(Nanos::MAX).missed, u32::MAX);
        let mut grid = Grid::new(Nanos::MAX, Duration::MAX);
        assert_eq!(grid.next(Nanos::MAX).scheduled, Nanos::MAX);
        assert_eq!(grid.next(Nanos::MAX).index, 1);
    }

    proptest! {
        /// By definition: slots that ended before the wake-up are missed, no others.
        #[test]
        fn grid_slots_are_served_or_counted(
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
    fn grid_steered_keeps_numbers_and_logical_time() {
        let clock = Estimate {
            state: crate::servo::State::Locked,
            remote: Nanos(3_000),
            frequency_ppb: 100_000.0,
            ..Estimate::default()
        };
        let period = Duration::from_micros(100);
        let mut grid = Grid::new(Nanos::ZERO, period);
        let mut spacings = Vec::new();
        let mut before = Nanos::ZERO;
        for index in 0..80 {
            let tick = grid.next(grid.deadline());
            assert_eq!((tick.index, tick.missed), (index, 0));
            assert_eq!(tick.time, Nanos(100_000 * i64::try_from(index).unwrap()));
            spacings.push((tick.scheduled - before).0);
            before = tick.scheduled;
            // The second call must not move it again.
            grid.steer(&clock, Nanos(30_000));
            grid.steer(&clock, Nanos(30_000));
        }
        assert_eq!(spacings[1], 100_500, "27 us ahead, at 0.5 % a cycle");
        assert_eq!(spacings[79], 99_990, "then at that clock's rate");
        let error = clock.phase_error(before, grid.period(), Nanos(30_000));
        assert!(error.abs() <= Nanos(1), "{error}");
    }

    proptest! {
        /// Slots keep their minimum distance and none is lost, even if the followed clock jumps.
        #[test]
        fn grid_keeps_spacing_with_any_clock(
            period in 1_000_i64..50_000_000,
            phase: i64,
            clocks in proptest::collection::vec((any::<i64>(), any::<i64>(), -5e8..5e8_f64, 0_i64..200), 1..60),
        ) {
            let mut grid = Grid::new(Nanos::ZERO, Duration::from_nanos(period.unsigned_abs()));
            let mut before = grid.next(Nanos::ZERO);
            for (local, remote, frequency_ppb, late) in clocks {
                let clock = Estimate {
                    local: Nanos(local),
                    remote: Nanos(remote),
                    frequency_ppb,
                    ..Estimate::default()
                };
                grid.steer(&clock, Nanos(phase));
                let tick = grid.next(grid.deadline() + Nanos(period * late / 100));
                let slots = i64::from(tick.missed) + 1;
                prop_assert_eq!(tick.index, before.index + slots.unsigned_abs());
                prop_assert_eq!(tick.missed, u32::try_from(late / 100).unwrap());
                prop_assert_eq!(tick.time - before.time, Nanos(slots * period));
                let spacing = (tick.scheduled - before.scheduled).0;
                prop_assert!((spacing - slots * period).abs() <= period / STEER_PART, "{}", spacing);
                before = tick;
            }
        }
    }

    #[test]
    fn cycles_follow_clock_and_record_phase() {
        let clock = Estimate {
            state: crate::servo::State::Locked,
            local: clock::monotonic(),
            expires: Nanos::MAX,
            ..Estimate::default()
        };
        let (_writer, estimates) = crate::latest::latest(1, || clock);
        let (mut writer, reader) = crate::stats::pair();
        let cycles = Cycles {
            follow: Some(Follow::new(estimates, Nanos(5_000))),
            ..Cycles::every(Duration::from_micros(50))
        };
        let mut last = None;
        let mut left = 200;
        let ran = cycles.run(&mut writer, |tick| {
            last = Some(*tick);
            left -= 1;
            if left > 0 {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        });
        let error = clock.phase_error(last.unwrap().scheduled, Nanos(50_000), Nanos(5_000));
        assert!(error.abs() <= Nanos(250), "{error}");
        assert_eq!(reader.snapshot().phase_error.count, ran);
    }

    #[test]
    fn cycles_record_missed_slots() {
        let (mut writer, _reader) = crate::stats::pair();
        let flight = FlightRecorder::new(4);
        let cycles = Cycles {
            flight: Some(&flight),
            ..Cycles::every(Duration::from_micros(50))
        };
        let mut missed = 0;
        cycles.run(&mut writer, |tick| {
            while clock::monotonic() < tick.scheduled + Nanos(200_000) {}
            missed = tick.missed;
            if missed > 0 {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        let last = flight.entries().last().unwrap();
        assert_eq!(
            (last.event, last.value),
            ("missed slots", i64::from(missed))
        );
    }

    #[test]
    fn cycles_run_grid_until_break() {
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
    fn cycles_past_start_keeps_phase() {
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
