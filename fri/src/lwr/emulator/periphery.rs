//! The hook for devices at the user variables of the robot program, such as tools in a world that several emulators share. No
//! device is here.

use crate::lwr::wire::Krl;
use std::fmt;
use std::time::Duration;

/// Devices at the user variables of the robot program.
pub trait Periphery: Send + fmt::Debug {
    /// Once per cycle, with the time on the clock of the controller's owner: `$FRI_FRM_...` as the client wrote them, and
    /// `$FRI_TO_...`, to be written where a device reports. Integers belong to the robot program.
    fn exchange(&mut self, at: Duration, from_client: &Krl, to_client: &mut Krl);
}
