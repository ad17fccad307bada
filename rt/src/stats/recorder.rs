//! One histogram, written by one thread and read by others. The cycle statistics consist of three; drivers
//! have their own, for example of reply times.
//!
//! Its only unit is the nanosecond: a recorder of other quantities would mislead its readers.

use std::{fmt, sync::Arc};

use hdrhistogram::Histogram;

use super::counters::{Counters, HIGHEST};
use crate::Nanos;

/// Counts times from 1 ns to 10 s to two significant digits: wait-free, no allocation. Negative times
/// count as zero, longer ones as 10 s.
#[derive(Debug)]
pub struct Recorder {
    // Not `Clone`, and `record` takes `&mut self`: the counters have one writer.
    counters: Arc<Counters>,
}

impl Recorder {
    /// An empty recorder. All memory, 28 KiB, is allocated here.
    #[expect(
        clippy::new_without_default,
        reason = "it allocates; that should be visible"
    )]
    pub fn new() -> Self {
        Self {
            counters: Arc::new(Counters::new()),
        }
    }

    /// Counts one time.
    pub fn record(&mut self, value: Nanos) {
        self.counters.count(value.0.max(0).unsigned_abs());
    }

    /// A reading endpoint; any number can exist.
    pub fn reader(&self) -> RecorderReader {
        RecorderReader {
            counters: Arc::clone(&self.counters),
        }
    }
}

/// Reads the counts of a [`Recorder`], at any time and from any thread.
#[derive(Debug, Clone)]
pub struct RecorderReader {
    counters: Arc<Counters>,
}

impl RecorderReader {
    /// The current counts. Allocates; not for the real-time path.
    ///
    /// # Panics
    /// Never: the bounds are constants within the library's.
    pub fn read(&self) -> Distribution {
        let mut histogram = Histogram::new_with_bounds(1, HIGHEST, 2)
            .expect("1 ns, 10 s and two digits are within the library's bounds");
        self.counters.for_each_bucket(|upper_ns, count| {
            histogram.saturating_record_n(upper_ns, count);
        });
        let (sum, min, max) = self.counters.sum_min_max();
        Distribution {
            histogram,
            sum,
            min,
            max,
        }
    }
}

/// A reading of a [`Recorder`].
#[derive(Debug, Clone)]
pub struct Distribution {
    histogram: Histogram<u64>,
    sum: u64,
    min: u64,
    max: u64,
}

impl Distribution {
    /// Its summary.
    pub fn summary(&self) -> Summary {
        let count = self.histogram.len();
        if count == 0 {
            return Summary::default();
        }
        Summary {
            min: nanos(self.min),
            p50: self.quantile(0.5),
            p99: self.quantile(0.99),
            p999: self.quantile(0.999),
            max: nanos(self.max),
            mean: nanos(self.sum / count),
            sum: nanos(self.sum),
            count,
        }
    }

    /// The quantile `quantile` (0 to 1), to two significant digits.
    pub fn quantile(&self, quantile: f64) -> Nanos {
        nanos(self.histogram.value_at_quantile(quantile).min(self.max))
    }

    /// The counts as (upper bound, count), ascending, empty buckets left out.
    pub fn buckets(&self) -> impl Iterator<Item = (Nanos, u64)> {
        self.histogram
            .iter_recorded()
            .map(|bucket| (nanos(bucket.value_iterated_to()), bucket.count_at_value()))
    }
}

fn nanos(value: u64) -> Nanos {
    Nanos(i64::try_from(value).unwrap_or(i64::MAX))
}

/// Summary of a distribution of times; all zero if it is empty. Displays as one line.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Summary {
    /// Minimum, exact.
    pub min: Nanos,
    /// Median, to two significant digits.
    pub p50: Nanos,
    /// 99th percentile, to two significant digits.
    pub p99: Nanos,
    /// 99.9th percentile, to two significant digits.
    pub p999: Nanos,
    /// Maximum, exact.
    pub max: Nanos,
    /// Mean, rounded down to a nanosecond.
    pub mean: Nanos,
    /// Sum, exact. It never decreases from one reading to the next.
    pub sum: Nanos,
    /// Number of times.
    pub count: u64,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            p50,
            p99,
            p999,
            max,
            ..
        } = self;
        write!(f, "p50 {p50} p99 {p99} p99.9 {p999} max {max}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use proptest::prelude::*;

    fn distribution(values: impl IntoIterator<Item = i64>) -> Distribution {
        let mut recorder = Recorder::new();
        let reader = recorder.reader();
        values
            .into_iter()
            .for_each(|value| recorder.record(Nanos(value)));
        reader.read()
    }

    #[test]
    fn recorder_quantiles_of_1000_values() {
        let summary = distribution((1..=1000).map(|us| us * 1_000)).summary();
        assert_eq!((summary.min, summary.max), (Nanos(1_000), Nanos(1_000_000)));
        assert_eq!((summary.mean, summary.count), (Nanos(500_500), 1_000));
        for (found, exact) in [
            (summary.p50, 500_000),
            (summary.p99, 990_000),
            (summary.p999, 999_000),
        ] {
            assert!(
                (exact..=exact + exact / 100).contains(&found.0),
                "{found} for {exact}ns"
            );
        }
    }

    #[test]
    fn recorder_sum_is_exact() {
        let mut recorder = Recorder::new();
        let reader = recorder.reader();
        for ns in [10, 10, 0] {
            recorder.record(Nanos(ns));
        }
        let summary = reader.read().summary();
        assert_eq!((summary.mean, summary.sum), (Nanos(6), Nanos(20)));
        recorder.record(Nanos(0));
        assert_eq!(reader.read().summary().sum, Nanos(20));
    }

    #[test]
    fn recorder_range_saturates_extremes_are_exact() {
        let distribution = distribution([-5, 0, i64::MAX]);
        let summary = distribution.summary();
        assert_eq!(
            (summary.min, summary.max, summary.count),
            (Nanos(0), Nanos::MAX, 3)
        );
        let buckets: Vec<_> = distribution.buckets().collect();
        assert_eq!(buckets.len(), 2);
        assert_eq!(buckets[0], (Nanos(0), 2));
        assert!((10_000_000_000..10_100_000_000).contains(&buckets[1].0.0));
    }

    proptest! {
        /// Compares with the library recording the same values.
        #[test]
        fn recorder_matches_hdrhistogram(values in proptest::collection::vec(0_i64..20_000_000_000, 1..300)) {
            let mut library = Histogram::<u64>::new_with_bounds(1, HIGHEST, 2).unwrap();
            for &value in &values {
                library.saturating_record(value.unsigned_abs().min(HIGHEST));
            }
            let ours = distribution(values);
            let theirs: Vec<_> =
                library.iter_recorded().map(|b| (b.value_iterated_to(), b.count_at_value())).collect();
            let found: Vec<_> = ours.buckets().map(|(upper, n)| (upper.0.unsigned_abs(), n)).collect();
            prop_assert_eq!(found, theirs);
        }
    }
}
