//! Where the flange of an LBR arm is and how it moves with the joints. No limits, no inverse.

use super::AXES;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Rows X, Y, Z (m/rad), then rotations about x, y, z (rad/rad), in the base frame.
pub(crate) type Jacobian = SMatrix<f64, 6, 7>;

/// A place and an orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) rotation: Matrix3<f64>,
    /// m
    pub(crate) position: Vector3<f64>,
}

/// Seven axes, pivots and hinges by turns; all of them intersect in shoulder, elbow and wrist.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Chain {
    /// Heights of shoulder, elbow, wrist and flange above the one before, m; data sheets.
    links: [f64; 4],
    /// Sense of each axis against z for pivots and y for hinges.
    signs: [f64; AXES],
}

impl Chain {
    /// LWR 4+.
    pub(crate) const LWR: Self = Self {
        links: [0.3105, 0.400, 0.390, 0.078],
        signs: [1.0, -1.0, 1.0, 1.0, 1.0, -1.0, 1.0],
    };
    /// LBR iiwa 7 R800 with its basic media flange.
    pub(crate) const IIWA7: Self = Self::iiwa(0.340, 0.400);
    /// LBR iiwa 14 R820 with its basic media flange.
    pub(crate) const IIWA14: Self = Self::iiwa(0.360, 0.420);

    const fn iiwa(base: f64, upper: f64) -> Self {
        Self {
            links: [base, upper, 0.400, 0.126],
            signs: [1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0],
        }
    }

    /// The flange, and origin and direction of every axis.
    fn axes(&self, joints: &[f64; AXES]) -> (Place, [(Vector3<f64>, Vector3<f64>); AXES]) {
        let mut rotation = Matrix3::identity();
        let mut position = Vector3::zeros();
        let mut axes = [(Vector3::zeros(), Vector3::zeros()); AXES];
        for (joint, axis) in axes.iter_mut().enumerate() {
            let is_hinge = joint % 2 == 1;
            if is_hinge {
                position += rotation.column(2) * self.links[joint / 2];
            }
            let (sin, cos) = (self.signs[joint] * joints[joint]).sin_cos();
            let turn = if is_hinge {
                Matrix3::new(cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos)
            } else {
                Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
            };
            let direction = rotation.column(if is_hinge { 1 } else { 2 });
            *axis = (position, direction * self.signs[joint]);
            rotation *= turn;
        }
        position += rotation.column(2) * self.links[3];
        (Place { rotation, position }, axes)
    }

    pub(crate) fn forward(&self, joints: &[f64; AXES]) -> Place {
        self.axes(joints).0
    }

    pub(crate) fn jacobian(&self, joints: &[f64; AXES]) -> (Place, Jacobian) {
        let (place, axes) = self.axes(joints);
        let mut jacobian = Jacobian::zeros();
        for (joint, (origin, direction)) in axes.iter().enumerate() {
            let linear = direction.cross(&(place.position - origin));
            jacobian.fixed_view_mut::<3, 1>(0, joint).copy_from(&linear);
            jacobian
                .fixed_view_mut::<3, 1>(3, joint)
                .copy_from(direction);
        }
        (place, jacobian)
    }
}

/// The rotation that leads from `from` to `to`, as a vector along its axis, rad.
pub(crate) fn turn(from: &Matrix3<f64>, to: &Matrix3<f64>) -> Vector3<f64> {
    let between = to * from.transpose();
    let axis = Vector3::new(
        between[(2, 1)] - between[(1, 2)],
        between[(0, 2)] - between[(2, 0)],
        between[(1, 0)] - between[(0, 1)],
    ) / 2.0;
    let sin = axis.norm();
    if sin < 1e-12 {
        return axis;
    }
    let cos = (between.trace() - 1.0) / 2.0;
    axis * (sin.atan2(cos) / sin)
}

#[cfg(test)]
mod tests {
    use super::*;

    const Q: [f64; AXES] = [0.3, -0.4, 0.5, 1.1, -0.7, 0.8, 0.9];

    #[test]
    fn stretched_up_and_elbow_square() {
        let mut joints = [0.0; AXES];
        let up = Chain::IIWA14.forward(&joints).position;
        assert!((up - Vector3::new(0.0, 0.0, 1.306)).norm() < 1e-12);
        // The lower arm of an iiwa leans forward with a negative A4, that of an LWR with a positive A3.
        joints[3] = -std::f64::consts::FRAC_PI_2;
        let bent = Chain::IIWA7.forward(&joints).position;
        assert!((bent - Vector3::new(0.526, 0.0, 0.740)).norm() < 1e-12);
        joints[3] = std::f64::consts::FRAC_PI_2;
        let bent = Chain::LWR.forward(&joints).position;
        assert!((bent - Vector3::new(0.468, 0.0, 0.7105)).norm() < 1e-12);
    }

    #[test]
    fn the_jacobian_is_the_derivative() {
        const STEP: f64 = 1e-6;
        for chain in [Chain::LWR, Chain::IIWA7, Chain::IIWA14] {
            let (place, jacobian) = chain.jacobian(&Q);
            for joint in 0..AXES {
                let mut moved = Q;
                moved[joint] += STEP;
                let there = chain.forward(&moved);
                let linear = (there.position - place.position) / STEP;
                let angular = turn(&place.rotation, &there.rotation) / STEP;
                let column = jacobian.column(joint);
                assert!((linear - column.fixed_rows::<3>(0)).norm() < 1e-5);
                assert!((angular - column.fixed_rows::<3>(3)).norm() < 1e-5);
            }
        }
    }
}
