//! Feeds the observer with recorded datagrams, so that a recording gets the same verdict as a live connection. It opens
//! no file.

use super::{Measurement, Observer};
use crate::capture::{Datagram, Decoded};

impl Observer {
    /// An observer for the generation of the first FRI datagram; `None` if `decoded` is no FRI datagram.
    pub fn of(decoded: &Decoded) -> Option<Self> {
        match decoded {
            Decoded::LwrMeasurement(_) | Decoded::LwrCommand(_) => Some(Self::lwr()),
            Decoded::SunriseMonitoring { .. } | Decoded::SunriseCommand { .. } => {
                Some(Self::sunrise())
            }
            Decoded::Foreign { .. } | Decoded::Refused(_) => None,
        }
    }

    /// Counts a datagram recorded at this host: measurements on arrival, answers on departure.
    pub fn handle_datagram(&mut self, datagram: &Datagram) {
        match Decoded::of(&datagram.bytes) {
            Decoded::LwrMeasurement(msr) => {
                self.handle_measurement(Measurement::lwr(datagram.at, &msr));
            }
            Decoded::SunriseMonitoring { message, .. } => {
                self.handle_measurement(Measurement::sunrise(datagram.at, &message));
            }
            Decoded::LwrCommand(cmd) => {
                let header = cmd.header;
                self.handle_answer_to(header.reflected.into(), datagram.at, header.sequence.into());
            }
            Decoded::SunriseCommand { message, .. } => {
                let header = message.header;
                self.handle_answer_to(header.reflected, datagram.at, header.sequence);
            }
            Decoded::Foreign { .. } | Decoded::Refused(_) => {}
        }
    }
}
