//! Devices: the data that nets and drivers exchange, and which devices a controller has. Drivers
//! are in the modules below; what nets see of a device is in `takt_net::device`.

pub mod canopen;
pub(crate) mod config;
pub mod continuity;
pub mod driver;
mod drives;
#[cfg(test)]
mod ends;
pub mod ethercat;
pub mod fri;
pub mod iiwa;
pub mod last_stage;
mod link_watch;
pub mod lwr;
pub mod parts;
pub mod rmp;
pub mod setpoint;
pub mod sim;
mod table;

use std::borrow::Cow;
use std::fmt;
use std::ops::Range;

use takt_net::device::Base;
use takt_net::{Image, JointLimits, JointState, Twist};
use takt_rt::Nanos;

use continuity::Jumped;
use last_stage::Limited;
pub use parts::Part;
pub use table::{Device, DevicePorts, DeviceTable};

/// Least and most of what is to be above zero, such as a joint's speed: beyond these, products with the cycle would
/// be zero or infinite.
const LEAST: f64 = 1e-6;
const MOST: f64 = 1e9;

/// Most joints of one robot arm.
pub const ARM_JOINTS_MAX: usize = 8;

/// Below this a joint or a base counts as resting by what it is commanded, rad/s and m/s.
const RESTS_COMMANDED: f64 = 1e-3;
/// Below this a base counts as resting by what its wheels measure, m/s and rad/s: a few of their increments.
const RESTS_MEASURED: f64 = 1e-2;

/// Whether a device can be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum DeviceStatus {
    /// No contact.
    #[default]
    Offline,
    /// In contact, but it does not follow commands.
    SafeOperational,
    /// It follows commands.
    Operational,
}

impl DeviceStatus {
    /// The word for it on the wire.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Offline => "off",
            Self::SafeOperational => "safeop",
            Self::Operational => "op",
        }
    }

    /// The same, or what becomes of it while an emergency stop is on.
    #[must_use]
    pub const fn under(self, is_stopped: bool) -> Self {
        match self {
            Self::Operational if is_stopped => Self::SafeOperational,
            Self::Operational => Self::Operational,
            Self::SafeOperational => Self::SafeOperational,
            Self::Offline => Self::Offline,
        }
    }
}

impl fmt::Display for DeviceStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Offline => "offline",
            Self::SafeOperational => "safe-operational",
            Self::Operational => "operational",
        })
    }
}

/// What a driver tells nets.
#[derive(Clone, Debug, Default)]
pub struct DeviceState {
    /// When the measurement arrived.
    pub stamp: Nanos,
    /// Whether the device follows commands.
    pub status: DeviceStatus,
    /// How often it left [`DeviceStatus::Operational`]; a net that commands it ends then.
    pub faults: u64,
    /// Its joints.
    pub joints: [JointState; ARM_JOINTS_MAX],
    /// What the last stages of its driver held back: by joint, or of a base along the floor and turning.
    pub limited: [Limited; ARM_JOINTS_MAX],
    /// Positions that stood elsewhere all of a sudden; nets that were scheduled before are given back.
    pub jumped: Jumped,
    /// What else it tells, in the places of its interfaces.
    pub signals: Box<[u64]>,
}

impl DeviceState {
    /// One that knows nothing yet, with so many words for what is told beside joints.
    #[must_use]
    pub fn new(signals: usize) -> Self {
        Self {
            signals: vec![0; signals].into(),
            ..Self::default()
        }
    }

    /// Puts it into the image, at the place of its device.
    pub fn show(&self, place: &Place, image: &Image) {
        let joints = image.joints.iter().skip(place.first_joint);
        for (joint, told) in joints.take(place.joints).zip(&self.joints) {
            joint.state.set(*told);
        }
        let cells = image.signals.get(place.signals.clone());
        for (cell, word) in cells.into_iter().flatten().zip(&self.signals) {
            cell.set(*word);
        }
    }

    /// Notes how the device is at that instant; one that leaves [`DeviceStatus::Operational`] has one fault more.
    pub fn enter(&mut self, status: DeviceStatus, stamp: Nanos) {
        let left = self.status == DeviceStatus::Operational && status != self.status;
        self.faults += u64::from(left);
        (self.status, self.stamp) = (status, stamp);
    }

    /// Whether nothing of it moves: no joint is commanded to, whose measured velocity would never be without noise,
    /// and its base, if it is one, neither is nor does. What is out of contact cannot be waited for and counts as
    /// resting. `base` is where a base lies in [`Self::signals`].
    #[must_use]
    pub fn is_at_rest(&self, base: Option<&Base>) -> bool {
        let joints = self.joints.iter().filter_map(|j| j.commanded_velocity);
        let rests = |base: &Base| {
            let below = |twist: Option<Twist>, bound: f64| {
                twist.is_none_or(|twist| twist.vel.norm() < bound && twist.rot.norm() < bound)
            };
            below(base.commanded.read(&self.signals), RESTS_COMMANDED)
                && below(base.velocity.read(&self.signals), RESTS_MEASURED)
        };
        self.status == DeviceStatus::Offline
            || (joints.into_iter().all(|v| v.abs() < RESTS_COMMANDED) && base.is_none_or(rests))
    }

    /// Becomes like another of the same device, in the memory it has.
    pub fn copy_from(&mut self, other: &Self) {
        (self.stamp, self.status, self.faults) = (other.stamp, other.status, other.faults);
        (self.joints, self.limited) = (other.joints, other.limited);
        self.jumped = other.jumped;
        for (word, told) in self.signals.iter_mut().zip(&other.signals) {
            *word = *told;
        }
    }
}

/// A span in seconds.
#[expect(
    clippy::cast_precision_loss,
    reason = "spans of milliseconds are exact"
)]
const fn seconds(span: Nanos) -> f64 {
    span.0 as f64 * 1e-9
}

/// A position at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetPoint {
    /// When the cycle that made it began on this host's clock, without jitter.
    pub time: Nanos,
    /// Position, rad.
    pub position: f64,
}

/// How many set-points of a joint its driver sees, the newest first. Four bridge a net thread that
/// is late by up to a period, and one set-point that the driver never saw.
pub const SET_POINTS: usize = 4;

/// What nets command to a joint.
#[derive(Clone, Copy, Debug, Default)]
pub struct JointSetPoints {
    /// Whether a net commanded the joint in the last cycle.
    pub active: bool,
    /// Time from one set-point to the next, by the net that gives them.
    pub period: Nanos,
    /// How many of `points` are of the present run of set-points.
    pub count: usize,
    /// The set-points, newest first.
    pub points: [SetPoint; SET_POINTS],
}

impl JointSetPoints {
    /// Adds the set-point of a new cycle, or notes that there is none.
    pub fn advance(&mut self, point: Option<SetPoint>) {
        self.active = point.is_some();
        match point {
            None => self.count = 0,
            Some(point) => {
                self.points.rotate_right(1);
                self.points[0] = point;
                self.count = (self.count + 1).min(SET_POINTS);
            }
        }
    }
}

/// What nets command to a device, handed over once a cycle.
#[derive(Clone, Debug, Default)]
pub struct DeviceCommand {
    /// When the cycle began on this host's clock, without jitter; a driver that sees it stand still
    /// stops the device.
    pub time: Nanos,
    /// Number of the cycle, to which the stamps of commands refer.
    pub cycle: u64,
    /// By joint.
    pub joints: [JointSetPoints; ARM_JOINTS_MAX],
    /// What else is commanded, in the places of its interfaces.
    pub words: Box<[u64]>,
}

impl DeviceCommand {
    /// One that commands nothing, with so many words for what is commanded beside joints.
    #[must_use]
    pub fn new(words: usize) -> Self {
        Self {
            words: vec![0; words].into(),
            ..Self::default()
        }
    }

    /// Becomes like another for the same device, in the memory it has.
    pub fn copy_from(&mut self, other: &Self) {
        (self.time, self.cycle, self.joints) = (other.time, other.cycle, other.joints);
        for (word, told) in self.words.iter_mut().zip(&other.words) {
            *word = *told;
        }
    }
}

/// What is known of an arm before it is in contact.
#[derive(Clone, Debug)]
pub struct ArmDescription {
    /// Name by which nets find it.
    pub name: String,
    /// Device type, such as `kuka_lwr_fri`.
    pub kind: &'static str,
    /// Limits by joint.
    pub limits: Vec<JointLimits>,
    /// Model of its kinematics, as `takt_motion::kinematics` names it; empty for none.
    pub model: Cow<'static, str>,
}

impl ArmDescription {
    /// The arm as a device that offers this beside its joints.
    #[must_use]
    pub fn with(self, parts: &[Part]) -> DeviceDescription {
        DeviceDescription {
            name: self.name,
            kind: self.kind,
            limits: self.limits,
            model: self.model,
            parts: parts.to_vec(),
        }
    }
}

/// What is known of a device before it is in contact.
#[derive(Clone, Debug)]
pub struct DeviceDescription {
    /// Name by which nets find it.
    pub name: String,
    /// Device type, such as `kuka_lwr_fri`.
    pub kind: &'static str,
    /// Limits by joint; empty if it is no arm.
    pub limits: Vec<JointLimits>,
    /// Model of its kinematics, as `takt_motion::kinematics` names it; empty for none.
    pub model: Cow<'static, str>,
    /// What it offers beside joints.
    pub parts: Vec<Part>,
}

/// Where a device lies in the image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Number of its first joint.
    pub first_joint: usize,
    /// How many joints it has.
    pub joints: usize,
    /// The words of what else it tells.
    pub signals: Range<usize>,
    /// The words of what else it is told.
    pub commands: Range<usize>,
}
