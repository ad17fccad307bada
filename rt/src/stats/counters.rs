//! The counters of one histogram, shared by one writer and any number of readers.
//!
//! No quantiles: a reader fills a library histogram from the counters.
//!
//! The bucket of a value: below 256 the value itself; above, its leading eight bits, which is 128
//! buckets per power of two and a width below 1 % of the value. `hdrhistogram` with two significant
//! digits has the same bounds, which a test checks.

use std::sync::atomic::{AtomicU64, Ordering};

/// Larger values than this, 10 s in ns, are counted in the last bucket.
pub(super) const HIGHEST: u64 = 10_000_000_000;

const BUCKETS: usize = bucket_of(HIGHEST) + 1;

#[expect(
    clippy::cast_possible_truncation,
    reason = "the result is below 64 · 128; const context"
)]
const fn bucket_of(value: u64) -> usize {
    let value = if value < HIGHEST { value } else { HIGHEST };
    let shift = (u64::BITS - value.leading_zeros()).saturating_sub(8);
    shift as usize * 128 + (value >> shift) as usize
}

/// The largest value that `bucket` counts.
fn upper_bound(bucket: usize) -> u64 {
    let shift = (bucket / 128).saturating_sub(1);
    let leading = (bucket - shift * 128) as u64;
    ((leading + 1) << shift) - 1
}

/// Counts of values in ns. Written by one thread, the owner of the [`Recorder`](super::Recorder); read by any.
#[derive(Debug)]
pub(super) struct Counters {
    buckets: Box<[AtomicU64]>,
    sum: AtomicU64,
    max: AtomicU64,
    min: AtomicU64,
}

impl Counters {
    pub(super) fn new() -> Self {
        Self {
            buckets: (0..BUCKETS).map(|_| AtomicU64::new(0)).collect(),
            sum: AtomicU64::new(0),
            max: AtomicU64::new(0),
            min: AtomicU64::new(u64::MAX),
        }
    }

    /// Counts `value`. One thread at a time.
    pub(super) fn count(&self, value: u64) {
        if value > self.max.load(Ordering::Relaxed) {
            self.max.store(value, Ordering::Relaxed);
        }
        if value < self.min.load(Ordering::Relaxed) {
            self.min.store(value, Ordering::Relaxed);
        }
        add(&self.sum, value);
        let bucket = &self.buckets[bucket_of(value)];
        // Release: a reader that counts this value also sees it in the figures above.
        let count = bucket.load(Ordering::Relaxed).wrapping_add(1);
        bucket.store(count, Ordering::Release);
    }

    /// Calls `each` with upper bound and count of every bucket in use.
    pub(super) fn for_each_bucket(&self, mut each: impl FnMut(u64, u64)) {
        for (index, bucket) in self.buckets.iter().enumerate() {
            let count = bucket.load(Ordering::Acquire);
            if count > 0 {
                each(upper_bound(index), count);
            }
        }
    }

    /// Sum, minimum and maximum of the values. Read after the buckets.
    pub(super) fn sum_min_max(&self) -> (u64, u64, u64) {
        let load = |figure: &AtomicU64| figure.load(Ordering::Relaxed);
        (load(&self.sum), load(&self.min), load(&self.max))
    }
}

/// For counters with one writer: no read-modify-write needed.
pub(super) fn add(counter: &AtomicU64, amount: u64) {
    let sum = counter.load(Ordering::Relaxed).wrapping_add(amount);
    counter.store(sum, Ordering::Relaxed);
}

#[cfg(test)]
mod tests {
    use super::*;

    use hdrhistogram::Histogram;
    use proptest::prelude::*;

    #[test]
    fn counters_buckets_are_contiguous() {
        let mut lowest = 0;
        for bucket in 0..BUCKETS {
            assert_eq!(bucket_of(lowest), bucket);
            assert_eq!(bucket_of(upper_bound(bucket).min(HIGHEST)), bucket);
            lowest = upper_bound(bucket) + 1;
        }
        assert!(lowest > HIGHEST);
    }

    #[test]
    fn counters_excess_values_use_last_bucket() {
        assert_eq!(bucket_of(u64::MAX), BUCKETS - 1);
        assert_eq!(bucket_of(HIGHEST), BUCKETS - 1);
    }

    proptest! {
        #[test]
        fn counters_bounds_match_hdrhistogram(value in 0..=HIGHEST) {
            let library = Histogram::<u64>::new_with_bounds(1, HIGHEST, 2).unwrap();
            prop_assert_eq!(upper_bound(bucket_of(value)), library.highest_equivalent(value));
        }
    }
}
