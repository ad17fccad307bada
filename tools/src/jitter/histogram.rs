//! Distributions of times from our own statistics, a saved report, or cyclictest, in one form, so that they are
//! compared by the same arithmetic.
//!
//! Quantiles are interpolated within a bucket: cyclictest counts whole microseconds and our recorder parts of one, and
//! taking either's bounds would favour one.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use takt_rt::Nanos;
use takt_rt::stats::Summary;

/// How many times fell from `lower_ns` to below `upper_ns`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Bucket {
    pub(crate) lower_ns: u64,
    pub(crate) upper_ns: u64,
    pub(crate) count: u64,
}

/// A distribution of times, ns. Buckets ascend; none is empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Wire", into = "Wire")]
pub(crate) struct Histogram {
    buckets: Vec<Bucket>,
    min_ns: u64,
    max_ns: u64,
    mean_ns: u64,
    count: u64,
}

/// The quantiles that reports show, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Quantiles {
    pub(crate) p50: u64,
    pub(crate) p99: u64,
    pub(crate) p999: u64,
    pub(crate) max: u64,
}

/// Its form in JSON. The quantiles are for readers; reading back, they are computed again.
#[derive(Serialize, Deserialize)]
struct Wire {
    min: u64,
    mean: u64,
    #[serde(flatten)]
    quantiles: Quantiles,
    /// Lower bound, upper bound (not included), count.
    buckets: Vec<(u64, u64, u64)>,
}

impl From<Histogram> for Wire {
    fn from(histogram: Histogram) -> Self {
        let triple = |b: &Bucket| (b.lower_ns, b.upper_ns, b.count);
        Self {
            min: histogram.min_ns,
            mean: histogram.mean_ns,
            quantiles: histogram.quantiles(),
            buckets: histogram.buckets.iter().map(triple).collect(),
        }
    }
}

impl TryFrom<Wire> for Histogram {
    type Error = &'static str;

    fn try_from(wire: Wire) -> Result<Self, Self::Error> {
        let buckets = wire
            .buckets
            .into_iter()
            .map(|(lower_ns, upper_ns, count)| Bucket {
                lower_ns,
                upper_ns,
                count,
            });
        Self::new(buckets.collect(), wire.min, wire.mean, wire.quantiles.max)
    }
}

impl Histogram {
    /// From buckets, and the figures that buckets do not hold.
    pub(crate) fn new(
        buckets: Vec<Bucket>,
        min_ns: u64,
        mean_ns: u64,
        max_ns: u64,
    ) -> Result<Self, &'static str> {
        if buckets.iter().any(|b| b.lower_ns >= b.upper_ns) {
            return Err("a bucket whose upper bound is not above its lower bound");
        }
        if !buckets.is_sorted_by_key(|b| b.lower_ns) {
            return Err("buckets that do not ascend");
        }
        if min_ns > max_ns {
            return Err("a minimum above the maximum");
        }
        let count = buckets
            .iter()
            .try_fold(0_u64, |sum, b| sum.checked_add(b.count))
            .ok_or("more times than can be counted")?;
        Ok(Self {
            buckets: buckets.into_iter().filter(|b| b.count > 0).collect(),
            min_ns,
            max_ns,
            mean_ns,
            count,
        })
    }

    /// From a reading of the cycle statistics: main figures, and buckets by their highest value.
    pub(crate) fn from_stats(
        summary: &Summary,
        buckets: impl Iterator<Item = (Nanos, u64)>,
    ) -> Self {
        let ns = |time: Nanos| time.0.max(0).unsigned_abs();
        let bucket = |(highest, count)| {
            let upper_ns = ns(highest).saturating_add(1);
            Bucket {
                lower_ns: upper_ns - width(ns(highest)),
                upper_ns,
                count,
            }
        };
        let buckets: Vec<_> = buckets.map(bucket).collect();
        // A cycle may be recorded between the readings of figures and buckets.
        let (min, max) = (ns(summary.min), ns(summary.max).max(ns(summary.min)));
        Self::new(buckets, min, ns(summary.mean), max).unwrap_or_default()
    }

    /// All of these together.
    pub(crate) fn pooled<'a>(parts: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut counts = BTreeMap::new();
        let (mut sum, mut min_ns, mut max_ns) = (0_u128, u64::MAX, 0);
        for part in parts.into_iter().filter(|part| part.count > 0) {
            for b in &part.buckets {
                *counts.entry((b.lower_ns, b.upper_ns)).or_insert(0_u64) += b.count;
            }
            sum += u128::from(part.mean_ns) * u128::from(part.count);
            min_ns = min_ns.min(part.min_ns);
            max_ns = max_ns.max(part.max_ns);
        }
        let count = counts.values().sum::<u64>();
        let mean = sum.checked_div(count.into()).unwrap_or(0);
        Self {
            buckets: counts
                .into_iter()
                .map(|((lower_ns, upper_ns), count)| Bucket {
                    lower_ns,
                    upper_ns,
                    count,
                })
                .collect(),
            min_ns: min_ns.min(max_ns),
            max_ns,
            mean_ns: u64::try_from(mean).unwrap_or(u64::MAX),
            count,
        }
    }

    /// How many times it holds.
    #[cfg(test)]
    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// The shortest, ns.
    pub(crate) fn min_ns(&self) -> u64 {
        self.min_ns
    }

    /// The longest, ns.
    pub(crate) fn max_ns(&self) -> u64 {
        self.max_ns
    }

    /// Its buckets, ascending.
    #[cfg(test)]
    pub(crate) fn buckets(&self) -> &[Bucket] {
        &self.buckets
    }

    /// The time that a share of `quantile` (0 to 1) stays within, ns.
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "counts below 2^53; the result lies within its bucket, which is positive"
    )]
    pub(crate) fn quantile(&self, quantile: f64) -> u64 {
        let mut left = quantile * self.count as f64;
        for b in &self.buckets {
            let here = b.count as f64;
            if left <= here {
                let into = left / here * (b.upper_ns - b.lower_ns) as f64;
                let value = b.lower_ns.saturating_add(into as u64);
                return value.clamp(self.min_ns, self.max_ns);
            }
            left -= here;
        }
        self.max_ns
    }

    /// The quantiles that reports show.
    pub(crate) fn quantiles(&self) -> Quantiles {
        Quantiles {
            p50: self.quantile(0.5),
            p99: self.quantile(0.99),
            p999: self.quantile(0.999),
            max: self.max_ns,
        }
    }

    /// How many times exceed `bound_ns`, to the width of a bucket; never 0 if the longest does.
    pub(crate) fn above(&self, bound_ns: u64) -> u64 {
        if self.max_ns <= bound_ns {
            return 0;
        }
        let above = self.buckets.iter().filter(|b| b.lower_ns > bound_ns);
        above.map(|b| b.count).sum::<u64>().max(1)
    }

    /// Its times in other bins, given by ascending bounds: the i-th bin is from bound i to bound i + 1. A
    /// bucket across a bound is shared out by width. Times outside count in the first or last bin.
    #[expect(clippy::cast_precision_loss, reason = "for pictures and bars")]
    pub(crate) fn rebinned(&self, bounds: &[f64]) -> Vec<f64> {
        let mut bins = vec![0.0; bounds.len().saturating_sub(1)];
        let Some(last) = bins.len().checked_sub(1) else {
            return bins;
        };
        for b in &self.buckets {
            let (lower, upper) = (b.lower_ns as f64, b.upper_ns as f64);
            for (i, bin) in bins.iter_mut().enumerate() {
                let left = if i == 0 { f64::MIN } else { bounds[i] };
                let right = if i == last { f64::MAX } else { bounds[i + 1] };
                let overlap = upper.min(right) - lower.max(left);
                if overlap > 0.0 {
                    *bin += b.count as f64 * overlap / (upper - lower);
                }
            }
        }
        bins
    }
}

/// The width of a bucket of the recorder: two significant digits, as `takt_rt::stats` counts them.
fn width(highest_ns: u64) -> u64 {
    let bits = u64::BITS - highest_ns.leading_zeros();
    1 << bits.saturating_sub(8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bucket(lower_ns: u64, upper_ns: u64, count: u64) -> Bucket {
        Bucket {
            lower_ns,
            upper_ns,
            count,
        }
    }

    #[test]
    fn quantiles_are_interpolated_within_a_bucket() {
        let buckets = vec![bucket(1_000, 2_000, 50), bucket(5_000, 6_000, 50)];
        let h = Histogram::new(buckets, 1_000, 3_500, 5_900).unwrap();
        assert_eq!(h.quantile(0.25), 1_500);
        assert_eq!(h.quantile(0.5), 2_000);
        assert_eq!(h.quantile(0.75), 5_500);
        assert_eq!(h.quantile(1.0), 5_900, "never above the longest");
        assert_eq!(Histogram::default().quantile(0.5), 0);
    }

    #[test]
    fn histogram_buckets_have_no_gaps() {
        let mut recorder = takt_rt::stats::Recorder::new();
        for ns in 0..100_000 {
            recorder.record(Nanos(ns));
        }
        let read = recorder.reader().read();
        let h = Histogram::from_stats(&read.summary(), read.buckets());
        assert_eq!((h.count(), h.min_ns(), h.max_ns()), (100_000, 0, 99_999));
        let meets = |pair: &[Bucket]| pair[0].upper_ns == pair[1].lower_ns;
        assert!(h.buckets().windows(2).all(meets));
        for (quantile, exact) in [(0.1, 10_000), (0.5, 50_000), (0.99, 99_000)] {
            assert!(h.quantile(quantile).abs_diff(exact) <= 1, "{quantile}");
        }
    }

    #[test]
    fn pooling_is_the_same_as_counting_together() {
        let a = Histogram::new(vec![bucket(10, 20, 3), bucket(20, 30, 1)], 12, 16, 25).unwrap();
        let b = Histogram::new(vec![bucket(10, 20, 1), bucket(40, 50, 1)], 11, 30, 44).unwrap();
        let both = Histogram::pooled([&a, &b, &Histogram::default()]);
        assert_eq!(
            both.buckets(),
            [bucket(10, 20, 4), bucket(20, 30, 1), bucket(40, 50, 1)]
        );
        assert_eq!((both.count(), both.min_ns(), both.max_ns()), (6, 11, 44));
        assert_eq!(both.mean_ns, (16 * 4 + 30 * 2) / 6);
        assert_eq!(Histogram::pooled([]), Histogram::default());
    }

    #[test]
    fn excesses_are_counted() {
        let h = Histogram::new(vec![bucket(10, 20, 3), bucket(100, 200, 2)], 12, 60, 150).unwrap();
        assert_eq!([h.above(150), h.above(149), h.above(50)], [0, 1, 2]);
    }

    #[test]
    fn rebinning_loses_nothing_and_shares_by_width() {
        let h = Histogram::new(vec![bucket(0, 4, 8), bucket(90, 100, 5)], 0, 35, 99).unwrap();
        assert_eq!(h.rebinned(&[1.0, 2.0, 3.0, 50.0]), [4.0, 2.0, 7.0]);
        assert!(h.rebinned(&[1.0]).is_empty());
    }

    #[test]
    fn json_is_read_back_and_nonsense_refused() {
        let h = Histogram::new(vec![bucket(10, 20, 3), bucket(20, 30, 1)], 12, 16, 25).unwrap();
        let text = serde_json::to_string(&h).unwrap();
        assert_eq!(
            text,
            r#"{"min":12,"mean":16,"p50":16,"p99":25,"p999":25,"max":25,"buckets":[[10,20,3],[20,30,1]]}"#
        );
        assert_eq!(serde_json::from_str::<Histogram>(&text).unwrap(), h);
        for (from, to) in [
            ("[10,20,3]", "[20,20,3]"),
            ("[10,20,3]", "[25,40,3]"),
            ("[10,20,3]", "[10,20,18446744073709551615]"),
            ("\"min\":12", "\"min\":26"),
            ("[10,20,3]", "[10,20,-3]"),
        ] {
            let text = text.replace(from, to);
            assert!(serde_json::from_str::<Histogram>(&text).is_err(), "{text}");
        }
    }
}
