//! Set-points that a driver rejects: counted by the driver cycle by cycle, with the figures of the last onset. What a net rejects by
//! itself, such as a position out of range, never reaches a driver.

/// Why a driver rejects set-points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The first one is too far from where the device is.
    Start,
    /// They got too far ahead of the device.
    Lost,
    /// They are not finite, or not in the plane of a base.
    Finite,
    /// They began before the device followed commands.
    Resumed,
    /// The robot's own limits, as the driver checks them before each answer.
    Guard,
}

/// The onset of a rejection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rejection {
    /// Why.
    pub cause: Cause,
    /// The set-point, rad or m.
    pub wanted: f64,
    /// Where the device was, rad or m.
    pub actual: f64,
    /// The largest distance between both, rad or m.
    pub allowed: f64,
}

/// Rejected set-points of one part of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rejected {
    /// Number of driver cycles in which set-points were rejected.
    pub cycles: u64,
    /// The last onset.
    pub last: Option<Rejection>,
}

impl Rejected {
    /// None so far.
    pub const NONE: Self = Self {
        cycles: 0,
        last: None,
    };

    /// Counts the first cycle of a rejection.
    pub const fn begin(&mut self, rejection: Rejection) {
        self.last = Some(rejection);
        self.repeat();
    }

    /// Counts a further cycle of it.
    pub const fn repeat(&mut self) {
        self.cycles = self.cycles.saturating_add(1);
    }
}

#[cfg(test)]
mod tests {
    use takt_net::JointLimits;
    use takt_rt::Nanos;

    use super::*;
    use crate::device::setpoint::{Joint, START_DISTANCE};
    use crate::device::{JointSetPoints, SetPoint};

    const LIMITS: JointLimits = JointLimits {
        position_min: -3.0,
        position_max: 3.0,
        velocity_max: 2.0,
        acceleration_max: 4.0,
    };

    fn set_points(position: f64) -> JointSetPoints {
        let mut points = JointSetPoints {
            period: Nanos(1_000_000),
            ..JointSetPoints::default()
        };
        let time = Nanos::ZERO;
        points.advance(Some(SetPoint { time, position }));
        points
    }

    fn sample(joint: &mut Joint, points: &JointSetPoints) {
        joint.sample(points, true, Nanos::ZERO, 1e-3);
    }

    #[test]
    fn joint_counts_rejected_cycles_with_first_figures() {
        let mut joint = Joint::new(LIMITS);
        for position in [0.1, 0.2, 0.3] {
            sample(&mut joint, &set_points(position));
        }
        let expected = Rejection {
            cause: Cause::Start,
            wanted: 0.1,
            actual: 0.0,
            allowed: START_DISTANCE,
        };
        assert_eq!(
            (joint.rejected().cycles, joint.rejected().last),
            (3, Some(expected))
        );
        sample(&mut joint, &JointSetPoints::default());
        sample(&mut joint, &set_points(0.01));
        assert_eq!(
            joint.rejected().cycles,
            3,
            "they ended, and others are followed"
        );
        sample(&mut joint, &set_points(f64::NAN));
        assert_eq!(joint.rejected().last.unwrap().cause, Cause::Finite);
    }

    #[test]
    fn joint_rejects_resumed_set_points_once_controlled() {
        let mut joint = Joint::new(LIMITS);
        // The device failed, and the net that commands it is about to end.
        joint.rest_at(0.3, &set_points(0.3));
        assert_eq!(joint.rejected().cycles, 0);
        sample(&mut joint, &set_points(0.3));
        let rejected = joint.rejected();
        assert_eq!(
            (rejected.cycles, rejected.last.unwrap().cause),
            (1, Cause::Resumed)
        );
    }

    #[test]
    fn joint_following_all_keeps_range_and_reports_speed() {
        let mut joint = Joint::new(LIMITS).following_all();
        sample(&mut joint, &set_points(1.0));
        assert!((joint.motion().0 - 1.0).abs() < 1e-12);
        let limited = joint.limited();
        assert!(limited.is_exceeded);
        let excess = limited.last.unwrap();
        assert!((excess.wanted - 1000.0).abs() < 1e-6 && (excess.limit - 2.0).abs() < 1e-12);
        sample(&mut joint, &set_points(9.0));
        assert!((joint.motion().0 - 3.0).abs() < 1e-12, "its range");
        sample(&mut joint, &JointSetPoints::default());
        assert_eq!((joint.rejected().cycles, joint.motion().1), (0, 0.0));
    }
}
