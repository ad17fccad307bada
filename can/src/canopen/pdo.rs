//! Process data objects (CiA 301, clauses 7.2.2 and 7.5.2.35 to 38): parameters in the object
//! dictionary, transmission and reception. The network plan defines which nodes exchange which
//! PDOs.

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

/// Transmission type: sub-index 2 of the communication parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transmission {
    /// 0: sent with the next SYNC after an event; an RPDO takes effect with the next SYNC.
    SyncAcyclic,
    /// 1 to 240: sent with every n-th SYNC; an RPDO takes effect with the next SYNC.
    Sync(u8),
    /// 252: sampled with SYNC, sent on a remote frame.
    RemoteSync,
    /// 253: sampled and sent on a remote frame.
    Remote,
    /// 254: on a manufacturer-specific event; here on a change of its content, as 255.
    EventManufacturer,
    /// 255: on an event of the device profile: a change of its content.
    EventProfile,
    /// 241 to 251: reserved.
    Reserved(u8),
}

impl Transmission {
    /// Decodes the value in the dictionary.
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

    /// The value in the dictionary.
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

    /// Whether an RPDO takes effect with SYNC.
    pub(crate) const fn is_synchronous(self) -> bool {
        matches!(self, Self::SyncAcyclic | Self::Sync(_))
    }

    /// Whether it is sent on events.
    pub(crate) const fn is_event_driven(self) -> bool {
        matches!(self, Self::EventManufacturer | Self::EventProfile)
    }
}

/// COB-ID of a PDO in its communication parameters.
///
/// | bit | meaning |
/// |---|---|
/// | 31 | 1: PDO disabled |
/// | 30 | 1: no remote frame allowed |
/// | 29 | 1: 29-bit identifier, not supported here |
/// | 0 to 10 | identifier |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PdoCob(u32);

impl PdoCob {
    const INVALID: u32 = 1 << 31;
    const NO_REMOTE: u32 = 1 << 30;
    /// Bits 28 to 30 depend on the device: real ones read `F000_0181h`, or always clear bit 30.
    const COMPARED: u32 = 0x8FFF_FFFF;

    /// Decodes the value in the dictionary.
    pub const fn from_raw(raw: u32) -> Self {
        Self(raw)
    }

    /// COB-ID of an enabled PDO without remote frames.
    pub const fn new(id: Id) -> Self {
        Self(id.raw() | Self::NO_REMOTE)
    }

    /// The value in the dictionary.
    pub const fn raw(self) -> u32 {
        self.0
    }

    /// Whether identifier and bit 31 are equal. Devices set and clear bits 28 to 30 on their own, so values read back
    /// are never compared as a whole.
    pub const fn is_same(self, other: Self) -> bool {
        (self.0 ^ other.0) & Self::COMPARED == 0
    }

    /// The same COB-ID, disabled.
    #[must_use]
    pub const fn off(self) -> Self {
        Self(self.0 | Self::INVALID)
    }

    /// Whether the PDO is enabled.
    pub(crate) const fn is_valid(self) -> bool {
        self.0 & Self::INVALID == 0
    }

    /// Whether remote frames are allowed.
    pub(crate) const fn allows_remote(self) -> bool {
        self.0 & Self::NO_REMOTE == 0
    }

    /// The identifier, if the PDO is enabled and the identifier is allowed for PDOs.
    pub fn id(self) -> Option<Id> {
        self.identifier().filter(|_| self.is_valid())
    }

    /// The identifier, if it has 11 bits and is not reserved for other services (clause 7.3.5,
    /// table of restricted identifiers).
    pub fn identifier(self) -> Option<Id> {
        // Bit 28 is only used by 29-bit identifiers; some devices set it anyway.
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
