//! What a recording consists of: frames with their times, and what is not a frame. The readers of all formats fill it;
//! it knows none of them.

use std::fmt;
use std::time::Duration;

use crate::AnyFrame;
use crate::error::LogError;

/// Direction of a frame, seen from the logging host (`candump -x`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Received from the bus.
    Received,
    /// Sent by the logging host.
    Transmitted,
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Received => "R",
            Self::Transmitted => "T",
        })
    }
}

/// A recorded frame with time and interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// Time since 1970, or since the log's own epoch.
    pub at: Duration,
    /// Name of the interface, as `can0`; or the channel number.
    pub interface: String,
    /// The frame.
    pub frame: AnyFrame,
    /// Direction, if recorded.
    pub direction: Option<Direction>,
}

/// The year 10,000: later times are damaged, and sums of earlier times never overflow.
const LATEST: Duration = Duration::from_secs(253_402_300_800);

/// Rejects times beyond the year 9999.
pub(super) fn sound(at: Duration) -> Result<Duration, LogError> {
    if at < LATEST {
        Ok(at)
    } else {
        Err(LogError::Late)
    }
}

/// Content of a file that is not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// Line number of a text file, from 1; byte offset in a binary file.
    pub location: usize,
    /// Why it was skipped.
    pub why: LogError,
}

/// Content of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Log {
    /// Frames in the order of the file.
    pub records: Vec<Record>,
    /// The first skipped items, at most [`Log::LEFT_OUT_MAX`].
    pub left_out: Vec<LeftOut>,
    /// Total number of skipped items.
    pub left_out_count: usize,
}

impl Log {
    /// Maximum number of entries in [`Log::left_out`].
    pub const LEFT_OUT_MAX: usize = 16;

    pub(super) fn leave_out(&mut self, location: usize, why: LogError) {
        self.left_out_count += 1;
        if self.left_out.len() < Self::LEFT_OUT_MAX {
            self.left_out.push(LeftOut { location, why });
        }
    }

    pub(super) fn take(&mut self, location: usize, record: Result<Record, LogError>) {
        match record.and_then(|record| sound(record.at).map(|_| record)) {
            Ok(record) => self.records.push(record),
            Err(why) => self.leave_out(location, why),
        }
    }
}
