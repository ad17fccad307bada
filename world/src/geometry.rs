//! Poses, twists and wrenches: the values that cross the border of the world. No frames with names.

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};

/// A pose in the world frame, or of one frame in another; m.
pub type Pose = Isometry3<f64>;

/// Velocity of the origin of a frame and rate of its turn, in the axes of the world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Twist {
    /// Of the origin, m/s.
    pub linear: Vector3<f64>,
    /// rad/s.
    pub angular: Vector3<f64>,
}

impl Twist {
    /// Velocity of a point at `arm` from the origin, m/s.
    #[must_use]
    pub fn at(&self, arm: &Vector3<f64>) -> Vector3<f64> {
        self.linear + self.angular.cross(arm)
    }

    /// The twist that leads from one pose to another in `seconds`.
    pub(crate) fn between(from: &Pose, to: &Pose, seconds: f64) -> Self {
        if seconds <= 0.0 {
            return Self::default();
        }
        let turn = to.rotation * from.rotation.inverse();
        Self {
            linear: (to.translation.vector - from.translation.vector) / seconds,
            angular: turn.scaled_axis() / seconds,
        }
    }

    pub(crate) fn is_finite(&self) -> bool {
        finite(&self.linear) && finite(&self.angular)
    }
}

/// A force and its moment, in the axes of the world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wrench {
    /// N.
    pub force: Vector3<f64>,
    /// About the origin of the frame that the wrench acts on, Nm.
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// Adds a force that acts at `arm` from the origin.
    pub(crate) fn add_at(&mut self, force: &Vector3<f64>, arm: &Vector3<f64>) {
        self.force += force;
        self.torque += arm.cross(force);
    }
}

pub(crate) fn finite(vector: &Vector3<f64>) -> bool {
    vector.iter().all(|value| value.is_finite())
}

pub(crate) fn finite_pose(pose: &Pose) -> bool {
    let length = pose.rotation.coords.norm();
    finite(&pose.translation.vector) && (0.99..1.01).contains(&length)
}

/// Moves a pose on by a twist of its origin.
pub(crate) fn moved(pose: &Pose, twist: &Twist, seconds: f64) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(twist.angular * seconds);
    let mut rotation = turn * pose.rotation;
    rotation.renormalize();
    let translation = pose.translation.vector + twist.linear * seconds;
    Pose::from_parts(translation.into(), rotation)
}

/// Origin of a pose.
pub(crate) fn origin(pose: &Pose) -> Vector3<f64> {
    pose.translation.vector
}

/// A point of a frame, in the frame in which the pose is given.
pub(crate) fn point(pose: &Pose, local: &Vector3<f64>) -> Vector3<f64> {
    pose.rotation * local + pose.translation.vector
}

/// A point of the outer frame, in the frame of the pose.
pub(crate) fn local(pose: &Pose, outer: &Vector3<f64>) -> Vector3<f64> {
    pose.rotation.inverse() * (outer - pose.translation.vector)
}

/// The matrix of a cross product.
pub(crate) fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}
