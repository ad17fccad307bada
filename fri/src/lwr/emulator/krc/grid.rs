//! The controller's own clock: a grid of cycles that never shifts, whoever is late. It does not read any clock.

use std::ops::RangeInclusive;
use std::time::Duration;

const PERIODS: RangeInclusive<Duration> = Duration::from_millis(1)..=Duration::from_millis(100);

/// Cycles of one period from a start.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    start: Duration,
    period: Duration,
    next: Duration,
    index: u64,
    is_late: bool,
    stalls: u64,
}

impl Grid {
    /// The first cycle is due at `start`.
    pub(super) fn new(start: Duration, period: Duration) -> Self {
        let period = period.clamp(*PERIODS.start(), *PERIODS.end());
        Self {
            start,
            period,
            next: start,
            index: 0,
            is_late: false,
            stalls: 0,
        }
    }

    /// Begins the cycle that `now` lies in, skipping those missed, and returns its number, from 1.
    pub(super) fn advance(&mut self, now: Duration) -> u64 {
        let behind = now.saturating_sub(self.next);
        let missed = behind.as_nanos() / self.period.as_nanos();
        let missed = u32::try_from(missed).unwrap_or(u32::MAX - 1);
        self.is_late = behind > self.period / 4;
        self.next += self.period * (missed + 1);
        self.index += u64::from(missed) + 1;
        self.stalls += u64::from(missed);
        self.index
    }

    /// Number of the cycle begun last.
    pub(super) fn index(&self) -> u64 {
        self.index
    }

    /// Nominal time of the cycle begun last, since the start.
    pub(super) fn time(&self) -> Duration {
        self.next
            .saturating_sub(self.start)
            .saturating_sub(self.period)
    }

    /// When the next cycle is due.
    pub(super) fn next(&self) -> Duration {
        self.next
    }

    pub(super) fn period(&self) -> Duration {
        self.period
    }

    /// Whether the cycle begun last began more than a quarter period late.
    pub(super) fn is_late(&self) -> bool {
        self.is_late
    }

    /// Cycles skipped so far.
    pub(super) fn stalls(&self) -> u64 {
        self.stalls
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_never_shifts() {
        let ms = Duration::from_millis;
        let mut grid = Grid::new(ms(10), ms(4));
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
    fn periods_are_those_of_fri_open() {
        assert_eq!(
            Grid::new(Duration::ZERO, Duration::ZERO).period(),
            Duration::from_millis(1)
        );
        assert_eq!(
            Grid::new(Duration::ZERO, Duration::MAX).period(),
            Duration::from_millis(100)
        );
    }
}
