//! TIME (CiA 301, clause 7.2.6): the time of day. The owner reads the clock.

use std::time::Duration;

use super::message::{TIME, frame};
use crate::Frame;

/// ms in a day.
const DAY_MS: u32 = 86_400_000;
/// Days from 1970-01-01 to 1984-01-01.
const EPOCH_DAYS: u64 = 5113;

/// TIME_OF_DAY.
///
/// | bytes | content |
/// |---|---|
/// | 0 to 3 | ms since midnight, in the lowest 28 bits |
/// | 4, 5 | days since 1984-01-01 |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct TimeOfDay {
    /// Days since 1984-01-01.
    pub days: u16,
    /// ms since midnight, 0 to 86,399,999.
    pub ms: u32,
}

impl TimeOfDay {
    /// The time of day at a time since 1970-01-01; clamped to 1984 to 2163.
    pub fn from_unix(since: Duration) -> Self {
        let days = since.as_secs() / 86_400;
        let ms = since.as_millis() % u128::from(DAY_MS);
        Self {
            days: u16::try_from(days.saturating_sub(EPOCH_DAYS)).unwrap_or(u16::MAX),
            ms: u32::try_from(ms).unwrap_or(0),
        }
    }

    /// The time since 1970-01-01.
    pub fn unix(self) -> Duration {
        let days = u64::from(self.days) + EPOCH_DAYS;
        Duration::from_secs(days * 86_400) + Duration::from_millis(self.ms.into())
    }

    /// The frame, on the default identifier.
    pub fn frame(self) -> Frame {
        let [a, b, c, d] = (self.ms & 0x0FFF_FFFF).to_le_bytes();
        let [e, f] = self.days.to_le_bytes();
        frame(TIME, &[a, b, c, d, e, f])
    }

    /// From the bytes of a frame.
    pub fn decode(data: &[u8]) -> Option<Self> {
        let [a, b, c, d, e, f] = *data.first_chunk::<6>()?;
        Some(Self {
            days: u16::from_le_bytes([e, f]),
            ms: u32::from_le_bytes([a, b, c, d]) & 0x0FFF_FFFF,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_of_day_starts_1984_and_reads_back() {
        // 2000-01-01 12:00 UTC is 946,728,000 s.
        let noon = TimeOfDay::from_unix(Duration::from_secs(946_728_000));
        assert_eq!((noon.days, noon.ms), (5844, 43_200_000));
        assert_eq!(noon.unix(), Duration::from_secs(946_728_000));
        assert_eq!(noon.frame().to_string(), "100#002E9302D416");
        assert_eq!(TimeOfDay::decode(noon.frame().data()), Some(noon));
        assert_eq!(TimeOfDay::decode(&[0; 5]), None);
        assert_eq!(TimeOfDay::from_unix(Duration::ZERO).days, 0);
    }
}
