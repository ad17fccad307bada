//! Forward kinematics and Jacobian of an LBR arm. No limits, no inverse kinematics.

use super::AXES;
use nalgebra::{Matrix3, Vector3};

/// Jacobian of the flange, by columns: X, Y, Z (m/rad), then rotations about x, y, z (rad/rad), in the base
/// frame. Plain arrays: the emulators evaluate it thousands of times a second, in debug builds too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Jacobian(pub(crate) [[f64; 6]; AXES]);

impl Jacobian {
    /// Velocity of the flange at these joint speeds.
    pub(crate) fn times(&self, speeds: &[f64; AXES]) -> [f64; 6] {
        let mut sum = [0.0; 6];
        for (column, speed) in self.0.iter().zip(speeds) {
            for (sum, part) in sum.iter_mut().zip(column) {
                *sum += part * speed;
            }
        }
        sum
    }

    /// Joint torques of a wrench on the flange.
    pub(crate) fn torques(&self, wrench: &[f64; 6]) -> [f64; AXES] {
        self.0
            .map(|column| column.iter().zip(wrench).map(|(a, b)| a * b).sum())
    }
}

/// A pose: position and orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pose {
    pub(crate) rotation: Matrix3<f64>,
    /// m
    pub(crate) position: Vector3<f64>,
}

impl Pose {
    fn new(columns: &[Triple; 3], position: Triple) -> Self {
        Self {
            rotation: Matrix3::from_columns(&columns.map(Vector3::from)),
            position: position.into(),
        }
    }

    /// `other` relative to this pose.
    pub(crate) fn to(self, other: &Self) -> Self {
        let back = self.rotation.transpose();
        Self {
            rotation: back * other.rotation,
            position: back * (other.position - self.position),
        }
    }
}

/// Seven axes, alternating roll and pitch; all of them intersect in shoulder, elbow and wrist.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Chain {
    /// Heights of shoulder, elbow, wrist and flange above the one before, m; data sheets.
    links: [f64; 4],
    /// Sense of each axis against z for roll and y for pitch axes.
    signs: [f64; AXES],
    /// Masses of upper arm, forearm and hand, kg, in the middle of their links. The data sheets give the whole arm's; the
    /// shares are an *assumption*.
    masses: [f64; 3],
}

/// Of the earth, m/s2.
const GRAVITY: f64 = 9.81;

impl Chain {
    /// LWR 4+.
    pub(crate) const LWR: Self = Self {
        links: [0.3105, 0.400, 0.390, 0.078],
        signs: [1.0, -1.0, 1.0, 1.0, 1.0, -1.0, 1.0],
        masses: [5.0, 4.0, 2.0],
    };
    /// LBR iiwa 7 R800 with its basic media flange.
    pub(crate) const IIWA7: Self = Self::iiwa(0.340, 0.400, [7.0, 5.0, 3.0]);
    /// LBR iiwa 14 R820 with its basic media flange.
    pub(crate) const IIWA14: Self = Self::iiwa(0.360, 0.420, [9.0, 6.0, 4.0]);

    const fn iiwa(base: f64, upper: f64, masses: [f64; 3]) -> Self {
        Self {
            links: [base, upper, 0.400, 0.126],
            signs: [1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0],
            masses,
        }
    }

    /// Flange pose, and origin and direction of every axis.
    fn axes(&self, joints: &[f64; AXES]) -> ([Triple; 3], Triple, [(Triple, Triple); AXES]) {
        let [mut x, mut y, mut z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let mut position = [0.0; 3];
        let mut axes = [([0.0; 3], [0.0; 3]); AXES];
        for (joint, axis) in axes.iter_mut().enumerate() {
            let is_hinge = joint % 2 == 1;
            if is_hinge {
                position = sum(&position, 1.0, &z, self.links[joint / 2]);
            }
            let sign = self.signs[joint];
            *axis = (
                position,
                (if is_hinge { y } else { z }).map(|part| sign * part),
            );
            let (sin, cos) = (sign * joints[joint]).sin_cos();
            if is_hinge {
                (x, z) = (sum(&x, cos, &z, -sin), sum(&x, sin, &z, cos));
            } else {
                (x, y) = (sum(&x, cos, &y, sin), sum(&x, -sin, &y, cos));
            }
        }
        position = sum(&position, 1.0, &z, self.links[3]);
        ([x, y, z], position, axes)
    }

    pub(crate) fn forward(&self, joints: &[f64; AXES]) -> Pose {
        let (columns, position, _) = self.axes(joints);
        Pose::new(&columns, position)
    }

    /// Joint torques that hold the arm's own weight, Nm.
    pub(crate) fn gravity(&self, joints: &[f64; AXES]) -> [f64; AXES] {
        let (_, flange, axes) = self.axes(joints);
        let [shoulder, elbow, wrist] = [1, 3, 5].map(|axis: usize| axes[axis].0);
        // Each mass loads the axes before its end.
        let loads = [(shoulder, elbow, 3), (elbow, wrist, 5), (wrist, flange, 7)];
        let mut torques = [0.0; AXES];
        for ((from, to, count), mass) in loads.iter().zip(self.masses) {
            let centre = sum(from, 0.5, to, 0.5);
            for (torque, (origin, [a, b, _])) in torques.iter_mut().zip(axes).take(*count) {
                let [x, y, _] = sum(&centre, 1.0, &origin, -1.0);
                // About the axis: the lever times the force that lifts the mass.
                *torque += (a * y - b * x) * mass * GRAVITY;
            }
        }
        torques
    }

    pub(crate) fn jacobian(&self, joints: &[f64; AXES]) -> (Pose, Jacobian) {
        let (columns, position, axes) = self.axes(joints);
        let jacobian = axes.map(|(origin, [a, b, c])| {
            let [x, y, z] = sum(&position, 1.0, &origin, -1.0);
            [b * z - c * y, c * x - a * z, a * y - b * x, a, b, c]
        });
        (Pose::new(&columns, position), Jacobian(jacobian))
    }
}

type Triple = [f64; 3];

/// `a * p + b * q`.
fn sum(a: &Triple, p: f64, b: &Triple, q: f64) -> Triple {
    [
        a[0] * p + b[0] * q,
        a[1] * p + b[1] * q,
        a[2] * p + b[2] * q,
    ]
}

/// The rotation from `from` to `to`, as a vector along its axis, rad.
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
    fn chain_gravity_loads_levers_alone() {
        for chain in [Chain::LWR, Chain::IIWA7, Chain::IIWA14] {
            let upright = chain.gravity(&[0.0; AXES]);
            assert!(
                upright.iter().all(|torque| torque.abs() < 1e-9),
                "{upright:?}"
            );
            // Stretched out to the side by the shoulder alone.
            let mut joints = [0.0; AXES];
            joints[1] = std::f64::consts::FRAC_PI_2;
            let torques = chain.gravity(&joints);
            let [_, upper, fore, hand] = chain.links;
            let [a, b, c] = chain.masses;
            let levers =
                a * upper / 2.0 + b * (upper + fore / 2.0) + c * (upper + fore + hand / 2.0);
            assert!(
                (torques[1].abs() - levers * GRAVITY).abs() < 1e-9,
                "{torques:?}"
            );
            assert!(torques[0].abs() < 1e-9 && torques[3].abs() > 1.0);
            // The potential energy falls that way: holding it takes a torque against it.
            assert!(torques[1] * chain.signs[1] * joints[1] * chain.signs[1] < 0.0);
        }
    }

    #[test]
    fn chain_forward_stretched_and_right_angle() {
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
    fn chain_jacobian_is_derivative() {
        const STEP: f64 = 1e-6;
        for chain in [Chain::LWR, Chain::IIWA7, Chain::IIWA14] {
            let (pose, jacobian) = chain.jacobian(&Q);
            for joint in 0..AXES {
                let mut moved = Q;
                moved[joint] += STEP;
                let there = chain.forward(&moved);
                let linear = (there.position - pose.position) / STEP;
                let angular = turn(&pose.rotation, &there.rotation) / STEP;
                let [x, y, z, a, b, c] = jacobian.0[joint];
                assert!((linear - Vector3::new(x, y, z)).norm() < 1e-5);
                assert!((angular - Vector3::new(a, b, c)).norm() < 1e-5);
            }
        }
    }
}
