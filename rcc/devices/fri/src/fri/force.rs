//! Estimates the force at the tool from joint torques, for controllers that report only those. It is as good as their
//! estimate of external torques, and assumes that the force acts on the last link.

use std::sync::Arc;

use nalgebra::{Matrix6, Vector6};
use takt_motion::Model;
use takt_net::device::Kinematics;
use takt_net::value::{Twist, Vector, Wrench};

use super::protocol::{AXES, Joints};

/// Poses with less leverage than this in a direction, m or 1, yield no estimate.
const LEVERAGE_MIN: f64 = 0.05;

/// Estimator of an arm, by its kinematics.
#[derive(Debug)]
pub(super) struct ForceByTorques {
    kinematics: Option<Arc<dyn Kinematics>>,
}

impl ForceByTorques {
    /// For the arm of that model; an unknown model yields no estimates.
    pub(super) fn new(model: &Model) -> Self {
        let kinematics = model.unlimited();
        Self {
            kinematics: kinematics.filter(|it| it.joints() == AXES),
        }
    }

    /// Force and torque at the flange, along and about the axes of the base, that cause these torques, Nm, at these
    /// joint positions, rad. The part of the seven torques that no such force causes is ignored. `None` near singular
    /// poses.
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

    /// Jacobian of the flange, by columns.
    fn jacobian(&self, joints: &Joints) -> Option<[Vector6<f64>; AXES]> {
        let mut columns = [Twist::default(); AXES];
        self.kinematics.as_ref()?.jacobian(joints, &mut columns);
        Some(
            columns
                .map(|Twist { vel, rot }| Vector6::new(vel.x, vel.y, vel.z, rot.x, rot.y, rot.z)),
        )
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
    fn force_estimate_recovers_wrench_from_torques() {
        for model in ["kuka_lwr4", "kuka_iiwa7", "kuka_iiwa14"] {
            let arm = ForceByTorques::new(&model.into());
            let wrench = [10.0, -20.0, 30.0, 1.0, -2.0, 3.0];
            let estimate = arm.estimate(&BENT, &torques(&arm, wrench)).unwrap();
            let force = estimate.force - Vector::new(10.0, -20.0, 30.0);
            let torque = estimate.torque - Vector::new(1.0, -2.0, 3.0);
            assert!(force.norm() < 1e-9 && torque.norm() < 1e-9, "{estimate:?}");
        }
    }

    #[test]
    fn force_estimate_singular_or_unknown_arm_is_none() {
        let arm = ForceByTorques::new(&"kuka_iiwa7".into());
        assert_eq!(arm.estimate(&[0.0; AXES], &[1.0; AXES]), None);
        let arm = ForceByTorques::new(&"staubli_tx90".into());
        assert_eq!(arm.estimate(&BENT, &[1.0; AXES]), None);
    }
}
