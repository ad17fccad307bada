//! The nets' view of devices: an image of their interfaces. The thread that evaluates nets
//! refreshes the image before each cycle and publishes it after the cycle. No driver and no wire is
//! known here.

mod commanded;
mod image;
pub mod interface;
mod owner;
mod signal;

use std::fmt;
use std::sync::Arc;

use crate::netcomm::NetBoxes;
use crate::value::{Frame, Twist};

pub use commanded::{Commanded, Trail};
pub use image::{
    COMMAND_WORDS_MAX, Image, JOINTS_MAX, Joint, JointCommand, JointError, JointState,
    SIGNAL_WORDS_MAX, StopVote,
};
pub use interface::{
    Answer, Base, CartesianImpedance, CartesianPosition, CartesianSine, Figure, Gripper,
    GripperCommand, Homing, Interfaces, Io, JointImpedance, JointTorque, Order, Output,
    ServoGripper, Tool, Wheel,
};
pub use owner::Target;
pub use signal::{Command, Given, Layout, Signal, Words, is_in_force, withhold};

/// Limits of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Smallest position, rad.
    pub position_min: f64,
    /// Largest position, rad.
    pub position_max: f64,
    /// Largest speed, rad/s.
    pub velocity_max: f64,
    /// Largest acceleration, rad/s².
    pub acceleration_max: f64,
}

/// The geometry of an arm, in closed form: it is used in every cycle, so it neither allocates nor
/// iterates without bound.
pub trait Kinematics: fmt::Debug + Send + Sync {
    /// Number of joints.
    fn joints(&self) -> usize;

    /// The flange frame in the arm's base (m) at these joint positions (rad), whatever the joint
    /// limits are. Not finite if a joint is not, or if there are not [`Self::joints`] of them.
    fn forward(&self, joints: &[f64]) -> Frame;

    /// Joint positions (rad) within their limits that bring the flange to `flange` (m, in the arm's
    /// base): of all solutions the one nearest to `hint` (rad), turns included.
    ///
    /// # Errors
    /// If there is no solution; `joints` then keeps its values.
    fn inverse(&self, flange: &Frame, hint: &[f64], joints: &mut [f64]) -> Result<(), Unreachable>;

    /// The Jacobian of the flange at these joint positions (rad), one column for each joint: the
    /// velocity of the flange in the arm's base (m/s, rad/s) while that joint alone moves at
    /// 1 rad/s. Not finite if a joint is not, or if there are not [`Self::joints`] of them or of
    /// the columns.
    fn jacobian(&self, joints: &[f64], columns: &mut [Twist]);
}

/// Why no joint positions bring a flange to a frame. The numbers are those of `outError`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[repr(i32)]
pub enum Unreachable {
    /// The arm is too short or too long for the frame, or has too few joints.
    #[error("the frame is out of reach")]
    Reach = 1,
    /// Only positions beyond the joint limits reach the frame.
    #[error("the frame is reached only beyond joint limits")]
    Limits = 2,
    /// The frame or the hint is not finite, or the number of values is not the number of joints.
    #[error("the frame or the hint is not finite, or has not as many values as the arm has joints")]
    Invalid = 3,
}

/// A robot arm as found by its name during loading.
#[derive(Clone, Debug)]
pub struct ArmBinding {
    /// Number of the arm's first joint in [`Image::joints`]; the others follow.
    pub first_joint: usize,
    /// Limits by joint; its length is the number of joints.
    pub limits: Arc<[JointLimits]>,
    /// Its geometry; `None` if it is not configured.
    pub kinematics: Option<Arc<dyn Kinematics>>,
}

/// Finds devices, and other nets, by name during loading.
pub trait Devices {
    /// The robot arm with that name.
    fn arm(&self, name: &str) -> Option<ArmBinding>;

    /// The other interfaces of the device with that name; `None` if there is no such device.
    fn interfaces(&self, _name: &str) -> Option<Interfaces> {
        None
    }

    /// Names of all devices, for error messages.
    fn names(&self) -> Vec<String>;

    /// The in and out values of the loaded net with that name; only a controller knows nets.
    fn net(&self, _name: &str) -> Option<NetBoxes> {
        None
    }
}

/// A controller without devices.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoDevices;

impl Devices for NoDevices {
    fn arm(&self, _name: &str) -> Option<ArmBinding> {
        None
    }

    fn names(&self) -> Vec<String> {
        Vec::new()
    }
}
