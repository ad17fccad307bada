//! Process data objects (CiA 301, clauses 7.2.2 and 7.5.2.35 to 38): their parameters in the object
//! dictionary, and when each is sent or taken. Which nodes exchange which PDOs, the network says.

mod parameters;
mod receive;
#[cfg(test)]
mod tests;
mod transmit;

pub(in crate::canopen) use parameters::number_at;
pub use parameters::{Direction, ENTRIES_MAX, PDOS_MAX, Parameters, check_download};
pub use receive::{Received, Rpdo};
pub use transmit::Tpdo;

use std::fmt;

use crate::Id;

/// When a PDO is sent or taken: sub-index 2 of its communication parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transmission {
    /// 0: with the next SYNC after an event; received ones count with the next SYNC.
    SyncAcyclic,
    /// 1 to 240: with every n-th SYNC; received ones count with the next SYNC.
    Sync(u8),
    /// 252: sampled with SYNC, sent when a remote frame asks.
    RemoteSync,
    /// 253: sampled and sent when a remote frame asks.
    Remote,
    /// 254: on an event of the manufacturer's choice; here a change of its contents, as 255.
    EventManufacturer,
    /// 255: on an event of the device profile: a change of its contents.
    EventProfile,
    /// 241 to 251: reserved.
    Reserved(u8),
}

impl Transmission {
    /// From the number in the dictionary.
    #[must_use]
    pub const fn from_raw(raw: u8) -> Self {
        match raw {
            0 => Self::SyncAcyclic,
            1..=240 => Self::Sync(raw),
            241..=251 => Self::Reserved(raw),
            252 => Self::RemoteSync,
            253 => Self::Remote,
            254 => Self::EventManufacturer,
            255 => Self::EventProfile,
        }
    }

    /// The number in the dictionary.
    #[must_use]
    pub const fn raw(self) -> u8 {
        match self {
            Self::SyncAcyclic => 0,
            Self::Sync(raw) | Self::Reserved(raw) => raw,
            Self::RemoteSync => 252,
            Self::Remote => 253,
            Self::EventManufacturer => 254,
            Self::EventProfile => 255,
        }
    }

    /// Whether SYNC decides when a received PDO counts.
    #[must_use]
    pub const fn is_synchronous(self) -> bool {
        matches!(self, Self::SyncAcyclic | Self::Sync(_))
    }

    /// Whether events decide when it is sent.
    #[must_use]
    pub const fn is_event_driven(self) -> bool {
        matches!(self, Self::EventManufacturer | Self::EventProfile)
    }
}

/// The COB-ID of a PDO as its communication parameters hold it.
///
/// | bit | what |
/// |---|---|
/// | 31 | 1: the PDO does not exist |
/// | 30 | 1: no remote frame may ask for it |
/// | 29 | 1: the identifier has 29 bits, which is not supported here |
/// | 0 to 10 | identifier |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PdoCob(u32);

impl PdoCob {
    const INVALID: u32 = 1 << 31;
    const NO_REMOTE: u32 = 1 << 30;
    /// Bits 28 to 30 are the device's own: real ones read `F000_0181h`, or clear bit 30 whatever was written.
    const COMPARED: u32 = 0x8FFF_FFFF;

    /// From the number in the dictionary.
    #[must_use]
    pub const fn from_raw(raw: u32) -> Self {
        Self(raw)
    }

    /// Of a PDO that exists, and that no remote frame may ask for.
    #[must_use]
    pub const fn new(id: Id) -> Self {
        Self(id.raw() | Self::NO_REMOTE)
    }

    /// The number in the dictionary.
    #[must_use]
    pub const fn raw(self) -> u32 {
        self.0
    }

    /// Whether both are the same PDO: their identifiers and bit 31 agree. Devices set and clear bits 28 to 30 as they
    /// like, so a value that was read back is never compared as a whole.
    #[must_use]
    pub const fn is_same(self, other: Self) -> bool {
        (self.0 ^ other.0) & Self::COMPARED == 0
    }

    /// The same PDO switched off.
    #[must_use]
    pub const fn off(self) -> Self {
        Self(self.0 | Self::INVALID)
    }

    /// Whether the PDO exists.
    #[must_use]
    pub const fn is_valid(self) -> bool {
        self.0 & Self::INVALID == 0
    }

    /// Whether a remote frame may ask for it.
    #[must_use]
    pub const fn allows_remote(self) -> bool {
        self.0 & Self::NO_REMOTE == 0
    }

    /// The identifier, of a PDO that exists and has one that a PDO may have.
    #[must_use]
    pub fn id(self) -> Option<Id> {
        self.identifier().filter(|_| self.is_valid())
    }

    /// The identifier, if it has 11 bits and is not one of those that CiA 301 keeps for other
    /// services (clause 7.3.5, table of restricted identifiers).
    #[must_use]
    pub fn identifier(self) -> Option<Id> {
        // Bit 28 belongs to identifiers of 29 bits alone; some devices show it all the same.
        let raw = u16::try_from(self.0 & 0x2FFF_FFFF).ok()?;
        let restricted = matches!(
            raw,
            0x000..=0x080 | 0x101..=0x180 | 0x581..=0x5FF | 0x601..=0x67F | 0x6E0..=0x6FF | 0x701..
        );
        Id::standard(raw).ok().filter(|_| !restricted)
    }
}

impl fmt::Display for PdoCob {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:03X}h", self.0 & 0x1FFF_FFFF)?;
        if self.is_valid() {
            Ok(())
        } else {
            f.write_str(" off")
        }
    }
}
