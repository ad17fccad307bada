//! Durations as text: `250us`, `1ms`, `5s`. A bare number is rejected, because its
//! unit is ambiguous.

use std::time::Duration;

/// A text is not a duration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no duration: write a number and a unit, such as 250us, 1ms, 5s or 2min")]
pub struct SpanError(String);

/// Reads a duration such as `250us` or `1.5ms`; units are ns, us, ms, s, min and h.
///
/// # Errors
/// If the text is no such duration, or has no unit.
pub fn parse(text: &str) -> Result<Duration, SpanError> {
    let error = || SpanError(text.to_owned());
    let trimmed = text.trim();
    let unit_at = trimmed
        .find(|c: char| c.is_ascii_alphabetic())
        .ok_or_else(error)?;
    let (number, unit) = trimmed.split_at(unit_at);
    let number: f64 = number.trim().parse().map_err(|_| error())?;
    let seconds = match unit {
        "ns" => number * 1e-9,
        "us" => number * 1e-6,
        "ms" => number * 1e-3,
        "s" => number,
        "min" => number * 60.0,
        "h" => number * 3600.0,
        _ => return Err(error()),
    };
    Duration::try_from_secs_f64(seconds).map_err(|_| error())
}

/// Serde functions for a field that holds a duration as text.
pub mod text {
    use std::time::Duration;

    use serde::{Deserialize, Deserializer};

    /// Reads the duration.
    ///
    /// # Errors
    /// If the field holds no text, or no duration.
    pub fn deserialize<'de, D: Deserializer<'de>>(input: D) -> Result<Duration, D::Error> {
        super::parse(&String::deserialize(input)?).map_err(serde::de::Error::custom)
    }

    /// Reads the duration of an optional field.
    ///
    /// # Errors
    /// If the field holds no text, or no duration.
    pub fn deserialize_some<'de, D: Deserializer<'de>>(
        input: D,
    ) -> Result<Option<Duration>, D::Error> {
        deserialize(input).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_units() {
        assert_eq!(parse("250us"), Ok(Duration::from_micros(250)));
        assert_eq!(parse("1.5ms"), Ok(Duration::from_micros(1500)));
        assert_eq!(parse("2min"), Ok(Duration::from_secs(120)));
        assert_eq!(parse(" 5 s "), Ok(Duration::from_secs(5)));
    }

    #[test]
    fn durations_without_unit_are_rejected() {
        for text in ["5", "", "ms", "-1s", "1e400s", "5 weeks", "nan s"] {
            assert!(parse(text).is_err(), "{text}");
        }
    }
}
