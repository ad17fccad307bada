//! The geometry that arms share: rotations about an axis, frames, and two links in a plane.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use takt_net::Frame;
use takt_net::device::Unreachable;

/// Tolerance for rounding: the cosine of an elbow that exceeds ±1 by less counts as a straight or
/// folded elbow.
const STRAIGHT: f64 = 1e-12;

/// The planar part of an arm: the first link is turned by an angle from the z axis towards x, the
/// second link by one more. Returns both angles, rad, that bring its end to (`x`, `z`) with the
/// elbow bent towards `bend` (±1). Lengths in m.
pub(super) fn two_links(
    x: f64,
    z: f64,
    first: f64,
    second: f64,
    bend: f64,
) -> Result<[f64; 2], Unreachable> {
    let cos = (x * x + z * z - first * first - second * second) / (2.0 * first * second);
    // Not a number, after an overflow, is out of reach as well.
    let is_within_reach = cos.abs() <= 1.0 + STRAIGHT;
    if !is_within_reach {
        return Err(Unreachable::Reach);
    }
    let elbow = bend * cos.clamp(-1.0, 1.0).acos();
    let (sin, cos) = elbow.sin_cos();
    let shoulder = x.atan2(z) - (second * sin).atan2(first + second * cos);
    Ok([shoulder, elbow])
}

/// A frame from a position (m) and a rotation matrix.
pub(super) fn frame(position: Vector3<f64>, rotation: &Matrix3<f64>) -> Frame {
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(*rotation);
    Frame::from_parts(
        position.into(),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

pub(super) fn rot_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

pub(crate) fn rot_z(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}
