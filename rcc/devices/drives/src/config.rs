//! Cell file configuration of arms of drives, for the drivers of any bus.

use serde::{Deserialize, Deserializer};
use takt_cia402::{MasterOptions, Quirk, UnknownQuirk};
use takt_motion::Model;
use takt_motion::dynamics::{Body, Down, Payload};
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
    /// Feed-forward torque by the masses of its URDF (60B2h): the largest share of each joint's effort; 0 for none.
    pub feed_forward: f64,
    /// Direction of gravity in its base.
    pub down: Down,
    /// What it carries at its flange, beside its tools.
    pub payload: Payload,
    /// Its tools, in the frame of its flange.
    pub tools: Body,
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
    #[serde(default, deserialize_with = "share")]
    feed_forward: f64,
    #[serde(default)]
    down: Down,
    #[serde(default)]
    payload: Payload,
    #[serde(rename = "joint")]
    joints: Vec<DriveJoint<D>>,
}

fn share<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let share = f64::deserialize(from)?;
    if (0.0..=1.0).contains(&share) {
        return Ok(share);
    }
    Err(serde::de::Error::custom(format!(
        "a share of {share}; it must be 0 for none to 1 for the whole effort of each joint"
    )))
}

impl<D> TryFrom<Given<D>> for DriveArm<D> {
    type Error = String;

    /// Limits that the table leaves out are those of the file of its model.
    fn try_from(given: Given<D>) -> Result<Self, String> {
        let Given {
            name,
            model,
            recovery,
            feed_forward,
            down,
            payload,
            mut joints,
        } = given;
        for (number, joint) in joints.iter_mut().enumerate() {
            let of_file = model.arm().and_then(|arm| arm.joints.get(number));
            let missing = joint.complete(of_file);
            missing.map_err(|key| format!("arm {name}: joint {number}: missing field `{key}`"))?;
        }
        let arm = Self {
            name,
            model,
            recovery,
            feed_forward,
            down,
            payload,
            tools: Body::default(),
            joints,
        };
        arm.check_torques()?;
        Ok(arm)
    }
}

impl<D> DriveArm<D> {
    /// Tools and payload, in the frame of the flange.
    #[must_use]
    pub fn load(&self) -> Body {
        self.tools.with(&self.payload.body())
    }

    /// Adds a tool, in the frame of the flange, if it is of this arm.
    pub fn carry(&mut self, device: &str, tool: &Body) {
        if self.name == device {
            self.tools = self.tools.with(tool);
        }
    }

    /// Checks what feed-forward needs.
    fn check_torques(&self) -> Result<(), String> {
        let name = &self.name;
        for (number, joint) in self.joints.iter().enumerate() {
            let sound = |rated: f64| (1e-6..=1e9).contains(&rated);
            if let Some(rated) = joint.rated_torque.filter(|rated| !sound(*rated)) {
                return Err(format!(
                    "arm {name}: joint {number}: `rated_torque` is {rated}; it must be above 0, Nm at the joint"
                ));
            }
        }
        if self.feed_forward <= 0.0 {
            return Ok(());
        }
        let Some(of_file) = self.model.arm() else {
            return Err(format!(
                "arm {name}: `feed_forward` needs the masses of a URDF\nhint: `model = \"urdf:FILE\"`"
            ));
        };
        let file = &of_file.file;
        if of_file.dynamics.is_none() {
            let mut joints = of_file.joints.iter();
            let (joint, line) = joints
                .find(|joint| joint.body.mass <= 0.0)
                .map_or(("", 0), |joint| (&*joint.name, joint.line));
            return Err(format!(
                "arm {name}: `feed_forward` needs masses, but {file}:{line} gives none behind joint `{joint}`"
            ));
        }
        for (number, joint) in self.joints.iter().enumerate() {
            if joint.rated_torque.is_none() {
                return Err(format!(
                    "arm {name}: joint {number}: `feed_forward` needs `rated_torque`\nhint: rated torque of the motor \
                     (6076h) times gear ratio and efficiency, Nm"
                ));
            }
            let of_file = of_file.joints.get(number);
            if let Some(joint) = of_file.filter(|joint| joint.effort_max.is_none_or(|it| it <= 0.0))
            {
                let (joint, line) = (&joint.name, joint.line);
                return Err(format!(
                    "arm {name}: joint {number}: `feed_forward` is a share of its effort, but {file}:{line} gives none for \
                     `{joint}`"
                ));
            }
        }
        Ok(())
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
    /// Torque at the joint at the rated torque of its motor (6076h), gear ratio and efficiency included, Nm; with it torques are
    /// measured (6077h) and may be fed forward. `None` for neither.
    #[serde(default)]
    pub rated_torque: Option<f64>,
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
