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

/// Detects that periodic events are of two sources: every other interval is alike, neighbours are not. Two sources half
/// a period apart look like one of twice the rate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Interleaved {
    last: Option<Duration>,
    /// The last interval, and the one before.
    intervals: [Option<Duration>; 2],
    alternating: u32,
    regular: u32,
}

/// Intervals that count as evidence, and how many more of them than others.
const ALTERNATING_MIN: u32 = 8;
const ALTERNATING_FACTOR: u32 = 4;

impl Interleaved {
    /// Handles an event.
    pub(super) fn record(&mut self, at: Duration) {
        let Some(last) = self.last.replace(at) else {
            return;
        };
        let interval = at.saturating_sub(last);
        let [one, two] = self.intervals;
        self.intervals = [Some(interval), one];
        let (Some(one), Some(two)) = (one, two) else {
            return;
        };
        let period = interval + one;
        let is_alike = interval.abs_diff(two) <= period / 10;
        let differs = interval.abs_diff(one) >= period / 6;
        if is_alike && differs {
            self.alternating += 1;
        } else {
            self.regular += 1;
        }
    }

    /// Whether there are two sources.
    pub const fn is_found(&self) -> bool {
        self.alternating >= ALTERNATING_MIN
            && self.alternating >= ALTERNATING_FACTOR.saturating_mul(self.regular)
    }

    /// Their period, if there are two.
    pub fn period(&self) -> Option<Duration> {
        let [one, two] = self.intervals;
        Some(one? + two?).filter(|_| self.is_found())
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

    #[test]
    fn interval_two_sources_differ_from_jitter() {
        let us = Duration::from_micros;
        let found = |offset: u64, jitter: u64| {
            let mut events = Interleaved::default();
            for n in 0..20 {
                let noise = n * 7919 % (2 * jitter + 1);
                events.record(us(n * 10_000 + noise));
                if offset > 0 {
                    events.record(us(n * 10_000 + offset + noise));
                }
            }
            events.is_found()
        };
        assert!(found(1_000, 300) && found(7_000, 300));
        assert!(!found(0, 0) && !found(0, 2_000) && !found(0, 4_900));
    }
}
