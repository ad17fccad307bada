//! Index and sub-index. Which objects exist is not known here.

use std::fmt;
use std::str::FromStr;

/// The address of an entry of an object dictionary; also called its multiplexor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address {
    /// Index of the object.
    pub index: u16,
    /// Sub-index; 0 for a plain variable and for the count of an array or a record.
    pub sub: u8,
}

/// The text is not an address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is not an object; write index and sub-index in hexadecimal, such as 6041 or 1018:02"
)]
pub struct AddressError(String);

impl Address {
    /// Distance between the objects of two logical devices of a multi-axis drive (CiA 402-2, clause on multiple device
    /// modules).
    pub const AXIS: u16 = 0x800;

    /// The address with this index and sub-index.
    pub const fn new(index: u16, sub: u8) -> Self {
        Self { index, sub }
    }

    /// The same object of another logical device: 6040h of axis 1 is 6840h. `None` beyond axis 7
    /// and for objects outside 6000h to 67FFh, which all axes share.
    #[must_use]
    pub const fn on_axis(self, axis: u8) -> Option<Self> {
        if axis > 7 || self.index < 0x6000 || self.index > 0x67FF {
            return None;
        }
        Some(Self {
            index: self.index + Self::AXIS * axis as u16,
            sub: self.sub,
        })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}h:{:02X}", self.index, self.sub)
    }
}

/// Reads `6041`, `6041h`, `0x6041`, each with an optional `:sub`; all digits are hexadecimal.
impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let error = || AddressError(text.to_owned());
        let hexadecimal = |part: &str| {
            let part = part.trim();
            let part = part.strip_prefix("0x").unwrap_or(part);
            let part = part.strip_suffix(['h', 'H']).unwrap_or(part);
            let digits = !part.is_empty() && part.bytes().all(|b| b.is_ascii_hexdigit());
            digits.then(|| u16::from_str_radix(part, 16).ok()).flatten()
        };
        let (index, sub) = text.split_once(':').unwrap_or((text, "0"));
        let index = hexadecimal(index).ok_or_else(error)?;
        let sub = hexadecimal(sub).and_then(|sub| u8::try_from(sub).ok());
        Ok(Self::new(index, sub.ok_or_else(error)?))
    }
}
