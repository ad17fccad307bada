//! Error frames: reports of an interface's controller in the kernel's format (`linux/can/error.h`), and the bus state
//! that follows from them. They never were on the wire. Module `stat` derives findings from them.

use std::fmt;

use socketcan::CanErrorFrame;
use socketcan::errors::{CanError, ErrorCause};

/// Error classes, the bits of [`ErrorFrame::class`].
pub mod class {
    /// Transmit timeout of the driver.
    pub(crate) const TX_TIMEOUT: u32 = 0x001;
    /// Lost arbitration.
    pub(crate) const LOST_ARBITRATION: u32 = 0x002;
    /// Controller state; data byte 1.
    pub const CONTROLLER: u32 = 0x004;
    /// Protocol violation; data bytes 2 and 3.
    pub const PROTOCOL: u32 = 0x008;
    /// Transceiver state; data byte 4.
    pub(crate) const TRANSCEIVER: u32 = 0x010;
    /// No acknowledgement.
    pub(crate) const NO_ACK: u32 = 0x020;
    /// Bus-off.
    pub(crate) const BUS_OFF: u32 = 0x040;
    /// Bus error.
    pub(crate) const BUS_ERROR: u32 = 0x080;
    /// The controller was restarted after bus-off.
    pub(crate) const RESTARTED: u32 = 0x100;
    /// Data bytes 6 and 7 hold the error counters.
    pub const COUNTERS: u32 = 0x200;
}

/// Bits of data byte 1 with class [`class::CONTROLLER`].
pub mod controller {
    /// Receive buffer overflow.
    pub(crate) const RX_OVERFLOW: u8 = 0x01;
    /// Transmit buffer overflow.
    pub const TX_OVERFLOW: u8 = 0x02;
    /// The receive error counter is above 95.
    pub(crate) const RX_WARNING: u8 = 0x04;
    /// The transmit error counter is above 95.
    pub(crate) const TX_WARNING: u8 = 0x08;
    /// The receive error counter is above 127.
    pub(crate) const RX_PASSIVE: u8 = 0x10;
    /// The transmit error counter is above 127.
    pub(crate) const TX_PASSIVE: u8 = 0x20;
    /// Error-active again.
    pub const ACTIVE: u8 = 0x40;
}

/// Bits of data byte 2 with class [`class::PROTOCOL`].
pub mod violation {
    /// Bit error.
    pub(crate) const BIT: u8 = 0x01;
    /// Form error.
    pub(crate) const FORM: u8 = 0x02;
    /// Stuff error: six equal bits in a row.
    pub(crate) const STUFF: u8 = 0x04;
    /// A dominant bit could not be sent.
    pub const BIT0: u8 = 0x08;
    /// A recessive bit could not be sent.
    pub const BIT1: u8 = 0x10;
    /// Overload frame.
    pub const OVERLOAD: u8 = 0x20;
    /// Active error flag.
    pub const ACTIVE: u8 = 0x40;
    /// The error occurred during transmission.
    pub(crate) const TRANSMITTING: u8 = 0x80;
}

/// Location of an error in the frame: data byte 3 with class [`class::PROTOCOL`].
pub mod location {
    /// CRC sequence.
    pub const CRC_SEQUENCE: u8 = 0x08;
    /// ACK slot.
    pub(crate) const ACK_SLOT: u8 = 0x19;
}

/// Error state of a controller (ISO 11898-1, clause 12.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BusState {
    /// Both error counters are below 96.
    #[default]
    ErrorActive,
    /// One of them is 96 or more.
    ErrorWarning,
    /// One of them is 128 or more: the controller sends passive error flags only.
    ErrorPassive,
    /// The transmit error counter reached 256: the controller neither sends nor receives.
    BusOff,
    /// Stopped or sleeping.
    Stopped,
}

impl BusState {
    /// The state that follows from these error counters.
    pub(crate) const fn of_counters(transmit: u16, receive: u16) -> Self {
        let worst = if transmit > receive {
            transmit
        } else {
            receive
        };
        match worst {
            _ if transmit > 255 => Self::BusOff,
            0..96 => Self::ErrorActive,
            96..128 => Self::ErrorWarning,
            _ => Self::ErrorPassive,
        }
    }

    /// As `ip link` and `takt doctor` write it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ErrorActive => "error-active",
            Self::ErrorWarning => "error-warning",
            Self::ErrorPassive => "error-passive",
            Self::BusOff => "bus-off",
            Self::Stopped => "stopped",
        }
    }
}

impl fmt::Display for BusState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// An error frame of a controller.
///
/// | data byte | content |
/// |---|---|
/// | 0 | bit in which arbitration was lost |
/// | 1 | controller state, bits of [`controller`] |
/// | 2 | protocol violations, bits of [`violation`] |
/// | 3 | location in the frame |
/// | 4 | transceiver state |
/// | 5 | driver-specific |
/// | 6, 7 | transmit and receive error counters |
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ErrorFrame {
    class: u32,
    /// Details, depending on the class.
    pub data: [u8; 8],
}

/// Bit 29 of an identifier in the kernel's or a log's format: error frame.
pub(crate) const ERROR_FLAG: u32 = 0x2000_0000;

impl ErrorFrame {
    /// Bits of [`class`]: the lower 29.
    const CLASS_MASK: u32 = 0x1FFF_FFFF;

    /// An error frame of these classes; bits above 28 are ignored.
    pub const fn new(class: u32, data: [u8; 8]) -> Self {
        Self {
            class: class & Self::CLASS_MASK,
            data,
        }
    }

    /// Error classes, bits of [`mod@class`].
    pub const fn class(&self) -> u32 {
        self.class
    }

    /// All reported causes by name; there is always at least one.
    pub fn causes(&self) -> CanError {
        // Only more than 29 bits or more than 8 bytes are rejected.
        CanErrorFrame::new_error(self.class, &self.data)
            .map_or_else(|_| ErrorCause::Unknown(self.class).into(), CanError::from)
    }

    /// Transmit and receive error counters, if reported.
    pub const fn counters(&self) -> Option<(u8, u8)> {
        let [.., transmit, receive] = self.data;
        if self.class & class::COUNTERS != 0 {
            Some((transmit, receive))
        } else {
            None
        }
    }

    /// The new state of the controller, if reported.
    pub const fn state(&self) -> Option<BusState> {
        use controller::{ACTIVE, RX_PASSIVE, RX_WARNING, TX_PASSIVE, TX_WARNING};
        if self.class & class::BUS_OFF != 0 {
            return Some(BusState::BusOff);
        }
        let flags = if self.class & class::CONTROLLER != 0 {
            self.data[1]
        } else {
            0
        };
        if flags & (RX_PASSIVE | TX_PASSIVE) != 0 {
            Some(BusState::ErrorPassive)
        } else if flags & (RX_WARNING | TX_WARNING) != 0 {
            Some(BusState::ErrorWarning)
        } else if flags & ACTIVE != 0 || self.class & class::RESTARTED != 0 {
            Some(BusState::ErrorActive)
        } else {
            None
        }
    }

    /// Whether a sent frame was not acknowledged, according to the class or to the location of a
    /// violation.
    pub(crate) const fn is_unacknowledged(&self) -> bool {
        self.class & class::NO_ACK != 0
            || self.class & class::PROTOCOL != 0 && self.data[3] == location::ACK_SLOT
    }
}

impl fmt::Display for ErrorFrame {
    /// The format of candump logs: `20000044#0030000000008205`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08X}#", self.class | ERROR_FLAG)?;
        self.data
            .iter()
            .try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_frame_causes_have_names() {
        let off = ErrorFrame::new(0x044, [0, 0x30, 0, 0, 0, 0, 0x82, 0x05]);
        assert_eq!(off.to_string(), "20000044#0030000000008205");
        assert_eq!(
            off.causes().to_string(),
            "controller problem: rx passive, tx passive; bus off"
        );
        assert_eq!(off.state(), Some(BusState::BusOff));
        assert_eq!(off.counters(), None, "not reported by its class");
        let noisy = ErrorFrame::new(0x288, [0, 0, 0x84, 0x08, 0, 0, 16, 3]);
        assert!(noisy.causes().to_string().contains("bus error"));
        assert_eq!(noisy.counters(), Some((16, 3)));
        assert_eq!(noisy.state(), None);
    }

    #[test]
    fn error_frame_flags_set_bus_state() {
        let state = |class, flags| ErrorFrame::new(class, [0, flags, 0, 0, 0, 0, 0, 0]).state();
        let class = class::CONTROLLER;
        assert_eq!(state(class, 0x04), Some(BusState::ErrorWarning));
        assert_eq!(state(class, 0x08), Some(BusState::ErrorWarning));
        assert_eq!(state(class, 0x1C), Some(BusState::ErrorPassive));
        assert_eq!(state(class, 0x20), Some(BusState::ErrorPassive));
        assert_eq!(state(class, 0x40), Some(BusState::ErrorActive));
        assert_eq!(state(class, 0x03), None);
        assert_eq!(state(class::BUS_ERROR, 0x20), None, "flags not reported");
        assert_eq!(state(class::RESTARTED, 0), Some(BusState::ErrorActive));
        assert_eq!(state(class::BUS_OFF, 0), Some(BusState::BusOff));
    }

    #[test]
    fn bus_state_follows_error_counters() {
        for (transmit, receive, state) in [
            (0, 0, BusState::ErrorActive),
            (95, 95, BusState::ErrorActive),
            (96, 0, BusState::ErrorWarning),
            (0, 127, BusState::ErrorWarning),
            (0, 128, BusState::ErrorPassive),
            (255, 0, BusState::ErrorPassive),
            (0, 300, BusState::ErrorPassive),
            (256, 0, BusState::BusOff),
        ] {
            assert_eq!(BusState::of_counters(transmit, receive), state);
        }
    }

    #[test]
    fn error_frame_every_class_has_causes() {
        for bit in 0..32 {
            for byte in 0..=u8::MAX {
                let frame = ErrorFrame::new(1 << bit, [byte; 8]);
                assert!(!frame.causes().to_string().is_empty());
                let _ = (frame.state(), frame.is_unacknowledged());
            }
        }
    }
}
