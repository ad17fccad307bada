//! The system specification: the robots, their limits and defaults, and the signals that a program can use. It is read
//! from TOML or XML (`.spc`). Devices of a cell are bound to it by the net, not here.

mod channel;
mod xml;

use std::path::Path;

use serde::Deserialize;
use takt_motion::Model;

pub use channel::Channel;
pub(crate) use channel::is_device;

/// Most robots of a system.
pub(crate) const ROBOTS_MAX: usize = 8;
/// Most joints of a robot.
pub(crate) const JOINTS_MAX: usize = 7;
/// Most signals of a system.
pub(crate) const SIGNALS_MAX: usize = 256;
/// Most bits of a binary signal with a width: its values are whole numbers from 0.
pub(crate) const BITS_MAX: u8 = 31;

/// A joint of a robot, in degrees.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Joint {
    /// Lowest position, deg.
    pub min: f64,
    /// Highest position, deg.
    pub max: f64,
    /// Largest speed, deg/s.
    pub speed: f64,
    /// Largest acceleration, deg/s².
    pub acceleration: f64,
    /// Largest jerk, deg/s³.
    pub jerk: f64,
}

/// A robot.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Its name, as `act_rob` and its record use it.
    pub name: String,
    /// Model of its kinematics, by name or from a URDF; empty if it moves its joints only.
    #[serde(default)]
    pub model: Model,
    /// Its joints, 1 to 7.
    pub joints: Vec<Joint>,
    /// Default of `speed`, mm/s.
    #[serde(default = "speed")]
    pub speed: f64,
    /// Default of `acc`, mm/s².
    #[serde(default = "acceleration")]
    pub acceleration: f64,
    /// Jerk of a tool on a line or an arc, mm/s³.
    #[serde(default = "jerk")]
    pub jerk: f64,
    /// Default of `speed_ori`, deg/s.
    #[serde(default = "speed_ori")]
    pub speed_ori: f64,
    /// Default of `speed_ptp`, part of the largest speed of each joint, 0 to 1.
    #[serde(default = "part")]
    pub speed_ptp: f64,
    /// Default of `acc_ptp`, part of the largest acceleration of each joint, 0 to 1.
    #[serde(default = "part")]
    pub acc_ptp: f64,
    /// Frame of its base in the world: x, y, z (mm), rotation about z, then y, then x (deg).
    #[serde(default)]
    pub base: [f64; 6],
    /// Frame of its tool at the flange, as `base`.
    #[serde(default)]
    pub tool: [f64; 6],
    /// Position at which a simulation begins, deg; zeros if empty.
    #[serde(default)]
    pub home: Vec<f64>,
}

const fn speed() -> f64 {
    250.0
}
const fn acceleration() -> f64 {
    1000.0
}
const fn jerk() -> f64 {
    10_000.0
}
const fn speed_ori() -> f64 {
    90.0
}
const fn part() -> f64 {
    0.2
}

/// What values a signal has.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
#[repr(u8)]
pub enum SignalKind {
    /// On or off.
    Digital = 0,
    /// A real number.
    Analog = 1,
    /// A whole number of several bits.
    Binary = 2,
}

/// Whether the program reads or writes a signal.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
#[repr(u8)]
pub enum Direction {
    /// The program reads it.
    In = 0,
    /// The program writes it.
    Out = 1,
}

/// A signal.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct Signal {
    /// Its name.
    pub name: String,
    /// Read or written.
    pub direction: Direction,
    /// Its values.
    pub kind: SignalKind,
    /// Index in the port of its direction and kind, from 0.
    pub channel: u16,
    /// Width of a binary signal, 1 to 31: its values are 0 to 2^bits - 1. 0 is any whole number, which no device can have.
    #[serde(default)]
    pub bits: u8,
    /// Input or output of a device that has it; that of the lowest bit if it is binary. A controller can be given another one.
    #[serde(default)]
    pub io: Option<Channel>,
}

impl Signal {
    /// Inputs or outputs of a device that it takes.
    #[must_use]
    pub fn width(&self) -> u16 {
        self.bits.max(1).into()
    }

    fn check(&self) -> Result<(), String> {
        let is_binary = self.kind == SignalKind::Binary;
        if self.bits > if is_binary { BITS_MAX } else { 0 } {
            let bits = self.bits;
            return Err(format!(
                "bits is {bits}; binary signals have 1 to {BITS_MAX}, others none"
            ));
        }
        if usize::from(self.channel) >= SIGNALS_MAX {
            let (channel, last) = (self.channel, SIGNALS_MAX - 1);
            return Err(format!("channel {channel}; channels are 0 to {last}"));
        }
        match &self.io {
            Some(io) if is_binary && self.bits == 0 => Err(format!(
                "{io} is digital; give the signal its `bits`, 1 to {BITS_MAX}"
            )),
            Some(io) if io.port.checked_add(self.width()).is_none() => {
                Err(format!("{io} leaves no ports for its bits"))
            }
            _ => Ok(()),
        }
    }
}

/// The robots and signals that a program can use.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct System {
    /// The robots.
    #[serde(default, rename = "robot")]
    pub robots: Vec<Robot>,
    /// The signals.
    #[serde(default, rename = "signal")]
    pub signals: Vec<Signal>,
}

/// Why a system specification is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// It is neither TOML nor XML of this form; the text has the location.
    #[error("{0}")]
    Form(String),
    /// A value is out of range or given twice.
    #[error("{0}")]
    Value(String),
}

impl System {
    /// Reads a specification: TOML, or XML if it begins with `<`.
    ///
    /// # Errors
    /// If it is not one; all values are checked.
    pub fn parse(text: &str) -> Result<Self, SpecError> {
        Self::parse_in(text, None)
    }

    /// As [`Self::parse`], for a text from a file in this folder: models from URDFs, `urdf:arm.urdf`, are read there.
    ///
    /// # Errors
    /// As [`Self::parse`], and if a URDF describes no arm that can be used.
    pub fn read_in(text: &str, folder: &Path) -> Result<Self, SpecError> {
        Self::parse_in(text, Some(folder))
    }

    fn parse_in(text: &str, folder: Option<&Path>) -> Result<Self, SpecError> {
        if text.len() > crate::parse::TEXT_MAX {
            return Err(SpecError::Form("the text is larger than 1 MiB".to_owned()));
        }
        let mut system: Self = if xml::is_xml(text) {
            let table = xml::read(text).map_err(SpecError::Form)?;
            let system = toml::Value::Table(table).try_into();
            system.map_err(|error| SpecError::Form(error.to_string().trim_end().to_owned()))?
        } else {
            toml::from_str(text).map_err(|error| SpecError::Form(error.to_string()))?
        };
        for robot in &mut system.robots {
            robot.name = robot.name.to_ascii_lowercase();
            if let Some(folder) = folder {
                let model = std::mem::take(&mut robot.model).read(folder);
                robot.model = model.map_err(|error| SpecError::Value(error.to_string()))?;
            }
        }
        for signal in &mut system.signals {
            signal.name = signal.name.to_ascii_lowercase();
        }
        system.check().map_err(SpecError::Value)?;
        Ok(system)
    }

    pub(crate) fn check(&self) -> Result<(), String> {
        bounded("robots", self.robots.len(), ROBOTS_MAX)?;
        bounded("signals", self.signals.len(), SIGNALS_MAX)?;
        for (i, robot) in self.robots.iter().enumerate() {
            check_name("robot", &robot.name)?;
            if self.robots.iter().skip(i + 1).any(|r| r.name == robot.name) {
                return Err(format!("robot `{}` is given twice", robot.name));
            }
            robot
                .check()
                .map_err(|why| format!("robot `{}`: {why}", robot.name))?;
        }
        for (i, signal) in self.signals.iter().enumerate() {
            check_name("signal", &signal.name)?;
            let twin = |other: &&Signal| {
                other.name == signal.name
                    || (other.direction, other.kind as u8, other.channel)
                        == (signal.direction, signal.kind as u8, signal.channel)
            };
            if let Some(twin) = self.signals.iter().skip(i + 1).find(twin) {
                let (name, other) = (&signal.name, &twin.name);
                return Err(format!(
                    "signals `{name}` and `{other}` have the same name or the same channel"
                ));
            }
            let name = &signal.name;
            signal
                .check()
                .map_err(|why| format!("signal `{name}`: {why}"))?;
        }
        Ok(())
    }
}

fn bounded(what: &str, found: usize, bound: usize) -> Result<(), String> {
    if found > bound {
        return Err(format!("{found} {what}; at most {bound} are allowed"));
    }
    Ok(())
}

fn check_name(what: &str, name: &str) -> Result<(), String> {
    let mut letters = name.chars();
    let begins = letters
        .next()
        .is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
    if !begins || !letters.all(|c| c.is_ascii_alphanumeric() || c == '_') || name.len() > 64 {
        return Err(format!(
            "{what} `{}`: a name has up to 64 letters, digits and `_`, and begins with a letter",
            name.escape_debug()
        ));
    }
    if crate::token::RESERVED.contains(&name) {
        return Err(format!("{what} `{name}`: this is a word of the language"));
    }
    Ok(())
}

impl Robot {
    fn check(&self) -> Result<(), String> {
        if !(1..=JOINTS_MAX).contains(&self.joints.len()) {
            return Err(format!(
                "{} joints; 1 to {JOINTS_MAX} are allowed",
                self.joints.len()
            ));
        }
        for (number, joint) in (1..).zip(&self.joints) {
            if !(joint.min < joint.max && joint.min >= -3600.0 && joint.max <= 3600.0) {
                return Err(format!(
                    "joint {number}: min must be below max, both within ±3600 deg"
                ));
            }
            for value in [joint.speed, joint.acceleration, joint.jerk] {
                within(&format!("joint {number}: a limit"), value, 1e-3, 1e6)?;
            }
        }
        for (name, value) in [
            ("speed", self.speed),
            ("acceleration", self.acceleration),
            ("jerk", self.jerk),
            ("speed_ori", self.speed_ori),
        ] {
            within(name, value, 1e-3, 1e6)?;
        }
        within("speed_ptp", self.speed_ptp, 1e-3, 1.0)?;
        within("acc_ptp", self.acc_ptp, 1e-3, 1.0)?;
        for value in self.base.iter().chain(&self.tool) {
            within("a component of base or tool", *value, -1e6, 1e6)?;
        }
        if !self.home.is_empty() && self.home.len() != self.joints.len() {
            return Err("home needs one position for each joint".to_owned());
        }
        for (home, joint) in self.home.iter().zip(&self.joints) {
            within("home", *home, joint.min, joint.max)?;
        }
        if self.model.is_empty() {
            return Ok(());
        }
        match self.model.unlimited() {
            None => Err(format!(
                "there is no model `{}`",
                self.model.name().escape_debug()
            )),
            Some(arm) if arm.joints() != self.joints.len() => Err(format!(
                "model `{}` has {} joints, the specification {}",
                self.model,
                arm.joints(),
                self.joints.len()
            )),
            Some(_) => Ok(()),
        }
    }
}

fn within(name: &str, value: f64, least: f64, most: f64) -> Result<(), String> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(format!(
        "{name} is {value}; it must be between {least} and {most}"
    ))
}
