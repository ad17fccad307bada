//! Arms of seven axes with a spherical shoulder, an elbow and a spherical wrist (S-R-S), with the
//! arm angle as redundancy parameter, after Shimizu et al. (2008). Obstacle avoidance of the elbow
//! is not decided here: the arm angle is that of the hint, and changes only where joint limits
//! force it.

mod near;

use nalgebra::{Matrix3, Vector3};
use takt_net::device::{Kinematics, Unreachable};
use takt_net::{Frame, Twist};

use super::wrist::zyz;
use super::{
    Nearest, Range, checked, columns_or_nan, frame, joints_or_nan, rot_y, rot_z, two_links,
};
use near::Pose;

/// Distance of the wrist centre from axis 1 below which it counts as on the axis, m.
const ON_AXIS: f64 = 1e-9;
/// Margin to the joint limit for an arm angle that is forced by it, rad.
const INSIDE: f64 = 1e-7;
const UNLIMITED: Range = Range {
    min: f64::NEG_INFINITY,
    max: f64::INFINITY,
};

/// Dimensions of an arm with spherical shoulder and wrist, m, and the signs of its joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SrsGeometry {
    /// From the base up to the shoulder.
    pub base: f64,
    /// From the shoulder to the elbow.
    pub upper: f64,
    /// From the elbow to the centre of the wrist.
    pub lower: f64,
    /// From the centre of the wrist to the flange.
    pub hand: f64,
    /// 1, or -1 for a joint that counts against its axis; the axes of the stretched arm are z, y,
    /// z, y, z, y, z.
    pub signs: [f64; 7],
}

/// Closed-form kinematics of an arm with spherical shoulder and wrist.
///
/// The arm angle (rad) is the rotation of the elbow about the line from shoulder to wrist. It is 0
/// where the elbow is in the plane of that line and axis 1, on the side that axis 2 alone reaches,
/// and counts counter-clockwise seen from the wrist.
#[derive(Clone, Debug, PartialEq)]
pub struct Srs {
    geometry: SrsGeometry,
    ranges: [Range; 7],
}

/// The triangle of shoulder, elbow and wrist.
struct Triangle {
    /// From shoulder to wrist, unit length.
    axis: Vector3<f64>,
    /// Rotation of the upper arm at arm angle 0.
    upright: Matrix3<f64>,
    /// Angle of axis 4, rad.
    elbow: f64,
}

/// Rotation of the upper arm at arm angle 0, for the wrist at `wrist` from the shoulder (m) and an
/// angle of `shoulder` (rad) between the upper arm and axis 1.
fn upright(wrist: &Vector3<f64>, shoulder: f64) -> Matrix3<f64> {
    let is_on_axis = wrist.x.hypot(wrist.y) < ON_AXIS;
    let turn = if is_on_axis {
        0.0
    } else {
        wrist.y.atan2(wrist.x)
    };
    rot_z(turn) * rot_y(shoulder)
}

impl Triangle {
    fn new(g: &SrsGeometry, wrist: &Vector3<f64>, bend: f64) -> Result<Self, Unreachable> {
        if wrist.norm() < ON_AXIS {
            return Err(Unreachable::Reach);
        }
        let off_axis = wrist.x.hypot(wrist.y);
        let [shoulder, elbow] = two_links(off_axis, wrist.z, g.upper, g.lower, bend)?;
        Ok(Self {
            axis: wrist.normalize(),
            upright: upright(wrist, shoulder),
            elbow,
        })
    }

    /// The parts of the upper arm's rotation at arm angle ψ: sin ψ · first + cos ψ · second +
    /// third.
    fn parts(&self) -> [Matrix3<f64>; 3] {
        let cross = self.axis.cross_matrix();
        let lateral = cross * self.upright;
        let radial = cross * lateral;
        [lateral, -radial, self.upright + radial]
    }
}

/// The parts of the rotations of shoulder and wrist, as in [`Triangle::parts`].
struct Sweep {
    shoulder: [Matrix3<f64>; 3],
    wrist: [Matrix3<f64>; 3],
}

impl Sweep {
    fn new(triangle: &Triangle, flange: &Matrix3<f64>) -> Self {
        let shoulder = triangle.parts();
        let elbow = rot_y(triangle.elbow);
        let wrist = shoulder.map(|part| (part * elbow).transpose() * flange);
        Self { shoulder, wrist }
    }

    fn at(parts: &[Matrix3<f64>; 3], alpha: f64) -> Matrix3<f64> {
        let (sin, cos) = alpha.sin_cos();
        parts[0] * sin + parts[1] * cos + parts[2]
    }

    /// Arm angles at which the joint with this number (0 to 6, not 3) has the axis angle `limit`.
    fn crossings(&self, joint: usize, limit: f64) -> Option<[f64; 2]> {
        let parts = if joint < 3 {
            &self.shoulder
        } else {
            &self.wrist
        };
        let (sin, cos) = limit.sin_cos();
        let term = |m: &Matrix3<f64>| match joint {
            0 | 4 => m[(1, 2)] * cos - m[(0, 2)] * sin,
            1 | 5 => m[(2, 2)],
            _ => m[(2, 1)] * cos + m[(2, 0)] * sin,
        };
        let [p, q, mut r] = [term(&parts[0]), term(&parts[1]), term(&parts[2])];
        if matches!(joint, 1 | 5) {
            r -= cos;
        }
        let around = (-r / p.hypot(q)).acos();
        let middle = p.atan2(q);
        around
            .is_finite()
            .then_some([middle - around, middle + around])
    }
}

impl Srs {
    /// An arm with that geometry and these joint ranges.
    pub const fn new(geometry: SrsGeometry, ranges: [Range; 7]) -> Self {
        Self { geometry, ranges }
    }

    /// The KUKA LWR 4 and 4+, with the joint ranges of the data sheet.
    pub const fn kuka_lwr4() -> Self {
        let geometry = SrsGeometry {
            base: 0.3105,
            upper: 0.400,
            lower: 0.390,
            hand: 0.078,
            signs: [1.0, -1.0, 1.0, 1.0, 1.0, -1.0, 1.0],
        };
        Self::lbr(geometry, 170.0)
    }

    /// The KUKA LBR iiwa 7 R800 with its basic media flange.
    pub const fn kuka_iiwa7() -> Self {
        Self::iiwa(0.340, 0.400, 0.400)
    }

    /// The KUKA LBR iiwa 14 R820 with its basic media flange.
    pub const fn kuka_iiwa14() -> Self {
        Self::iiwa(0.360, 0.420, 0.400)
    }

    const fn iiwa(base: f64, upper: f64, lower: f64) -> Self {
        let geometry = SrsGeometry {
            base,
            upper,
            lower,
            hand: 0.126,
            signs: [1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0],
        };
        Self::lbr(geometry, 175.0)
    }

    /// With the ranges common to all these arms, except that of axis 7 (degrees).
    const fn lbr(geometry: SrsGeometry, last: f64) -> Self {
        let (pivot, hinge) = (Range::degrees(-170.0, 170.0), Range::degrees(-120.0, 120.0));
        let last = Range::degrees(-last, last);
        Self::new(geometry, [pivot, hinge, pivot, hinge, pivot, hinge, last])
    }

    /// The joint ranges of its solutions.
    pub const fn ranges(&self) -> [Range; 7] {
        self.ranges
    }

    /// The same arm with other joint ranges.
    #[must_use]
    pub const fn within(self, ranges: [Range; 7]) -> Self {
        Self { ranges, ..self }
    }

    /// Converts joint positions to axis angles, and back: the signs are their own inverse.
    fn signed(&self, joints: [f64; 7]) -> [f64; 7] {
        std::array::from_fn(|i| self.geometry.signs[i] * joints[i])
    }

    /// The flange frame (m) and the arm angle (rad) at these joint positions (rad).
    pub fn forward_alpha(&self, joints: &[f64; 7]) -> (Frame, f64) {
        let g = &self.geometry;
        let [a1, a2, a3, a4, a5, a6, a7] = self.signed(*joints);
        let shoulder = rot_z(a1) * rot_y(a2) * rot_z(a3);
        let lower = shoulder * rot_y(a4);
        let wrist = shoulder.column(2) * g.upper + lower.column(2) * g.lower;
        let rotation = lower * rot_z(a5) * rot_y(a6) * rot_z(a7);
        let position = Vector3::z() * g.base + wrist + rotation.column(2) * g.hand;

        let (sin, cos) = a4.sin_cos();
        let lean = (g.lower * sin).atan2(g.upper + g.lower * cos);
        let polar = wrist.x.hypot(wrist.y).atan2(wrist.z);
        let turned = shoulder * upright(&wrist, polar - lean).transpose();
        let doubled = Vector3::new(
            turned[(2, 1)] - turned[(1, 2)],
            turned[(0, 2)] - turned[(2, 0)],
            turned[(1, 0)] - turned[(0, 1)],
        );
        let alpha = wrist.normalize().dot(&doubled).atan2(turned.trace() - 1.0);
        (frame(position, &rotation), alpha)
    }

    /// As [`Kinematics::inverse`], with the arm angle `alpha` (rad) instead of that of the hint; it
    /// refers to the side to which the hint bends the elbow.
    ///
    /// # Errors
    /// If there is no solution within the joint ranges at any arm angle.
    pub fn inverse_alpha(
        &self,
        flange: &Frame,
        alpha: f64,
        hint: &[f64; 7],
    ) -> Result<[f64; 7], Unreachable> {
        let hint: [f64; 7] = checked(flange, hint, hint)?;
        if !alpha.is_finite() {
            return Err(Unreachable::Invalid);
        }
        let angles = self.signed(hint);
        let pose = self.pose(flange);
        let (sin, cos) = alpha.sin_cos();
        let bend = 1.0_f64.copysign(angles[3]);
        match self.near(&pose, [bend * cos, bend * sin], &hint, &angles) {
            Some(joints) => Ok(joints),
            None => self.search(&pose, alpha, hint, &angles),
        }
    }

    /// The solutions found without a search and by one; `None` if the former gives up.
    #[cfg(test)]
    pub(super) fn both(
        &self,
        flange: &Frame,
        hint: &[f64; 7],
    ) -> Option<[Result<[f64; 7], Unreachable>; 2]> {
        let (axes, pose) = (self.signed(*hint), self.pose(flange));
        let near = self.near(&pose, self.side(&axes)?, hint, &axes)?;
        let alpha = self.forward_alpha(hint).1;
        Some([Ok(near), self.search(&pose, alpha, *hint, &axes)])
    }

    fn pose(&self, flange: &Frame) -> Pose {
        let g = &self.geometry;
        let rotation = flange.rotation.to_rotation_matrix().into_inner();
        let position = flange.translation.vector;
        let wrist = position - Vector3::z() * g.base - rotation.column(2) * g.hand;
        Pose { wrist, rotation }
    }

    /// The nearest of all solutions: of four at this arm angle for each side of the elbow, or, where joint limits
    /// forbid these, of those with a joint at its limit.
    fn search(
        &self,
        pose: &Pose,
        alpha: f64,
        hint: [f64; 7],
        angles: &[f64; 7],
    ) -> Result<[f64; 7], Unreachable> {
        let g = &self.geometry;
        let Pose { wrist, rotation } = pose;
        let bend = 1.0_f64.copysign(angles[3]);
        let same = Triangle::new(g, wrist, bend)?;
        let other = Triangle::new(g, wrist, -bend)?;
        // The elbow bent to the other side has the same position half a turn further.
        let turned = alpha + std::f64::consts::PI;
        let sweeps = [
            (Sweep::new(&same, rotation), same.elbow, alpha),
            (Sweep::new(&other, rotation), other.elbow, turned),
        ];

        let mut nearest = Nearest::new(hint, self.ranges);
        let mut free = Nearest::new(hint, [UNLIMITED; 7]);
        for (sweep, elbow, alpha) in &sweeps {
            self.each(sweep, *elbow, *alpha, angles, |solution| {
                nearest.offer(solution);
                free.offer(solution);
            });
        }
        if nearest.best != free.best {
            // The elbow changes its side only if the present side has no solution.
            for (sweep, elbow, _) in &sweeps {
                self.on_limits(sweep, |alpha, joint, limit| {
                    self.each(sweep, *elbow, alpha, angles, |solution| {
                        if is_turn_of(solution[joint], limit) {
                            nearest.offer(solution);
                        }
                    });
                });
                if nearest.best.is_some() {
                    break;
                }
            }
        }
        nearest.result()
    }

    /// Calls `found` with the joint positions of the four solutions at an arm angle.
    fn each(
        &self,
        sweep: &Sweep,
        elbow: f64,
        alpha: f64,
        hint: &[f64; 7],
        mut found: impl FnMut([f64; 7]),
    ) {
        let shoulder = Sweep::at(&sweep.shoulder, alpha);
        let wrist = Sweep::at(&sweep.wrist, alpha);
        let wrists = [1.0, -1.0].map(|sign| zyz(&wrist, sign, hint[4]));
        for sign in [1.0, -1.0] {
            let [a1, a2, a3] = zyz(&shoulder, sign, hint[0]);
            for [a5, a6, a7] in wrists {
                found(self.signed([a1, a2, a3, elbow, a5, a6, a7]));
            }
        }
    }

    /// Calls `found` with the arm angles at which a joint is just inside one of its limits, the
    /// number of the joint and the limit (rad). At most 48 times; in some of the solutions at these
    /// arm angles the joint has another position.
    fn on_limits(&self, sweep: &Sweep, mut found: impl FnMut(f64, usize, f64)) {
        for joint in [0, 1, 2, 4, 5, 6] {
            let Range { min, max } = self.ranges[joint];
            for limit in [min, max] {
                let angle = self.geometry.signs[joint] * limit;
                for alpha in sweep.crossings(joint, angle).into_iter().flatten() {
                    found(alpha - INSIDE, joint, limit);
                    found(alpha + INSIDE, joint, limit);
                }
            }
        }
    }

    /// Velocity of the flange in the base (m/s, rad/s) and of the arm angle (rad/s) at these joint
    /// positions (rad) and velocities (rad/s). The latter is `None` where the arm is stretched or
    /// the wrist is on axis 1: there the arm angle has no derivative.
    pub fn velocity(&self, joints: &[f64; 7], velocities: &[f64; 7]) -> (Twist, Option<f64>) {
        let g = &self.geometry;
        let angles = self.signed(*joints);
        let rates = self.signed(*velocities);
        let mut rotation = Matrix3::identity();
        // Angular velocity of each link.
        let mut turning = [Vector3::zeros(); 8];
        let mut links = [Vector3::zeros(); 3];
        for (i, angle) in angles.into_iter().enumerate() {
            let is_pivot = i % 2 == 0;
            let axis = rotation.column(if is_pivot { 2 } else { 1 });
            turning[i + 1] = turning[i] + axis * rates[i];
            rotation *= if is_pivot { rot_z(angle) } else { rot_y(angle) };
            match i {
                2 => links[0] = rotation.column(2) * g.upper,
                3 => links[1] = rotation.column(2) * g.lower,
                _ => {}
            }
        }
        links[2] = rotation.column(2) * g.hand;
        let elbow = (links[0], turning[3].cross(&links[0]));
        let wrist = (links[0] + links[1], elbow.1 + turning[4].cross(&links[1]));
        let twist = Twist {
            vel: wrist.1 + turning[7].cross(&links[2]),
            rot: turning[7],
        };
        (twist, alpha_rate(elbow, wrist))
    }
}

/// Whether two angles (rad) are about equal, modulo full turns.
fn is_turn_of(a: f64, b: f64) -> bool {
    (a - b).cos() > 1.0 - 1e-6
}

/// Rate of the arm angle, rad/s, from position (m) and velocity (m/s) of elbow and wrist relative
/// to the shoulder: the angle about the line to the wrist from the z axis to the elbow.
fn alpha_rate(
    (elbow, elbow_velocity): (Vector3<f64>, Vector3<f64>),
    (wrist, wrist_velocity): (Vector3<f64>, Vector3<f64>),
) -> Option<f64> {
    let length = wrist.norm();
    let axis = wrist / length;
    let axis_rate = (wrist_velocity - axis * axis.dot(&wrist_velocity)) / length;
    let side = Vector3::z().cross(&elbow);
    let side_rate = Vector3::z().cross(&elbow_velocity);
    let y = axis.dot(&side);
    let y_rate = axis_rate.dot(&side) + axis.dot(&side_rate);
    let x = elbow.z - axis.z * elbow.dot(&axis);
    let x_rate = elbow_velocity.z
        - axis_rate.z * elbow.dot(&axis)
        - axis.z * (elbow_velocity.dot(&axis) + elbow.dot(&axis_rate));
    let rate = (x * y_rate - y * x_rate) / (x * x + y * y);
    (x.hypot(y) > ON_AXIS && rate.is_finite()).then_some(rate)
}

impl Kinematics for Srs {
    fn joints(&self) -> usize {
        7
    }

    fn forward(&self, joints: &[f64]) -> Frame {
        self.forward_alpha(&joints_or_nan(joints)).0
    }

    fn inverse(&self, flange: &Frame, hint: &[f64], joints: &mut [f64]) -> Result<(), Unreachable> {
        let hint: [f64; 7] = checked(flange, hint, joints)?;
        let axes = self.signed(hint);
        let pose = self.pose(flange);
        let side = self.side(&axes);
        let near = side.and_then(|side| self.near(&pose, side, &hint, &axes));
        let solution = match near {
            Some(solution) => solution,
            None => self.search(&pose, self.forward_alpha(&hint).1, hint, &axes)?,
        };
        joints.copy_from_slice(&solution);
        Ok(())
    }

    fn jacobian(&self, joints: &[f64], columns: &mut [Twist]) {
        let g = &self.geometry;
        let angles = self.signed(joints_or_nan(joints));
        let mut rotation = Matrix3::identity();
        let mut axes = [Vector3::zeros(); 7];
        let mut links = [Vector3::zeros(); 3];
        for (i, angle) in angles.into_iter().enumerate() {
            let is_pivot = i % 2 == 0;
            axes[i] = rotation.column(if is_pivot { 2 } else { 1 }) * g.signs[i];
            rotation *= if is_pivot { rot_z(angle) } else { rot_y(angle) };
            match i {
                2 => links[0] = rotation.column(2) * g.upper,
                3 => links[1] = rotation.column(2) * g.lower,
                _ => {}
            }
        }
        // From shoulder, elbow and wrist to the flange.
        let hand = rotation.column(2) * g.hand;
        let (forearm, arm) = (hand + links[1], hand + links[1] + links[0]);
        let arms = [arm, arm, arm, forearm, hand, hand, hand];
        columns_or_nan(columns, axes.into_iter().zip(arms));
    }
}
