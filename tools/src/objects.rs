//! Objects of drives in JSON, for all buses.

use serde_json::Value;
use takt_cia402::dictionary::DataType;

/// The value of an object: a number if its type is one, else the text that is printed.
pub(crate) fn json(data_type: Option<DataType>, bytes: &[u8], shown: String) -> Value {
    let number = |data_type: DataType| -> Option<Value> {
        let real = |number: f64| serde_json::Number::from_f64(number).map(Value::Number);
        if data_type == DataType::Real32 {
            return real(f32::from_le_bytes(bytes.try_into().ok()?).into());
        }
        if data_type == DataType::Real64 {
            return real(f64::from_le_bytes(bytes.try_into().ok()?));
        }
        let is_whole = data_type.size() == Some(bytes.len());
        let number = data_type.integer(bytes).filter(|_| is_whole)?;
        let small = i64::try_from(number).map(Value::from);
        small
            .or_else(|_| u64::try_from(number).map(Value::from))
            .ok()
    };
    data_type.and_then(number).unwrap_or(Value::String(shown))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn object_numbers_are_json_numbers() {
        let value = |kind, bytes: &[u8]| json(kind, bytes, "text".to_owned());
        let table = [
            (Some(DataType::Integer16), vec![0xFE, 0xFF], json!(-2)),
            (Some(DataType::Unsigned8), vec![7], json!(7)),
            (
                Some(DataType::Unsigned64),
                vec![0xFF; 8],
                json!(18_446_744_073_709_551_615_u64),
            ),
            (
                Some(DataType::Real32),
                1.5_f32.to_le_bytes().to_vec(),
                json!(1.5),
            ),
            (
                Some(DataType::Real64),
                f64::NAN.to_le_bytes().to_vec(),
                json!("text"),
            ),
            (Some(DataType::Integer16), vec![1], json!("text")),
            (Some(DataType::VisibleString), b"12".to_vec(), json!("text")),
            (None, vec![1], json!("text")),
        ];
        for (kind, bytes, expected) in table {
            assert_eq!(value(kind, &bytes), expected, "{kind:?} {bytes:?}");
        }
    }
}
