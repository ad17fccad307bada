//! The kinds of datagrams, as errors state them. Their identification is in the parent module.

use std::fmt;

/// Kind of a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Measurement of FRI 1.0, controller to PC.
    LwrMeasurement,
    /// Command of FRI 1.0, PC to controller.
    LwrCommand,
    /// Monitoring message of Sunrise, controller to client; whether in the frame of 2.7.
    SunriseMonitoring {
        /// Whether length and checksum surround the message.
        is_framed: bool,
    },
    /// Command message of Sunrise, client to controller; whether in the frame of 2.7.
    SunriseCommand {
        /// Whether length and checksum surround the message.
        is_framed: bool,
    },
    /// No FRI datagram.
    Unknown,
}

impl Kind {
    /// Remedy when this kind arrives where `expected` was due.
    pub(crate) fn remedy(self, expected: Self) -> &'static str {
        let expects_controller = expected.is_from_controller();
        match (self.is_from_controller(), expects_controller) {
            (true, true) | (false, false) => {
                "the other robot generation uses this port: check the device kind and the controller's target port"
            }
            (false, true) => {
                "a client sends to this port, not a controller: check for a second client and for equal addresses"
            }
            (true, false) => {
                "a controller sends to this port, not a client: check addresses and ports of both sides"
            }
        }
    }

    /// Whether controllers send it.
    pub fn is_from_controller(self) -> bool {
        match self {
            Self::LwrMeasurement | Self::SunriseMonitoring { .. } => true,
            Self::LwrCommand | Self::SunriseCommand { .. } | Self::Unknown => false,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::LwrMeasurement => "a measurement of FRI 1.0 (LWR)",
            Self::LwrCommand => "a command of FRI 1.0 (LWR)",
            Self::SunriseMonitoring { is_framed: false } => {
                "a monitoring message of Sunrise FRI 1.x or 2.0 to 2.5"
            }
            Self::SunriseMonitoring { is_framed: true } => {
                "a monitoring message of Sunrise FRI 2.7 (3.0)"
            }
            Self::SunriseCommand { is_framed: false } => {
                "a command message of Sunrise FRI 1.x or 2.0 to 2.5"
            }
            Self::SunriseCommand { is_framed: true } => {
                "a command message of Sunrise FRI 2.7 (3.0)"
            }
            Self::Unknown => "no FRI datagram",
        })
    }
}
