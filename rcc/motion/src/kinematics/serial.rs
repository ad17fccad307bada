//! Any serial arm, from the frames and axes of its joints: what a URDF describes. Forward kinematics and Jacobian are those of the
//! chain; the inverse is in closed form where the structure of the chain has one, else numeric and bounded. Closed loops,
//! branches and mimic joints are not decided here.

use nalgebra::{Matrix3, Vector3};
use takt_net::device::{Kinematics, Unreachable};
use takt_net::{Frame, Twist};

use super::geometry::{frame, rot_z};
use super::numeric;
use super::structure::{ClosedForm, Structure};
use super::{ON_LIMIT, Range};

/// Most joints of a serial arm.
pub const JOINTS_MAX: usize = 8;

/// What a joint does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about its axis, rad.
    Revolute,
    /// Moves along its axis, m.
    Prismatic,
}

/// A joint of a serial arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// From the frame of the previous joint, or from the base, to that of this joint at position 0, m.
    pub origin: Frame,
    /// Its axis in its own frame; any length but 0.
    pub axis: Vector3<f64>,
    /// What it does.
    pub kind: JointKind,
    /// Its range, rad or m.
    pub range: Range,
}

/// Why joints are no serial arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SerialError {
    /// Too few or too many joints.
    #[error("an arm has 1 to {JOINTS_MAX} joints, not {0}")]
    Count(usize),
    /// The joint with this number, from 0, has no axis or a frame that is not finite.
    #[error("joint {0} has no axis, or its frame is not finite")]
    Joint(usize),
    /// The range of the joint with this number, from 0, is empty.
    #[error("the range of joint {0} is empty")]
    Range(usize),
}

/// A fixed transform: rotation and position, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fixed {
    pub(crate) rotation: Matrix3<f64>,
    pub(crate) position: Vector3<f64>,
}

impl Fixed {
    pub(crate) const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        position: Vector3::new(0.0, 0.0, 0.0),
    };

    pub(crate) fn frame(&self) -> Frame {
        frame(self.position, &self.rotation)
    }

    fn of(frame: &Frame) -> Self {
        Self {
            rotation: frame.rotation.to_rotation_matrix().into_inner(),
            position: frame.translation.vector,
        }
    }

    fn then(&self, other: &Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            position: self.rotation * other.position + self.position,
        }
    }
}

/// The kinematics of a serial arm.
#[derive(Clone, Debug)]
pub struct Serial {
    /// From one joint to the next, each with its axis along z; the last one is from the last joint to the flange.
    links: Vec<Fixed>,
    /// From the frame of each joint as it was given to the one with its axis along z.
    turns: Vec<Matrix3<f64>>,
    kinds: Vec<JointKind>,
    ranges: Vec<Range>,
    /// The length of the stretched arm, m, for tolerances and the first check of the reach.
    length: f64,
    closed: Option<ClosedForm>,
}

/// Where the axes of an arm are: of each joint a unit vector along it and a point on it, m, and the flange.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    pub(super) axes: [Vector3<f64>; JOINTS_MAX],
    pub(super) points: [Vector3<f64>; JOINTS_MAX],
    pub(super) flange: Fixed,
}

impl Serial {
    /// An arm of these joints, from the base on, with the flange at `tip` in the frame of the last joint (m).
    ///
    /// # Errors
    /// If there are too few or too many joints, or one has no axis or no range.
    pub fn new(joints: &[Joint], tip: &Frame) -> Result<Self, SerialError> {
        if joints.is_empty() || joints.len() > JOINTS_MAX {
            return Err(SerialError::Count(joints.len()));
        }
        let mut links = Vec::with_capacity(joints.len() + 1);
        let mut turns = Vec::with_capacity(joints.len());
        let mut back = Matrix3::identity();
        for (number, joint) in joints.iter().enumerate() {
            let origin = Fixed::of(&joint.origin);
            let axis = joint.axis.try_normalize(1e-9);
            let is_finite = is_finite(&origin);
            let axis = axis.filter(|_| is_finite);
            let axis = axis.ok_or(SerialError::Joint(number))?;
            let Range { min, max } = joint.range;
            if min.is_nan() || max.is_nan() || min >= max {
                return Err(SerialError::Range(number));
            }
            let along_z = turn_z_to(&axis);
            links.push(Fixed {
                rotation: back * origin.rotation * along_z,
                position: back * origin.position,
            });
            back = along_z.transpose();
            turns.push(back);
        }
        let tip = Fixed::of(tip);
        if !is_finite(&tip) {
            return Err(SerialError::Joint(joints.len() - 1));
        }
        links.push(Fixed {
            rotation: back * tip.rotation,
            position: back * tip.position,
        });
        let strokes = joints.iter().filter(|it| it.kind == JointKind::Prismatic);
        let strokes: f64 = strokes
            .map(|it| it.range.min.abs().max(it.range.max.abs()))
            .sum();
        let length = links.iter().map(|link| link.position.norm()).sum::<f64>() + strokes;
        let mut arm = Self {
            links,
            turns,
            kinds: joints.iter().map(|joint| joint.kind).collect(),
            ranges: joints.iter().map(|joint| joint.range).collect(),
            length,
            closed: None,
        };
        arm.closed = ClosedForm::of(&arm);
        Ok(arm)
    }

    /// The structure of the arm, which decides how its inverse is computed.
    pub fn structure(&self) -> Structure {
        let closed = self.closed.as_ref();
        closed.map_or(Structure::General, ClosedForm::structure)
    }

    /// The same arm with an inverse that is always numeric: for comparisons.
    #[must_use]
    pub fn numeric(mut self) -> Self {
        self.closed = None;
        self
    }

    /// The same arm with other joint ranges; `None` if there are not as many as joints.
    #[must_use]
    pub fn within(mut self, ranges: &[Range]) -> Option<Self> {
        if ranges.len() != self.ranges.len() {
            return None;
        }
        self.ranges = ranges.to_vec();
        self.closed = ClosedForm::of(&self);
        Some(self)
    }

    /// The joint ranges of its solutions, rad or m.
    pub fn ranges(&self) -> &[Range] {
        &self.ranges
    }

    /// What its joints do.
    pub fn kinds(&self) -> &[JointKind] {
        &self.kinds
    }

    /// The length of the stretched arm from its base to its flange, m: nothing beyond it is within reach.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// From one joint to the next, each with its axis along z, and from the last one to the flange.
    pub(crate) fn links(&self) -> &[Fixed] {
        &self.links
    }

    /// The rotation from the frame of each joint, as it was given, to the one with its axis along z.
    pub(crate) fn turns(&self) -> &[Matrix3<f64>] {
        &self.turns
    }

    /// Axes and flange at these joint positions; those that are left out count as NaN.
    pub(super) fn pose(&self, joints: &[f64]) -> Pose {
        let mut axes = [Vector3::zeros(); JOINTS_MAX];
        let mut points = axes;
        let mut at = Fixed {
            rotation: Matrix3::identity(),
            position: Vector3::zeros(),
        };
        let joints = joints.iter().copied().chain(std::iter::repeat(f64::NAN));
        let each = self.links.iter().zip(&self.kinds).zip(joints);
        for (((link, kind), joint), (axis, point)) in each.zip(axes.iter_mut().zip(&mut points)) {
            at = at.then(link);
            *axis = at.rotation.column(2).into_owned();
            *point = at.position;
            match kind {
                JointKind::Revolute => at.rotation *= rot_z(joint),
                JointKind::Prismatic => at.position += *axis * joint,
            }
        }
        Pose {
            axes,
            points,
            flange: self.links.last().map_or(at, |tip| at.then(tip)),
        }
    }

    /// The column of the Jacobian of each joint in this pose.
    pub(super) fn columns(&self, pose: &Pose) -> impl Iterator<Item = Twist> {
        let each = self.kinds.iter().zip(pose.axes).zip(pose.points);
        each.map(move |((kind, axis), point)| match kind {
            JointKind::Revolute => Twist {
                vel: axis.cross(&(pose.flange.position - point)),
                rot: axis,
            },
            JointKind::Prismatic => Twist {
                vel: axis,
                rot: Vector3::zeros(),
            },
        })
    }

    /// Whether these joint positions are within their ranges, up to rounding.
    pub(super) fn is_within(&self, joints: &[f64]) -> bool {
        let mut each = joints.iter().zip(&self.ranges);
        each.all(|(joint, range)| *joint >= range.min - ON_LIMIT && *joint <= range.max + ON_LIMIT)
    }
}

fn is_finite(fixed: &Fixed) -> bool {
    let rotation = fixed.rotation.iter();
    rotation.chain(fixed.position.iter()).all(|v| v.is_finite())
}

/// A rotation that brings z to this unit vector.
fn turn_z_to(axis: &Vector3<f64>) -> Matrix3<f64> {
    // Exact where the axis is along a coordinate axis, as most are.
    let other = if axis.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let x = (other - axis * axis.dot(&other)).normalize();
    Matrix3::from_columns(&[x, axis.cross(&x), *axis])
}

impl Kinematics for Serial {
    fn joints(&self) -> usize {
        self.kinds.len()
    }

    fn forward(&self, joints: &[f64]) -> Frame {
        let count = joints.len() == self.joints();
        let joints = if count { joints } else { &[] };
        let flange = self.pose(joints).flange;
        frame(flange.position, &flange.rotation)
    }

    fn inverse(&self, flange: &Frame, hint: &[f64], joints: &mut [f64]) -> Result<(), Unreachable> {
        let target = Fixed::of(flange);
        let is_valid = hint.iter().all(|it| it.is_finite())
            && is_finite(&target)
            && [hint.len(), joints.len()] == [self.joints(); 2];
        if !is_valid {
            return Err(Unreachable::Invalid);
        }
        if target.position.norm() > self.length + 1e-9 {
            return Err(Unreachable::Reach);
        }
        let mut found = [0.0; JOINTS_MAX];
        let found = found.get_mut(..joints.len());
        let found = found.ok_or(Unreachable::Invalid)?;
        match &self.closed {
            Some(closed) => closed.inverse(self, flange, &target, hint, found)?,
            None => numeric::inverse(self, &target, hint, found)?,
        }
        joints.copy_from_slice(found);
        Ok(())
    }

    fn jacobian(&self, joints: &[f64], columns: &mut [Twist]) {
        let fits = [joints.len(), columns.len()] == [self.joints(); 2];
        let pose = self.pose(if fits { joints } else { &[] });
        if !fits {
            let none = Vector3::repeat(f64::NAN);
            columns.fill(Twist {
                vel: none,
                rot: none,
            });
            return;
        }
        for (column, of_joint) in columns.iter_mut().zip(self.columns(&pose)) {
            *column = of_joint;
        }
    }
}

#[cfg(test)]
mod tests;
