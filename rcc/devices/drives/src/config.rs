//! Cell file configuration of arms of drives, for the drivers of any bus.

use serde::{Deserialize, Deserializer};
use takt_cia402::{MasterOptions, Quirk, UnknownQuirk};
use takt_motion::Model;
use takt_motion::urdf::ArmJoint;

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
#[serde(try_from = "Given<D>", bound(deserialize = "D: Deserialize<'de>"))]
pub struct DriveArm<D> {
    /// Name by which nets find it.
    pub name: String,
    /// Kinematics model, such as `staubli_tx90`; empty for none.
    pub model: Model,
    /// Recovery after a fault.
    pub recovery: Recovery,
    /// Its joints, from the base.
    pub joints: Vec<DriveJoint<D>>,
}

/// An arm as its table gives it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Given<D> {
    name: String,
    #[serde(default)]
    model: Model,
    #[serde(default)]
    recovery: Recovery,
    #[serde(rename = "joint")]
    joints: Vec<DriveJoint<D>>,
}

impl<D> TryFrom<Given<D>> for DriveArm<D> {
    type Error = String;

    /// Limits that the table leaves out are those of the file of its model.
    fn try_from(given: Given<D>) -> Result<Self, String> {
        let Given {
            name,
            model,
            recovery,
            mut joints,
        } = given;
        for (number, joint) in joints.iter_mut().enumerate() {
            let of_file = model.arm().and_then(|arm| arm.joints.get(number));
            let missing = joint.complete(of_file);
            missing.map_err(|key| format!("arm {name}: joint {number}: missing field `{key}`"))?;
        }
        Ok(Self {
            name,
            model,
            recovery,
            joints,
        })
    }
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
    /// Range of the joint, degrees; within that of the model's file, and that if left out.
    #[serde(default = "DriveJoint::<()>::no_range")]
    pub range: [f64; 2],
    /// Largest speed, degrees per second; at most that of the model's file, and that if left out.
    #[serde(default = "DriveJoint::<()>::not_given")]
    pub velocity_max: f64,
    /// Largest acceleration, degrees per second squared; for an arm with a file its speed within 0.25 s if left out.
    #[serde(default = "DriveJoint::<()>::not_given")]
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
    const fn not_given() -> f64 {
        f64::NAN
    }

    const fn no_range() -> [f64; 2] {
        [f64::NAN; 2]
    }

    /// Takes what is not given from the joint of a file; the key of what is missing there too.
    fn complete(&mut self, of_file: Option<&ArmJoint>) -> Result<(), &'static str> {
        let is_given = |value: f64| !value.is_nan();
        if !self.range.into_iter().all(is_given) {
            let range = of_file.map(|joint| [joint.range.min, joint.range.max]);
            let range = range.filter(|it| it.iter().all(|end| end.is_finite()));
            self.range = range.ok_or("range")?.map(f64::to_degrees);
        }
        if !is_given(self.velocity_max) {
            let velocity = of_file.and_then(|joint| joint.velocity_max);
            self.velocity_max = velocity.ok_or("velocity_max")?.to_degrees();
        }
        if !is_given(self.acceleration_max) {
            of_file.ok_or("acceleration_max")?;
            self.acceleration_max = self.velocity_max * ACCELERATION_PER_S;
        }
        Ok(())
    }

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

/// Acceleration to velocity of a joint of a file without a given acceleration, 1/s.
const ACCELERATION_PER_S: f64 = 4.0;
/// Default following error: motion in this time at the largest speed, s, but at least one degree.
const FOLLOWING_TIME_S: f64 = 0.1;
const FOLLOWING_MIN: f64 = 1.0;
