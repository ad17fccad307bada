//! Layer setting services (LSS, CiA 305): assign node numbers over the bus, and find nodes without
//! a number. Bit rate changes are passed on to the owner.
//!
//! | byte 0 | service | | byte 0 | service |
//! |---|---|---|---|---|
//! | 04h | switch mode, global | | 46h to 4Bh | identify by address; response 4Fh |
//! | 40h to 43h | switch mode, selective; response 44h | | 4Ch | identify unconfigured slaves; response 50h |
//! | 11h | set the node number | | 51h | fast scan; response 4Fh |
//! | 13h, 15h | set, activate bit timing | | 5Ah to 5Eh | inquire address, node number |
//! | 17h | store | | | |

mod master;
mod slave;
#[cfg(test)]
mod tests;

pub use master::{Job, LssError, Master, Reply};
pub use slave::{Done, Slave};

use std::fmt;

/// The LSS address: the four numbers of object 1018h, unique for each device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[doc(alias = "1018h")]
pub struct Identity {
    /// 1018h:01, assigned by CAN in Automation.
    pub vendor: u32,
    /// 1018h:02
    pub product: u32,
    /// 1018h:03
    pub revision: u32,
    /// 1018h:04
    pub serial: u32,
}

impl Identity {
    /// The numbers in the order of 1018h.
    pub const fn numbers(&self) -> [u32; 4] {
        [self.vendor, self.product, self.revision, self.serial]
    }

    /// Creates an identity from the numbers in the order of 1018h.
    pub(crate) const fn from_numbers(numbers: [u32; 4]) -> Self {
        let [vendor, product, revision, serial] = numbers;
        Self {
            vendor,
            product,
            revision,
            serial,
        }
    }
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "vendor {:08X}h product {:08X}h revision {:08X}h serial {:08X}h",
            self.vendor, self.product, self.revision, self.serial
        )
    }
}

/// LSS mode of a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Waiting for selection.
    Waiting,
    /// Configuration.
    Configuration,
}

/// The node number on the wire of a device that has none.
pub(crate) const NO_NODE: u8 = 0xFF;

/// One LSS message.
pub type Message = [u8; 8];

const SWITCH_GLOBAL: u8 = 0x04;
const SET_NODE: u8 = 0x11;
const SET_TIMING: u8 = 0x13;
const ACTIVATE_TIMING: u8 = 0x15;
const STORE: u8 = 0x17;
const SELECT: u8 = 0x40;
const SELECTED: u8 = 0x44;
const IDENTIFY: u8 = 0x46;
const IDENTIFY_NONE: u8 = 0x4C;
const IDENTIFIED: u8 = 0x4F;
const IDENTIFIED_NONE: u8 = 0x50;
const FAST_SCAN: u8 = 0x51;
const INQUIRE: u8 = 0x5A;
const INQUIRE_NODE: u8 = 0x5E;
/// Bit check value that addresses all unconfigured slaves.
const SCAN_RESET: u8 = 0x80;

const fn with_number(command: u8, number: u32) -> Message {
    let [a, b, c, d] = number.to_le_bytes();
    [command, a, b, c, d, 0, 0, 0]
}

const fn number(message: &Message) -> u32 {
    let [_, a, b, c, d, ..] = *message;
    u32::from_le_bytes([a, b, c, d])
}

const fn short(command: u8, first: u8, second: u8) -> Message {
    [command, first, second, 0, 0, 0, 0, 0]
}
