//! SYNC (CiA 301, clause 7.2.5): who sends it on a grid of time, and who listens to it with its
//! counter and its window. Which PDOs it carries along is not known here.

use std::time::Duration;

/// Largest counter overflow value, 1019h.
pub const OVERFLOW_MAX: u8 = 240;

/// A SYNC of another length than 1019h says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a SYNC with {len} bytes came; 1019h asks for {expected}")]
pub struct SyncLength {
    /// Bytes that came.
    pub len: u8,
    /// Bytes expected: 1 with a counter, else 0.
    pub expected: u8,
}

/// The counter a SYNC carries: 1 to the overflow value, then 1 again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counter {
    overflow: u8,
    last: u8,
}

impl Counter {
    /// A counter up to the overflow value (1019h), 2 to 240; anything less is no counter.
    #[must_use]
    pub const fn new(overflow: u8) -> Self {
        let overflow = if overflow > OVERFLOW_MAX {
            OVERFLOW_MAX
        } else {
            overflow
        };
        Self { overflow, last: 0 }
    }

    /// The counter of the next SYNC.
    pub const fn advance(&mut self) -> Option<u8> {
        if self.overflow < 2 {
            return None;
        }
        self.last = if self.last >= self.overflow {
            1
        } else {
            self.last + 1
        };
        Some(self.last)
    }
}

/// Who sends SYNC.
#[derive(Clone, Copy, Debug)]
pub struct Producer {
    period: Duration,
    due: Duration,
    counter: Counter,
}

impl Producer {
    /// Sends every `period` (1006h) from `now` on, with a counter up to `overflow` (1019h; 0: none).
    #[must_use]
    pub fn new(period: Duration, overflow: u8, now: Duration) -> Self {
        Self {
            period: period.max(Duration::from_micros(1)),
            due: now,
            counter: Counter::new(overflow),
        }
    }

    /// The counter of the SYNC that is due, if one is. Missed ones are skipped, never sent in a
    /// burst; the grid is kept.
    pub fn poll(&mut self, now: Duration) -> Option<Option<u8>> {
        if now < self.due {
            return None;
        }
        let behind = (now - self.due).as_nanos() / self.period.as_nanos();
        let steps = u32::try_from(behind + 1).unwrap_or(u32::MAX);
        self.due += self.period.saturating_mul(steps);
        Some(self.counter.advance())
    }

    /// When the next one is due.
    #[must_use]
    pub const fn poll_timeout(&self) -> Duration {
        self.due
    }
}

/// Who listens to SYNC.
#[derive(Clone, Copy, Debug, Default)]
pub struct Consumer {
    overflow: u8,
    /// 1007h; zero is without end.
    window: Duration,
    heard: Option<Duration>,
}

impl Consumer {
    /// Expects a counter if `overflow` (1019h) is not 0; PDOs count until `window` (1007h) after
    /// SYNC, for ever if that is zero.
    #[must_use]
    pub const fn new(overflow: u8, window: Duration) -> Self {
        Self {
            overflow,
            window,
            heard: None,
        }
    }

    /// Takes a SYNC; returns its counter.
    ///
    /// # Errors
    /// If it has not the length that is expected; it counts nevertheless only for its time.
    pub fn handle(&mut self, data: &[u8], now: Duration) -> Result<Option<u8>, SyncLength> {
        let expected = u8::from(self.overflow > 0);
        let len = u8::try_from(data.len()).unwrap_or(u8::MAX);
        if len != expected {
            return Err(SyncLength { len, expected });
        }
        self.heard = Some(now);
        Ok(data.first().copied())
    }

    /// Whether synchronous PDOs count now: within the window after a SYNC.
    #[must_use]
    pub fn is_open(&self, now: Duration) -> bool {
        let within = |heard| now.saturating_sub(heard) <= self.window;
        self.window.is_zero() || self.heard.is_some_and(within)
    }

    /// When the last SYNC came.
    #[must_use]
    pub const fn heard(&self) -> Option<Duration> {
        self.heard
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn grid_is_kept_and_missed_ones_are_skipped() {
        let mut producer = Producer::new(2 * MS, 3, 10 * MS);
        assert_eq!(producer.poll(9 * MS), None);
        assert_eq!(producer.poll(10 * MS), Some(Some(1)));
        assert_eq!(producer.poll(Duration::from_micros(12_300)), Some(Some(2)));
        assert_eq!(producer.poll_timeout(), 14 * MS);
        assert_eq!(producer.poll(29 * MS), Some(Some(3)), "one, not eight");
        assert_eq!(producer.poll_timeout(), 30 * MS);
        assert_eq!(
            producer.poll(30 * MS),
            Some(Some(1)),
            "after the overflow value"
        );
    }

    #[test]
    fn counters_count_from_one_to_their_overflow() {
        for overflow in 0..=u8::MAX {
            let mut counter = Counter::new(overflow);
            let counted: Vec<_> = (0..500).map(|_| counter.advance()).collect();
            let top = u32::from(overflow.min(OVERFLOW_MAX));
            for (n, value) in (0_u32..).zip(&counted) {
                let expected = (top >= 2).then(|| n % top + 1);
                assert_eq!(value.map(u32::from), expected, "{overflow}");
            }
        }
    }

    #[test]
    fn lengths_are_checked_and_the_window_closes() {
        let mut plain = Consumer::new(0, MS);
        assert!(!plain.is_open(Duration::ZERO), "no SYNC yet");
        assert_eq!(plain.handle(&[], 5 * MS), Ok(None));
        assert!(plain.is_open(6 * MS) && !plain.is_open(7 * MS));
        let wrong = SyncLength {
            len: 1,
            expected: 0,
        };
        assert_eq!(plain.handle(&[1], 8 * MS), Err(wrong));
        let mut counting = Consumer::new(10, Duration::ZERO);
        assert!(counting.is_open(Duration::ZERO), "without a window always");
        assert_eq!(counting.handle(&[7], MS), Ok(Some(7)));
        assert_eq!(
            counting.handle(&[], MS),
            Err(SyncLength {
                len: 0,
                expected: 1
            })
        );
    }
}
