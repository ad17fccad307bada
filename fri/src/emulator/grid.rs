//! The controller's own clock: a grid of cycles that never shifts, even if host or client is late. It reads no clock.

use std::ops::RangeInclusive;
use std::time::Duration;

const PERIODS: RangeInclusive<Duration> = Duration::from_millis(1)..=Duration::from_millis(100);
/// Longest stall of the host through which the robot moves on.
const MOVES_ON: Duration = Duration::from_millis(20);

/// Cycles of one period since a start.
#[derive(Debug, Clone)]
pub(crate) struct Grid {
    period: Duration,
    /// The period on the host's clock; differs by the drift.
    span: Duration,
    next: Duration,
    index: u64,
    is_late: bool,
    stalls: u64,
    /// Cycles skipped before the one begun last.
    skipped: u32,
    /// Nominal time of the cycle begun last.
    time: Duration,
    slower: f64,
}

impl Grid {
    /// The first cycle is due at `start`; the controller's clock runs slow by `drift_ppm` (at most 100,000 either way).
    pub(crate) fn new(start: Duration, period: Duration, drift_ppm: f64) -> Self {
        let drift_ppm = if drift_ppm.is_nan() { 0.0 } else { drift_ppm };
        let mut grid = Self {
            period,
            span: period,
            next: start,
            index: 0,
            is_late: false,
            stalls: 0,
            skipped: 0,
            time: Duration::ZERO,
            slower: 1.0 + drift_ppm.clamp(-1e5, 1e5) / 1e6,
        };
        grid.set_period(period);
        grid
    }

    /// Changes the period from the next cycle on, 1 ms to 100 ms.
    pub(crate) fn set_period(&mut self, period: Duration) {
        self.period = period.clamp(*PERIODS.start(), *PERIODS.end());
        self.span = self.period.mul_f64(self.slower);
    }

    /// Begins the cycle that contains `now`, skips missed ones, and returns its number, from 1.
    pub(crate) fn advance(&mut self, now: Duration) -> u64 {
        let behind = now.saturating_sub(self.next);
        let missed = behind.as_nanos() / self.span.as_nanos();
        let missed = u32::try_from(missed).unwrap_or(u32::MAX - 1);
        self.is_late = behind > self.period / 4;
        self.next += self.span * (missed + 1);
        let is_first = self.index == 0;
        self.time += self.period * (missed + u32::from(!is_first));
        self.index += u64::from(missed) + 1;
        self.stalls += u64::from(missed);
        self.skipped = missed;
        self.index
    }

    /// Number of the cycle begun last.
    pub(crate) fn index(&self) -> u64 {
        self.index
    }

    /// Nominal time of the cycle begun last, since the start, on the controller's clock.
    pub(crate) fn time(&self) -> Duration {
        self.time
    }

    /// When the cycle begun last was due, on the clock of the owner.
    pub(crate) fn now(&self) -> Duration {
        self.next.saturating_sub(self.span)
    }

    /// When the cycles were due through which the robot moved on while the host stalled, and the one begun last: a real
    /// robot does not stall with the host. Of a stall longer than 20 ms these are the first cycles.
    pub(crate) fn passed(&self) -> impl Iterator<Item = Duration> + use<> {
        let (last, span, skipped) = (self.now(), self.span, self.skipped);
        let moves_on = u32::try_from(MOVES_ON.as_nanos() / span.as_nanos()).unwrap_or(0);
        let ago = (0..skipped).map(move |number| skipped - number);
        let ago = ago.take(moves_on as usize);
        ago.chain([0])
            .map(move |ago| last.saturating_sub(span * ago))
    }

    /// When the next cycle is due.
    pub(crate) fn next(&self) -> Duration {
        self.next
    }

    pub(crate) fn period(&self) -> Duration {
        self.period
    }

    /// Whether the cycle begun last began more than a quarter period late.
    pub(crate) fn is_late(&self) -> bool {
        self.is_late
    }

    /// Cycles skipped so far.
    pub(crate) fn stalls(&self) -> u64 {
        self.stalls
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_robot_moves_on_through_skipped_cycles() {
        let ms = Duration::from_millis;
        let mut grid = Grid::new(ms(10), ms(4), 0.0);
        for (now, passed) in [
            (10, &[10][..]),
            (15, &[14]),
            (27, &[18, 22, 26]),
            // Five cycles of 4 ms: more than 20 ms are not made up.
            (60, &[30, 34, 38, 42, 46, 58]),
            (62, &[62]),
        ] {
            grid.advance(ms(now));
            let expected: Vec<_> = passed.iter().map(|it| ms(*it)).collect();
            assert_eq!(grid.passed().collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn grid_late_owner_keeps_phase() {
        let ms = Duration::from_millis;
        let mut grid = Grid::new(ms(10), ms(4), 0.0);
        for (now, index, next, late, stalls) in [
            (10, 1, 14, false, 0),
            (15, 2, 18, false, 0),
            (20, 3, 22, true, 0),
            (33, 6, 34, true, 2),
            (34, 7, 38, false, 2),
        ] {
            assert_eq!(grid.advance(ms(now)), index);
            assert_eq!(
                (grid.next(), grid.is_late(), grid.stalls()),
                (ms(next), late, stalls)
            );
            assert_eq!(grid.time(), ms(4) * u32::try_from(index - 1).unwrap());
        }
    }

    #[test]
    fn grid_period_is_clamped_to_fri_open() {
        assert_eq!(
            Grid::new(Duration::ZERO, Duration::ZERO, 0.0).period(),
            Duration::from_millis(1)
        );
        assert_eq!(
            Grid::new(Duration::ZERO, Duration::MAX, 0.0).period(),
            Duration::from_millis(100)
        );
    }

    #[test]
    fn grid_drift_stretches_host_time_only() {
        let ms = Duration::from_millis;
        let mut grid = Grid::new(ms(0), ms(1), 200.0);
        for _ in 0..=10_000 {
            grid.advance(grid.next());
        }
        assert_eq!(grid.time(), ms(10_000));
        assert_eq!(grid.next() - ms(1), ms(10_002) + Duration::from_nanos(200));
    }
}
