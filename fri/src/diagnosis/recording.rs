//! Measurements and answers out of decoded datagrams, so that a recording is judged as a live connection is. It opens no
//! file.

use super::{Measurement, Observer};
use crate::capture::{Datagram, Decoded};

impl Observer {
    /// For the generation of a recording's first FRI datagram; `None` if it is none.
    #[must_use]
    pub fn of(decoded: &Decoded) -> Option<Self> {
        match decoded {
            Decoded::LwrMeasurement(_) | Decoded::LwrCommand(_) => Some(Self::lwr()),
            Decoded::SunriseMonitoring { .. } | Decoded::SunriseCommand { .. } => {
                Some(Self::sunrise())
            }
            Decoded::Foreign { .. } | Decoded::Refused(_) => None,
        }
    }

    /// Takes a datagram of a recording made at this host: measurements when they come, answers when they leave.
    pub fn handle_datagram(&mut self, datagram: &Datagram) {
        match Decoded::of(&datagram.bytes) {
            Decoded::LwrMeasurement(msr) => {
                self.handle_measurement(Measurement::lwr(datagram.at, &msr));
            }
            Decoded::SunriseMonitoring { message, .. } => {
                self.handle_measurement(Measurement::sunrise(datagram.at, &message));
            }
            Decoded::LwrCommand(cmd) => {
                self.handle_answer(datagram.at, cmd.header.sequence.into());
            }
            Decoded::SunriseCommand { message, .. } => {
                self.handle_answer(datagram.at, message.header.sequence);
            }
            Decoded::Foreign { .. } | Decoded::Refused(_) => {}
        }
    }
}
