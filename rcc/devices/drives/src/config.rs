//! Cell file configuration of arms of drives, for the drivers of any bus.

use serde::{Deserialize, Deserializer};
use takt_cia402::{MasterOptions, Quirk, UnknownQuirk};

/// Recovery of a device after a fault, once its drives can follow commands again. In each case, nothing moves before
/// a program requests it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Recovery {
    /// Faults are reset, drives are enabled, and commutation and stops are searched as far as allowed.
    #[default]
    Automatic,
    /// It brakes and gets no commands until its driver restarts with the controller.
    OnRestart,
}

/// A robot arm made of drives, named as on their bus.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveArm<D> {
    /// Name by which nets find it.
    pub name: String,
    /// Kinematics model, such as `staubli_tx90`; empty for none.
    #[serde(default)]
    pub model: String,
    /// Recovery after a fault.
    #[serde(default)]
    pub recovery: Recovery,
    /// Its joints, from the base.
    #[serde(rename = "joint")]
    pub joints: Vec<DriveJoint<D>>,
}

/// A joint moved by an axis of a drive.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveJoint<D> {
    /// The drive: name of the EtherCAT slave, or number of the CANopen node.
    #[serde(alias = "slave", alias = "node")]
    pub drive: D,
    /// Axis of the drive, from 0.
    #[serde(default)]
    pub axis: u8,
    /// Increments of the drive per turn of the joint, including gear; negative for the opposite direction.
    pub increments_per_turn: f64,
    /// Increments at joint zero.
    #[serde(default)]
    pub zero: f64,
    /// Range of the joint, degrees.
    pub range: [f64; 2],
    /// Largest speed, degrees per second.
    pub velocity_max: f64,
    /// Largest acceleration, degrees per second squared.
    pub acceleration_max: f64,
    /// Largest following error, degrees of the joint, before power is removed, independent of 6065h; `None` for the
    /// motion in a tenth of a second at its largest speed, but not less than one degree.
    #[serde(default)]
    pub following_error_max: Option<f64>,
    /// Objects, by their index on the first axis, whose SDO upload does not mirror the PDO values, according to the
    /// drive's manual. They are excluded from the comparison before power-on; every other mapped object of the axis
    /// is compared.
    #[serde(default)]
    pub not_mirrored: Vec<u16>,
    /// Deviations of the drive from CiA 402, by its manual or by the text of its faults: `no_follow_bit`,
    /// `sod_as_0020`, `mode_after_enable`.
    #[serde(default, deserialize_with = "quirks")]
    pub quirks: Vec<Quirk>,
}

/// Deserializes quirks by name.
fn quirks<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Quirk>, D::Error> {
    let names = Vec::<String>::deserialize(deserializer)?;
    let quirks = names.iter().map(|name| name.parse());
    quirks
        .collect::<Result<_, UnknownQuirk>>()
        .map_err(serde::de::Error::custom)
}

impl<D> DriveJoint<D> {
    /// Largest following error, degrees of the joint.
    #[must_use]
    pub fn following_error(&self) -> f64 {
        let usual = (self.velocity_max * FOLLOWING_TIME_S).max(FOLLOWING_MIN);
        self.following_error_max.unwrap_or(usual)
    }

    /// Timeouts of its drive, adapted to its quirks.
    #[must_use]
    pub fn master_options(&self) -> MasterOptions {
        MasterOptions::default().with_quirks(&self.quirks)
    }
}

/// Default following error: motion in this time at the largest speed, s, but at least one degree.
const FOLLOWING_TIME_S: f64 = 0.1;
const FOLLOWING_MIN: f64 = 1.0;
