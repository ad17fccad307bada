//! The robot's clock, estimated from datagram arrivals: it ticks once per period. Jitter of the network and of this
//! host must not become jitter of the motion.
//!
//! The estimator is the servo of `takt_rt`; this module feeds it.

use takt_rt::Nanos;
use takt_rt::servo::{Estimate, Servo, ServoConfig};

/// Estimate of the instant of the newest datagram.
#[derive(Debug, Default)]
pub(super) struct DatagramClock {
    /// `None` before the first datagram.
    servo: Option<Servo>,
    /// The robot's time: periods since its first datagram.
    robot: Nanos,
    now: Nanos,
    period: Nanos,
    elapsed: Nanos,
}

impl DatagramClock {
    /// Handles a datagram that arrived after at least `lost` lost periods.
    pub(super) fn tick(&mut self, arrival: Nanos, period: Nanos, lost: u16) {
        if self.period != period {
            (self.servo, self.period) = (None, period);
        }
        let is_first = self.servo.is_none();
        let servo = self.servo.get_or_insert_with(|| new_servo(period));
        self.robot += Nanos(period.0.saturating_mul(1 + i64::from(lost)));
        servo.handle_sample(arrival, self.robot);
        let now = servo.estimate().local_at(self.robot);
        self.elapsed = if is_first {
            period
        } else {
            (now - self.now).max(Nanos(0))
        };
        self.now = now;
    }

    /// Handles the time `now` without a datagram.
    pub(super) fn handle_time(&mut self, now: Nanos) {
        if let Some(servo) = &mut self.servo {
            servo.handle_time(now);
        }
    }

    /// The clock for net threads: zero and every whole period is the instant of a datagram.
    pub(super) fn estimate(&self) -> Estimate {
        self.servo.as_ref().map(Servo::estimate).unwrap_or_default()
    }

    /// The instant of the newest datagram.
    pub(super) const fn now(&self) -> Nanos {
        self.now
    }

    /// The time between the newest datagram and the one before it.
    pub(super) const fn elapsed(&self) -> Nanos {
        self.elapsed
    }

    /// The robot's period.
    pub(super) const fn period(&self) -> Nanos {
        self.period
    }

    /// Whether `now` is so long after the newest datagram that another one may be waiting.
    pub(super) fn is_late(&self, now: Nanos) -> bool {
        now - self.now() > Nanos(self.period.0 * 3 / 4)
    }
}

/// Datagrams pass a network and a scheduler: an uncertainty that is large for a fieldbus is normal here, and
/// set-points are interpolated over more than a period anyway.
fn new_servo(period: Nanos) -> Servo {
    let config = ServoConfig::new(period.try_into().unwrap_or_default());
    Servo::new(&ServoConfig {
        uncertainty_max: Nanos(period.0 / 4),
        ..config
    })
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
    fn datagram_clock_smooths_jitter() {
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
    fn datagram_clock_follows_drift() {
        let clock = after((0..5000).map(|i| i * 1_000_100));
        assert!((clock.now() - Nanos(4999 * 1_000_100)).abs() < Nanos(10_000));
    }

    #[test]
    fn datagram_clock_ignores_stall() {
        let mut clock = after((0..100).map(|i| i * PERIOD.0));
        for i in 100..105 {
            clock.tick(Nanos(110 * PERIOD.0), PERIOD, 0);
            assert!((clock.now() - Nanos(i * PERIOD.0)).abs() < Nanos(15_000));
        }
        assert!(clock.is_late(Nanos(110 * PERIOD.0)));
    }

    #[test]
    fn datagram_clock_counts_lost_datagrams_as_time() {
        let mut clock = after((0..10).map(|i| i * PERIOD.0));
        clock.tick(Nanos(12 * PERIOD.0), PERIOD, 2);
        assert_eq!(clock.now(), Nanos(12 * PERIOD.0));
        assert_eq!(clock.elapsed(), Nanos(3 * PERIOD.0));
    }

    #[test]
    fn datagram_clock_is_valid_until_datagrams_stop() {
        let mut clock = after((0..2000).map(|i| i * 1_000_100));
        let estimate = clock.estimate();
        assert!(estimate.is_valid_at(clock.now()));
        assert!((estimate.frequency_ppb + 100_000.0).abs() < 100.0);
        let phase_error = estimate.phase_error(clock.now(), PERIOD, Nanos(0));
        assert!(phase_error.abs() < Nanos(10), "{phase_error}");
        clock.handle_time(clock.now() + Nanos(600_000_000_000));
        assert!(!clock.estimate().state.is_followed());
    }

    #[test]
    fn datagram_clock_adopts_new_phase() {
        let mut clock = after((0..10).map(|i| i * PERIOD.0));
        for i in 10..40 {
            clock.tick(Nanos(i * PERIOD.0 + 20_000_000), PERIOD, 0);
        }
        assert!((clock.now() - Nanos(39 * PERIOD.0 + 20_000_000)).abs() < Nanos(10_000));
    }
}
