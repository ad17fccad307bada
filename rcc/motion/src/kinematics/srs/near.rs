//! The solution near the hint, without the others: on a smooth path it is the one in nearly every cycle. Works with
//! directions instead of angles, so that each joint costs one arc tangent. It gives up, and leaves the rest to the
//! search among all solutions, near singularities and where the solution it finds may not be the nearest.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, Vector3};

use super::super::joints::ON_LIMIT;
use super::{INSIDE, Srs, Sweep, Triangle};

/// Sine of the elbow, and of the angle between wrist and axis 1, below which the arm angle is ill-conditioned.
const ALIGNED: f64 = 1e-4;
/// Sine of the middle angle of shoulder or wrist below which its outer axes count as one.
const SINGULAR: f64 = 1e-9;
/// Square of the distance from the hint, rad², below which no other solution at the same arm angle is nearer: they
/// differ from each other by half a turn of at least two joints.
const NEAREST: f64 = PI * PI / 2.0;
/// Square of the distance from the hint, rad², up to which a solution at a joint limit is accepted without search.
const NEAR_LIMIT: f64 = 0.1;

/// Centre of the wrist from the shoulder, m, and the rotation of the flange.
pub(super) struct Pose {
    pub(super) wrist: Vector3<f64>,
    pub(super) rotation: Matrix3<f64>,
}

/// Direction from the line between shoulder and wrist to the elbow: cosine and sine of the angle from the side of the z
/// axis, counter-clockwise seen from the wrist.
pub(super) type Side = [f64; 2];

/// A solution and its violations of the joint ranges.
struct Found {
    /// Joint positions, rad; each the turn nearest to the hint.
    joints: [f64; 7],
    /// Square of the distance from the hint, rad².
    distance: f64,
    is_within: bool,
}

/// The side of an elbow at `elbow`, for the wrist at `wrist`, m from the shoulder; `None` if ill-conditioned.
fn side(elbow: &Vector3<f64>, wrist: &Vector3<f64>) -> Option<Side> {
    let axis = wrist / wrist.norm();
    let x = elbow.z - axis.z * elbow.dot(&axis);
    let y = axis.y * elbow.x - axis.x * elbow.y;
    let radius = (x * x + y * y).sqrt();
    (radius > ALIGNED).then(|| [x / radius, y / radius])
}

/// The angle of (x, y) or its opposite, whichever is nearer to `hint` modulo full turns, and -1 for the opposite.
fn nearer_axis(x: f64, y: f64, hint: f64) -> (f64, f64) {
    let angle = y.atan2(x);
    let off = (angle - hint).abs();
    // Joint ranges are mostly within one turn, so that the remainder is seldom needed.
    let off = if off > 3.0 * FRAC_PI_2 {
        off % (2.0 * PI)
    } else {
        off
    };
    if off <= FRAC_PI_2 || off >= 3.0 * FRAC_PI_2 {
        (angle, 1.0)
    } else if angle > 0.0 {
        (angle - PI, -1.0)
    } else {
        (angle + PI, -1.0)
    }
}

/// Turns a vector by a negative angle about z, given its cosine and sine.
fn back_z([x, y, z]: [f64; 3], [cos, sin]: Side) -> [f64; 3] {
    [cos * x + sin * y, cos * y - sin * x, z]
}

/// As [`back_z`], about y.
fn back_y([x, y, z]: [f64; 3], [cos, sin]: Side) -> [f64; 3] {
    [cos * x - sin * z, y, sin * x + cos * z]
}

impl Srs {
    /// The side of the elbow at these axis angles, rad.
    pub(super) fn side(&self, angles: &[f64; 7]) -> Option<Side> {
        let g = &self.geometry;
        let [(s1, c1), (s2, c2), (s3, c3), (s4, c4)] =
            [angles[0], angles[1], angles[2], angles[3]].map(f64::sin_cos);
        let elbow = Vector3::new(s2 * c1, s2 * s1, c2) * g.upper;
        let (x, y) = (c2 * s4 * c3 + s2 * c4, s4 * s3);
        let lower = Vector3::new(c1 * x - s1 * y, s1 * x + c1 * y, c2 * c4 - s2 * s4 * c3);
        side(&elbow, &(elbow + lower * g.lower))
    }

    /// The axis angles, rad, with the elbow on that side and bent as in the hint, and each of shoulder and wrist in the
    /// one of its two positions that is nearer to the hint. `None` out of reach and near singularities.
    fn angles_near(&self, pose: &Pose, [cos, sin]: Side, hint: &[f64; 7]) -> Option<[f64; 7]> {
        let (first, second) = (self.geometry.upper, self.geometry.lower);
        let square = pose.wrist.norm_squared();
        let bent = (square - first * first - second * second) / (2.0 * first * second);
        let across = 1.0 - bent * bent;
        let axis = pose.wrist / square.sqrt();
        let off_axis = (axis.x * axis.x + axis.y * axis.y).sqrt();
        // Not a number counts as singular.
        let is_regular = across > ALIGNED * ALIGNED && off_axis > ALIGNED;
        if !is_regular {
            return None;
        }
        let length = square.sqrt();
        let up = Vector3::new(-axis.z * axis.x, -axis.z * axis.y, off_axis * off_axis);
        let left = Vector3::new(axis.y, -axis.x, 0.0);
        let upper = axis * ((first + second * bent) / length)
            + (up * cos + left * sin) * (second * across.sqrt() / (length * off_axis));
        let lower = (pose.wrist - upper * first) / second;

        let radius = (upper.x * upper.x + upper.y * upper.y).sqrt();
        if radius < SINGULAR {
            return None;
        }
        let (a1, sign) = nearer_axis(upper.x, upper.y, hint[0]);
        let first = [sign * upper.x / radius, sign * upper.y / radius];
        let a2 = (sign * radius).atan2(upper.z);
        let second = [upper.z, sign * radius];
        let [x, y, z] = back_y(back_z(lower.into(), first), second);
        let bend = 1.0_f64.copysign(hint[3]);
        let radius = (x * x + y * y).sqrt();
        let a3 = (bend * y).atan2(bend * x);
        let third = [bend * x / radius, bend * y / radius];
        let a4 = (bend * radius).atan2(z);
        let fourth = [z, bend * radius];

        let column = |n: usize| {
            let column: [f64; 3] = pose.rotation.column(n).into_owned().into();
            back_y(back_z(back_y(back_z(column, first), second), third), fourth)
        };
        let [x, y, z] = column(2);
        let radius = (x * x + y * y).sqrt();
        if radius < SINGULAR {
            return None;
        }
        let (a5, sign) = nearer_axis(x, y, hint[4]);
        let fifth = [sign * x / radius, sign * y / radius];
        let a6 = (sign * radius).atan2(z);
        let [x, y, _] = back_y(back_z(column(0), fifth), [z, sign * radius]);
        Some([a1, a2, a3, a4, a5, a6, y.atan2(x)])
    }

    /// As [`Self::angles_near`], as joint positions compared with hint and ranges.
    fn find_near(
        &self,
        pose: &Pose,
        side: Side,
        hint: &[f64; 7],
        axes: &[f64; 7],
    ) -> Option<Found> {
        let mut joints = self.signed(self.angles_near(pose, side, axes)?);
        let (mut distance, mut is_within) = (0.0, true);
        for (i, joint) in joints.iter_mut().enumerate() {
            let mut off = *joint - hint[i];
            if off.abs() > PI {
                let turns = (off / (2.0 * PI)).round() * 2.0 * PI;
                *joint -= turns;
                off -= turns;
            }
            let range = self.ranges[i];
            let within = range.min - ON_LIMIT..=range.max + ON_LIMIT;
            is_within &= within.contains(joint);
            distance += off * off;
        }
        Some(Found {
            joints,
            distance,
            is_within,
        })
    }

    /// The solution nearest to the hint with the elbow on that side; where a joint limit forbids it, with the elbow as
    /// near to that side as the limit permits. `None` if only a search can find the nearest one, or there is none.
    pub(super) fn near(
        &self,
        pose: &Pose,
        side: Side,
        hint: &[f64; 7],
        axes: &[f64; 7],
    ) -> Option<[f64; 7]> {
        let found = self.find_near(pose, side, hint, axes)?;
        let joints = if found.is_within {
            (found.distance < NEAREST).then_some(found.joints)
        } else if found.distance < NEAR_LIMIT {
            self.near_limit(pose, &found.joints, hint, axes)
        } else {
            None
        }?;
        // A solution on a limit may exceed it by rounding.
        Some(std::array::from_fn(|i| {
            joints[i].clamp(self.ranges[i].min, self.ranges[i].max)
        }))
    }

    /// The solution nearest to the hint at which a joint of `beyond` that exceeds its range is just within it.
    fn near_limit(
        &self,
        pose: &Pose,
        beyond: &[f64; 7],
        hint: &[f64; 7],
        axes: &[f64; 7],
    ) -> Option<[f64; 7]> {
        let bend = 1.0_f64.copysign(axes[3]);
        let triangle = Triangle::new(&self.geometry, &pose.wrist, bend).ok()?;
        let sweep = Sweep::new(&triangle, &pose.rotation);
        let mut best: Option<Found> = None;
        for joint in [0, 1, 2, 4, 5, 6] {
            let range = self.ranges[joint];
            if (range.min..=range.max).contains(&beyond[joint]) {
                continue;
            }
            let limit = beyond[joint].clamp(range.min, range.max);
            let angle = self.geometry.signs[joint] * limit;
            for crossing in sweep.crossings(joint, angle).into_iter().flatten() {
                for alpha in [crossing - INSIDE, crossing + INSIDE] {
                    let (sin, cos) = alpha.sin_cos();
                    let found = self.find_near(pose, [bend * cos, bend * sin], hint, axes);
                    let found = found.filter(|it| it.is_within && it.distance < NEAR_LIMIT);
                    if let Some(found) = found
                        && best
                            .as_ref()
                            .is_none_or(|best| found.distance < best.distance)
                    {
                        best = Some(found);
                    }
                }
            }
        }
        best.map(|best| best.joints)
    }
}
