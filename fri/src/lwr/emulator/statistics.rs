//! What the controller reports about our timing: means over the last 100 answers, and the quality made of them. It does
//! not decide what follows from a quality.

use super::config::Timing;
use crate::lwr::wire::{Quality, Statistics};
use std::time::Duration;

/// Datagrams over which statistics are means; published.
pub(super) const WINDOW: usize = 100;

/// The last 100 cycles: latency of the answer in s, or none.
#[derive(Debug, Clone)]
pub(super) struct Window {
    entries: [Option<f64>; WINDOW],
    len: usize,
    next: usize,
    missed: u32,
}

impl Window {
    pub(super) fn new() -> Self {
        Self {
            entries: [None; WINDOW],
            len: 0,
            next: 0,
            missed: 0,
        }
    }

    /// Ends a cycle with the latency of its answer or without one.
    pub(super) fn record(&mut self, latency: Option<Duration>) {
        self.entries[self.next] = latency.map(|latency| latency.as_secs_f64());
        self.next = (self.next + 1) % WINDOW;
        self.len = (self.len + 1).min(WINDOW);
        self.missed = self.missed.wrapping_add(u32::from(latency.is_none()));
    }

    fn latencies(&self) -> impl Iterator<Item = f64> {
        self.entries.iter().copied().flatten()
    }

    /// Share of cycles answered in time. Of 100 from the start: good timing must be shown first.
    pub(super) fn answer_rate(&self) -> f64 {
        share(self.latencies().count())
    }

    /// Answers missing since the start.
    pub(super) fn missed(&self) -> u32 {
        self.missed
    }

    /// Quality by the thresholds.
    pub(super) fn quality(&self, timing: &Timing) -> Quality {
        let rate = self.answer_rate();
        if rate < timing.bad_from {
            Quality::Unacceptable
        } else if rate < timing.ok_from {
            Quality::Bad
        } else if rate < timing.perfect_from {
            Quality::Ok
        } else {
            Quality::Perfect
        }
    }

    /// The fields of the measurement. Jitter is the mean absolute deviation from the mean latency.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the wire has single precision"
    )]
    pub(super) fn statistics(&self) -> Statistics {
        let answered = self.latencies().count();
        let mean = |sum: f64| {
            if answered == 0 {
                0.0
            } else {
                sum / share(answered) / 100.0
            }
        };
        let latency = mean(self.latencies().sum());
        let jitter = mean(self.latencies().map(|one| (one - latency).abs()).sum());
        Statistics {
            answer_rate: self.answer_rate() as f32,
            latency_s: latency as f32,
            jitter_s: jitter as f32,
            miss_rate: share(self.len - answered) as f32,
            miss_counter: self.missed,
        }
    }
}

/// `count` of the whole window, 0..=1.
fn share(count: usize) -> f64 {
    f64::from(u8::try_from(count).unwrap_or(u8::MAX)) / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(answered: usize) -> Window {
        let mut window = Window::new();
        for i in 0..WINDOW {
            window.record((i < answered).then_some(Duration::from_millis(1)));
        }
        window
    }

    #[test]
    fn quality_changes_exactly_at_the_thresholds() {
        for (answered, quality) in [
            (0, Quality::Unacceptable),
            (49, Quality::Unacceptable),
            (50, Quality::Bad),
            (89, Quality::Bad),
            (90, Quality::Ok),
            (96, Quality::Ok),
            (97, Quality::Perfect),
            (100, Quality::Perfect),
        ] {
            assert_eq!(
                window(answered).quality(&Timing::default()),
                quality,
                "{answered}"
            );
        }
    }

    #[test]
    fn quality_must_be_earned() {
        let mut window = Window::new();
        for answered in 1..=WINDOW {
            window.record(Some(Duration::ZERO));
            let perfect = window.quality(&Timing::default()) == Quality::Perfect;
            assert_eq!(perfect, answered >= 97);
        }
    }

    #[test]
    fn means_are_over_the_last_hundred() {
        let mut window = window(0);
        for i in 0..WINDOW {
            window.record(Some(Duration::from_millis(if i % 2 == 0 { 1 } else { 3 })));
        }
        let statistics = window.statistics();
        assert!((statistics.latency_s - 0.002).abs() < 1e-7);
        assert!((statistics.jitter_s - 0.001).abs() < 1e-7);
        assert_eq!(statistics.miss_counter, 100);
        assert_eq!(
            [statistics.answer_rate, statistics.miss_rate].map(f32::to_bits),
            [1.0_f32, 0.0].map(f32::to_bits)
        );
    }
}
