//! Metadata of objects and their entries: type, access, limits. Values are in [`super::Dictionary`].

use std::borrow::Cow;
use std::fmt;

use super::{AbortCode, DataType, Number, VALUE_MAX};

/// Object code: the structure of an object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ObjectCode {
    /// DOMAIN, 2h
    Domain,
    /// VAR, 7h
    #[default]
    Var,
    /// ARRAY, 8h
    Array,
    /// RECORD, 9h
    Record,
    /// Any other code, as received.
    Other(u8),
}

impl ObjectCode {
    /// The code of the standard.
    pub const fn raw(self) -> u8 {
        match self {
            Self::Domain => 2,
            Self::Var => 7,
            Self::Array => 8,
            Self::Record => 9,
            Self::Other(raw) => raw,
        }
    }

    /// From the code of the standard.
    pub const fn from_raw(raw: u8) -> Self {
        match raw {
            2 => Self::Domain,
            7 => Self::Var,
            8 => Self::Array,
            9 => Self::Record,
            other => Self::Other(other),
        }
    }
}

/// Access from the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Constant: readable, never changes.
    Const,
    /// Read only.
    ReadOnly,
    /// Write only.
    WriteOnly,
    /// Read and write.
    ReadWrite,
}

impl Access {
    /// Whether it can be read.
    pub const fn is_readable(self) -> bool {
        !matches!(self, Self::WriteOnly)
    }

    /// Whether it can be written.
    pub const fn is_writable(self) -> bool {
        matches!(self, Self::WriteOnly | Self::ReadWrite)
    }
}

impl fmt::Display for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Const => "const",
            Self::ReadOnly => "ro",
            Self::WriteOnly => "wo",
            Self::ReadWrite => "rw",
        })
    }
}

/// PDOs that an entry can be mapped to, seen from the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PdoUse {
    /// None.
    #[default]
    None,
    /// PDOs that the device receives.
    Receive,
    /// PDOs that the device transmits.
    Transmit,
    /// Read and write.
    Both,
}

/// One entry of an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Its name.
    pub name: Cow<'static, str>,
    /// Its type.
    pub data_type: DataType,
    /// Its access.
    pub access: Access,
    /// PDOs that it can be mapped to.
    pub pdo: PdoUse,
    /// Smallest value that can be written, of an integer type; in the entry's own unit.
    pub low: Option<i128>,
    /// Largest value that can be written, of an integer type; in the entry's own unit.
    pub high: Option<i128>,
    /// Maximum length in bytes, of a type of variable length.
    pub max_len: usize,
    /// Its value after a reset, little-endian.
    pub default: Vec<u8>,
}

impl Entry {
    /// A number with this value after a reset.
    pub fn number<T: Number>(name: &'static str, access: Access, default: T) -> Self {
        let mut bytes = vec![0; T::TYPE.size().unwrap_or(0)];
        default.to_le(&mut bytes);
        Self::of(name, T::TYPE, access, bytes)
    }

    /// A read-only VISIBLE_STRING.
    pub fn text(name: &'static str, text: &str) -> Self {
        Self::of(name, DataType::VisibleString, Access::Const, text.into())
    }

    /// An entry of any type with this value after a reset. The capacity of strings and domains is the length of this
    /// value.
    pub fn of(
        name: impl Into<Cow<'static, str>>,
        data_type: DataType,
        access: Access,
        default: Vec<u8>,
    ) -> Self {
        Self {
            name: name.into(),
            data_type,
            access,
            pdo: PdoUse::None,
            low: None,
            high: None,
            max_len: default.len(),
            default,
        }
    }

    /// The same with limits on written values.
    #[must_use]
    pub fn within(mut self, low: impl Into<i128>, high: impl Into<i128>) -> Self {
        (self.low, self.high) = (Some(low.into()), Some(high.into()));
        self
    }

    /// The same, mappable to PDOs.
    #[must_use]
    pub const fn mappable(mut self, pdo: PdoUse) -> Self {
        self.pdo = pdo;
        self
    }

    /// Bytes to reserve for it.
    pub(super) fn capacity(&self) -> usize {
        let varying = self.max_len.max(self.default.len()).min(VALUE_MAX);
        self.data_type.size().unwrap_or(varying)
    }

    pub(super) fn check_length(&self, len: usize) -> Result<(), AbortCode> {
        let fixed = self.data_type.size();
        if len > self.capacity() {
            Err(AbortCode::TooLong)
        } else if fixed.is_some_and(|size| len < size) {
            Err(AbortCode::TooShort)
        } else {
            Ok(())
        }
    }

    /// Whether length and value are allowed.
    pub(super) fn check(&self, data: &[u8]) -> Result<(), AbortCode> {
        self.check_length(data.len())?;
        let Some(value) = self.data_type.integer(data) else {
            return Ok(());
        };
        if self.high.is_some_and(|high| value > high) {
            Err(AbortCode::TooHigh)
        } else if self.low.is_some_and(|low| value < low) {
            Err(AbortCode::TooLow)
        } else {
            Ok(())
        }
    }
}

/// An object: its entries by sub-index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// Its index.
    pub index: u16,
    /// Its name.
    pub name: Cow<'static, str>,
    /// Its object code.
    pub code: ObjectCode,
    /// Its entries; a VAR has one, of sub-index 0.
    pub entries: Vec<(u8, Entry)>,
}

impl Object {
    /// A plain variable, named as its entry.
    pub fn var(index: u16, entry: Entry) -> Self {
        Self {
            index,
            name: entry.name.clone(),
            code: ObjectCode::Var,
            entries: vec![(0, entry)],
        }
    }

    /// A record of these entries from sub-index 1 on, with their number in sub-index 0, which is read only.
    pub fn record(index: u16, name: &'static str, entries: Vec<Entry>) -> Self {
        let count = u8::try_from(entries.len()).unwrap_or(u8::MAX);
        let highest = Entry::number("highest sub-index", Access::Const, count);
        let entries = std::iter::once(highest).chain(entries);
        Self {
            index,
            name: name.into(),
            code: ObjectCode::Record,
            entries: (0..=u8::MAX).zip(entries).collect(),
        }
    }

    /// An array of these entries from sub-index 1 on, as [`Self::record`].
    pub fn array(index: u16, name: &'static str, entries: Vec<Entry>) -> Self {
        Self {
            code: ObjectCode::Array,
            ..Self::record(index, name, entries)
        }
    }
}
