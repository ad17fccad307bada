//! Devices: the data that nets and drivers exchange, and which devices a controller has. Drivers
//! are in the modules below; what nets see of a device is in `takt_net::device`.

pub mod lwr;
pub mod setpoint;
pub mod sim;
mod table;

use std::borrow::Cow;
use std::fmt;

use takt_net::{JointLimits, JointState};
use takt_rt::Nanos;

pub use table::{Arm, ArmPorts, DeviceTable};

/// Most joints of one robot arm.
pub const ARM_JOINTS_MAX: usize = 8;

/// Whether a device can be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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

/// What the driver of an arm tells nets.
#[derive(Clone, Copy, Debug, Default)]
pub struct ArmState {
    /// When the measurement arrived.
    pub stamp: Nanos,
    /// Whether the arm follows commands.
    pub status: DeviceStatus,
    /// How often the arm left [`DeviceStatus::Operational`]; a net that commands it ends then.
    pub faults: u64,
    /// Its joints.
    pub joints: [JointState; ARM_JOINTS_MAX],
}

/// A position at a point of logical time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetPoint {
    /// Logical time of the cycle that made it.
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

/// What nets command to an arm, handed over once a cycle.
#[derive(Clone, Copy, Debug, Default)]
pub struct ArmCommand {
    /// Logical time of the cycle; a driver that sees it stand still stops the arm.
    pub time: Nanos,
    /// By joint.
    pub joints: [JointSetPoints; ARM_JOINTS_MAX],
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
