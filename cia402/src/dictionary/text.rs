//! Values as text for users, by data type: numbers decimal or hexadecimal, text, bytes. This is not the notation of
//! electronic data sheets (CiA 306-1).

use std::fmt::Write as _;

use super::DataType;

/// Short type names, as in programming languages.
const SHORT: [(&str, DataType); 14] = [
    ("bool", DataType::Boolean),
    ("i8", DataType::Integer8),
    ("i16", DataType::Integer16),
    ("i32", DataType::Integer32),
    ("i64", DataType::Integer64),
    ("u8", DataType::Unsigned8),
    ("u16", DataType::Unsigned16),
    ("u24", DataType::Unsigned24),
    ("u32", DataType::Unsigned32),
    ("u64", DataType::Unsigned64),
    ("f32", DataType::Real32),
    ("f64", DataType::Real64),
    ("string", DataType::VisibleString),
    ("bytes", DataType::OctetString),
];

/// A text that is neither a data type nor a value of one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TextError {
    /// Not the name of a type.
    #[error("`{0}` is no data type: write bool, i8 to i64, u8 to u64, f32, f64, string or bytes")]
    Type(String),
    /// Not a value of that type.
    #[error("`{text}` is no {data_type}: write {wanted}")]
    Value {
        /// The text.
        text: String,
        /// The expected type.
        data_type: DataType,
        /// The expected notation.
        wanted: &'static str,
    },
    /// A number beyond what the type holds.
    #[error("{text} does not fit {data_type}, which has {size} bytes")]
    Range {
        /// The text.
        text: String,
        /// The expected type.
        data_type: DataType,
        /// Size of the type, bytes.
        size: usize,
    },
}

impl DataType {
    /// The type with a short name: `u16`, `i32`, `f32`, `string`, `bytes`, ..
    pub fn named(name: &str) -> Result<Self, TextError> {
        let found = SHORT.iter().find(|(short, _)| *short == name);
        let found = found.map(|(_, data_type)| *data_type);
        found.ok_or_else(|| TextError::Type(name.to_owned()))
    }

    /// Whether its values are integers.
    fn is_integer(self) -> bool {
        self.integer(&[]).is_some()
    }

    /// A value as text: a number with its hexadecimal form, text in quotes, or bytes if the type has no other notation
    /// or the length does not match it.
    pub fn show(self, bytes: &[u8]) -> String {
        if self.size().is_some_and(|size| size != bytes.len()) {
            return octets(bytes);
        }
        if let Some(number) = self.integer(bytes) {
            let mut digits = String::new();
            for byte in bytes.iter().rev() {
                let _ = write!(digits, "{byte:02X}");
            }
            return format!("{number} ({digits}h)");
        }
        match (self, bytes) {
            (Self::Boolean, [value]) => if *value == 0 { "false" } else { "true" }.to_owned(),
            (Self::Real32, [a, b, c, d]) => f32::from_le_bytes([*a, *b, *c, *d]).to_string(),
            (Self::Real64, _) => bytes.first_chunk().map_or_else(
                || octets(bytes),
                |eight| f64::from_le_bytes(*eight).to_string(),
            ),
            (Self::VisibleString, _) => {
                let text = String::from_utf8_lossy(bytes);
                format!("{:?}", text.trim_end_matches('\0'))
            }
            _ => octets(bytes),
        }
    }

    /// The bytes of a value given as text, little-endian: an integer, decimal or with `0x`, `true`, `1.5`, text, or
    /// bytes as in `0A 1B`.
    pub fn read(self, text: &str) -> Result<Vec<u8>, TextError> {
        let wrong = |wanted| TextError::Value {
            text: text.to_owned(),
            data_type: self,
            wanted,
        };
        if self.is_integer() {
            return self.read_integer(text);
        }
        if self == Self::Boolean {
            return match text {
                "true" | "1" => Ok(vec![1]),
                "false" | "0" => Ok(vec![0]),
                _ => Err(wrong("true or false")),
            };
        }
        if self == Self::Real32 {
            let number: f32 = text.parse().map_err(|_| wrong("a number"))?;
            return Ok(number.to_le_bytes().to_vec());
        }
        if self == Self::Real64 {
            let number: f64 = text.parse().map_err(|_| wrong("a number"))?;
            return Ok(number.to_le_bytes().to_vec());
        }
        if self == Self::VisibleString {
            return Ok(text.as_bytes().to_vec());
        }
        read_octets(text).ok_or_else(|| wrong("bytes in hexadecimal, as in `0A 1B`"))
    }

    fn read_integer(self, text: &str) -> Result<Vec<u8>, TextError> {
        let (sign, digits) = text.strip_prefix('-').map_or((1, text), |rest| (-1, rest));
        let number = match digits.strip_prefix("0x") {
            Some(digits) => u64::from_str_radix(digits, 16).map(i128::from).ok(),
            None => digits.parse::<i128>().ok(),
        };
        let number = number.filter(|number| (0..1 << 64).contains(number));
        let number = sign
            * number.ok_or_else(|| TextError::Value {
                text: text.to_owned(),
                data_type: self,
                wanted: "a number, decimal or with 0x before it",
            })?;
        let size = self.size().unwrap_or_default();
        let bytes = number.to_le_bytes();
        let bytes = bytes.get(..size).unwrap_or_default();
        // A number fits if it reads back unchanged.
        if self.integer(bytes) == Some(number) {
            return Ok(bytes.to_vec());
        }
        Err(TextError::Range {
            text: text.to_owned(),
            data_type: self,
            size,
        })
    }
}

/// Bytes as `0A 1B`.
fn octets(bytes: &[u8]) -> String {
    let mut text = String::new();
    for byte in bytes {
        let _ = write!(text, "{byte:02X} ");
    }
    text.trim_end().to_owned()
}

fn read_octets(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
    if digits.is_empty() {
        return None;
    }
    let digit = |digit: u8| char::from(digit).to_digit(16);
    let pair = |pair: &[u8]| match *pair {
        [high, low] => u8::try_from(digit(high)? << 4 | digit(low)?).ok(),
        _ => None,
    };
    digits.chunks(2).map(pair).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_shown_as_text_read_back() {
        for (name, text, bytes, shown) in [
            ("u16", "0x231", &[0x31, 2][..], "561 (0231h)"),
            ("i32", "-2", &[0xFE, 0xFF, 0xFF, 0xFF], "-2 (FFFFFFFEh)"),
            ("u8", "255", &[255], "255 (FFh)"),
            ("bool", "true", &[1], "true"),
            ("f32", "1.5", &[0, 0, 0xC0, 0x3F], "1.5"),
            ("f64", "-1", &[0, 0, 0, 0, 0, 0, 0xF0, 0xBF], "-1"),
            ("string", "abc", b"abc", "\"abc\""),
            ("string", "a\"b", b"a\"b", r#""a\"b""#),
            ("bytes", "0A 1b", &[0x0A, 0x1B], "0A 1B"),
            ("u24", "65536", &[0, 0, 1], "65536 (010000h)"),
            ("i8", "-128", &[0x80], "-128 (80h)"),
        ] {
            let kind = DataType::named(name).unwrap();
            assert_eq!(kind.read(text).unwrap(), bytes, "{name} {text}");
            assert_eq!(kind.show(bytes), shown, "{name} {text}");
        }
        assert_eq!(DataType::Unsigned32.show(&[1, 2]), "01 02");
        assert_eq!(DataType::VisibleString.show(b"a\0"), "\"a\"");
    }

    #[test]
    fn values_that_do_not_fit_are_errors() {
        for (kind, text, why) in [
            (DataType::Unsigned8, "256", "256 does not fit UNSIGNED8"),
            (DataType::Unsigned8, "-1", "-1 does not fit"),
            (DataType::Integer8, "128", "which has 1 bytes"),
            (DataType::Integer16, "1.5", "write a number"),
            (DataType::Boolean, "yes", "write true or false"),
            (DataType::OctetString, "0A1", "write bytes"),
            (DataType::OctetString, " ", "write bytes"),
            (DataType::Integer8, "--1", "write a number"),
            (DataType::Unsigned32, "x", "write a number"),
            (DataType::Domain, "xy", "write bytes"),
            (DataType::Real32, "one", "write a number"),
        ] {
            let message = kind.read(text).unwrap_err().to_string();
            assert!(message.contains(why), "{message}");
        }
        let message = DataType::named("word").unwrap_err().to_string();
        assert!(message.contains("i8 to i64"), "{message}");
    }
}
