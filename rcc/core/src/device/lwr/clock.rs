//! The robot's clock as told by its datagrams: it ticks once a period, and arrivals only say how
//! it runs. Jitter of the network and of this host must not become jitter of the motion.

use takt_rt::Nanos;

/// Share of an arrival's deviation that is believed.
const GAIN: f64 = 0.02;
/// Largest deviation of one arrival that counts, so that a stall does not move the clock.
const CLAMP_NS: i64 = 100_000;
/// After so many arrivals that were all late, the clock jumps: they are not late, it is wrong.
const LATE_MAX: u32 = 16;

/// The instant that the newest datagram stands for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct DatagramClock {
    now: Option<Nanos>,
    period: Nanos,
    elapsed: Nanos,
    late: u32,
    late_min: Nanos,
}

impl DatagramClock {
    /// A datagram arrived, `lost` periods after those before it at least.
    pub(super) fn tick(&mut self, arrival: Nanos, period: Nanos, lost: u16) {
        let before = self.now;
        let expected = match before {
            Some(now) if self.period == period => now + Nanos(period.0 * (1 + i64::from(lost))),
            _ => arrival,
        };
        let mut error = arrival - expected;
        let half = Nanos(period.0 / 2);
        let is_late = error > half;
        self.late_min = if self.late == 0 {
            error
        } else {
            self.late_min.min(error)
        };
        self.late = if is_late { self.late + 1 } else { 0 };
        let wrong = error < Nanos(-period.0) || self.late > LATE_MAX;
        let now = if wrong {
            let jump = if error.0 < 0 { error } else { self.late_min };
            self.late = 0;
            expected + jump
        } else {
            error = Nanos(error.0.clamp(-CLAMP_NS, CLAMP_NS));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_precision_loss,
                reason = "at most the clamp"
            )]
            let step = (error.0 as f64 * GAIN) as i64;
            expected + Nanos(step)
        };
        self.elapsed = before.map_or(period, |before| (now - before).max(Nanos(0)));
        self.now = Some(now);
        self.period = period;
    }

    /// The instant of the newest datagram.
    pub(super) fn now(&self) -> Nanos {
        self.now.unwrap_or_default()
    }

    /// The time between the newest datagram and the one before it.
    pub(super) const fn elapsed(&self) -> Nanos {
        self.elapsed
    }

    /// The robot's period.
    pub(super) const fn period(&self) -> Nanos {
        self.period
    }

    /// Whether an arrival at `at` is so late that another datagram may be waiting.
    pub(super) fn is_late(&self, at: Nanos) -> bool {
        at - self.now() > Nanos(self.period.0 * 3 / 4)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Nanos = Nanos(1_000_000);

    fn after(arrivals: impl IntoIterator<Item = i64>) -> DatagramClock {
        let mut clock = DatagramClock::default();
        for at in arrivals {
            clock.tick(Nanos(at), PERIOD, 0);
        }
        clock
    }

    #[test]
    fn jitter_is_smoothed() {
        let jitter = [0, 300_000, -200_000, 100_000];
        let clock =
            after((0..1000).map(|i| i * PERIOD.0 + jitter[usize::try_from(i).unwrap() % 4]));
        let error = clock.now() - Nanos(999 * PERIOD.0);
        assert!(error.abs() < Nanos(100_000), "{error}");
        assert!(
            (clock.elapsed() - PERIOD).abs() <= Nanos(2_000),
            "{}",
            clock.elapsed()
        );
    }

    #[test]
    fn drift_is_followed() {
        let clock = after((0..5000).map(|i| i * 1_000_100));
        assert!((clock.now() - Nanos(4999 * 1_000_100)).abs() < Nanos(10_000));
    }

    #[test]
    fn a_stall_does_not_move_it() {
        let mut clock = after((0..100).map(|i| i * PERIOD.0));
        for i in 100..105 {
            clock.tick(Nanos(110 * PERIOD.0), PERIOD, 0);
            assert!((clock.now() - Nanos(i * PERIOD.0)).abs() < Nanos(15_000));
        }
        assert!(clock.is_late(Nanos(110 * PERIOD.0)));
    }

    #[test]
    fn lost_datagrams_count_as_time() {
        let mut clock = after((0..10).map(|i| i * PERIOD.0));
        clock.tick(Nanos(12 * PERIOD.0), PERIOD, 2);
        assert_eq!(clock.now(), Nanos(12 * PERIOD.0));
        assert_eq!(clock.elapsed(), Nanos(3 * PERIOD.0));
    }

    #[test]
    fn a_new_phase_is_taken_over_in_the_end() {
        let mut clock = after((0..10).map(|i| i * PERIOD.0));
        for i in 10..40 {
            clock.tick(Nanos(i * PERIOD.0 + 20_000_000), PERIOD, 0);
        }
        assert!((clock.now() - Nanos(39 * PERIOD.0 + 20_000_000)).abs() < Nanos(10_000));
    }
}
