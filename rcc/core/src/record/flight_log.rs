//! The last lines of the log, for flight files. Bounded: the oldest are dropped first.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use super::level_number;

/// Maximum number of lines that are kept.
const LINES_MAX: usize = 4096;
/// Maximum bytes of a line; the rest is cut off.
const LINE_BYTES_MAX: usize = 4096;

/// A line of the log.
#[derive(Clone, Debug)]
pub(crate) struct FlightLine {
    /// When, ns on `CLOCK_MONOTONIC`.
    pub(crate) at: i64,
    /// As `rcl_interfaces/msg/Log` numbers it.
    pub(crate) level: u8,
    pub(crate) name: String,
    pub(crate) text: String,
}

#[derive(Debug, Default)]
struct Lines {
    lines: VecDeque<FlightLine>,
    /// Number of the first one.
    first: u64,
}

/// The last 4096 lines of the log. Clones keep the same lines.
#[derive(Clone, Debug, Default)]
pub struct FlightLog(Arc<Mutex<Lines>>);

impl FlightLog {
    /// Keeps a line of that part of the program.
    pub fn line_of(&self, level: tracing::Level, part: &str, text: &str) {
        let mut end = text.len().min(LINE_BYTES_MAX);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let line = FlightLine {
            at: takt_rt::monotonic().0,
            level: level_number(level),
            name: part.to_owned(),
            text: text.get(..end).unwrap_or_default().to_owned(),
        };
        let mut lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        lines.lines.push_back(line);
        if lines.lines.len() > LINES_MAX {
            lines.lines.pop_front();
            lines.first += 1;
        }
    }

    /// The number of the first line since that instant.
    pub(crate) fn number_at(&self, since: i64) -> u64 {
        let lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let at = lines.lines.partition_point(|line| line.at < since);
        lines.first + at as u64
    }

    /// The line of that number, or the next that is kept, if it is of before that instant; `next` moves behind it.
    pub(crate) fn line(&self, next: &mut u64, before: i64) -> Option<FlightLine> {
        let lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let number = lines.first.max(*next);
        let at = usize::try_from(number - lines.first).ok()?;
        let line = lines.lines.get(at).filter(|line| line.at < before)?;
        *next = number + 1;
        Some(line.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_log_keeps_last_lines_in_bounds() {
        let log = FlightLog::default();
        for number in 0..LINES_MAX + 10 {
            log.line_of(tracing::Level::INFO, "test", &number.to_string());
        }
        let mut next = 0;
        let first = log.line(&mut next, i64::MAX).unwrap();
        assert_eq!((first.text.as_str(), next), ("10", 11));
        let long = "ä".repeat(LINE_BYTES_MAX);
        log.line_of(tracing::Level::WARN, "test", &long);
        let mut last = u64::try_from(LINES_MAX).unwrap() + 10;
        assert_eq!(log.line(&mut last.clone(), 0).map(|line| line.at), None);
        let line = log.line(&mut last, i64::MAX).unwrap();
        assert_eq!((line.text.len(), line.level), (LINE_BYTES_MAX, 30));
    }
}
