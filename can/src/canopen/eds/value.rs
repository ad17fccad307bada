//! Syntax of numbers and values in data sheets.

use takt_cia402::dictionary::DataType;

/// An integer: decimal, `0x` hexadecimal, or octal with a leading 0, as in CiA 306.
pub(super) fn integer(text: &str) -> Option<i128> {
    let text = text.trim();
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits.trim()),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let lower = digits.to_ascii_lowercase();
    let value = if let Some(digits) = lower.strip_prefix("0x") {
        i128::from_str_radix(digits, 16)
    } else if lower.len() > 1 && lower.starts_with('0') && lower.bytes().all(|b| b.is_ascii_digit())
    {
        i128::from_str_radix(&lower, 8).or_else(|_| lower.parse())
    } else {
        lower.parse()
    };
    let in_range = |value: &i128| value.unsigned_abs() <= u64::MAX.into();
    let value = value.ok().filter(in_range)?;
    Some(if negative { -value } else { value })
}

/// Parses an unsigned number of that type.
pub(super) fn number<T: TryFrom<i128>>(text: &str) -> Option<T> {
    integer(text).and_then(|value| T::try_from(value).ok())
}

/// An integer of `size` bytes, and whether it is relative to the node number: `$NODEID+0x180`,
/// `0x180+$NODEID`, or no `$NODEID` at all.
fn with_node(text: &str) -> Option<(i128, bool)> {
    let relative = text.to_ascii_uppercase().contains("$NODEID");
    if !relative {
        return integer(text).map(|value| (value, false));
    }
    let mut sum = 0;
    for part in text.split('+').map(str::trim) {
        if !part.eq_ignore_ascii_case("$NODEID") {
            sum += integer(part)?;
        }
    }
    Some((sum, true))
}

/// The limit of an integer type; hexadecimal ones of signed types are two's complement.
pub(super) fn limit(data_type: DataType, text: &str) -> Option<i128> {
    let value = integer(text)?;
    let size = data_type.size()?;
    let bytes = truncated(value, size)?;
    data_type.integer(&bytes)
}

/// The little-endian bytes of a value that fits the size as signed or unsigned number.
fn truncated(value: i128, size: usize) -> Option<Vec<u8>> {
    let bits = 8 * u32::try_from(size).ok()?;
    let fits = value >= -(1_i128 << (bits - 1)) && value < 1_i128 << bits;
    fits.then(|| value.to_le_bytes().get(..size).unwrap_or_default().to_vec())
}

/// A value, little-endian, and whether it is relative to the node number.
pub(super) fn parse(data_type: DataType, text: &str) -> Option<(Vec<u8>, bool)> {
    match (data_type, data_type.size()) {
        (DataType::VisibleString, _) => Some((text.as_bytes().to_vec(), false)),
        (DataType::Real32, _) if !is_number(text) => {
            let value: f32 = text.parse().ok()?;
            Some((value.to_le_bytes().to_vec(), false))
        }
        (DataType::Real64, _) if !is_number(text) => {
            let value: f64 = text.parse().ok()?;
            Some((value.to_le_bytes().to_vec(), false))
        }
        (_, Some(size)) => {
            let (value, relative) = with_node(text)?;
            Some((truncated(value, size)?, relative))
        }
        (_, None) => Some((hexadecimal(text)?, false)),
    }
}

/// A hexadecimal real number is the bit pattern.
fn is_number(text: &str) -> bool {
    text.trim_start().to_ascii_lowercase().starts_with("0x")
}

/// Bytes of octet strings: hexadecimal, with or without spaces between them.
fn hexadecimal(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
    let digits = digits.strip_prefix(b"0x").unwrap_or(&digits);
    if !digits.len().is_multiple_of(2) {
        return None;
    }
    digits
        .chunks(2)
        .map(|pair| {
            std::str::from_utf8(pair)
                .ok()
                .and_then(|p| u8::from_str_radix(p, 16).ok())
        })
        .collect()
}

/// Prints a value so that [`parse`] reads it back.
pub(super) fn print(data_type: DataType, bytes: &[u8], relative: bool) -> String {
    match data_type.size() {
        None if data_type == DataType::VisibleString => String::from_utf8_lossy(bytes).into_owned(),
        None => bytes.iter().map(|byte| format!("{byte:02X}")).collect(),
        Some(size) => {
            let mut eight = [0; 8];
            eight
                .iter_mut()
                .zip(bytes)
                .for_each(|(to, from)| *to = *from);
            let raw = u64::from_le_bytes(eight);
            let digits = 2 * size;
            let plus = if relative { "$NODEID+" } else { "" };
            format!("{plus}0x{raw:0digits$X}")
        }
    }
}
