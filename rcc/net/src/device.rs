//! What nets see of devices: an image of their interfaces, refreshed before and handed over
//! after each cycle by the thread that evaluates nets. No driver and no wire is known here.

pub mod interface;
mod owner;
mod signal;

use std::cell::Cell;
use std::fmt;
use std::sync::Arc;

use crate::netcomm::NetBoxes;
use crate::value::Frame;

pub use interface::{
    Answer, Base, CartesianImpedance, CartesianPosition, Gripper, Interfaces, Io, JointImpedance,
    JointTorque, Order, Output, Tool, Wheel,
};
pub use owner::Target;
pub use signal::{
    COMMAND_WORDS_MAX, Command, Given, Layout, SIGNAL_WORDS_MAX, Signal, Words, standing, withhold,
};

/// Most joints in the image; the sum over all robot arms.
pub const JOINTS_MAX: usize = 512;

/// What a robot-arm joint reports. `None` is "not known".
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointState {
    /// Position the driver last commanded, rad.
    pub commanded_position: Option<f64>,
    /// Velocity of the commanded position, rad/s.
    pub commanded_velocity: Option<f64>,
    /// Acceleration of the commanded position, rad/s².
    pub commanded_acceleration: Option<f64>,
    /// Position the joint has, rad.
    pub measured_position: Option<f64>,
    /// Velocity the joint has, rad/s.
    pub measured_velocity: Option<f64>,
    /// Acceleration the joint has, rad/s².
    pub measured_acceleration: Option<f64>,
    /// 0 if the joint follows commands; see [`JointError`] for the others.
    pub error: i32,
}

/// Values of [`JointState::error`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum JointError {
    /// The joint follows commands.
    None = 0,
    /// No contact to the device.
    Offline = 1,
    /// The device answers, but its drives are not enabled.
    NotEnabled = 2,
    /// The driver refused the set-points and holds the joint: a step or speed beyond the limit.
    Refused = 3,
    /// Its drive gets no power: its process data by PDO are not those by SDO.
    NotProven = 4,
    /// Its motor went where it was not told to go, and lost its power.
    Runaway = 5,
    /// It stands out of its range: set-points that begin where it stands move it back, slowly.
    OutOfRange = 6,
}

/// A set-point for a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointCommand {
    /// The cycle it was given in, as in `Moment::cycle`; 0 is "never".
    pub cycle: u64,
    /// In how many cycles of the thread its net gives one; it stands until then. 0 once it was withdrawn.
    pub every: u64,
    /// Position, rad.
    pub position: f64,
    /// The net that gave it; `None` for none that runs.
    pub net: Option<u32>,
}

impl JointCommand {
    /// Whether it holds in this cycle: it was given in it, or the next of its net is not due yet.
    #[must_use]
    pub const fn stands(&self, cycle: u64) -> bool {
        cycle.saturating_sub(self.cycle) < self.every
    }
}

/// One joint in the image.
#[derive(Debug, Default)]
pub struct Joint {
    /// What the driver reports.
    pub state: Cell<JointState>,
    /// What nets command.
    pub command: Cell<JointCommand>,
}

/// What nets say of the emergency stop, by their `EStop` primitives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StopVote {
    /// The first cycle of the thread for which nothing was said.
    pub said_until: u64,
    /// The first cycle of the thread for which no stop was demanded.
    pub stop_until: u64,
}

impl StopVote {
    /// Says for the cycles from `cycle` to `until` whether all is to stop. Of several who say something
    /// of one cycle, those who demand a stop count.
    #[must_use]
    pub fn with(self, until: u64, stop: bool) -> Self {
        Self {
            said_until: self.said_until.max(until),
            stop_until: if stop {
                self.stop_until.max(until)
            } else {
                self.stop_until
            },
        }
    }

    /// What is said for `cycle`: whether to stop; `None` for nothing.
    #[must_use]
    pub const fn at(self, cycle: u64) -> Option<bool> {
        if self.said_until > cycle {
            Some(self.stop_until > cycle)
        } else {
            None
        }
    }
}

/// All device interfaces as the nets of one thread see them during one cycle.
#[derive(Debug)]
pub struct Image {
    /// Joints of all robot arms.
    pub joints: Box<[Joint]>,
    /// What else drivers report, in the places of [`Signal`]s.
    pub signals: Box<[Cell<u64>]>,
    /// What else nets command, in the places of [`Command`]s.
    pub commands: Box<[Cell<u64>]>,
    /// By the first word of each command, the net that gave it.
    pub owners: Box<[Cell<Option<u32>>]>,
    /// What nets say of the emergency stop.
    pub stop: Cell<StopVote>,
}

impl Default for Image {
    fn default() -> Self {
        Self {
            joints: (0..JOINTS_MAX).map(|_| Joint::default()).collect(),
            signals: (0..SIGNAL_WORDS_MAX).map(|_| Cell::new(0)).collect(),
            commands: (0..COMMAND_WORDS_MAX).map(|_| Cell::new(0)).collect(),
            owners: (0..COMMAND_WORDS_MAX).map(|_| Cell::new(None)).collect(),
            stop: Cell::default(),
        }
    }
}

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

/// The geometry of an arm, in closed form: used in every cycle, so it neither allocates nor
/// iterates without bound.
pub trait Kinematics: fmt::Debug + Send + Sync {
    /// Number of joints.
    fn joints(&self) -> usize;

    /// The flange in the base of the arm (m) at these joint positions (rad); joint limits do not
    /// matter here. Not finite if a joint is not, or if there are not [`Self::joints`] of them.
    fn forward(&self, joints: &[f64]) -> Frame;

    /// Joint positions (rad) within their limits that bring the flange to `flange` (m, in the base
    /// of the arm): of all solutions the one nearest to `hint` (rad), turns included.
    ///
    /// # Errors
    /// If there is none; `joints` then stays as it was.
    fn inverse(&self, flange: &Frame, hint: &[f64], joints: &mut [f64]) -> Result<(), Unreachable>;
}

/// Why no joint positions bring a flange to a frame. The numbers are those of `outError`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[repr(i32)]
pub enum Unreachable {
    /// The arm is too short or too long for it, or has too few joints.
    #[error("the frame is out of reach")]
    Reach = 1,
    /// It could be reached, but only beyond the limits of the joints.
    #[error("the frame is reached only beyond joint limits")]
    Limits = 2,
    /// The frame or the hint is not finite, or there are not as many values as joints.
    #[error("frame or hint are no finite numbers, or not as many as joints")]
    Invalid = 3,
}

/// A robot arm as found by its name while loading.
#[derive(Clone, Debug)]
pub struct ArmBinding {
    /// Number of the arm's first joint in [`Image::joints`]; the others follow.
    pub first_joint: usize,
    /// Limits by joint; its length is the number of joints.
    pub limits: Arc<[JointLimits]>,
    /// Its geometry; `None` if nobody told it.
    pub kinematics: Option<Arc<dyn Kinematics>>,
}

/// Finds devices, and other nets, by name while a net is loaded.
pub trait Devices {
    /// The robot arm of that name.
    fn arm(&self, name: &str) -> Option<ArmBinding>;

    /// What else the device of that name offers; `None` if there is no such device.
    fn interfaces(&self, _name: &str) -> Option<Interfaces> {
        None
    }

    /// Names of all devices, for the text of a fault.
    fn names(&self) -> Vec<String>;

    /// What the loaded net of that name takes in and gives out; nets are known to a controller only.
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
