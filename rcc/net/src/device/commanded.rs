//! The motion that nets command of a joint, from the differences of their set-points. What the driver makes of it, some
//! cycles later, is in the joint's state.

/// Relative rounding error of motions at a limit.
const ROUNDING: f64 = 1e-3;

/// A set-point with the motion of the joint at it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Commanded {
    /// The cycle in which it was given; 0 is "never".
    cycle: u64,
    /// Cycles until the next one is due.
    every: u64,
    /// Position, rad.
    pub position: f64,
    /// Velocity, rad/s.
    pub velocity: f64,
    /// Acceleration, rad/s².
    pub acceleration: f64,
    /// Velocity on the way to it from the set-point before, rad/s.
    slope: f64,
}

impl Commanded {
    /// Whether it is a motion within these limits of velocity and acceleration, not a step.
    pub fn keeps(&self, velocity_max: f64, acceleration_max: f64) -> bool {
        self.velocity.abs() <= velocity_max * (1.0 + ROUNDING)
            && self.acceleration.abs() <= acceleration_max * (1.0 + ROUNDING)
    }

    /// The first set-point of a net, given in this cycle by a net with a period of `every` cycles, while the driver
    /// reports that it commands this velocity and acceleration.
    #[must_use]
    pub fn first(cycle: u64, every: u64, position: f64, reported: [Option<f64>; 2]) -> Self {
        let [velocity, acceleration] = reported.map(|value| value.unwrap_or(0.0));
        Self {
            cycle,
            every,
            position,
            velocity,
            acceleration,
            slope: velocity,
        }
    }

    /// Whether the set-point of the next cycle continues its motion.
    const fn is_due(&self, cycle: u64, every: u64) -> bool {
        let gap = if every > self.every {
            every
        } else {
            self.every
        };
        self.cycle != 0 && cycle >= self.cycle && cycle - self.cycle <= gap
    }

    /// The motion at the next set-point, if that one is due.
    #[expect(clippy::cast_precision_loss, reason = "a few cycles")]
    fn next(&self, first: Self, period_s: f64) -> Self {
        if !self.is_due(first.cycle, first.every) || first.cycle == self.cycle {
            return first;
        }
        let dt_s = (first.cycle - self.cycle) as f64 / first.every.max(1) as f64 * period_s;
        let slope = (first.position - self.position) / dt_s;
        let acceleration = (slope - self.slope) / dt_s;
        Self {
            velocity: acceleration.mul_add(dt_s / 2.0, slope),
            acceleration,
            slope,
            ..first
        }
    }
}

/// The last two set-points of a joint: a net that reads the motion of the cycle before may do so after it has commanded
/// the joint in this one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trail {
    last: Commanded,
    before: Commanded,
}

impl Trail {
    /// With this set-point of a net of that period (s); the first one continues what the driver reports.
    #[must_use]
    pub fn with(self, set_point: Commanded, period_s: f64) -> Self {
        Self {
            last: self.last.next(set_point, period_s),
            before: self.last,
        }
    }

    /// The motion that a net commanded in the cycle before this one; `None` if no net did. `every`: cycles in a period
    /// of the net that reads.
    pub fn before(&self, cycle: u64, every: u64) -> Option<&Commanded> {
        let of_this_cycle = self.last.cycle == cycle;
        let motion = if of_this_cycle {
            &self.before
        } else {
            &self.last
        };
        motion.is_due(cycle, every).then_some(motion)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A set-point of a cycle of 1 ms, at 3 t² from cycle 10 on.
    fn set_point(cycle: u64) -> Commanded {
        let time = f64::from(u32::try_from(cycle - 10).expect("small")) * 1e-3;
        Commanded::first(cycle, 1, 3.0 * time * time, [None; 2])
    }

    #[test]
    fn steady_acceleration_is_found_from_set_points() {
        let mut trail = Trail::default();
        for cycle in 10..20 {
            trail = trail.with(set_point(cycle), 1e-3);
        }
        let motion = trail.before(20, 1).expect("a motion");
        assert!((motion.position - 3.0 * 81e-6).abs() < 1e-12, "{motion:?}");
        assert!((motion.velocity - 6.0 * 9e-3).abs() < 1e-9, "{motion:?}");
        assert!((motion.acceleration - 6.0).abs() < 1e-6, "{motion:?}");
    }

    #[test]
    fn cycle_before_is_known_after_command_of_this_one() {
        let mut trail = Trail::default();
        for cycle in 10..13 {
            trail = trail.with(set_point(cycle), 1e-3);
        }
        let before = trail.before(12, 1).copied();
        assert_eq!(before.map(|motion| motion.cycle), Some(11));
        assert_eq!(trail.before(13, 1).map(|motion| motion.cycle), Some(12));
        assert_eq!(trail.before(14, 1), None);
        assert_eq!(trail.before(14, 4).map(|motion| motion.cycle), Some(12));
        // A count of cycles that begins again knows nothing of these.
        let trail = trail.with(Commanded::first(3, 1, 0.0, [None; 2]), 1e-3);
        assert_eq!(trail.before(1, 1), None);
    }

    #[test]
    fn set_point_after_pause_continues_reported_motion() {
        let trail = Trail::default().with(set_point(10), 1e-3);
        let reported = [Some(0.2), Some(-1.0)];
        let trail = trail.with(Commanded::first(50, 1, 0.5, reported), 1e-3);
        let motion = trail.before(51, 1).expect("a motion");
        let found = [motion.velocity, motion.acceleration].map(f64::to_bits);
        assert_eq!(found, [0.2_f64, -1.0].map(f64::to_bits));
    }
}
