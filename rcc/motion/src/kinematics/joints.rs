//! Joint ranges, and the choice of the solution nearest to a hint within them. No arm is known here.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use takt_net::device::Unreachable;
use takt_net::{Frame, JointLimits, Twist};

/// Tolerance for rounding, rad: a solution that exceeds a joint limit by less counts as on the
/// limit.
pub(super) const ON_LIMIT: f64 = 1e-10;

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
    pub(super) fn nearest_turn(self, angle: f64, hint: f64) -> Option<f64> {
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

/// The best solution so far: the one nearest to a hint.
pub(super) struct Nearest<const N: usize> {
    hint: [f64; N],
    ranges: [Range; N],
    pub(super) best: Option<([f64; N], f64)>,
}

impl<const N: usize> Nearest<N> {
    pub(super) const fn new(hint: [f64; N], ranges: [Range; N]) -> Self {
        Self {
            hint,
            ranges,
            best: None,
        }
    }

    /// Adds the joint angles of one solution, with every turn of a joint within its range. Returns
    /// whether they are within the ranges.
    pub(super) fn offer(&mut self, angles: [f64; N]) -> bool {
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

    pub(super) fn result(self) -> Result<[f64; N], Unreachable> {
        self.best
            .map(|(joints, _)| joints)
            .ok_or(Unreachable::Limits)
    }
}

/// Checks inputs from outside: all finite, and as many values as joints.
pub(super) fn checked<const N: usize>(
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
pub(super) fn joints_or_nan<const N: usize>(joints: &[f64]) -> [f64; N] {
    joints.try_into().unwrap_or([f64::NAN; N])
}

/// Writes the columns of a Jacobian: of each joint its axis, and the vector from there to the flange (m). If there are
/// not as many columns as joints, all are NaN.
pub(super) fn columns_or_nan(
    columns: &mut [Twist],
    joints: impl ExactSizeIterator<Item = (Vector3<f64>, Vector3<f64>)>,
) {
    if columns.len() != joints.len() {
        let none = Vector3::repeat(f64::NAN);
        columns.fill(Twist {
            vel: none,
            rot: none,
        });
        return;
    }
    for (column, (axis, arm)) in columns.iter_mut().zip(joints) {
        *column = Twist {
            vel: axis.cross(&arm),
            rot: axis,
        };
    }
}
