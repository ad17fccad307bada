//! The force at the tool by the torques at the joints, for controllers that tell only those. It is as good as their
//! estimate of what acts from outside, and knows nothing of forces on other links than the last.

use std::sync::Arc;

use nalgebra::{Matrix6, Vector6};
use takt_net::device::Kinematics;
use takt_net::value::{Vector, Wrench};

use super::protocol::{AXES, Joints};

/// By how much joints are moved to see what that does to the flange, rad.
const PROBE: f64 = 1e-6;
/// Poses from whose joints a direction is felt with less leverage than this, m or 1, tell no force.
const LEVERAGE_MIN: f64 = 0.05;

/// The geometry of an arm, and what torques at its joints say by it.
#[derive(Debug)]
pub(super) struct ForceByTorques {
    kinematics: Option<Arc<dyn Kinematics>>,
}

impl ForceByTorques {
    /// Of the arm of that model; nothing is told of one that is not known.
    pub(super) fn new(model: &str) -> Self {
        let kinematics = takt_motion::kinematics::named(model);
        Self {
            kinematics: kinematics.filter(|it| it.joints() == AXES),
        }
    }

    /// Force and torque on the flange, along and about the axes of the base, that cause these torques, Nm, at these
    /// joints, rad. Of seven torques, the part that no such force causes is left out. `None` near singular poses.
    pub(super) fn estimate(&self, joints: &Joints, torques: &Joints) -> Option<Wrench> {
        let columns = self.jacobian(joints)?;
        let mut square = Matrix6::zeros();
        let mut felt = Vector6::zeros();
        for (column, torque) in columns.iter().zip(torques) {
            square += column * column.transpose();
            felt += column * *torque;
        }
        let lower = square.cholesky()?;
        let leverage = lower.l_dirty().diagonal().min();
        let [x, y, z, a, b, c] = lower.solve(&felt).into();
        (leverage >= LEVERAGE_MIN).then_some(Wrench {
            force: Vector::new(x, y, z),
            torque: Vector::new(a, b, c),
        })
    }

    /// How the flange moves and turns per angle of each joint.
    fn jacobian(&self, joints: &Joints) -> Option<[Vector6<f64>; AXES]> {
        let kinematics = self.kinematics.as_ref()?;
        let flange = kinematics.forward(joints);
        let back = flange.rotation.inverse();
        Some(std::array::from_fn(|axis| {
            let mut probed = *joints;
            probed[axis] += PROBE;
            let moved = kinematics.forward(&probed);
            let way = (moved.translation.vector - flange.translation.vector) / PROBE;
            let turn = (moved.rotation * back).scaled_axis() / PROBE;
            Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BENT: Joints = [0.3, 0.5, -0.2, -1.2, 0.4, 0.8, 0.1];

    fn torques(arm: &ForceByTorques, wrench: [f64; 6]) -> Joints {
        let force = Vector6::from(wrench);
        arm.jacobian(&BENT)
            .unwrap()
            .map(|column| column.dot(&force))
    }

    #[test]
    fn what_a_force_does_to_the_joints_tells_the_force() {
        for model in ["kuka_lwr4", "kuka_iiwa7", "kuka_iiwa14"] {
            let arm = ForceByTorques::new(model);
            let wrench = [10.0, -20.0, 30.0, 1.0, -2.0, 3.0];
            let told = arm.estimate(&BENT, &torques(&arm, wrench)).unwrap();
            let force = told.force - Vector::new(10.0, -20.0, 30.0);
            let torque = told.torque - Vector::new(1.0, -2.0, 3.0);
            assert!(force.norm() < 1e-4 && torque.norm() < 1e-4, "{told:?}");
        }
    }

    #[test]
    fn a_stretched_arm_and_an_unknown_one_tell_nothing() {
        let arm = ForceByTorques::new("kuka_iiwa7");
        assert_eq!(arm.estimate(&[0.0; AXES], &[1.0; AXES]), None);
        let arm = ForceByTorques::new("staubli_tx90");
        assert_eq!(arm.estimate(&BENT, &[1.0; AXES]), None);
    }
}
