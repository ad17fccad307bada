//! One number type for instants and offsets: a cycle's arithmetic mixes both and must not panic on a
//! corrupt clock or wire value.
//!
//! It is no calendar: the instants are those of `CLOCK_MONOTONIC`, which starts at boot.

use std::{
    fmt,
    num::TryFromIntError,
    ops::{Add, AddAssign, Neg, Sub, SubAssign},
    time::Duration,
};

/// Nanoseconds: an instant on `CLOCK_MONOTONIC` or a signed offset between two. Arithmetic saturates
/// at ±292 years.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Nanos(pub i64);

impl Nanos {
    /// No offset; as an instant, the start of the clock.
    pub const ZERO: Self = Self(0);
    /// The largest offset, about 292 years.
    pub const MAX: Self = Self(i64::MAX);

    /// `micros` microseconds.
    pub const fn from_micros(micros: i64) -> Self {
        Self(micros.saturating_mul(1_000))
    }

    /// `millis` milliseconds.
    pub const fn from_millis(millis: i64) -> Self {
        Self(millis.saturating_mul(1_000_000))
    }

    /// The nearest to `ns`; NaN gives zero.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "saturates, as all arithmetic here"
    )]
    pub(crate) fn from_f64(ns: f64) -> Self {
        Self(ns.round() as i64)
    }

    /// In ns; exact up to 104 days.
    pub(crate) const fn to_f64(self) -> f64 {
        self.0 as f64
    }

    /// In s; exact to a nanosecond up to 104 days.
    #[must_use]
    pub const fn as_secs_f64(self) -> f64 {
        self.to_f64() * 1e-9
    }

    /// Absolute value.
    pub const fn abs(self) -> Self {
        Self(self.0.saturating_abs())
    }
}

impl Add for Nanos {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl Sub for Nanos {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl AddAssign for Nanos {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl SubAssign for Nanos {
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl Neg for Nanos {
    type Output = Self;
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

/// Saturates at 292 years.
impl From<Duration> for Nanos {
    fn from(span: Duration) -> Self {
        Self(i64::try_from(span.as_nanos()).unwrap_or(i64::MAX))
    }
}

/// Fails on a negative offset.
impl TryFrom<Nanos> for Duration {
    type Error = TryFromIntError;
    fn try_from(span: Nanos) -> Result<Self, TryFromIntError> {
        u64::try_from(span.0).map(Self::from_nanos)
    }
}

/// In the largest unit that leaves a whole part, to three decimals at most: `850ns`, `17.6us`, `1ms`.
impl fmt::Display for Nanos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let ns = self.0.unsigned_abs();
        let (thousandths, unit) = match ns {
            0..1_000 => return write!(f, "{sign}{ns}ns"),
            1_000..1_000_000 => (ns, "us"),
            1_000_000..1_000_000_000 => (ns / 1_000, "ms"),
            _ => (ns / 1_000_000, "s"),
        };
        let (whole, fraction) = (thousandths / 1_000, thousandths % 1_000);
        match fraction {
            0 => write!(f, "{sign}{whole}{unit}"),
            _ if fraction % 100 == 0 => write!(f, "{sign}{whole}.{}{unit}", fraction / 100),
            _ if fraction % 10 == 0 => write!(f, "{sign}{whole}.{:02}{unit}", fraction / 10),
            _ => write!(f, "{sign}{whole}.{fraction:03}{unit}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nanos_display_chooses_unit() {
        let table = [
            (0, "0ns"),
            (999, "999ns"),
            (1_000, "1us"),
            (17_600, "17.6us"),
            (17_650, "17.65us"),
            (-17_605, "-17.605us"),
            (1_000_999, "1ms"),
            (1_234_567, "1.234ms"),
            (10_000_000_000, "10s"),
            (i64::MIN, "-9223372036.854s"),
        ];
        for (ns, text) in table {
            assert_eq!(Nanos(ns).to_string(), text);
        }
    }

    #[test]
    fn nanos_arithmetic_saturates() {
        assert_eq!(Nanos::MAX + Nanos(1), Nanos::MAX);
        assert_eq!(-Nanos(i64::MIN), Nanos::MAX);
        assert_eq!(Nanos(i64::MIN) - Nanos(1), Nanos(i64::MIN));
        assert_eq!(Nanos(i64::MIN).abs(), Nanos::MAX);
    }

    #[test]
    fn nanos_convert_to_and_from_duration() {
        assert_eq!(
            Nanos::from(Duration::from_micros(250)),
            Nanos::from_micros(250)
        );
        assert_eq!(Nanos::from(Duration::MAX), Nanos::MAX);
        assert_eq!(
            Duration::try_from(Nanos::from_millis(3)),
            Ok(Duration::from_millis(3))
        );
        assert!(Duration::try_from(Nanos(-1)).is_err());
    }
}
