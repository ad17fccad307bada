//! Control law of an arm with tool impedance: a spring and a damper between commanded and measured flange pose, along
//! the flange's axes, as joint torques. Gravity compensation is not included.

use takt_ethercat::youbot::{ARM, JointGeometry};
use takt_motion::kinematics::YouBot;
use takt_net::Frame;
use takt_net::device::Kinematics;
use takt_net::value::{Rotation, Twist, Vector, Wrench};

/// Position (rad) and speed (rad/s) of each joint.
pub(super) type Motions = [[f64; 2]; 5];
/// Along and about x, y and z of the flange.
type Axes = [f64; 6];

/// How far the flange is from each joint at most, m: the arm stretched.
const REACH: [f64; 5] = [0.53, 0.47, 0.31, 0.18, 0.0];

/// Stiffness of the tool against the inertia of the motors, 1/s²: of no posture is it more. Springs of a stretched arm lie one upon
/// the other; the sum over the joints bounds the stiffest.
pub(super) fn stiffness_by_inertia(stiffness: &Axes) -> f64 {
    let [x, y, z, a, b, c] = *stiffness;
    let (along, about) = (x.max(y).max(z), a.max(b).max(c));
    let at =
        |(joint, reach): (&JointGeometry, &f64)| (along * reach * reach + about) / joint.inertia();
    ARM.iter().zip(&REACH).map(at).sum()
}

/// Tool impedance parameters.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tool {
    arm: YouBot,
    /// N/m and N m/rad, from 0.
    pub(super) stiffness: Axes,
    /// Damping ratio, 0 to 1.
    pub(super) damping: Axes,
    /// Additional force and torque, N and Nm.
    pub(super) added: Axes,
}

impl Default for Tool {
    /// Default stiffness as the vendor's users know it; theirs is undamped.
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

/// The offset from one frame to another, m and rad, along the axes of `seen`.
fn offset(seen: &Rotation, from: &Frame, to: &Frame) -> Axes {
    let offset = to.translation.vector - from.translation.vector;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    let (offset, turn) = (
        seen.inverse_transform_vector(&offset),
        seen.inverse_transform_vector(&turn),
    );
    [offset.x, offset.y, offset.z, turn.x, turn.y, turn.z]
}

impl Tool {
    /// The default springs of an arm with that kinematics.
    pub(super) fn of(arm: YouBot) -> Self {
        Self {
            arm,
            ..Self::default()
        }
    }

    /// Flange velocity per joint velocity (m/s and rad/s for 1 rad/s).
    fn jacobian(&self, joints: &[f64; 5], here: &Frame) -> [Axes; 5] {
        let mut columns = [Twist::default(); 5];
        self.arm.jacobian(joints, &mut columns);
        columns.map(|Twist { vel, rot }| {
            let back = |v: &Vector| here.rotation.inverse_transform_vector(v);
            let (vel, rot) = (back(&vel), back(&rot));
            [vel.x, vel.y, vel.z, rot.x, rot.y, rot.z]
        })
    }

    /// Joint torques, Nm. Each direction is damped for the inertia of the motors that move it; that of the links is
    /// small behind such gears.
    pub(super) fn torques(&self, commanded: &Motions, measured: &Motions) -> [f64; 5] {
        let (wanted, joints) = (commanded.map(|[at, _]| at), measured.map(|[at, _]| at));
        let here = self.arm.forward(&joints);
        let jacobian = self.jacobian(&joints, &here);
        let deviation = offset(&here.rotation, &here, &self.arm.forward(&wanted));
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
                .map(|(offset, force)| offset * force)
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

    /// The work of the torques over small joint motions equals that of the wrench over the motion of the flange.
    #[test]
    fn youbot_tool_joint_work_equals_flange_work() {
        let tool = Tool {
            stiffness: [0.0; 6],
            added: [3.0, -2.0, 5.0, 0.4, 0.7, -0.3],
            ..Tool::default()
        };
        let torques = tool.torques(&at(POSE), &at(POSE));
        let here = tool.arm.forward(&POSE);
        let offsets = [2e-6, -1e-6, 3e-6, 1e-6, -2e-6];
        let moved: [f64; 5] = std::array::from_fn(|n| POSE[n] + offsets[n]);
        let flange = offset(&here.rotation, &here, &tool.arm.forward(&moved));
        let of_joints: f64 = torques
            .iter()
            .zip(offsets)
            .map(|(t, offset)| t * offset)
            .sum();
        let of_flange: f64 = tool
            .added
            .iter()
            .zip(flange)
            .map(|(f, offset)| f * offset)
            .sum();
        assert!(
            (of_joints - of_flange).abs() < 1e-9,
            "{of_joints} {of_flange}"
        );
        assert!(of_joints.abs() > 1e-6);
    }

    #[test]
    fn youbot_tool_is_pulled_to_commanded_pose() {
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

    /// In joint space, springs are at most as stiff against the inertia of the motors as the bound over all postures.
    #[test]
    fn youbot_tool_stiffness_is_bounded_in_each_posture() {
        let stiffness = [1000.0, 1000.0, 1000.0, 100.0, 100.0, 100.0];
        for arm in [YouBot::default(), YouBot::upright(YouBot::UPRIGHT_RANGES)] {
            let tool = Tool::of(arm);
            let mut most = 0.0_f64;
            for n in 0..8_u32.pow(3) {
                let turned = |digit: u32| f64::from(n / 8_u32.pow(digit) % 8) * 0.8;
                let joints = [0.3, turned(0), -turned(1), turned(2), 0.7];
                let here = tool.arm.forward(&joints);
                let columns = tool.jacobian(&joints, &here);
                let by_inertia = columns.iter().zip(&ARM).map(|(column, joint)| {
                    let springs = column.iter().zip(&stiffness);
                    springs.map(|(offset, k)| k * offset * offset).sum::<f64>() / joint.inertia()
                });
                most = most.max(by_inertia.sum());
            }
            let bound = stiffness_by_inertia(&stiffness);
            assert!(most <= bound && most > bound / 2.0, "{most} {bound}");
        }
    }

    #[test]
    fn youbot_tool_directions_have_separate_springs() {
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
