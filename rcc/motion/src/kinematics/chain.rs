//! Any arm as a list of rotation axes: what another program needs to compute the forward kinematics without this crate.
//! It has no inverse.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use takt_net::device::Kinematics;
use takt_net::{Frame, Twist};

/// Most joints of an arm.
const JOINTS_MAX: usize = 16;

/// The kinematics of an arm as a product of exponentials: the flange is where the rotations about all axes, the last one
/// first, bring `home`.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// The flange in the base while all joints are at 0, m.
    pub home: Frame,
    /// The rotation axes of the joints while all are at 0, from the base.
    pub axes: Vec<Axis>,
}

/// The rotation axis of a joint, in the base of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Unit vector along it.
    pub direction: Vector3<f64>,
    /// A point on it, m: the one nearest to the flange.
    pub point: Vector3<f64>,
}

impl Chain {
    /// The axes of an arm.
    pub fn of(arm: &dyn Kinematics) -> Self {
        let zero = [0.0; JOINTS_MAX];
        let zero = zero.get(..arm.joints()).unwrap_or(&zero);
        let home = arm.forward(zero);
        let mut columns = vec![Twist::default(); zero.len()];
        arm.jacobian(zero, &mut columns);
        let axis = |column: &Twist| Axis {
            direction: column.rot,
            point: home.translation.vector + column.rot.cross(&column.vel),
        };
        let axes = columns.iter().map(axis).collect();
        Self { home, axes }
    }

    /// The flange in the base at these joint positions, rad; joints that are left out are at 0.
    #[must_use]
    pub fn forward(&self, joints: &[f64]) -> Frame {
        let pairs = self.axes.iter().zip(joints).rev();
        pairs.fold(self.home, |flange, (axis, joint)| {
            let turn = UnitQuaternion::from_scaled_axis(axis.direction * *joint);
            let to = Translation3::from(axis.point);
            to * turn * to.inverse() * flange
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODELS: [&str; 6] = [
        "staubli_tx90",
        "kuka_lwr4",
        "kuka_iiwa7",
        "kuka_iiwa14",
        "kuka_youbot",
        "kuka_youbot_upright",
    ];

    #[test]
    fn chain_of_every_model_is_its_forward_kinematics() {
        for model in MODELS {
            let arm = super::super::named(model).unwrap();
            let chain = Chain::of(&*arm);
            assert_eq!(chain.axes.len(), arm.joints());
            for round in 0..200 {
                let joint = |axis: usize| 2.5 * (f64::from(round) * 1.7 + axis as f64 * 0.9).sin();
                let joints: Vec<_> = (0..arm.joints()).map(joint).collect();
                let (wanted, found) = (arm.forward(&joints), chain.forward(&joints));
                let off = (wanted.translation.vector - found.translation.vector).norm();
                assert!(off < 1e-12, "{model}: {off} m");
                let turned = wanted.rotation.angle_to(&found.rotation);
                assert!(turned < 1e-7, "{model}: {turned} rad");
            }
        }
    }
}
