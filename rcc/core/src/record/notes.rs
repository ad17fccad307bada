//! What the file of a recording contains besides cycles.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use takt_machine::Program;
use takt_motion::TextError;
use takt_net::JointLimits;
use takt_net::netcomm::Directory;

use crate::cell::CellFrames;
use crate::device::{DeviceDescription, Part, Place};
use crate::error::Error;

pub(super) const CYCLES: &str = "/takt/cycles";
pub(super) const DEVICES: &str = "/takt/devices";
pub(super) const NETS: &str = "/takt/nets";
pub(super) const MACHINES: &str = "/takt/machines";

/// A device of the recorded cell.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct DeviceNote {
    pub(super) name: String,
    pub(super) number: usize,
    first_joint: usize,
    /// From and to.
    signals: [usize; 2],
    /// From and to.
    commands: [usize; 2],
    /// Model of its kinematics: its name, or the chain of its joints.
    model: String,
    /// By joint: minimum and maximum position (rad), speed (rad/s), acceleration (rad/s²).
    limits: Vec<[f64; 4]>,
    parts: Vec<Part>,
    /// An earlier part of the recording has it too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) is_repeated: bool,
}

impl DeviceNote {
    pub(super) fn new(number: usize, place: &Place, device: &DeviceDescription) -> Self {
        let limits = device.limits.iter().map(|l| {
            [
                l.position_min,
                l.position_max,
                l.velocity_max,
                l.acceleration_max,
            ]
        });
        Self {
            name: device.name.clone(),
            number,
            first_joint: place.first_joint,
            signals: [place.signals.start, place.signals.end],
            commands: [place.commands.start, place.commands.end],
            model: device.model.text().into_owned(),
            limits: limits.collect(),
            parts: device.parts.clone(),
            is_repeated: false,
        }
    }

    pub(super) fn place(&self) -> Place {
        Place {
            first_joint: self.first_joint,
            joints: self.limits.len(),
            signals: self.signals[0]..self.signals[1],
            commands: self.commands[0]..self.commands[1],
        }
    }

    /// # Errors
    /// If its model cannot be read.
    pub(super) fn description(&self) -> Result<DeviceDescription, TextError> {
        let model = self.model.parse()?;
        let limits = |l: &[f64; 4]| JointLimits {
            position_min: l[0],
            position_max: l[1],
            velocity_max: l[2],
            acceleration_max: l[3],
        };
        Ok(DeviceDescription {
            name: self.name.clone(),
            kind: "",
            limits: self.limits.iter().map(limits).collect(),
            model,
            parts: self.parts.clone(),
        })
    }
}

/// Addition or removal of a device.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum DeviceEvent {
    Came(DeviceNote),
    Went { name: String },
}

/// A net of the recording.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct NetNote {
    pub(super) id: u32,
    /// Its period in cycles of its thread.
    pub(super) every: u64,
    pub(super) period_ns: u64,
    pub(super) text: String,
    /// An earlier part of the recording has it too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) is_repeated: bool,
}

impl NetNote {
    pub(super) const fn period(&self) -> Duration {
        Duration::from_nanos(self.period_ns)
    }
}

/// A machine of the recording.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct MachineNote {
    pub(super) id: u32,
    pub(super) text: String,
    /// Component files by name.
    pub(super) files: Vec<(String, String)>,
    /// An earlier part of the recording has it too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) is_repeated: bool,
}

/// Version of what a replay reads, in the metadata of its channels.
pub(super) const FORMAT: &str = "6";
/// Notes for the file besides cycles.
#[derive(Clone, Debug)]
pub(super) enum Note {
    Device {
        number: usize,
        place: Place,
        description: DeviceDescription,
    },
    Gone(String),
    Net {
        id: u32,
        every: u64,
        period: Duration,
        text: Arc<str>,
        values: Arc<Directory>,
    },
    Frames(CellFrames),
    Log {
        level: u8,
        name: String,
        text: String,
    },
    Machine {
        id: u32,
        text: Arc<str>,
        files: Vec<(String, String)>,
        program: Arc<Program>,
    },
}

pub(super) fn wrong(path: &Path, why: String) -> Error {
    Error::Recording {
        path: path.to_owned(),
        why,
    }
}

/// Level of a warning in `rcl_interfaces/msg/Log`.
pub(super) const LEVEL_WARN: u8 = 30;
