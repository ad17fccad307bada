//! Kinematics of the arms that Takt drives, in closed form: exact, without iteration and without
//! allocation, so that they can run in every cycle. Not here: dynamics, tools, or arms without a
//! closed form.

mod opw;
mod primitives;
mod srs;
#[cfg(test)]
mod tests;
mod wrist;
mod youbot;

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use takt_net::device::{Kinematics, Unreachable};
use takt_net::{Frame, JointLimits};

pub use opw::{Opw, OpwGeometry};
pub(crate) use primitives::table;
pub use srs::{Srs, SrsGeometry};
pub use youbot::YouBot;

/// Tolerance for rounding, rad: a solution that exceeds a joint limit by less counts as on the
/// limit.
const ON_LIMIT: f64 = 1e-10;
/// Tolerance for rounding: the cosine of an elbow that exceeds ±1 by less counts as a straight or
/// folded elbow.
const STRAIGHT: f64 = 1e-12;

/// Position range of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Smallest position, rad.
    pub min: f64,
    /// Largest position, rad.
    pub max: f64,
}

impl Range {
    /// From the bounds of a data sheet, in degrees.
    pub const fn degrees(min: f64, max: f64) -> Self {
        let (min, max) = (min.to_radians(), max.to_radians());
        Self { min, max }
    }

    /// The turn of `angle` (rad) within the range that is nearest to `hint` (rad).
    fn nearest_turn(self, angle: f64, hint: f64) -> Option<f64> {
        let mut near = angle + TAU * ((hint - angle) / TAU).round();
        if near > self.max + ON_LIMIT {
            near -= TAU * ((near - self.max - ON_LIMIT) / TAU).ceil();
        } else if near < self.min - ON_LIMIT {
            near += TAU * ((self.min - ON_LIMIT - near) / TAU).ceil();
        }
        let inside = near >= self.min - ON_LIMIT && near <= self.max + ON_LIMIT;
        inside.then(|| near.clamp(self.min, self.max))
    }
}

impl From<JointLimits> for Range {
    fn from(limits: JointLimits) -> Self {
        Self {
            min: limits.position_min,
            max: limits.position_max,
        }
    }
}

/// The kinematics of an arm by the name of its model, with the joint ranges of its data sheet:
/// `staubli_tx90`, `kuka_lwr4`, `kuka_iiwa7`, `kuka_iiwa14` or `kuka_youbot`.
pub fn named(model: &str) -> Option<Arc<dyn Kinematics>> {
    Some(match model {
        "staubli_tx90" => Arc::new(Opw::staubli_tx90()),
        "kuka_lwr4" => Arc::new(Srs::kuka_lwr4()),
        "kuka_iiwa7" => Arc::new(Srs::kuka_iiwa7()),
        "kuka_iiwa14" => Arc::new(Srs::kuka_iiwa14()),
        "kuka_youbot" => Arc::new(YouBot::default()),
        _ => return None,
    })
}

/// As [`named`], with the joint limits of a particular arm; `None` also if the number of limits is
/// not the number of joints.
pub fn limited(model: &str, limits: &[JointLimits]) -> Option<Arc<dyn Kinematics>> {
    Some(match model {
        "staubli_tx90" => Arc::new(Opw::staubli_tx90().within(ranges(limits)?)),
        "kuka_lwr4" => Arc::new(Srs::kuka_lwr4().within(ranges(limits)?)),
        "kuka_iiwa7" => Arc::new(Srs::kuka_iiwa7().within(ranges(limits)?)),
        "kuka_iiwa14" => Arc::new(Srs::kuka_iiwa14().within(ranges(limits)?)),
        "kuka_youbot" => Arc::new(YouBot::new(ranges(limits)?)),
        _ => return None,
    })
}

/// The ranges of all joints, from the limits of an arm.
fn ranges<const N: usize>(limits: &[JointLimits]) -> Option<[Range; N]> {
    let limits: [JointLimits; N] = limits.try_into().ok()?;
    Some(limits.map(Range::from))
}

/// The best solution so far: the one nearest to a hint.
struct Nearest<const N: usize> {
    hint: [f64; N],
    ranges: [Range; N],
    best: Option<([f64; N], f64)>,
}

impl<const N: usize> Nearest<N> {
    const fn new(hint: [f64; N], ranges: [Range; N]) -> Self {
        Self {
            hint,
            ranges,
            best: None,
        }
    }

    /// Adds the joint angles of one solution, with every turn of a joint within its range. Returns
    /// whether they are within the ranges.
    fn offer(&mut self, angles: [f64; N]) -> bool {
        let mut joints = [0.0; N];
        let mut distance = 0.0;
        for (i, joint) in joints.iter_mut().enumerate() {
            let Some(near) = self.ranges[i].nearest_turn(angles[i], self.hint[i]) else {
                return false;
            };
            *joint = near;
            distance += (near - self.hint[i]).powi(2);
        }
        if self.best.is_none_or(|(_, least)| distance < least) {
            self.best = Some((joints, distance));
        }
        true
    }

    fn result(self) -> Result<[f64; N], Unreachable> {
        self.best
            .map(|(joints, _)| joints)
            .ok_or(Unreachable::Limits)
    }
}

/// The planar part of an arm: the first link is turned by an angle from the z axis towards x, the
/// second link by one more. Returns both angles, rad, that bring its end to (`x`, `z`) with the
/// elbow bent towards `bend` (±1). Lengths in m.
fn two_links(x: f64, z: f64, first: f64, second: f64, bend: f64) -> Result<[f64; 2], Unreachable> {
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

/// Checks inputs from outside: all finite, and as many values as joints.
fn checked<const N: usize>(
    flange: &Frame,
    hint: &[f64],
    joints: &[f64],
) -> Result<[f64; N], Unreachable> {
    let hint: [f64; N] = hint.try_into().map_err(|_| Unreachable::Invalid)?;
    let pose = flange
        .translation
        .vector
        .iter()
        .chain(flange.rotation.coords.iter());
    let mut values = hint.iter().chain(pose);
    if values.all(|v| v.is_finite()) && joints.len() == N {
        Ok(hint)
    } else {
        Err(Unreachable::Invalid)
    }
}

/// The joint positions, or NaN for all joints.
fn joints_or_nan<const N: usize>(joints: &[f64]) -> [f64; N] {
    joints.try_into().unwrap_or([f64::NAN; N])
}

/// A frame from a position (m) and a rotation matrix.
fn frame(position: Vector3<f64>, rotation: &Matrix3<f64>) -> Frame {
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(*rotation);
    Frame::from_parts(
        position.into(),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

fn rot_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

fn rot_z(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}
