//! How many flight files may be written: some at once, further ones only from time to time, so that a device that faults each
//! second neither fills the disk nor has the file of its first fault deleted.

use std::time::Duration;

/// A number of files that grows with time up to a bound.
#[derive(Debug)]
pub(super) struct Credit {
    left: u32,
    most: u32,
    every_ns: i64,
    /// From when on the next one is counted, ns.
    since: i64,
}

impl Credit {
    /// So many files at once, and another one after each such time.
    pub(super) fn new(most: u32, every: Duration) -> Self {
        Self {
            left: most,
            most,
            every_ns: i64::try_from(every.as_nanos()).unwrap_or(i64::MAX),
            since: 0,
        }
    }

    /// Takes one.
    ///
    /// # Errors
    /// If there is none; with the time until there is one.
    pub(super) fn take(&mut self, now: i64) -> Result<(), Duration> {
        let grown = (now - self.since) / self.every_ns.max(1);
        if self.left >= self.most {
            self.since = now;
        } else if grown > 0 {
            let grown = u32::try_from(grown).unwrap_or(u32::MAX);
            self.left = self.left.saturating_add(grown).min(self.most);
            self.since = now;
        }
        match self.left.checked_sub(1) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => {
                let wait = self.since + self.every_ns - now;
                Err(Duration::from_nanos(wait.max(0).unsigned_abs()))
            }
        }
    }
}
