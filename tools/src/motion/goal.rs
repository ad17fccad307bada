//! Motions of the command line as activities of the Robotics API.

use takt_api::motion::JointLimits;
use takt_api::{Activity, Arm, Pose};

use super::{Circ, Lin, Motion, Ptp, commanded_pose};
use crate::quantity::Place;

/// The activity that a motion requests of an arm.
pub(super) fn activity(motion: &Motion, arm: &Arm) -> anyhow::Result<Activity> {
    Ok(match motion {
        Motion::Ptp(Ptp { joints, .. }) => arm.ptp(joints.as_slice()),
        Motion::Home(_) => arm.ptp(home(&arm.description().joints)),
        Motion::Lin(Lin { to, .. }) => arm.lin(pose(to, arm)?),
        Motion::Circ(Circ { via, to, .. }) => arm.circ(pose(via, arm)?, pose(to, arm)?),
    })
}

/// A pose; without an orientation of its own it has that of the arm now.
fn pose(place: &Place, arm: &Arm) -> anyhow::Result<Pose> {
    let now = if place.is_whole() {
        None
    } else {
        Some(commanded_pose(arm)?)
    };
    Ok(place.pose(now).unwrap_or(Pose::IDENTITY))
}

/// The joint positions of `home`, rad.
fn home(joints: &[JointLimits]) -> Vec<f64> {
    let of = |joint: &JointLimits| {
        let (min, max) = (joint.position_min, joint.position_max);
        if (min..=max).contains(&0.0) {
            0.0
        } else {
            f64::midpoint(min, max)
        }
    };
    joints.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn home_is_zero_or_middle_of_range() {
        let joint = |position_min, position_max| JointLimits {
            position_min,
            position_max,
            velocity: 1.0,
            acceleration: 1.0,
            jerk: 1.0,
        };
        let joints = [joint(-1.0, 2.0), joint(0.5, 1.5), joint(-3.0, -1.0)];
        assert_eq!(home(&joints), [0.0, 1.0, -2.0]);
    }
}
