//! Bus recordings: reads and writes candump logs; reads candump terminal text, ASC, BLF, TRC, pcap and pcapng files.
//! Content that is not a frame is counted and reported, never guessed. It opens no files; the caller passes their
//! bytes.

mod asc;
mod blf;
mod candump;
mod pcap;
mod plain;
mod trc;

use std::fmt;
use std::time::Duration;

use takt_link::capture::Container;

pub use crate::error::LogError;
use crate::{AnyFrame, Frame};

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
fn sound(at: Duration) -> Result<Duration, LogError> {
    if at < LATEST {
        Ok(at)
    } else {
        Err(LogError::Late)
    }
}

impl Record {
    /// Reads one line of a candump log, with or without line ending.
    pub fn parse(line: &str) -> Result<Self, LogError> {
        let line = candump::Line::parse(line)?;
        Ok(Self {
            at: line.at,
            interface: line.interface.to_owned(),
            frame: line.frame,
            direction: line.direction,
        })
    }
}

impl fmt::Display for Record {
    /// A line of a candump log. Whole microseconds are printed.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (at, interface) = (self.at, self.interface.as_str());
        candump::write(f, at, interface, &self.frame, self.direction)
    }
}

/// A line of a candump log with a classic data or remote frame, as CANopen uses. [`Record::parse`]
/// reads lines with other frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogLine<'a> {
    /// Time since 1970, or since the log's own epoch. Whole microseconds are printed.
    pub at: Duration,
    /// Name of the interface, as `can0`.
    pub interface: &'a str,
    /// The frame.
    pub frame: Frame,
    /// Direction, if recorded.
    pub direction: Option<Direction>,
}

impl<'a> LogLine<'a> {
    /// Reads one line, with or without line ending.
    pub fn parse(line: &'a str) -> Result<Self, LogError> {
        let line = candump::Line::parse(line)?;
        let what = match line.frame {
            AnyFrame::Classic(frame) => {
                return Ok(Self {
                    at: line.at,
                    interface: line.interface,
                    frame,
                    direction: line.direction,
                });
            }
            AnyFrame::Fd(_) => "a CAN FD frame",
            AnyFrame::Error(_) => "an error frame",
        };
        Err(LogError::Unsupported { what })
    }
}

impl fmt::Display for LogLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        candump::write(f, self.at, self.interface, &self.frame, self.direction)
    }
}

/// Reads a frame in the syntax of candump logs and cansend: `123#DEADBEEF`, `123#R4`, `123##1AB`.
pub fn parse_frame(text: &str) -> Result<AnyFrame, LogError> {
    candump::frame(text)
}

/// File formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Log of candump (`candump -l`, `-L`).
    Candump,
    /// Text format of Vector's tools.
    Asc,
    /// Binary format of Vector's tools.
    Blf,
    /// Terminal output of candump, with or without time stamps.
    Plain,
    /// Text format of PEAK's tools.
    Trc,
    /// pcap, with the link type of CAN or of the "any" device.
    Pcap,
    /// pcapng, as written by Wireshark.
    PcapNg,
    /// None of these.
    Unknown,
}

/// Number of bytes searched to detect a text format.
const HEAD_MAX: usize = 64 << 10;

impl Format {
    /// Detects the format of a file from its content. An empty file is a candump log.
    pub fn of(bytes: &[u8]) -> Self {
        if bytes.starts_with(blf::MAGIC) {
            Self::Blf
        } else if asc::is_asc(bytes) {
            Self::Asc
        } else if trc::is_trc(bytes) {
            Self::Trc
        } else {
            match Container::of(bytes) {
                Some(Container::Pcap) => Self::Pcap,
                Some(Container::PcapNg) => Self::PcapNg,
                None => Self::of_text(bytes.get(..HEAD_MAX).unwrap_or(bytes)),
            }
        }
    }

    /// The first line with a frame, even a damaged one, determines the text format.
    fn of_text(bytes: &[u8]) -> Self {
        let mut lines = lines(bytes).filter(|(_, line)| !line.trim().is_empty());
        let first = lines.clone().next();
        let known = lines.find_map(|(_, line)| match line.trim() {
            line if line.starts_with('(') && line.contains('#') => Some(Self::Candump),
            line => plain::is_line(line).then_some(Self::Plain),
        });
        match first {
            Some(_) => known.unwrap_or(Self::Unknown),
            None => Self::Candump,
        }
    }

    /// Unit of [`LeftOut::location`] in this format: line or byte.
    pub const fn location_unit(self) -> &'static str {
        match self {
            Self::Candump | Self::Asc | Self::Plain | Self::Trc => "line",
            Self::Blf | Self::Pcap | Self::PcapNg | Self::Unknown => "byte",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Candump => "candump log",
            Self::Asc => "ASC file",
            Self::Blf => "BLF file",
            Self::Plain => "candump text",
            Self::Trc => "TRC file",
            Self::Pcap => "pcap file",
            Self::PcapNg => "pcapng file",
            Self::Unknown => "unknown file",
        })
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

    /// Reads all frames of a file; detects its format from the beginning.
    pub fn read(bytes: &[u8]) -> Self {
        let mut log = Self::default();
        match Format::of(bytes) {
            Format::Candump => candump::read(bytes, &mut log),
            Format::Asc => asc::read(bytes, &mut log),
            Format::Blf => blf::read(bytes, &mut log),
            Format::Plain => plain::read(bytes, &mut log),
            Format::Trc => trc::read(bytes, &mut log),
            Format::Pcap | Format::PcapNg => pcap::read(bytes, &mut log),
            Format::Unknown => log.leave_out(0, LogError::Unknown),
        }
        log
    }

    fn leave_out(&mut self, location: usize, why: LogError) {
        self.left_out_count += 1;
        if self.left_out.len() < Self::LEFT_OUT_MAX {
            self.left_out.push(LeftOut { location, why });
        }
    }

    fn take(&mut self, location: usize, record: Result<Record, LogError>) {
        match record.and_then(|record| sound(record.at).map(|_| record)) {
            Ok(record) => self.records.push(record),
            Err(why) => self.leave_out(location, why),
        }
    }
}

/// Lines of a text with their numbers from 1; the text need not be valid UTF-8.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, std::borrow::Cow<'_, str>)> + Clone {
    bytes
        .split(|byte| *byte == b'\n')
        .enumerate()
        .map(|(number, line)| (number + 1, String::from_utf8_lossy(line)))
}

/// Days from 1970-01-01 to a Gregorian date, 1970 to 9999.
fn days_since_1970(year: u32, month: u32, day: u32) -> Option<u64> {
    const BEFORE: [u32; 12] = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334];
    if !(1970..=9999).contains(&year) || !(1..=31).contains(&day) {
        return None;
    }
    let leaps = |year: u32| year / 4 - year / 100 + year / 400;
    let is_leap = leaps(year) > leaps(year - 1);
    let before = BEFORE.get(usize::try_from(month.checked_sub(1)?).ok()?)?;
    let past_february = u32::from(month > 2 && is_leap);
    let days = (year - 1970) * 365 + leaps(year - 1) - leaps(1969);
    Some(u64::from(days + before + past_february + day - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_days_follow_gregorian_calendar() {
        for (year, month, day, days) in [
            (1970, 1, 1, 0),
            (1999, 12, 31, 10_956),
            (2000, 2, 29, 11_016),
            (2000, 3, 1, 11_017),
            (2023, 11, 14, 19_675),
            (2100, 3, 1, 47_541),
        ] {
            assert_eq!(
                days_since_1970(year, month, day),
                Some(days),
                "{year}-{month}-{day}"
            );
        }
        for (year, month, day) in [
            (1969, 1, 1),
            (2000, 0, 1),
            (2000, 13, 1),
            (2000, 1, 0),
            (10_000, 1, 1),
        ] {
            assert_eq!(days_since_1970(year, month, day), None);
        }
    }

    #[test]
    fn log_format_is_detected_from_file_start() {
        assert_eq!(Format::of(b"LOGG...."), Format::Blf);
        assert_eq!(Format::of(b"\n date Tue Nov 14\n"), Format::Asc);
        assert_eq!(Format::of(b"(1.000000) can0 123#"), Format::Candump);
        assert_eq!(Format::of(b"x\n  can0  701   [1]  00\n"), Format::Plain);
        assert_eq!(Format::of(b";$FILEVERSION=2.1\n"), Format::Trc);
        assert_eq!(Format::of(b"\xD4\xC3\xB2\xA1...."), Format::Pcap);
        assert_eq!(Format::of(b"\n\r\r\n...."), Format::PcapNg);
        assert_eq!(Format::of(b"\x7FELF"), Format::Unknown);
        let log = Log::read(b"a letter\nof two lines\n");
        assert_eq!(
            (log.left_out_count, log.left_out[0].why),
            (1, LogError::Unknown)
        );
        assert_eq!(Format::of(b""), Format::Candump);
    }
}
