//! The law of an arm whose tool gives way: a spring and a damper between where the flange is commanded and where it
//! is, along the flange's own axes, as torques of the joints. What holds the arm's weight is not in it.

use takt_ethercat::youbot::ARM;
use takt_motion::kinematics::YouBot;
use takt_net::Frame;
use takt_net::device::Kinematics;
use takt_net::value::{Rotation, Wrench};

/// Half of how far a joint is moved to see where the flange goes, rad: enough for six digits.
const STEP: f64 = 1e-5;

/// Position (rad) and speed (rad/s) of each joint.
pub(super) type Motions = [[f64; 2]; 5];
/// Along and about x, y and z of the flange.
type Axes = [f64; 6];

/// How the tool gives way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tool {
    arm: YouBot,
    /// N/m and N m/rad, from 0.
    pub(super) stiffness: Axes,
    /// Damping ratio, 0 to 1.
    pub(super) damping: Axes,
    /// Force and torque on top of them, N and N m.
    pub(super) added: Axes,
}

impl Default for Tool {
    /// As stiff as the vendor's users know it; that one does not damp.
    fn default() -> Self {
        Self {
            arm: YouBot::default(),
            stiffness: [50.0, 50.0, 50.0, 5.0, 5.0, 5.0],
            damping: [0.7; 6],
            added: [0.0; 6],
        }
    }
}

/// In the order of [`Axes`].
pub(super) fn axes(wrench: &Wrench) -> Axes {
    let Wrench { force, torque } = wrench;
    [force.x, force.y, force.z, torque.x, torque.y, torque.z]
}

/// The way from one frame to another, m and rad, seen along these axes.
fn way(seen: &Rotation, from: &Frame, to: &Frame) -> Axes {
    let way = to.translation.vector - from.translation.vector;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    let (way, turn) = (
        seen.inverse_transform_vector(&way),
        seen.inverse_transform_vector(&turn),
    );
    [way.x, way.y, way.z, turn.x, turn.y, turn.z]
}

impl Tool {
    /// How fast the flange moves with each joint (m/s and rad/s for 1 rad/s).
    fn jacobian(&self, joints: &[f64; 5], here: &Frame) -> [Axes; 5] {
        std::array::from_fn(|n| {
            let at = |by: f64| {
                let mut joints = *joints;
                joints[n] += by;
                self.arm.forward(&joints)
            };
            way(&here.rotation, &at(-STEP), &at(STEP)).map(|way| way / (2.0 * STEP))
        })
    }

    /// Torques at the joints, N m. Each direction is damped for the inertia of the motors that move it: that of links
    /// is small behind such gears.
    pub(super) fn torques(&self, commanded: &Motions, measured: &Motions) -> [f64; 5] {
        let (wanted, joints) = (commanded.map(|[at, _]| at), measured.map(|[at, _]| at));
        let here = self.arm.forward(&joints);
        let jacobian = self.jacobian(&joints, &here);
        let deviation = way(&here.rotation, &here, &self.arm.forward(&wanted));
        let wrench: Axes = std::array::from_fn(|i| {
            let (mut speed, mut mobility) = (0.0, 0.0);
            for (n, geometry) in ARM.iter().enumerate() {
                speed += jacobian[n][i] * (commanded[n][1] - measured[n][1]);
                mobility += jacobian[n][i].powi(2) / geometry.inertia();
            }
            // A direction in which the arm cannot move needs no damper.
            let mass = if mobility > 1e-9 { 1.0 / mobility } else { 0.0 };
            let damper = 2.0 * self.damping[i] * (self.stiffness[i] * mass).sqrt();
            self.stiffness[i] * deviation[i] + damper * speed + self.added[i]
        });
        jacobian.map(|column| {
            column
                .iter()
                .zip(wrench)
                .map(|(way, force)| way * force)
                .sum()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: [f64; 5] = [1.0, 1.2, -1.4, 1.1, 2.0];

    fn at(joints: [f64; 5]) -> Motions {
        joints.map(|joint| [joint, 0.0])
    }

    /// Work of the torques over small ways of the joints is that of the wrench over the way of the flange.
    #[test]
    fn what_is_added_does_the_same_work_at_the_joints_as_at_the_flange() {
        let tool = Tool {
            stiffness: [0.0; 6],
            added: [3.0, -2.0, 5.0, 0.4, 0.7, -0.3],
            ..Tool::default()
        };
        let torques = tool.torques(&at(POSE), &at(POSE));
        let here = tool.arm.forward(&POSE);
        let ways = [2e-6, -1e-6, 3e-6, 1e-6, -2e-6];
        let moved: [f64; 5] = std::array::from_fn(|n| POSE[n] + ways[n]);
        let flange = way(&here.rotation, &here, &tool.arm.forward(&moved));
        let of_joints: f64 = torques.iter().zip(ways).map(|(t, way)| t * way).sum();
        let of_flange: f64 = tool.added.iter().zip(flange).map(|(f, way)| f * way).sum();
        assert!(
            (of_joints - of_flange).abs() < 1e-9,
            "{of_joints} {of_flange}"
        );
        assert!(of_joints.abs() > 1e-6);
    }

    #[test]
    fn a_tool_is_pulled_to_where_it_is_commanded_and_nowhere_once_there() {
        let tool = Tool::default();
        assert!(
            tool.torques(&at(POSE), &at(POSE))
                .iter()
                .all(|t| t.abs() < 1e-9)
        );
        for n in 0..5 {
            let mut commanded = POSE;
            commanded[n] += 0.05;
            let torques = tool.torques(&at(commanded), &at(POSE));
            assert!(torques[n] > 0.0, "joint {n}: {torques:?}");
            let mut moving = at(POSE);
            moving[n][1] = 0.2;
            let torques = tool.torques(&at(POSE), &moving);
            assert!(torques[n] < 0.0, "joint {n} is damped: {torques:?}");
        }
    }

    #[test]
    fn directions_have_springs_of_their_own() {
        let tool = Tool {
            stiffness: [0.0, 0.0, 400.0, 0.0, 0.0, 0.0],
            ..Tool::default()
        };
        // Joint 4 turns about the flange's z axis, which moves nothing along it.
        let mut commanded = POSE;
        commanded[4] += 0.3;
        let torques = tool.torques(&at(commanded), &at(POSE));
        assert!(
            torques.iter().all(|torque| torque.abs() < 1e-6),
            "{torques:?}"
        );
    }
}
