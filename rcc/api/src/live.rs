//! Activities that follow a program while they run: jogging, and streamed goals. One net runs from begin to end, and what
//! the program sends is written into it.

use std::marker::PhantomData;
use std::ops::Deref;

use crate::activity::Activity;
use crate::error::{Error, ErrorKind};
use crate::explain::Explanation;
use crate::expression::Condition;
use crate::handle::{FOR_EVER, Handle};
use crate::motion::{ArmDescription, CartesianLimits};
use crate::pose::Pose;

/// Key of the value that a program writes.
pub(crate) const KEY: &str = "sent";

/// What a program can send to an activity that runs.
pub trait SetPoint: Clone + Send + Sync + std::fmt::Debug {
    /// Checks it, as far as the program can.
    ///
    /// # Errors
    /// [`ErrorKind::Invalid`], [`ErrorKind::Limit`] and [`ErrorKind::Unreachable`].
    fn check(&self, target: &Target) -> Result<(), ErrorKind>;

    /// Its text in a net.
    fn text(&self) -> String;
}

/// The arm to which set-points are sent.
#[derive(Clone, Debug)]
pub struct Target {
    pub(crate) arm: ArmDescription,
    pub(crate) limits: CartesianLimits,
    pub(crate) tool: Pose,
}

impl Target {
    fn invalid(&self, text: &str) -> ErrorKind {
        ErrorKind::Invalid(format!("{}: {text}", self.arm.name))
    }
}

/// Velocity of a motion centre, in the axes of the base of its arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Velocity, m/s.
    pub velocity: [f64; 3],
    /// Rotational velocity about x, y and z, rad/s.
    pub rotation: [f64; 3],
}

impl Twist {
    /// A velocity without rotation, m/s.
    pub const fn xyz(x: f64, y: f64, z: f64) -> Self {
        Self {
            velocity: [x, y, z],
            rotation: [0.0; 3],
        }
    }

    /// The same with a rotational velocity about x, y and z, rad/s.
    #[must_use]
    pub const fn turning(mut self, x: f64, y: f64, z: f64) -> Self {
        self.rotation = [x, y, z];
        self
    }
}

impl SetPoint for Twist {
    fn check(&self, target: &Target) -> Result<(), ErrorKind> {
        let length = |vector: [f64; 3]| vector.iter().map(|x| x * x).sum::<f64>().sqrt();
        let parts = [
            (length(self.velocity), target.limits.velocity, "m/s"),
            (length(self.rotation), target.limits.rot_velocity, "rad/s"),
        ];
        for (speed, limit, unit) in parts {
            if speed.is_nan() || speed > limit * (1.0 + 1e-9) {
                let text = format!("a velocity of {speed} {unit}; it is at most {limit} {unit}");
                return Err(target.invalid(&text));
            }
        }
        Ok(())
    }

    fn text(&self) -> String {
        let vector = |[x, y, z]: [f64; 3]| format!("{{x:{x},y:{y},z:{z}}}");
        let (velocity, rotation) = (vector(self.velocity), vector(self.rotation));
        format!("{{vel:{velocity},rot:{rotation}}}")
    }
}

/// Velocities of the joints of an arm, rad/s.
#[derive(Clone, Debug, PartialEq)]
pub struct JointVelocities(pub Vec<f64>);

impl<V: Into<Vec<f64>>> From<V> for JointVelocities {
    fn from(velocities: V) -> Self {
        Self(velocities.into())
    }
}

impl SetPoint for JointVelocities {
    fn check(&self, target: &Target) -> Result<(), ErrorKind> {
        let joints = &target.arm.joints;
        if self.0.len() != joints.len() {
            let text = format!("it has {} joints, not {}", joints.len(), self.0.len());
            return Err(target.invalid(&text));
        }
        for (number, (velocity, limits)) in self.0.iter().zip(joints).enumerate() {
            let limit = limits.velocity;
            if velocity.is_nan() || velocity.abs() > limit {
                let text = format!(
                    "a velocity of {velocity} rad/s for joint {number}; it is at most {limit} rad/s"
                );
                return Err(target.invalid(&text));
            }
        }
        Ok(())
    }

    fn text(&self) -> String {
        crate::net::array(&self.0)
    }
}

/// Goals of the joints of an arm, rad.
#[derive(Clone, Debug, PartialEq)]
pub struct JointGoal(pub Vec<f64>);

impl<V: Into<Vec<f64>>> From<V> for JointGoal {
    fn from(positions: V) -> Self {
        Self(positions.into())
    }
}

impl SetPoint for JointGoal {
    fn check(&self, target: &Target) -> Result<(), ErrorKind> {
        target.arm.check_joints(&self.0)
    }

    fn text(&self) -> String {
        crate::net::array(&self.0)
    }
}

impl SetPoint for Pose {
    fn check(&self, target: &Target) -> Result<(), ErrorKind> {
        let arm = &target.arm;
        if !self.is_finite() {
            return Err(target.invalid("the pose is not finite"));
        }
        // Of an arm whose model is not known here, the controller decides.
        let Some(kinematics) = arm.kinematics() else {
            return Ok(());
        };
        let flange = *self * target.tool.inverse();
        let middle = |limits: &crate::motion::JointLimits| {
            f64::midpoint(limits.position_min, limits.position_max)
        };
        let hint: Vec<_> = arm.joints.iter().map(middle).collect();
        let mut joints = hint.clone();
        let found = kinematics.inverse(flange.isometry(), &hint, &mut joints);
        if found.is_ok() {
            return Ok(());
        }
        Err(ErrorKind::Unreachable {
            device: arm.name.clone(),
            progress: 0.0,
            cause: "the frame is out of reach".to_owned(),
        })
    }

    fn text(&self) -> String {
        Self::text(self)
    }
}

/// An activity that follows set-points of type `T`, described and not begun.
#[derive(Clone, Debug)]
#[must_use = "nothing moves before it is begun"]
pub struct Live<T> {
    activity: Activity,
    target: Target,
    kind: PhantomData<T>,
}

impl<T: SetPoint> Live<T> {
    pub(crate) const fn new(activity: Activity, target: Target) -> Self {
        Self {
            activity,
            target,
            kind: PhantomData,
        }
    }

    /// Multiplies its speed by `factor`, above 0 to 1.
    pub fn speed(mut self, factor: f64) -> Self {
        self.activity = self.activity.speed(factor);
        self
    }

    /// Stops it when the condition holds; the outcome names it.
    pub fn until(mut self, name: &str, condition: Condition) -> Self {
        self.activity = self.activity.until(name, condition);
        self
    }

    /// Lets it begin in the next cycle, in place of what its arm does, at rest or in motion.
    pub fn now(mut self) -> Self {
        self.activity = self.activity.now();
        self
    }

    /// Begins it, and returns when it runs. The arm brakes, and waits for set-points.
    ///
    /// # Errors
    /// As [`Activity::begin`].
    #[track_caller]
    pub fn begin(self) -> Result<LiveHandle<T>, Error> {
        let handle = self.queue()?;
        handle.wait_for_begin(FOR_EVER).unwrap_or(Ok(()))?;
        Ok(handle)
    }

    /// Lets it begin after what its arm does, and returns at once. What is sent before its net is loaded is refused.
    ///
    /// # Errors
    /// As [`Activity::queue`].
    #[track_caller]
    pub fn queue(self) -> Result<LiveHandle<T>, Error> {
        Ok(LiveHandle {
            handle: self.activity.queue()?,
            target: self.target,
            kind: PhantomData,
        })
    }

    /// What it becomes, as of [`Activity::explain`].
    ///
    /// # Errors
    /// As [`Activity::explain`].
    #[track_caller]
    pub fn explain(&self) -> Result<Explanation, Error> {
        self.activity.explain()
    }
}

/// An activity that follows what a program sends. It goes on until it is cancelled, a condition stops it, or another
/// activity takes over with `now`; dropping the handle does not end it.
#[derive(Debug)]
#[must_use = "it goes on until it is cancelled"]
pub struct LiveHandle<T> {
    handle: Handle,
    target: Target,
    kind: PhantomData<T>,
}

impl<T: SetPoint> LiveHandle<T> {
    /// Sends a set-point, which takes effect in the next cycle of the controller; returns when the controller has it.
    ///
    /// # Errors
    /// If it is out of its bounds: nothing was sent then, and the last one remains in effect. If the activity has ended: the
    /// error with which it ended, or [`ErrorKind::Ended`]. If the connection is lost.
    #[track_caller]
    pub fn send(&self, set_point: impl Into<T>) -> Result<(), Error> {
        let set_point = set_point.into();
        set_point.check(&self.target)?;
        if let Some(outcome) = self.handle.outcome() {
            let reason = format!("it has ended: {:?}", outcome?);
            let device = self.target.arm.name.clone();
            return Err(ErrorKind::Ended { device, reason }.into());
        }
        Ok(self.handle.write(KEY, &set_point.text())?)
    }
}

impl<T> Deref for LiveHandle<T> {
    type Target = Handle;

    fn deref(&self) -> &Handle {
        &self.handle
    }
}
