//! Three axes z, y, z that intersect in a point: shoulders and wrists. The last angle is computed
//! from the rest of the rotation after the first two, so that the product is exact near the
//! singularity, too, where the angles themselves are ill-conditioned.

use nalgebra::Matrix3;

use super::{rot_y, rot_z};

/// Sine of the middle angle below which the outer axes count as one.
const SINGULAR: f64 = 1e-10;

/// Angles (rad) with `rotation` = Rz · Ry · Rz, the middle one with the sign `sign` (±1). Where the
/// outer axes coincide, the first angle is `first`.
pub(super) fn zyz(rotation: &Matrix3<f64>, sign: f64, first: f64) -> [f64; 3] {
    let (x, y) = (rotation[(0, 2)], rotation[(1, 2)]);
    let a = if x.hypot(y) < SINGULAR {
        first
    } else {
        (sign * y).atan2(sign * x)
    };
    let (sin, cos) = a.sin_cos();
    let b = (x * cos + y * sin).atan2(rotation[(2, 2)]);
    let rest = rot_y(-b) * rot_z(-a) * rotation;
    [a, b, rest[(1, 0)].atan2(rest[(0, 0)])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zyz_near_singularity_reproduces_rotation() {
        for b in [
            1.2,
            1e-3,
            1e-7,
            1e-9,
            1e-11,
            0.0,
            3.0,
            std::f64::consts::PI - 1e-6,
        ] {
            for sign in [1.0, -1.0] {
                let wanted = rot_z(0.7) * rot_y(b) * rot_z(-2.1);
                let [a, m, c] = zyz(&wanted, sign, 0.3);
                let got = rot_z(a) * rot_y(m) * rot_z(c);
                assert!((got - wanted).abs().max() < 2e-10, "{b} {sign}");
                assert!(m * sign > -1e-8, "{b} {sign}: {m}");
            }
        }
    }

    #[test]
    fn zyz_with_coinciding_axes_keeps_first_angle() {
        let [a, b, c] = zyz(&rot_z(0.5), 1.0, 0.3);
        assert!((a - 0.3).abs() < 1e-15 && b.abs() < 1e-15 && (c - 0.2).abs() < 1e-15);
    }
}
