//! Devices: the data that nets and drivers exchange, which devices a controller has, and the parts that drivers share.
//! Drivers are crates of their own; what nets see of a device is in `takt_net::device`.

pub mod bus;
pub mod continuity;
pub mod driver;
pub mod endpoint;
pub mod homing;
pub mod last_stage;
pub mod link_watch;
pub mod on_end;
pub mod parts;
pub mod rejected;
pub mod setpoint;
pub mod sim;
mod surroundings;
mod table;

use std::fmt;
use std::ops::Range;

use takt_motion::Model;
use takt_net::device::Base;
use takt_net::{Image, JointLimits, JointState, Twist};
use takt_rt::Nanos;

use continuity::Jumped;
use last_stage::Limited;
pub use parts::{Figure, Part};
use rejected::Rejected;
pub(crate) use surroundings::Surroundings;
pub use table::{Device, DevicePorts, DeviceTable};

/// Bounds for positive parameters, such as the speed of a joint; beyond them, products with the cycle time would be
/// zero or infinite.
pub const LEAST: f64 = 1e-6;
/// The upper bound of [`LEAST`].
pub const MOST: f64 = 1e9;

/// Most joints of one robot arm.
pub const ARM_JOINTS_MAX: usize = 8;

/// A joint or base counts as at rest below this commanded velocity, rad/s and m/s.
const RESTS_COMMANDED: f64 = 1e-3;
/// A base counts as at rest below this measured velocity, m/s and rad/s: a few increments of its wheels.
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
    /// Its name on the wire.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Offline => "off",
            Self::SafeOperational => "safeop",
            Self::Operational => "op",
        }
    }

    /// Status during an emergency stop, if one is active.
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

/// State of a device, as its driver reports it to nets.
#[derive(Clone, Debug, Default)]
pub struct DeviceState {
    /// When the measurement arrived.
    pub stamp: Nanos,
    /// Whether the device follows commands.
    pub status: DeviceStatus,
    /// Number of times it left [`DeviceStatus::Operational`]; nets that command it end then.
    pub faults: u64,
    /// Its joints.
    pub joints: [JointState; ARM_JOINTS_MAX],
    /// What the last stages of its driver limited: by joint, or of a base along the floor and turning.
    pub limited: [Limited; ARM_JOINTS_MAX],
    /// Set-points that its driver rejected, by the same parts.
    pub rejected: [Rejected; ARM_JOINTS_MAX],
    /// Position jumps; nets that were scheduled before a jump are returned.
    pub jumped: Jumped,
    /// Further values, in the words of its interfaces.
    pub signals: Box<[u64]>,
}

impl DeviceState {
    /// An offline state with `signals` words for values besides joints.
    #[must_use]
    pub fn new(signals: usize) -> Self {
        Self {
            signals: vec![0; signals].into(),
            ..Self::default()
        }
    }

    /// Writes it to the image, to the slots of its device.
    pub fn show(&self, place: &Place, image: &Image) {
        let joints = image.joints.iter().skip(place.first_joint);
        for (joint, reported) in joints.take(place.joints).zip(&self.joints) {
            joint.state.set(*reported);
        }
        let cells = image.signals.get(place.signals.clone());
        for (cell, word) in cells.into_iter().flatten().zip(&self.signals) {
            cell.set(*word);
        }
    }

    /// Sets status and stamp; leaving [`DeviceStatus::Operational`] counts as a fault.
    pub fn enter(&mut self, status: DeviceStatus, stamp: Nanos) {
        let left = self.status == DeviceStatus::Operational && status != self.status;
        self.faults += u64::from(left);
        (self.status, self.stamp) = (status, stamp);
    }

    /// As [`Self::enter`], where leaving [`DeviceStatus::Operational`] is no fault: the device does what it was requested to.
    pub const fn retire(&mut self, status: DeviceStatus, stamp: Nanos) {
        (self.status, self.stamp) = (status, stamp);
    }

    /// Whether nothing moves: no joint and no base is commanded to move, and the base does not measure motion.
    /// Measured joint velocities are not checked: their noise never ends. An offline device counts as at rest,
    /// because waiting for it would be pointless. `base` is where a base lies in [`Self::signals`].
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

    /// Copies another state of the same device without allocating.
    pub fn copy_from(&mut self, other: &Self) {
        (self.stamp, self.status, self.faults) = (other.stamp, other.status, other.faults);
        (self.joints, self.limited) = (other.joints, other.limited);
        (self.rejected, self.jumped) = (other.rejected, other.jumped);
        for (word, reported) in self.signals.iter_mut().zip(&other.signals) {
            *word = *reported;
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
    /// Start of the cycle that computed it, on this host's clock, without jitter.
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
    /// Number of `points` that belong to the current run of set-points.
    pub count: usize,
    /// The set-points, newest first.
    pub points: [SetPoint; SET_POINTS],
}

impl JointSetPoints {
    /// Appends the set-point of a new cycle; `None` ends the run.
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

/// What nets command to a device, transferred once per cycle.
#[derive(Clone, Debug, Default)]
pub struct DeviceCommand {
    /// Start of the cycle on this host's clock, without jitter; if it stops advancing, the driver stops the device.
    pub time: Nanos,
    /// Number of the cycle, to which the stamps of commands refer.
    pub cycle: u64,
    /// By joint.
    pub joints: [JointSetPoints; ARM_JOINTS_MAX],
    /// Further commands, in the words of its interfaces.
    pub words: Box<[u64]>,
}

impl DeviceCommand {
    /// An empty command with `words` words for commands besides joints.
    #[must_use]
    pub fn new(words: usize) -> Self {
        Self {
            words: vec![0; words].into(),
            ..Self::default()
        }
    }

    /// Copies another command for the same device without allocating.
    pub fn copy_from(&mut self, other: &Self) {
        (self.time, self.cycle, self.joints) = (other.time, other.cycle, other.joints);
        for (word, reported) in self.words.iter_mut().zip(&other.words) {
            *word = *reported;
        }
    }
}

/// Description of an arm, known before contact.
#[derive(Clone, Debug)]
pub struct ArmDescription {
    /// Name by which nets find it.
    pub name: String,
    /// Device type, such as `kuka_lwr_fri`.
    pub kind: &'static str,
    /// Limits by joint.
    pub limits: Vec<JointLimits>,
    /// Model of its kinematics; empty for none.
    pub model: Model,
}

impl ArmDescription {
    /// The arm as a device with these parts besides its joints.
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

/// Description of a device, known before contact.
#[derive(Clone, Debug)]
pub struct DeviceDescription {
    /// Name by which nets find it.
    pub name: String,
    /// Device type, such as `kuka_lwr_fri`.
    pub kind: &'static str,
    /// Limits by joint; empty if it is no arm.
    pub limits: Vec<JointLimits>,
    /// Model of its kinematics; empty for none.
    pub model: Model,
    /// Parts besides joints.
    pub parts: Vec<Part>,
}

/// Where a device lies in the image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Number of its first joint.
    pub first_joint: usize,
    /// How many joints it has.
    pub joints: usize,
    /// Signal words that it reports besides joints.
    pub signals: Range<usize>,
    /// Command words besides joints.
    pub commands: Range<usize>,
}
