//! Values of objects as text, both ways, by their data type (CiA 301). Where the type is from is the caller's matter.

use std::fmt::Write as _;

use takt_cia402::dictionary::DataType;

/// Short names, as programmers write them.
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

/// Reads a data type of the command line.
pub(super) fn data_type(text: &str) -> Result<DataType, String> {
    let found = SHORT.iter().find(|(name, _)| *name == text);
    found.map(|(_, data_type)| *data_type).ok_or_else(|| {
        let names: Vec<&str> = SHORT.iter().map(|(name, _)| *name).collect();
        format!(
            "`{text}` is no data type: write one of {}",
            names.join(", ")
        )
    })
}

/// Bytes as `0A 1B`.
pub(super) fn hexadecimal(bytes: &[u8]) -> String {
    let mut text = String::new();
    for byte in bytes {
        let _ = write!(text, "{byte:02X} ");
    }
    text.trim_end().to_owned()
}

/// A value for readers: a number with its hexadecimal form, text in quotes, or bytes where the type says no more or
/// the length does not fit it.
pub(super) fn shown(data_type: Option<DataType>, bytes: &[u8]) -> String {
    let known = data_type.filter(|kind| kind.size().is_none_or(|size| size == bytes.len()));
    let Some(kind) = known else {
        return hexadecimal(bytes);
    };
    if let Some(number) = kind.integer(bytes) {
        let mut digits = String::new();
        for byte in bytes.iter().rev() {
            let _ = write!(digits, "{byte:02X}");
        }
        return format!("{number} ({digits}h)");
    }
    match (kind, bytes) {
        (DataType::Boolean, [value]) => if *value == 0 { "false" } else { "true" }.to_owned(),
        (DataType::Real32, [a, b, c, d]) => f32::from_le_bytes([*a, *b, *c, *d]).to_string(),
        (DataType::Real64, _) => bytes.first_chunk().map_or_else(
            || hexadecimal(bytes),
            |eight| f64::from_le_bytes(*eight).to_string(),
        ),
        (DataType::VisibleString, _) => {
            let text = String::from_utf8_lossy(bytes);
            format!("{:?}", text.trim_end_matches('\0'))
        }
        _ => hexadecimal(bytes),
    }
}

/// The bytes of a value that somebody wrote.
pub(super) fn bytes(kind: DataType, text: &str) -> Result<Vec<u8>, String> {
    if let (Some(size), Some(_)) = (kind.size(), kind.integer(&[])) {
        return integer(kind, size, text);
    }
    let wrong = |wanted: &str| format!("`{text}` is no {kind}: write {wanted}");
    if kind == DataType::Boolean {
        return match text {
            "true" | "1" => Ok(vec![1]),
            "false" | "0" => Ok(vec![0]),
            _ => Err(wrong("true or false")),
        };
    }
    if kind == DataType::Real32 {
        let number = text.parse::<f32>().map_err(|_| wrong("a number"))?;
        return Ok(number.to_le_bytes().to_vec());
    }
    if kind == DataType::Real64 {
        let number = text.parse::<f64>().map_err(|_| wrong("a number"))?;
        return Ok(number.to_le_bytes().to_vec());
    }
    if kind == DataType::VisibleString {
        return Ok(text.as_bytes().to_vec());
    }
    octets(text).ok_or_else(|| wrong("bytes in hexadecimal, as in `0A 1B`"))
}

fn integer(kind: DataType, size: usize, text: &str) -> Result<Vec<u8>, String> {
    let (sign, digits) = text.strip_prefix('-').map_or((1, text), |rest| (-1, rest));
    let number = match digits.strip_prefix("0x") {
        Some(digits) => i128::from_str_radix(digits, 16).ok(),
        None => digits.parse().ok(),
    };
    let number = number.filter(|number| *number >= 0).ok_or_else(|| {
        format!("`{text}` is no {kind}: write a number, decimal or with 0x before it")
    })?;
    let bytes = (sign * number).to_le_bytes();
    let bytes = bytes.get(..size).unwrap_or_default();
    // What reads back as the same number fits.
    if kind.integer(bytes) == Some(sign * number) {
        Ok(bytes.to_vec())
    } else {
        Err(format!(
            "{text} does not fit {kind}, which has {size} bytes"
        ))
    }
}

fn octets(text: &str) -> Option<Vec<u8>> {
    let digits: String = text.split_whitespace().collect();
    let pair = |at: usize| u8::from_str_radix(digits.get(at..at + 2)?, 16).ok();
    (!digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_hexdigit()))
        .then(|| (0..digits.len()).step_by(2).map(pair).collect())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_as_their_type_says() {
        let is = |kind, text, expected: &[u8]| assert_eq!(bytes(kind, text).unwrap(), expected);
        is(DataType::Unsigned16, "0x6041", &[0x41, 0x60]);
        is(DataType::Integer8, "-128", &[0x80]);
        is(DataType::Unsigned24, "65536", &[0, 0, 1]);
        is(DataType::Boolean, "true", &[1]);
        is(DataType::Real32, "1.5", &[0, 0, 0xC0, 0x3F]);
        is(DataType::VisibleString, "ab", b"ab");
        is(DataType::OctetString, "0a 1B", &[10, 27]);
        for (kind, text, why) in [
            (DataType::Unsigned8, "256", "does not fit UNSIGNED8"),
            (DataType::Unsigned8, "-1", "does not fit"),
            (DataType::Integer8, "128", "does not fit"),
            (DataType::Integer8, "--1", "write a number"),
            (DataType::Unsigned32, "x", "write a number"),
            (DataType::OctetString, "abc", "bytes in hexadecimal"),
            (DataType::OctetString, "", "bytes in hexadecimal"),
            (DataType::Boolean, "yes", "true or false"),
        ] {
            let told = bytes(kind, text).unwrap_err();
            assert!(told.contains(why), "{told}");
        }
        assert_eq!(data_type("u24"), Ok(DataType::Unsigned24));
        assert!(data_type("u7").unwrap_err().contains("u8"));
    }

    #[test]
    fn values_are_shown_as_their_type_says() {
        let is = |kind, bytes: &[u8], expected| assert_eq!(shown(kind, bytes), expected);
        is(Some(DataType::Integer16), &[0xFE, 0xFF], "-2 (FFFEh)");
        is(Some(DataType::Real32), &[0, 0, 0xC0, 0x3F], "1.5");
        is(Some(DataType::VisibleString), b"a\"b\0", "\"a\\\"b\"");
        is(Some(DataType::Boolean), &[1], "true");
        // The slave gave another length than its type has.
        is(Some(DataType::Unsigned16), &[1, 2, 3], "01 02 03");
        is(None, &[1, 255], "01 FF");
    }
}
