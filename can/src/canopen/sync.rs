//! SYNC (CiA 301, clause 7.2.5): producer on a time grid, and consumer with counter and window.

use std::time::Duration;

/// Maximum counter overflow value, 1019h.
pub(crate) const OVERFLOW_MAX: u8 = 240;

/// A SYNC whose length does not match 1019h.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("received a SYNC with {len} bytes; 1019h requires {expected}")]
pub struct SyncLength {
    /// Received bytes.
    pub len: u8,
    /// Expected bytes: 1 with a counter, else 0.
    pub expected: u8,
}

/// SYNC counter: 1 to the overflow value, then 1 again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counter {
    overflow: u8,
    last: u8,
}

impl Counter {
    /// A counter up to the overflow value (1019h), 2 to 240; smaller values disable it.
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

/// SYNC producer.
#[derive(Clone, Copy, Debug)]
pub struct Producer {
    period: Duration,
    due: Duration,
    counter: Counter,
}

impl Producer {
    /// Produces a SYNC every `period` (1006h) from `now` on, with a counter up to `overflow` (1019h; 0: none).
    pub fn new(period: Duration, overflow: u8, now: Duration) -> Self {
        Self {
            period: period.max(Duration::from_micros(1)),
            due: now,
            counter: Counter::new(overflow),
        }
    }

    /// The counter of the due SYNC, if any. Missed ones are skipped without a burst; the grid is
    /// kept.
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
    pub const fn poll_timeout(&self) -> Duration {
        self.due
    }
}

/// SYNC consumer.
#[derive(Clone, Copy, Debug, Default)]
pub struct Consumer {
    overflow: u8,
    /// 1007h; zero: unlimited.
    window: Duration,
    last_received: Option<Duration>,
}

impl Consumer {
    /// Expects a counter if `overflow` (1019h) is not 0; the window for synchronous PDOs is open
    /// until `window` (1007h) after SYNC, always if that is zero.
    pub const fn new(overflow: u8, window: Duration) -> Self {
        Self {
            overflow,
            window,
            last_received: None,
        }
    }

    /// Handles a SYNC; returns its counter.
    ///
    /// # Errors
    /// If its length is wrong; its time still opens the window.
    pub fn handle(&mut self, data: &[u8], now: Duration) -> Result<Option<u8>, SyncLength> {
        let expected = u8::from(self.overflow > 0);
        let len = u8::try_from(data.len()).unwrap_or(u8::MAX);
        if len != expected {
            return Err(SyncLength { len, expected });
        }
        self.last_received = Some(now);
        Ok(data.first().copied())
    }

    /// Whether the window for synchronous PDOs is open.
    pub fn is_open(&self, now: Duration) -> bool {
        let within = |at| now.saturating_sub(at) <= self.window;
        self.window.is_zero() || self.last_received.is_some_and(within)
    }

    /// Time of the last SYNC.
    pub const fn last_received(&self) -> Option<Duration> {
        self.last_received
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn sync_producer_keeps_grid_and_skips_missed() {
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
    fn sync_counter_counts_from_one_to_overflow() {
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
    fn sync_consumer_checks_length_and_closes_window() {
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
