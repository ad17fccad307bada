//! The structure of a serial arm, read from where its axes are: if it is one of those with an inverse in closed form, its
//! dimensions, and how its joints count against those of that form. What is only nearly so, because a file rounds its
//! angles, counts as well: a solution in closed form is then corrected on the arm itself.

use std::fmt;

use nalgebra::{Matrix3, Vector3};
use takt_net::Frame;
use takt_net::device::{Kinematics, Unreachable};

use super::geometry::{frame, rot_y, rot_z};
use super::numeric;
use super::parallel::ThreeParallel;
use super::serial::{Fixed, JOINTS_MAX, JointKind, Pose, Serial};
use super::{Nearest, Opw, OpwGeometry, Range, Srs, SrsGeometry};

/// Tolerance for angles between axes, rad.
const ANGLE: f64 = 1e-4;
/// Tolerance for distances between axes, m.
const DISTANCE: f64 = 1e-4;
/// Number of poses at which a form must find its way back.
const SAMPLES: u32 = 50;
/// How far a closed form may be from the arm, m and rad.
const NEARLY: f64 = 2e-3;

/// How the axes of an arm lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Structure {
    /// Six axes: ortho-parallel basis and spherical wrist. Closed form.
    Opw,
    /// Seven axes: spherical shoulder, elbow, spherical wrist. Closed form.
    Srs,
    /// Six axes of which the second, third and fourth are parallel. Closed form.
    ThreeParallel,
    /// Any other. Numeric.
    General,
}

impl fmt::Display for Structure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Opw => "ortho-parallel basis and spherical wrist (closed form)",
            Self::Srs => "spherical shoulder, elbow, spherical wrist (closed form)",
            Self::ThreeParallel => "three parallel axes (closed form)",
            Self::General => "general (numeric inverse)",
        })
    }
}

#[derive(Clone, Debug)]
enum Form {
    Opw(Opw),
    Srs(Srs),
    ThreeParallel(ThreeParallel, [Range; 6]),
}

/// A closed form, and what is between it and an arm.
#[derive(Clone, Debug)]
pub(super) struct ClosedForm {
    form: Form,
    /// The joint positions at which the axis angles of the form are 0, and the signs of the joints.
    offsets: Vec<f64>,
    signs: [f64; JOINTS_MAX],
    /// From the base of the arm to that of the form.
    base: Frame,
    /// From the flange of the form to that of the arm.
    tip: Frame,
}

/// The axis angles of an arm at joint position 0, found axis by axis from the base on.
struct Walk {
    /// The axes as the form counts them.
    axes: [Vector3<f64>; JOINTS_MAX],
    signs: [f64; JOINTS_MAX],
    flange: Fixed,
    rotation: Matrix3<f64>,
    angles: Vec<f64>,
}

impl Walk {
    /// Begins with axis 1 as z and axis 2 as y, if they are square to each other. A sign of -1 is that of a joint that counts
    /// against its axis of the form.
    fn new(pose: &Pose, signs: [f64; JOINTS_MAX]) -> Option<Self> {
        let mut axes = pose.axes;
        for (axis, sign) in axes.iter_mut().zip(signs) {
            *axis *= sign;
        }
        let [z, y, ..] = axes;
        is_square(&z, &y).then_some(())?;
        let y = (y - z * z.dot(&y)).normalize();
        Some(Self {
            axes,
            signs,
            flange: pose.flange,
            rotation: Matrix3::from_columns(&[y.cross(&z), y, z]),
            angles: vec![0.0],
        })
    }

    /// The next joint turns by `angle` about its axis, y or z of the form.
    fn turn(&mut self, is_y: bool, angle: f64) {
        self.rotation *= if is_y { rot_y(angle) } else { rot_z(angle) };
        self.angles.push(angle);
    }

    /// The next joint, about y or z of the form, is square to the one after it, which is z or y: that gives its angle.
    fn turn_to_next(&mut self, is_y: bool) -> Option<()> {
        let number = self.angles.len();
        let (own, next) = (self.axes.get(number)?, self.axes.get(number + 1)?);
        is_square(own, next).then_some(())?;
        let next = self.rotation.transpose() * next;
        let angle = if is_y {
            next.x.atan2(next.z)
        } else {
            (-next.x).atan2(next.y)
        };
        self.turn(is_y, angle);
        Some(())
    }

    /// Joint positions at which the axis angles are 0.
    fn offsets(&self) -> Vec<f64> {
        let each = self.angles.iter().zip(&self.signs);
        each.map(|(angle, sign)| -sign * angle).collect()
    }

    /// The ranges of the axis angles, from those of the joints.
    fn ranges<const N: usize>(&self, ranges: &[Range]) -> Option<[Range; N]> {
        let each = ranges.iter().zip(self.offsets()).zip(&self.signs);
        let each = each.map(|((range, offset), sign)| {
            let (a, b) = (sign * (range.min - offset), sign * (range.max - offset));
            Range {
                min: a.min(b),
                max: a.max(b),
            }
        });
        let all: Vec<_> = each.collect();
        all.try_into().ok()
    }

    /// A form with this base at `origin`, whose flange is `flange` for the angles that were found.
    fn place(
        self,
        form: Form,
        (base, origin): (&Matrix3<f64>, &Vector3<f64>),
        flange: &Frame,
    ) -> ClosedForm {
        let base = frame(*origin, base);
        let arm = frame(self.flange.position, &self.flange.rotation);
        ClosedForm {
            form,
            offsets: self.offsets(),
            signs: self.signs,
            base,
            tip: (base * flange).inv_mul(&arm),
        }
    }
}

/// The signs of the joints with these numbers, so that their axes point as that of joint 2 does; `None` if they are not parallel.
fn parallel(pose: &Pose, joints: &[usize]) -> Option<[f64; JOINTS_MAX]> {
    let mut signs = [1.0; JOINTS_MAX];
    for joint in joints {
        let (axis, own) = (pose.axes.get(1)?, pose.axes.get(*joint)?);
        (axis.cross(own).norm() < ANGLE).then_some(())?;
        *signs.get_mut(*joint)? = axis.dot(own).signum();
    }
    Some(signs)
}

fn is_square(a: &Vector3<f64>, b: &Vector3<f64>) -> bool {
    a.dot(b).abs() < ANGLE
}

/// Where two lines that are not parallel are nearest to each other, if they nearly meet.
fn meeting(pose: &Pose, first: usize, second: usize) -> Option<Vector3<f64>> {
    let (d, e) = (pose.axes[first], pose.axes[second]);
    let (p, q) = (pose.points[first], pose.points[second]);
    let normal = d.cross(&e);
    let square = normal.norm_squared();
    if square < ANGLE {
        return None;
    }
    let between = q - p;
    let on_first = p + d * (between.cross(&e).dot(&normal) / square);
    let on_second = q + e * (between.cross(&d).dot(&normal) / square);
    let is_near = (on_first - on_second).norm() < DISTANCE;
    is_near.then(|| (on_first + on_second) * 0.5)
}

/// Distance of a point from an axis.
fn distance(pose: &Pose, axis: usize, point: &Vector3<f64>) -> f64 {
    (point - pose.points[axis]).cross(&pose.axes[axis]).norm()
}

impl ClosedForm {
    /// The closed form of an arm, if it has one.
    pub(super) fn of(arm: &Serial) -> Option<Self> {
        if arm.kinds().contains(&JointKind::Prismatic) {
            return None;
        }
        let zero = [0.0; 7];
        let pose = arm.pose(zero.get(..arm.joints())?);
        let candidates = match arm.joints() {
            6 => [
                opw(&pose, arm.ranges()),
                three_parallel(&pose, arm.ranges()),
            ],
            7 => [srs(&pose, arm.ranges()), None],
            _ => [None, None],
        };
        let mut candidates = candidates.into_iter().flatten();
        candidates.find(|form| form.finds_back(arm))
    }

    pub(super) const fn structure(&self) -> Structure {
        match self.form {
            Form::Opw(_) => Structure::Opw,
            Form::Srs(_) => Structure::Srs,
            Form::ThreeParallel(..) => Structure::ThreeParallel,
        }
    }

    /// Joint positions near the hint with the flange at `flange`, which is `target` as well.
    pub(super) fn inverse(
        &self,
        arm: &Serial,
        flange: &Frame,
        target: &Fixed,
        hint: &[f64],
        joints: &mut [f64],
    ) -> Result<(), Unreachable> {
        self.solve(flange, hint, joints)?;
        if numeric::polish(arm, target, joints) && arm.is_within(joints) {
            return Ok(());
        }
        // Beside a singularity a rounded structure may be too far from the arm.
        numeric::inverse(arm, target, hint, joints)
    }

    /// The solution of the form itself.
    fn solve(&self, flange: &Frame, hint: &[f64], joints: &mut [f64]) -> Result<(), Unreachable> {
        let flange = self.base.inv_mul(flange) * self.tip.inverse();
        let mut angles = [0.0; 7];
        let mut found = [0.0; 7];
        let (Some(angles), Some(found)) =
            (angles.get_mut(..hint.len()), found.get_mut(..hint.len()))
        else {
            return Err(Unreachable::Invalid);
        };
        let joint_map = || self.signs.iter().zip(&self.offsets);
        for ((angle, joint), (sign, offset)) in angles.iter_mut().zip(hint).zip(joint_map()) {
            *angle = sign * (joint - offset);
        }
        match &self.form {
            Form::Opw(arm) => arm.inverse(&flange, angles, found)?,
            Form::Srs(arm) => arm.inverse(&flange, angles, found)?,
            Form::ThreeParallel(arm, ranges) => three(arm, *ranges, &flange, angles, found)?,
        }
        for ((joint, angle), (sign, offset)) in joints.iter_mut().zip(found).zip(joint_map()) {
            *joint = sign * *angle + offset;
        }
        Ok(())
    }

    /// Whether the form finds its way back from poses all over the ranges of the arm.
    fn finds_back(&self, arm: &Serial) -> bool {
        let search = numeric::seeds(arm);
        (1..=SAMPLES).all(|number| {
            let hint = search(number);
            let Some(hint) = hint.get(..arm.joints()) else {
                return false;
            };
            let flange = arm.forward(hint);
            let mut joints = [0.0; 7];
            let Some(joints) = joints.get_mut(..hint.len()) else {
                return false;
            };
            if self.solve(&flange, hint, joints).is_err() {
                return false;
            }
            let found = arm.forward(joints);
            let off = (found.translation.vector - flange.translation.vector).norm();
            off < NEARLY && found.rotation.angle_to(&flange.rotation) < NEARLY
        })
    }
}

/// The nearest of the eight solutions of an arm with three parallel axes.
fn three(
    arm: &ThreeParallel,
    ranges: [Range; 6],
    flange: &Frame,
    hint: &[f64],
    joints: &mut [f64],
) -> Result<(), Unreachable> {
    let rotation = flange.rotation.to_rotation_matrix().into_inner();
    let position = flange.translation.vector;
    let near = hint.try_into().map_err(|_| Unreachable::Invalid)?;
    let mut nearest = Nearest::<6>::new(near, ranges);
    let mut is_reached = false;
    for number in 0..8 {
        let sign = |bit: u8| if number & (1 << bit) == 0 { 1.0 } else { -1.0 };
        let signs = [sign(0), sign(1), sign(2)];
        if let Ok(angles) = arm.solution((&position, &rotation), signs, hint) {
            is_reached = true;
            nearest.offer(angles);
        }
    }
    if !is_reached {
        return Err(Unreachable::Reach);
    }
    joints.copy_from_slice(&nearest.result()?);
    Ok(())
}

fn opw(pose: &Pose, ranges: &[Range]) -> Option<ClosedForm> {
    let mut walk = Walk::new(pose, parallel(pose, &[2])?)?;
    let base = walk.rotation;
    let wrist = meeting(pose, 3, 4)?;
    (distance(pose, 5, &wrist) < DISTANCE).then_some(())?;
    let (origin, local) = beside_second(pose, &base);
    let (axis_2, axis_3, wrist) = (
        local(&pose.points[1]),
        local(&pose.points[2]),
        local(&wrist),
    );
    let upper = axis_3 - axis_2;
    let c2 = upper.x.hypot(upper.z);
    (c2 > DISTANCE).then_some(())?;
    walk.turn(true, upper.x.atan2(upper.z));
    walk.turn_to_next(true)?;
    let lower = (base.transpose() * walk.rotation).transpose() * (wrist - axis_3);
    (lower.x.hypot(lower.z) > DISTANCE).then_some(())?;
    walk.turn_to_next(false)?;
    walk.turn_to_next(true)?;
    walk.turn(false, 0.0);
    let geometry = OpwGeometry {
        a1: axis_2.x,
        a2: lower.x,
        b: wrist.y,
        c1: 0.0,
        c2,
        c3: lower.z,
        c4: 0.0,
        offsets: [0.0; 6],
        signs: [1.0; 6],
    };
    let arm = Opw::new(geometry, walk.ranges(ranges)?);
    let flange = arm.forward(&walk.angles);
    Some(walk.place(Form::Opw(arm), (&base, &origin), &flange))
}

fn three_parallel(pose: &Pose, ranges: &[Range]) -> Option<ClosedForm> {
    let mut walk = Walk::new(pose, parallel(pose, &[2, 3])?)?;
    let base = walk.rotation;
    let end = meeting(pose, 4, 5)?;
    let (origin, local) = beside_second(pose, &base);
    let [axis_2, axis_3, axis_4] = [1, 2, 3].map(|axis: usize| local(&pose.points[axis]));
    let end = local(&end);
    let [upper, lower] = [axis_3 - axis_2, axis_4 - axis_3];
    let [first, second] = [upper, lower].map(|link| link.x.hypot(link.z));
    (first.min(second) > DISTANCE).then_some(())?;
    let [pitch, both] = [upper, lower].map(|link| link.x.atan2(link.z));
    walk.turn(true, pitch);
    walk.turn(true, both - pitch);
    walk.turn_to_next(true)?;
    let hand = (base.transpose() * walk.rotation).transpose() * (end - axis_4);
    walk.turn_to_next(false)?;
    walk.turn(true, 0.0);
    let arm = ThreeParallel {
        a1: axis_2.x,
        b: end.y,
        upper: first,
        lower: second,
        hand: [hand.x, hand.z],
    };
    let form = Form::ThreeParallel(arm, walk.ranges(ranges)?);
    let flange = frame(end, &(base.transpose() * walk.rotation));
    Some(walk.place(form, (&base, &origin), &flange))
}

fn srs(pose: &Pose, ranges: &[Range]) -> Option<ClosedForm> {
    let shoulder = meeting(pose, 0, 1)?;
    let elbow = meeting(pose, 2, 3)?;
    let wrist = meeting(pose, 4, 5)?;
    let is_met = [(2, &shoulder), (4, &elbow), (6, &wrist)];
    let is_met = is_met.map(|(axis, point)| distance(pose, axis, point) < DISTANCE);
    (is_met == [true; 3]).then_some(())?;
    // Axes 3 and 5 of the form point towards the hand.
    let [upper, lower] = [elbow - shoulder, wrist - elbow];
    let mut signs = [1.0; JOINTS_MAX];
    signs[2] = upper.dot(&pose.axes[2]).signum();
    signs[4] = lower.dot(&pose.axes[4]).signum();
    let mut walk = Walk::new(pose, signs)?;
    let base = walk.rotation;
    for number in 1..6 {
        walk.turn_to_next(number % 2 == 1)?;
    }
    walk.turn(false, 0.0);
    let geometry = SrsGeometry {
        base: 0.0,
        upper: upper.norm(),
        lower: lower.norm(),
        hand: 0.0,
        signs: [1.0; 7],
    };
    (geometry.upper.min(geometry.lower) > DISTANCE).then_some(())?;
    let arm = Srs::new(geometry, walk.ranges(ranges)?);
    let flange = arm.forward(&walk.angles);
    Some(walk.place(Form::Srs(arm), (&base, &shoulder), &flange))
}

/// The origin of a form, on axis 1 beside axis 2, and points in its frame.
fn beside_second(
    pose: &Pose,
    base: &Matrix3<f64>,
) -> (Vector3<f64>, impl Fn(&Vector3<f64>) -> Vector3<f64> + use<>) {
    let base = *base;
    let up = base.column(2).dot(&(pose.points[1] - pose.points[0]));
    let origin = pose.points[0] + base.column(2) * up;
    (origin, move |point| base.transpose() * (point - origin))
}
