//! The last lines of the log, for HTTP clients, and a rate limit for lines that clients can cause. This module
//! writes no log itself; the program that sets up logging feeds it.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Lines that are kept; beyond that the oldest is dropped.
pub(crate) const LOG_LINES_MAX: usize = 4096;

/// Most bytes of one line; longer lines are truncated.
pub(crate) const LOG_LINE_BYTES_MAX: usize = 1024;

/// The last lines of the log. Clones share it. As an [`io::Write`] it expects whole lines, as
/// loggers write them.
#[derive(Clone, Debug, Default)]
pub struct LogBook(Arc<Mutex<Lines>>);

#[derive(Debug, Default)]
struct Lines {
    /// Number of the oldest line kept.
    first: u64,
    lines: VecDeque<String>,
}

impl LogBook {
    /// Adds a line.
    pub fn push(&self, line: &str) {
        let mut end = line.len().min(LOG_LINE_BYTES_MAX);
        while !line.is_char_boundary(end) {
            end -= 1;
        }
        let line = line.get(..end).unwrap_or_default().to_owned();
        let mut log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if log.lines.len() == LOG_LINES_MAX {
            log.lines.pop_front();
            log.first += 1;
        }
        log.lines.push_back(line);
    }

    /// The lines from number `start` on that contain `filter`, with their numbers, and the number of the
    /// next line to be written.
    pub fn lines(&self, start: u64, filter: &str) -> (Vec<(u64, String)>, u64) {
        let log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let numbered = (log.first..).zip(&log.lines);
        let wanted = numbered.filter(|(n, line)| *n >= start && line.contains(filter));
        let lines = wanted.map(|(n, line)| (n, line.clone())).collect();
        let next = log.first + u64::try_from(log.lines.len()).unwrap_or(u64::MAX);
        (lines, next)
    }
}

impl io::Write for LogBook {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(bytes);
        for line in text.lines().filter(|line| !line.is_empty()) {
            self.push(line);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Lines of one kind that are logged within [`LIMIT_WINDOW`].
const LIMIT_LINES: u32 = 5;

/// See [`LIMIT_LINES`].
const LIMIT_WINDOW: Duration = Duration::from_secs(10);

/// Rate limit for log lines of one kind that clients can cause; counts the suppressed ones.
#[derive(Debug, Default)]
pub(crate) struct LineLimit(Mutex<Limited>);

#[derive(Debug, Default)]
struct Limited {
    since: Duration,
    lines: u32,
    suppressed: u64,
}

impl LineLimit {
    /// Whether a line may be logged now; if so, how many were suppressed since the last one.
    pub(crate) fn admit(&self, now: Duration) -> Option<u64> {
        let mut limited = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if now.saturating_sub(limited.since) >= LIMIT_WINDOW {
            (limited.since, limited.lines) = (now, 0);
        }
        if limited.lines >= LIMIT_LINES {
            limited.suppressed += 1;
            return None;
        }
        limited.lines += 1;
        Some(std::mem::take(&mut limited.suppressed))
    }

    /// How many lines were suppressed, once the window is over, so that the last ones are reported too.
    pub(crate) fn flush(&self, now: Duration) -> Option<u64> {
        let mut limited = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let over = now.saturating_sub(limited.since) >= LIMIT_WINDOW;
        (over && limited.suppressed > 0).then(|| std::mem::take(&mut limited.suppressed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    #[test]
    fn lines_beyond_the_limit_are_counted() {
        let limit = LineLimit::default();
        let at = Duration::from_secs;
        for _ in 0..LIMIT_LINES {
            assert_eq!(limit.admit(at(1)), Some(0));
        }
        assert_eq!([limit.admit(at(2)), limit.admit(at(9))], [None, None]);
        assert_eq!(limit.flush(at(9)), None);
        assert_eq!(limit.admit(at(10)), Some(2));
        for _ in 0..LIMIT_LINES {
            limit.admit(at(10));
        }
        assert_eq!((limit.flush(at(20)), limit.flush(at(21))), (Some(1), None));
    }

    #[test]
    fn log_lines_keep_numbers_when_oldest_drop() {
        let log = LogBook::default();
        for number in 0..LOG_LINES_MAX + 10 {
            log.push(&format!("line {number}"));
        }
        let (lines, next) = log.lines(0, "");
        assert_eq!((lines.len(), next), (LOG_LINES_MAX, 4106));
        assert_eq!(lines[0], (10, "line 10".to_owned()));
        assert_eq!(log.lines(4105, "").0, [(4105, "line 4105".to_owned())]);
        assert_eq!(log.lines(4106, "").0, []);
        assert_eq!(log.lines(0, "line 4000").0.len(), 1);
    }

    #[test]
    fn long_lines_are_cut_between_characters() {
        let mut log = LogBook::default();
        writeln!(log, "{}", "ä".repeat(LOG_LINE_BYTES_MAX)).unwrap();
        let (lines, _) = log.lines(0, "");
        assert_eq!(lines[0].1.len(), LOG_LINE_BYTES_MAX);
        log.push(&format!("a{}", "ä".repeat(LOG_LINE_BYTES_MAX)));
        assert_eq!(log.lines(1, "").0[0].1.len(), LOG_LINE_BYTES_MAX - 1);
    }
}
