//! Interval statistics of periodic events.

use std::time::Duration;

/// Shortest, longest and mean interval and their spread, in constant memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Intervals {
    last: Option<Duration>,
    count: u32,
    sum: Duration,
    shortest: Duration,
    longest: Duration,
    /// Sum of squares relative to the first interval, in s², to avoid cancellation.
    squares: f64,
    deviations: f64,
    first: Duration,
}

impl Intervals {
    /// No events yet.
    pub const fn new() -> Self {
        Self {
            last: None,
            count: 0,
            sum: Duration::ZERO,
            shortest: Duration::ZERO,
            longest: Duration::ZERO,
            squares: 0.0,
            deviations: 0.0,
            first: Duration::ZERO,
        }
    }

    /// Handles an event, which ends an interval unless it is the first. A decreasing time counts as an interval of 0.
    pub fn record(&mut self, at: Duration) {
        if let Some(last) = self.last {
            let interval = at.saturating_sub(last);
            if self.count == 0 {
                (self.shortest, self.first) = (interval, interval);
            }
            self.count += 1;
            self.sum = self.sum.saturating_add(interval);
            self.shortest = self.shortest.min(interval);
            self.longest = self.longest.max(interval);
            let deviation = interval.as_secs_f64() - self.first.as_secs_f64();
            self.deviations += deviation;
            self.squares += deviation * deviation;
        }
        self.last = Some(at);
    }

    /// Handles an event without ending an interval.
    pub const fn restart(&mut self, at: Duration) {
        self.last = Some(at);
    }

    /// Time of the last event.
    pub const fn last(&self) -> Option<Duration> {
        self.last
    }

    /// Number of intervals.
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Minimum interval; 0 without any.
    pub const fn shortest(&self) -> Duration {
        self.shortest
    }

    /// Maximum interval; 0 without any.
    pub const fn longest(&self) -> Duration {
        self.longest
    }

    /// Mean interval; 0 without any.
    pub fn mean(&self) -> Duration {
        self.sum.checked_div(self.count).unwrap_or_default()
    }

    /// Standard deviation; 0 without any.
    pub fn deviation(&self) -> Duration {
        if self.count == 0 {
            return Duration::ZERO;
        }
        let count = f64::from(self.count);
        let variance = self.squares / count - (self.deviations / count).powi(2);
        Duration::from_secs_f64(variance.max(0.0).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interval_statistics_match_reference() {
        let ms = Duration::from_millis;
        let mut intervals = Intervals::new();
        intervals.record(ms(1_700_000_000_000));
        assert_eq!((intervals.count(), intervals.mean()), (0, Duration::ZERO));
        for offset in [10, 20, 40, 50] {
            intervals.record(ms(1_700_000_000_000 + offset));
        }
        assert_eq!(intervals.count(), 4);
        assert_eq!(
            (intervals.shortest(), intervals.longest()),
            (ms(10), ms(20))
        );
        assert_eq!(intervals.mean(), Duration::from_micros(12_500));
        // Three of 10 ms, one of 20 ms: the root of 18.75 ms².
        let deviation = intervals.deviation().as_secs_f64() * 1e3;
        assert!((deviation - 18.75_f64.sqrt()).abs() < 1e-6, "{deviation}");
        intervals.restart(ms(1_700_000_009_000));
        assert_eq!(intervals.longest(), ms(20));
    }

    #[test]
    fn interval_decreasing_times_are_tolerated() {
        let mut intervals = Intervals::new();
        intervals.record(Duration::from_secs(5));
        intervals.record(Duration::from_secs(3));
        assert_eq!((intervals.count(), intervals.mean()), (1, Duration::ZERO));
    }
}
