//! Simulated devices that programs make while the controller runs. The net thread steps them
//! itself, so they need no thread, no wire and no clock. They simulate what nets see, no physics
//! beyond what each file says.

mod arm;
mod base;
mod compliance;
mod gripper;
mod io;
mod parameters;

use std::collections::BTreeMap;
use std::fmt;

use takt_rt::Nanos;

use crate::device::{DeviceCommand, DeviceDescription, DeviceState};
use crate::error::Error;
use parameters::Parameters;

/// A device that a net thread steps.
pub trait Simulated: fmt::Debug + Send {
    /// One cycle, `dt` after the last: follows what nets command.
    fn step(&mut self, command: &DeviceCommand, dt: Nanos);

    /// How it is.
    fn state(&self) -> &DeviceState;
}

type Made = (DeviceDescription, Box<dyn Simulated>);
type Make = fn(&Parameters<'_>, &'static str) -> Result<Made, Error>;

/// What can be made.
const KINDS: [(&str, Make); 6] = [
    ("kuka_lwr_sim", arm::lwr),
    ("kuka_iiwa_sim", arm::iiwa),
    ("kuka_youbot_arm_sim", arm::youbot),
    ("kuka_youbot_base_sim", base::youbot),
    ("kuka_youbot_gripper_sim", gripper::youbot),
    ("io_sim", io::looped),
];

/// The types of devices that can be made while the controller runs.
#[must_use]
pub fn kinds() -> Vec<&'static str> {
    KINDS.iter().map(|(kind, _)| *kind).collect()
}

/// Makes a simulated device of one of [`kinds`]. Parameters that it does not know are ignored: known
/// clients send the same to real devices.
///
/// # Errors
/// If there is no such type, or a parameter is missing, unreadable or out of range.
pub fn make(name: &str, kind: &str, parameters: &BTreeMap<String, String>) -> Result<Made, Error> {
    let parameters = Parameters {
        name,
        texts: parameters,
    };
    let Some((kind, make)) = KINDS.iter().find(|(known, _)| *known == kind) else {
        let known = kinds().join(", ");
        let what = format!("there is no type `{kind}`; there are {known}");
        return Err(parameters.wrong(what));
    };
    make(&parameters, kind)
}

/// A span in seconds.
#[expect(
    clippy::cast_precision_loss,
    reason = "spans of milliseconds are exact"
)]
const fn seconds(span: Nanos) -> f64 {
    span.0 as f64 * 1e-9
}
