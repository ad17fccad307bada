//! Pose control of a base: computes the velocity towards commanded poses, plus the velocity of the poses themselves.
//! The position comes from odometry; acceleration limits are applied elsewhere.

use std::f64::consts::TAU;

use takt_core::device::rejected::{Cause, Rejected, Rejection};
use takt_core::device::setpoint::{LOST_DISTANCE, START_DISTANCE};
use takt_net::Frame;
use takt_net::device::Given;
use takt_net::value::Vector;

/// Proportional gain of the position error, 1/s: that of the vendor's users.
const GAIN: f64 = 3.0;
/// Largest deviation of a pose from the floor, m, and of its z axis from the vertical, sine.
const OFF_PLANE: f64 = 1e-3;

/// x and y (m) and heading (rad), or their rates.
pub(super) type Planar = [f64; 3];

/// The course of the base.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Course {
    goal: Option<Goal>,
    refused: bool,
    rejected: Rejected,
}

/// A pose since the cycle in which it was given, and the velocity of the poses.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Goal {
    cycle: u64,
    pose: Planar,
    velocity: Planar,
}

/// The pose in the plane; `None` for one outside of it, or if it is not finite.
fn flat(pose: &Frame) -> Option<Planar> {
    let at = pose.translation.vector;
    let (ahead, up) = (pose.rotation * Vector::x(), pose.rotation * Vector::z());
    let level = at.z.abs() <= OFF_PLANE && up.x.hypot(up.y) <= OFF_PLANE && up.z > 0.0;
    let flat = [at.x, at.y, ahead.y.atan2(ahead.x)];
    (level && flat.iter().all(|v| v.is_finite())).then_some(flat)
}

/// The offset from one pose to another, by the shorter turn.
fn offset(from: Planar, to: Planar) -> Planar {
    let turn = to[2] - from[2];
    [
        to[0] - from[0],
        to[1] - from[1],
        turn - TAU * (turn / TAU).round(),
    ]
}

impl Course {
    /// Whether the current poses are out of reach; cleared when they end.
    pub(super) const fn is_refused(&self) -> bool {
        self.refused
    }

    /// Rejected poses.
    pub(super) const fn rejected(&self) -> &Rejected {
        &self.rejected
    }

    /// The current target.
    pub(super) fn goal(&self) -> Option<Planar> {
        self.goal.filter(|_| !self.refused).map(|goal| goal.pose)
    }

    /// The velocity in the base's frame towards the pose in force; `None` without one, or if it is refused. `cycle_s`
    /// is the cycle time of the nets.
    #[expect(clippy::cast_precision_loss, reason = "a count of a few cycles")]
    pub(super) fn follow(
        &mut self,
        given: Option<&Given<Frame>>,
        at: Planar,
        cycle_s: f64,
    ) -> Option<Planar> {
        let Some(given) = given else {
            (self.goal, self.refused) = (None, false);
            return None;
        };
        let last = self.goal.filter(|_| !self.refused);
        let velocity = |pose: Planar| match last {
            Some(last) if given.cycle > last.cycle => {
                let span_s = (given.cycle - last.cycle) as f64 * cycle_s;
                offset(last.pose, pose).map(|offset| offset / span_s)
            }
            Some(last) => last.velocity,
            None => [0.0; 3],
        };
        let goal = flat(&given.value).map(|pose| Goal {
            cycle: given.cycle,
            pose,
            velocity: velocity(pose),
        });
        let most = if last.is_some() {
            LOST_DISTANCE
        } else {
            START_DISTANCE
        };
        let away = goal.map(|goal| offset(at, goal.pose));
        let near = away.is_some_and(|[x, y, turn]| x.hypot(y) <= most && turn.abs() <= most);
        if self.refused {
            self.rejected.repeat();
        } else if !near {
            let cause = match (away, last) {
                (None, _) => Cause::Finite,
                (Some(_), None) => Cause::Start,
                (Some(_), Some(_)) => Cause::Lost,
            };
            self.rejected.begin(Rejection {
                cause,
                wanted: away.map_or(f64::NAN, |[x, y, turn]| x.hypot(y).max(turn.abs())),
                actual: 0.0,
                allowed: most,
            });
        }
        self.refused |= !near;
        self.goal = goal;
        let (goal, away) = (goal?, away?);
        let [x, y, turn]: Planar = std::array::from_fn(|i| GAIN.mul_add(away[i], goal.velocity[i]));
        let (sin, cos) = at[2].sin_cos();
        (!self.refused).then_some([cos * x + sin * y, cos * y - sin * x, turn])
    }
}

/// The velocity, scaled down in its direction to the limits of the base (m/s, rad/s).
pub(super) fn within(velocity: Planar, speed_max: f64, rotation_max: f64) -> Planar {
    let [x, y, turn] = velocity;
    let over = (x.hypot(y) / speed_max).max(turn.abs() / rotation_max);
    velocity.map(|v| if over > 1.0 { v / over } else { v })
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_net::value::Rotation;

    /// s
    const CYCLE: f64 = 0.002;

    fn given(cycle: u64, [x, y, heading]: Planar) -> Given<Frame> {
        let rotation = Rotation::from_axis_angle(&Vector::z_axis(), heading);
        Given {
            cycle,
            every: 1,
            value: Frame::from_parts([x, y, 0.0].into(), rotation),
        }
    }

    /// Lets an ideal base follow poses; returns its largest lag, m or rad.
    fn behind(poses: impl Fn(f64) -> Planar, start: Planar) -> f64 {
        let (mut course, mut at, mut most) = (Course::default(), start, 0.0_f64);
        for cycle in 0..2000_u32 {
            let pose = poses(f64::from(cycle) * CYCLE);
            let [x, y, turn] = offset(at, pose);
            most = most.max(x.hypot(y)).max(turn.abs());
            let given = given(u64::from(cycle) + 1, pose);
            let velocity = course.follow(Some(&given), at, CYCLE).unwrap();
            let (sin, cos) = (at[2] + velocity[2] * CYCLE / 2.0).sin_cos();
            at[0] += (cos * velocity[0] - sin * velocity[1]) * CYCLE;
            at[1] += (sin * velocity[0] + cos * velocity[1]) * CYCLE;
            at[2] += velocity[2] * CYCLE;
        }
        most
    }

    #[test]
    fn youbot_base_follows_poses_through_all_headings() {
        let circle = |t: f64| [0.3 * t.cos(), 0.3 * t.sin(), t + 3.0];
        let most = behind(circle, circle(0.0));
        assert!(most < 0.003, "{most}");
        let still = |_| [0.0, 0.0, 0.0];
        assert!(behind(still, [0.01, 0.01, 0.01]) < 0.02);
    }

    #[test]
    fn youbot_base_poses_out_of_reach_are_refused() {
        let at = [0.0; 3];
        let tilted = Given {
            value: Frame::from_parts(
                [0.0; 3].into(),
                Rotation::from_axis_angle(&Vector::x_axis(), 0.1),
            ),
            ..given(1, at)
        };
        for first in [
            given(1, [0.03, 0.0, 0.0]),
            given(1, [0.0, 0.0, 0.03]),
            given(1, [f64::NAN, 0.0, 0.0]),
            tilted,
        ] {
            let mut course = Course::default();
            assert_eq!(course.follow(Some(&first), at, CYCLE), None);
            assert_eq!(course.follow(Some(&given(2, at)), at, CYCLE), None);
            assert!(course.is_refused() && course.goal().is_none());
            assert_eq!(course.follow(None, at, CYCLE), None);
            assert!(course.follow(Some(&given(3, at)), at, CYCLE).is_some());
        }
        let mut course = Course::default();
        assert!(course.follow(Some(&given(1, at)), at, CYCLE).is_some());
        assert!(
            course
                .follow(Some(&given(2, [0.1, 0.0, 0.0])), at, CYCLE)
                .is_some()
        );
        assert_eq!(
            course.follow(Some(&given(3, [0.21, 0.0, 0.0])), at, CYCLE),
            None
        );
    }

    #[test]
    fn youbot_base_overspeed_keeps_direction() {
        let [x, y, turn] = within([3.0, 4.0, 1.0], 1.0, 0.8);
        assert!((x - 0.6).abs() < 1e-9 && (y - 0.8).abs() < 1e-9 && (turn - 0.2).abs() < 1e-9);
        assert!((within([0.1, 0.0, 1.6], 1.0, 0.8)[2] - 0.8).abs() < 1e-9);
        assert_eq!(
            within([0.1, 0.0, 0.1], 1.0, 0.8).map(f64::to_bits),
            [0.1, 0.0, 0.1].map(f64::to_bits)
        );
    }
}
