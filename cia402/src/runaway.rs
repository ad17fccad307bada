//! Checks whether an enabled motor follows its target, independently of the drive's 6065h. A drive that misinterprets
//! its targets runs at full speed and reports no error. The monitor does not remove power itself.

use std::fmt;
use std::time::Duration;

/// Positions over which speed is measured.
const SAMPLES: usize = 8;
/// Tolerated error of a position, increments.
const NOISE: f64 = 16.0;

/// Largest distance from the target and largest speed of a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunawayLimits {
    /// Largest distance of 6064h from the target, increments.
    pub following: f64,
    /// Largest speed of 6064h, increments/s.
    pub speed: f64,
}

/// An uncommanded motion of a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Runaway {
    /// The motor is too far from its target.
    Following {
        /// Target, increments.
        target: i32,
        /// 6064h, increments.
        actual: i32,
        /// Largest distance, increments.
        limit: f64,
    },
    /// The motor is faster than any command allows.
    Speed {
        /// By 6064h, increments/s.
        speed: f64,
        /// Largest speed, increments/s.
        limit: f64,
    },
}

impl fmt::Display for Runaway {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Following {
                target,
                actual,
                limit,
            } => write!(
                f,
                "6064h is {actual}, its target {target}: more than the {limit:.0} increments of allowed lag; its power was \
                 taken\nhint: check brake, load, limits and mapping of the drive, then power-cycle it"
            ),
            Self::Speed { speed, limit } => write!(
                f,
                "6064h moves by {speed:.0} increments/s, more than the largest commanded {limit:.0}; its power was \
                 taken\nhint: check encoder, increments_per_turn and mapping of the drive, then power-cycle it"
            ),
        }
    }
}

/// The monitor of one motor.
#[derive(Clone, Copy, Debug)]
pub struct Monitor {
    limits: RunawayLimits,
    samples: [(Duration, i32); SAMPLES],
    count: usize,
}

impl Monitor {
    /// A monitor with these limits.
    pub const fn new(limits: RunawayLimits) -> Self {
        Self {
            limits,
            samples: [(Duration::ZERO, 0); SAMPLES],
            count: 0,
        }
    }

    /// Its limits.
    pub const fn limits(&self) -> RunawayLimits {
        self.limits
    }

    /// One cycle: `target` and actual position of a motor; `None` as target while it has no power.
    pub fn step(&mut self, target: Option<i32>, actual: i32, now: Duration) -> Option<Runaway> {
        let Some(target) = target else {
            self.count = 0;
            return None;
        };
        let limit = self.limits.following;
        let lag = f64::from(target.wrapping_sub(actual));
        if lag.abs() > limit {
            return Some(Runaway::Following {
                target,
                actual,
                limit,
            });
        }
        self.samples.rotate_right(1);
        if let Some(newest) = self.samples.first_mut() {
            *newest = (now, actual);
        }
        self.count = (self.count + 1).min(SAMPLES);
        self.speed(actual, now)
    }

    fn speed(&self, actual: i32, now: Duration) -> Option<Runaway> {
        let (at, from) = *self.samples.last().filter(|_| self.count == SAMPLES)?;
        let time = now.saturating_sub(at).as_secs_f64();
        let moved = f64::from(actual.wrapping_sub(from)).abs();
        let limit = self.limits.speed;
        (moved > limit * time + NOISE).then(|| Runaway::Speed {
            speed: moved / time.max(1e-9),
            limit,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn monitor() -> Monitor {
        Monitor::new(RunawayLimits {
            following: 1000.0,
            speed: 100_000.0,
        })
    }

    /// Runs until the monitor trips; returns the cycle and the cause.
    fn run(mut moved: impl FnMut(u32) -> (i32, i32)) -> Option<(u32, Runaway)> {
        let mut monitor = monitor();
        (1..2000).find_map(|n| {
            let (target, actual) = moved(n);
            Some((n, monitor.step(Some(target), actual, n * MS)?))
        })
    }

    #[test]
    fn motor_that_follows_trips_no_monitor() {
        let lagging = |n: u32| {
            let target = n.cast_signed() * 90;
            (target, (target - 450).max(0) + n.cast_signed() % 7)
        };
        assert_eq!(run(lagging), None);
    }

    #[test]
    fn motor_at_full_speed_is_detected_within_eight_cycles() {
        // 2.5 million increments in a second.
        let (n, runaway) = run(|n| (9992, 9999 + 90 * n.cast_signed())).unwrap();
        assert!(n <= 12, "{n} {runaway}");
        let (n, _) = run(|n| (9992, 9999 + 2548 * n.cast_signed())).unwrap();
        assert_eq!(n, 1);
        let fast = |n: u32| (150 * n.cast_signed(), 150 * n.cast_signed());
        let (n, runaway) = run(fast).unwrap();
        assert!(matches!(runaway, Runaway::Speed { .. }) && n == 8, "{n}");
    }

    #[test]
    fn motor_at_rest_under_moving_target_is_detected() {
        let (_, runaway) = run(|n| (n.cast_signed() * 50, 0)).unwrap();
        let text = runaway.to_string();
        assert!(
            text.starts_with("6064h is 0, its target 1050: more than the 1000 increments"),
            "{text}"
        );
    }

    #[test]
    fn monitor_without_target_resets() {
        let mut monitor = monitor();
        for n in 1..200 {
            // Fast, but never eight cycles in a row with power.
            let actual = n * 150;
            let target = (n % 7 != 0).then_some(actual);
            let runaway = monitor.step(target, actual, n.unsigned_abs() * MS);
            assert_eq!(runaway, None, "{n}");
        }
    }
}
