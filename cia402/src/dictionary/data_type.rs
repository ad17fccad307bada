//! The data types of CiA 301 (clause 7.4.7) and the numeric ones among them. Conversion to text is in `text.rs`.

use std::fmt;

/// The type of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[expect(missing_docs, reason = "the names are those of the standard")]
pub enum DataType {
    Boolean,
    Integer8,
    Integer16,
    Integer32,
    Unsigned8,
    Unsigned16,
    Unsigned32,
    Real32,
    VisibleString,
    OctetString,
    UnicodeString,
    TimeOfDay,
    TimeDifference,
    Domain,
    Integer24,
    Real64,
    Integer40,
    Integer48,
    Integer56,
    Integer64,
    Unsigned24,
    Unsigned40,
    Unsigned48,
    Unsigned56,
    Unsigned64,
    /// Any other code, as received.
    Other(u16),
}

use DataType as T;

/// Type, code, size in bytes (0 if variable), signedness of an integer, name.
const TABLE: [(DataType, u16, usize, Option<bool>, &str); 25] = [
    (T::Boolean, 0x01, 1, None, "BOOLEAN"),
    (T::Integer8, 0x02, 1, Some(true), "INTEGER8"),
    (T::Integer16, 0x03, 2, Some(true), "INTEGER16"),
    (T::Integer32, 0x04, 4, Some(true), "INTEGER32"),
    (T::Unsigned8, 0x05, 1, Some(false), "UNSIGNED8"),
    (T::Unsigned16, 0x06, 2, Some(false), "UNSIGNED16"),
    (T::Unsigned32, 0x07, 4, Some(false), "UNSIGNED32"),
    (T::Real32, 0x08, 4, None, "REAL32"),
    (T::VisibleString, 0x09, 0, None, "VISIBLE_STRING"),
    (T::OctetString, 0x0A, 0, None, "OCTET_STRING"),
    (T::UnicodeString, 0x0B, 0, None, "UNICODE_STRING"),
    (T::TimeOfDay, 0x0C, 6, None, "TIME_OF_DAY"),
    (T::TimeDifference, 0x0D, 6, None, "TIME_DIFFERENCE"),
    (T::Domain, 0x0F, 0, None, "DOMAIN"),
    (T::Integer24, 0x10, 3, Some(true), "INTEGER24"),
    (T::Real64, 0x11, 8, None, "REAL64"),
    (T::Integer40, 0x12, 5, Some(true), "INTEGER40"),
    (T::Integer48, 0x13, 6, Some(true), "INTEGER48"),
    (T::Integer56, 0x14, 7, Some(true), "INTEGER56"),
    (T::Integer64, 0x15, 8, Some(true), "INTEGER64"),
    (T::Unsigned24, 0x16, 3, Some(false), "UNSIGNED24"),
    (T::Unsigned40, 0x18, 5, Some(false), "UNSIGNED40"),
    (T::Unsigned48, 0x19, 6, Some(false), "UNSIGNED48"),
    (T::Unsigned56, 0x1A, 7, Some(false), "UNSIGNED56"),
    (T::Unsigned64, 0x1B, 8, Some(false), "UNSIGNED64"),
];

impl DataType {
    fn row(self) -> Option<&'static (Self, u16, usize, Option<bool>, &'static str)> {
        TABLE.iter().find(|row| row.0 == self)
    }

    /// The code of the standard.
    pub fn raw(self) -> u16 {
        if let Self::Other(raw) = self {
            return raw;
        }
        self.row().map_or(0, |row| row.1)
    }

    /// From the code of the standard.
    pub fn from_raw(raw: u16) -> Self {
        let found = TABLE.iter().find(|row| row.1 == raw);
        found.map_or(Self::Other(raw), |row| row.0)
    }

    /// Size of a value, bytes; `None` if variable.
    pub fn size(self) -> Option<usize> {
        self.row().map(|row| row.2).filter(|size| *size > 0)
    }

    /// Size of a value in a PDO, bits; `None` if variable. A BOOLEAN has one.
    pub fn bits(self) -> Option<usize> {
        let size = self.size()?;
        Some(if self == Self::Boolean { 1 } else { 8 * size })
    }

    /// The integer in little-endian bytes; `None` if this is not an integer type.
    pub fn integer(self, bytes: &[u8]) -> Option<i128> {
        let signed = self.row()?.3?;
        let mut value = 0_i128;
        for byte in bytes.iter().rev().take(8) {
            value = value << 8 | i128::from(*byte);
        }
        let bits = 8 * bytes.len().min(8);
        let negative = signed && bits > 0 && value >> (bits - 1) & 1 == 1;
        Some(if negative { value - (1 << bits) } else { value })
    }
}

impl fmt::Display for DataType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.row() {
            Some(row) => f.write_str(row.4),
            None => write!(f, "type {:04X}h", self.raw()),
        }
    }
}

/// A numeric type of an entry.
pub trait Number: Copy {
    /// Its type.
    const TYPE: DataType;

    /// The number in the first bytes, little-endian; zero if they are too few.
    fn from_le(bytes: &[u8]) -> Self;

    /// Writes the number to the first bytes, little-endian, if there are enough.
    fn to_le(self, bytes: &mut [u8]);
}

macro_rules! number {
    ($($number:ty => $data_type:ident),*) => {$(
        impl Number for $number {
            const TYPE: DataType = DataType::$data_type;

            fn from_le(bytes: &[u8]) -> Self {
                bytes.first_chunk().map_or(Self::default(), |chunk| Self::from_le_bytes(*chunk))
            }

            fn to_le(self, bytes: &mut [u8]) {
                if let Some(chunk) = bytes.first_chunk_mut() {
                    *chunk = self.to_le_bytes();
                }
            }
        }
    )*};
}

number!(i8 => Integer8, i16 => Integer16, i32 => Integer32, i64 => Integer64, u8 => Unsigned8,
        u16 => Unsigned16, u32 => Unsigned32, u64 => Unsigned64, f32 => Real32, f64 => Real64);

impl Number for bool {
    const TYPE: DataType = DataType::Boolean;

    fn from_le(bytes: &[u8]) -> Self {
        bytes.first().is_some_and(|byte| *byte != 0)
    }

    fn to_le(self, bytes: &mut [u8]) {
        if let Some(byte) = bytes.first_mut() {
            *byte = self.into();
        }
    }
}
