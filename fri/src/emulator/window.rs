//! The controller's statistics of our timing: means over the last 100 answers, and the quality derived from them. It
//! does not decide what follows from a quality.

use std::time::Duration;

/// Number of datagrams in each mean; published for FRI 1.0.
const WINDOW: usize = 100;

/// Thresholds for the quality of answers. KUKA publishes that statistics of FRI 1.0 are means over 100 datagrams, not
/// the numbers below: all of them are *assumptions*, those for Sunrise entirely.
///
/// They are strict: the only other public rule, RCPRG's simulated LWR, counts an answer up and a miss down between 0 and
/// 20 and reports PERFECT above 15, which random loss of a few per cent never leaves. A mean over 100 does leave it by
/// chance: with 1 % of exchanges lost, four of 100 are lost in 2 % of the time, with 2 % in 14 %. To tolerate such loss,
/// set `perfect_from` to 0.95.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Share of answers in time, 0..=1, below which quality is UNACCEPTABLE or POOR: 0.5.
    pub bad_from: f64,
    /// Share below which quality is BAD or FAIR: 0.9.
    pub ok_from: f64,
    /// Share below which quality is OK or GOOD, from which it is PERFECT or EXCELLENT: 0.97.
    pub perfect_from: f64,
    /// Maximum age of the measurement that an answer in time reflects, in measurements, 0..=63: 1.
    ///
    /// Every cycle expects one answer. With 0 it must reflect that cycle's measurement; with 1 a client that answers
    /// each measurement one cycle later, as the reference client does, is still in time.
    pub reflected_age_max: u16,
    /// Consecutive cycles without answer that end command mode, from 1: 10. Fewer are bridged by extrapolation.
    pub misses_max: u32,
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            bad_from: 0.5,
            ok_from: 0.9,
            perfect_from: 0.97,
            reflected_age_max: 1,
            misses_max: 10,
        }
    }
}

/// The last 100 cycles: latency of the answer in s, or none.
#[derive(Debug, Clone)]
pub(crate) struct Window {
    entries: [Option<f64>; WINDOW],
    len: usize,
    next: usize,
    missed: u32,
}

impl Window {
    pub(crate) fn new() -> Self {
        Self {
            entries: [None; WINDOW],
            len: 0,
            next: 0,
            missed: 0,
        }
    }

    /// Ends a cycle with the latency of its answer or without one.
    pub(crate) fn record(&mut self, latency: Option<Duration>) {
        self.entries[self.next] = latency.map(|latency| latency.as_secs_f64());
        self.next = (self.next + 1) % WINDOW;
        self.len = (self.len + 1).min(WINDOW);
        self.missed = self.missed.wrapping_add(u32::from(latency.is_none()));
    }

    fn latencies(&self) -> impl Iterator<Item = f64> {
        self.entries.iter().copied().flatten()
    }

    /// Share of cycles answered in time, of 100 from the start: a new client has no quality.
    pub(crate) fn answer_rate(&self) -> f64 {
        share(self.latencies().count())
    }

    /// Share of cycles without an answer in time, of those recorded.
    pub(crate) fn miss_rate(&self) -> f64 {
        share(self.len - self.latencies().count())
    }

    /// Answers missing since the start.
    pub(crate) fn missed(&self) -> u32 {
        self.missed
    }

    /// Quality by the thresholds, from 0 (worst) to 3: the codes of both generations. Without any answer it is 0, however
    /// tolerant the thresholds are.
    pub(crate) fn rank(&self, timing: &Timing) -> u8 {
        let rate = self.answer_rate();
        if self.latencies().next().is_none() {
            return 0;
        }
        let reached = |threshold: f64| u8::from(rate >= threshold);
        [timing.bad_from, timing.ok_from, timing.perfect_from]
            .map(reached)
            .iter()
            .sum()
    }

    /// Mean latency and jitter, s. Jitter is the mean absolute deviation from the mean latency.
    pub(crate) fn latency_and_jitter(&self) -> (f64, f64) {
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
        (latency, jitter)
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
    fn window_quality_changes_at_thresholds() {
        for (answered, rank) in [
            (0, 0),
            (49, 0),
            (50, 1),
            (89, 1),
            (90, 2),
            (96, 2),
            (97, 3),
            (100, 3),
        ] {
            assert_eq!(
                window(answered).rank(&Timing::default()),
                rank,
                "{answered}"
            );
        }
    }

    #[test]
    fn window_without_answers_has_lowest_quality() {
        let tolerant = Timing {
            bad_from: 0.0,
            ok_from: 0.0,
            ..Timing::default()
        };
        assert_eq!(window(0).rank(&tolerant), 0);
        assert_eq!(window(1).rank(&tolerant), 2);
    }

    #[test]
    fn window_quality_starts_at_lowest() {
        let mut window = Window::new();
        for answered in 1..=WINDOW {
            window.record(Some(Duration::ZERO));
            assert_eq!(window.rank(&Timing::default()) == 3, answered >= 97);
        }
    }

    #[test]
    fn window_means_cover_last_hundred() {
        let mut window = window(0);
        for i in 0..WINDOW {
            window.record(Some(Duration::from_millis(if i % 2 == 0 { 1 } else { 3 })));
        }
        let (latency_s, jitter_s) = window.latency_and_jitter();
        assert!((latency_s - 0.002).abs() < 1e-9 && (jitter_s - 0.001).abs() < 1e-9);
        assert_eq!(window.missed(), 100);
        assert_eq!(
            [window.answer_rate(), window.miss_rate()].map(f64::to_bits),
            [1.0_f64, 0.0].map(f64::to_bits)
        );
    }
}
