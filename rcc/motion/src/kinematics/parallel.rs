//! Arms of six axes of which the second, third and fourth are parallel, such as those of Universal Robots: eight solutions in
//! closed form. Stretched, their axes are z, y, y, y, z, y.

use nalgebra::{Matrix3, Vector3};
use takt_net::device::Unreachable;

use super::{rot_y, rot_z, two_links};

/// Sine of the fifth angle below which the axes 2, 3, 4 and 6 count as parallel: the sixth keeps its hint.
const SINGULAR: f64 = 1e-9;

/// Dimensions of an arm with three parallel axes, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ThreeParallel {
    /// From axis 1 to axis 2, along x.
    pub(super) a1: f64,
    /// From axis 1 to the point where the axes 5 and 6 intersect, along y.
    pub(super) b: f64,
    /// From axis 2 to axis 3.
    pub(super) upper: f64,
    /// From axis 3 to axis 4.
    pub(super) lower: f64,
    /// From axis 4 to the point where the axes 5 and 6 intersect, along x and z of the hand.
    pub(super) hand: [f64; 2],
}

impl ThreeParallel {
    /// Axis angles of one of the eight solutions for the frame of axis 6 (y along it) at the point where it meets axis 5.
    pub(super) fn solution(
        &self,
        (position, rotation): (&Vector3<f64>, &Matrix3<f64>),
        [side, flip, bend]: [f64; 3],
        hint: &[f64],
    ) -> Result<[f64; 6], Unreachable> {
        let square = position.xy().norm_squared() - self.b * self.b;
        if square < -1e-15 {
            return Err(Unreachable::Reach);
        }
        let x = side * square.max(0.0).sqrt();
        let q1 = position.y.atan2(position.x) - self.b.atan2(x);
        let hand = rot_z(-q1) * rotation;
        // In the plane of the arm: axis 6, and axis 5 square to it and to y.
        let axis = hand.column(1);
        let sin = flip * axis.x.hypot(axis.z);
        let q5 = sin.atan2(axis.y);
        let (pitch, q6) = if sin.abs() < SINGULAR {
            // Axis 6 is parallel to y: only the sum of the angles 2, 3, 4 and 6 is known.
            let q6 = hint.get(5).copied().unwrap_or(0.0);
            let rest = hand * rot_y(-q6) * rot_z(-q5);
            (rest[(0, 2)].atan2(rest[(2, 2)]), q6)
        } else {
            // y × axis 6 is axis 5 times the sine.
            let pitch = (axis.z / sin).atan2(-axis.x / sin);
            let rest = (rot_y(pitch) * rot_z(q5)).transpose() * hand;
            (pitch, rest[(0, 2)].atan2(rest[(2, 2)]))
        };
        let (sin, cos) = pitch.sin_cos();
        let [along, up] = self.hand;
        let at_x = x - self.a1 - (cos * along + sin * up);
        let at_z = position.z - (cos * up - sin * along);
        let [q2, q3] = two_links(at_x, at_z, self.upper, self.lower, bend)?;
        Ok([q1, q2, q3, pitch - q2 - q3, q5, q6])
    }
}
