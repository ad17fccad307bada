//! Arms of six axes with an ortho-parallel basis and a spherical wrist (OPW): most industrial
//! robots. The derivation follows the geometry of Brandstötter, Angerer and Hofbaur (2014). Not for
//! arms whose wrist axes do not intersect in a point.

use nalgebra::{Matrix3, Vector3};
use takt_net::device::{Kinematics, Unreachable};
use takt_net::{Frame, Twist};

use super::wrist::zyz;
use super::{
    Nearest, Range, checked, columns_or_nan, frame, joints_or_nan, rot_y, rot_z, two_links,
};

/// Dimensions of an arm with ortho-parallel basis and spherical wrist, m, and the signs of its
/// joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpwGeometry {
    /// From axis 1 to axis 2, along x.
    pub a1: f64,
    /// From axis 3 to axis 4, along x.
    pub a2: f64,
    /// From axis 1 to the plane of the arm, along y.
    pub b: f64,
    /// From the base up to axis 2.
    pub c1: f64,
    /// From axis 2 to axis 3.
    pub c2: f64,
    /// From axis 3 to the centre of the wrist, along axis 4.
    pub c3: f64,
    /// From the centre of the wrist to the flange.
    pub c4: f64,
    /// Joint positions (rad) at which the arm points straight up.
    pub offsets: [f64; 6],
    /// 1, or -1 for a joint that counts against its axis.
    pub signs: [f64; 6],
}

impl OpwGeometry {
    /// The Stäubli TX90.
    pub const STAUBLI_TX90: Self = Self {
        a1: 0.050,
        a2: 0.0,
        b: 0.050,
        c1: 0.478,
        c2: 0.425,
        c3: 0.425,
        c4: 0.100,
        offsets: [0.0; 6],
        signs: [1.0; 6],
    };
}

/// Closed-form kinematics of an arm with ortho-parallel basis and spherical wrist.
#[derive(Clone, Debug, PartialEq)]
pub struct Opw {
    geometry: OpwGeometry,
    ranges: [Range; 6],
}

impl Opw {
    /// An arm with that geometry and these joint ranges.
    pub const fn new(geometry: OpwGeometry, ranges: [Range; 6]) -> Self {
        Self { geometry, ranges }
    }

    /// The Stäubli TX90.
    pub const fn staubli_tx90() -> Self {
        let ranges = [
            Range::degrees(-180.0, 180.0),
            Range::degrees(-130.0, 147.5),
            Range::degrees(-145.0, 145.0),
            Range::degrees(-270.0, 270.0),
            Range::degrees(-115.0, 140.0),
            Range::degrees(-270.0, 270.0),
        ];
        Self::new(OpwGeometry::STAUBLI_TX90, ranges)
    }

    /// The same arm with other joint ranges.
    #[must_use]
    pub const fn within(self, ranges: [Range; 6]) -> Self {
        Self { ranges, ..self }
    }

    /// The joint ranges of its solutions.
    pub const fn ranges(&self) -> [Range; 6] {
        self.ranges
    }

    /// Axis angles of joint positions.
    fn angles(&self, joints: [f64; 6]) -> [f64; 6] {
        let g = &self.geometry;
        std::array::from_fn(|i| g.signs[i] * (joints[i] - g.offsets[i]))
    }

    /// Joint positions of axis angles.
    fn positions(&self, angles: [f64; 6]) -> [f64; 6] {
        let g = &self.geometry;
        std::array::from_fn(|i| g.signs[i] * angles[i] + g.offsets[i])
    }

    /// The angle of axis 1 that brings the plane of the arm to the wrist centre `c`, and the
    /// distance of the wrist centre from axis 2 along x. `side` is 1 for the arm in front of its
    /// base, -1 for an arm that reaches over it. If the wrist centre is on axis 1, the angle is
    /// `hint`.
    fn base(&self, c: &Vector3<f64>, side: f64, hint: f64) -> Result<[f64; 2], Unreachable> {
        let g = &self.geometry;
        let square = c.x * c.x + c.y * c.y - g.b * g.b;
        if square < -1e-15 {
            return Err(Unreachable::Reach);
        }
        let x = side * square.max(0.0).sqrt();
        let is_on_axis = c.x.hypot(c.y) < 1e-12;
        let angle = if is_on_axis {
            hint
        } else {
            c.y.atan2(c.x) - g.b.atan2(x)
        };
        Ok([angle, x - g.a1])
    }

    /// Axis angles of one of the eight solutions.
    fn solution(
        &self,
        flange: (&Vector3<f64>, &Matrix3<f64>),
        [side, bend, flip]: [f64; 3],
        hint: [f64; 6],
    ) -> Result<[f64; 6], Unreachable> {
        let (position, rotation) = flange;
        let g = &self.geometry;
        let centre = position - rotation.column(2) * g.c4;
        let [q1, x] = self.base(&centre, side, hint[0])?;
        let (lower, lean) = (g.a2.hypot(g.c3), g.a2.atan2(g.c3));
        let [q2, elbow] = two_links(x, centre.z - g.c1, g.c2, lower, bend)?;
        let q3 = elbow - lean;
        let wrist = rot_y(-q2 - q3) * rot_z(-q1) * rotation;
        let [q4, q5, q6] = zyz(&wrist, flip, hint[3]);
        Ok([q1, q2, q3, q4, q5, q6])
    }
}

impl Kinematics for Opw {
    fn joints(&self) -> usize {
        6
    }

    fn forward(&self, joints: &[f64]) -> Frame {
        let g = &self.geometry;
        let [q1, q2, q3, q4, q5, q6] = self.angles(joints_or_nan(joints));
        let (upper, lower) = (rot_y(q2), rot_y(q2 + q3));
        let in_plane = upper * Vector3::new(0.0, 0.0, g.c2) + lower * Vector3::new(g.a2, 0.0, g.c3);
        let base = rot_z(q1);
        let centre = base * (Vector3::new(g.a1, g.b, g.c1) + in_plane);
        let rotation = base * lower * rot_z(q4) * rot_y(q5) * rot_z(q6);
        frame(centre + rotation.column(2) * g.c4, &rotation)
    }

    fn inverse(&self, flange: &Frame, hint: &[f64], joints: &mut [f64]) -> Result<(), Unreachable> {
        let hint = checked(flange, hint, joints)?;
        let rotation = flange.rotation.to_rotation_matrix().into_inner();
        let pose = (&flange.translation.vector, &rotation);
        let angles = self.angles(hint);
        let mut nearest = Nearest::new(hint, self.ranges);
        let mut is_reached = false;
        for number in 0..8 {
            let sign = |bit: u8| if number & (1 << bit) == 0 { 1.0 } else { -1.0 };
            let signs = [sign(0), sign(1), sign(2)];
            if let Ok(solution) = self.solution(pose, signs, angles) {
                is_reached = true;
                nearest.offer(self.positions(solution));
            }
        }
        if !is_reached {
            return Err(Unreachable::Reach);
        }
        joints.copy_from_slice(&nearest.result()?);
        Ok(())
    }

    fn jacobian(&self, joints: &[f64], columns: &mut [Twist]) {
        let g = &self.geometry;
        let [q1, q2, q3, q4, q5, _] = self.angles(joints_or_nan(joints));
        let base = rot_z(q1);
        let (upper, lower) = (base * rot_y(q2), base * rot_y(q2 + q3));
        let roll = lower * rot_z(q4);
        let pitch = roll * rot_y(q5);
        // From the wrist, axis 3, axis 2 and axis 1 to the flange.
        let hand = pitch.column(2) * g.c4;
        let elbow = hand + lower * Vector3::new(g.a2, 0.0, g.c3);
        let shoulder = elbow + upper * Vector3::new(0.0, 0.0, g.c2);
        let whole = shoulder + base * Vector3::new(g.a1, g.b, 0.0);
        let axes = [
            (Vector3::z(), whole),
            (base.column(1).into_owned(), shoulder),
            (base.column(1).into_owned(), elbow),
            (lower.column(2).into_owned(), hand),
            (roll.column(1).into_owned(), hand),
            (pitch.column(2).into_owned(), hand),
        ];
        let signed = axes.into_iter().zip(g.signs);
        columns_or_nan(
            columns,
            signed.map(|((axis, arm), sign)| (axis * sign, arm)),
        );
    }
}
