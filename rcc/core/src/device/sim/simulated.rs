//! What every simulated device is to the net thread that steps it.

use std::fmt;

use takt_rt::Nanos;

use crate::device::{DeviceCommand, DeviceDescription, DeviceState};

/// A device that a net thread steps.
pub trait Simulated: fmt::Debug + Send {
    /// One cycle, `dt` after the last: follows the commands of nets.
    fn step(&mut self, command: &DeviceCommand, dt: Nanos);

    /// Applies a withdrawal of commands after [`Self::step`] in the same cycle. Motion reacts in the next.
    fn retract(&mut self, _command: &DeviceCommand) {}

    /// Its state.
    fn state(&self) -> &DeviceState;
}

/// A simulated device with its description.
pub type Made = (DeviceDescription, Box<dyn Simulated>);

/// A span in seconds.
#[expect(
    clippy::cast_precision_loss,
    reason = "spans of milliseconds are exact"
)]
pub(super) const fn seconds(span: Nanos) -> f64 {
    span.0 as f64 * 1e-9
}
