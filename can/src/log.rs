//! Recordings of buses: candump logs are read and written; candump's text, ASC, BLF, TRC, pcap and pcapng files are
//! read. What a file holds that is no frame is counted and reported, never guessed. Opens no file; it is given their
//! bytes.

mod asc;
mod blf;
mod candump;
mod pcap;
mod plain;
mod trc;

use std::fmt;
use std::time::Duration;

pub use crate::error::LogError;
use crate::{AnyFrame, Frame};

/// Which way a frame went, seen from the machine that logged it (`candump -x`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the bus.
    Received,
    /// Sent by the machine itself.
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

/// A frame of any kind, when and where it was seen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// Since 1970, or since whatever the log counts from.
    pub at: Duration,
    /// Name of the interface, as `can0`; logs that count channels give their number.
    pub interface: String,
    /// What was seen.
    pub frame: AnyFrame,
    /// Not every log tells.
    pub direction: Option<Direction>,
}

/// The year 10,000: what comes then is damage, and sums of earlier times never overflow.
const LATEST: Duration = Duration::from_secs(253_402_300_800);

/// Refuses times that no recording has.
fn sound(at: Duration) -> Result<Duration, LogError> {
    if at < LATEST {
        Ok(at)
    } else {
        Err(LogError::Late)
    }
}

impl Record {
    /// Reads one line of a candump log, with or without its line end.
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

/// A line of a candump log that holds a classic data or remote frame: what CANopen is made of.
/// Lines with other frames are read by [`Record::parse`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogLine<'a> {
    /// Since 1970, or since whatever the log counts from. Whole microseconds are printed.
    pub at: Duration,
    /// Name of the interface, as `can0`.
    pub interface: &'a str,
    /// What was seen.
    pub frame: Frame,
    /// Not every log tells.
    pub direction: Option<Direction>,
}

impl<'a> LogLine<'a> {
    /// Reads one line, with or without its line end.
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

/// Reads a frame as it is written in a candump log and for cansend: `123#DEADBEEF`, `123#R4`, `123##1AB`.
///
/// # Errors
/// As [`LogError`] tells.
pub fn parse_frame(text: &str) -> Result<AnyFrame, LogError> {
    candump::frame(text)
}

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Log of candump (`candump -l`, `-L`).
    Candump,
    /// Text of Vector's tools.
    Asc,
    /// Binary log of Vector's tools.
    Blf,
    /// What candump prints on a terminal, with or without time stamps.
    Plain,
    /// Text of PEAK's tools.
    Trc,
    /// Recording of tcpdump, with the link type of CAN or of the "any" device.
    Pcap,
    /// The newer kind of it, as Wireshark writes it.
    PcapNg,
    /// None of these.
    Unknown,
}

/// Bytes in which the kind of a text is looked for.
const HEAD_MAX: usize = 64 << 10;

impl Format {
    /// The kind of a file by its content. An empty one is a candump log.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        if bytes.starts_with(blf::MAGIC) {
            Self::Blf
        } else if asc::is_asc(bytes) {
            Self::Asc
        } else if trc::is_trc(bytes) {
            Self::Trc
        } else if pcap::is_pcap(bytes) {
            Self::Pcap
        } else if pcap::is_pcapng(bytes) {
            Self::PcapNg
        } else {
            Self::of_text(bytes.get(..HEAD_MAX).unwrap_or(bytes))
        }
    }

    /// A text is what its first line with a frame is, even a damaged one.
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

    /// What a place in such a file is: see [`LeftOut::place`].
    #[must_use]
    pub const fn place(self) -> &'static str {
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

/// Something in a file that is no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// Line of a text, from 1; byte of a binary file, from 0.
    pub place: usize,
    /// What is wrong with it.
    pub why: LogError,
}

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Log {
    /// Frames in the order of the file.
    pub records: Vec<Record>,
    /// The first things that are no frames, at most [`Log::LEFT_OUT_MAX`].
    pub left_out: Vec<LeftOut>,
    /// How many things are no frames.
    pub left_out_count: usize,
}

impl Log {
    /// Reasons that are kept.
    pub const LEFT_OUT_MAX: usize = 16;

    /// Reads all that can be read; the kind of file is found by how it begins.
    #[must_use]
    pub fn read(bytes: &[u8]) -> Self {
        let mut log = Self::default();
        match Format::of(bytes) {
            Format::Candump => candump::read(bytes, &mut log),
            Format::Asc => asc::read(bytes, &mut log),
            Format::Blf => blf::read(bytes, &mut log),
            Format::Plain => plain::read(bytes, &mut log),
            Format::Trc => trc::read(bytes, &mut log),
            Format::Pcap => pcap::read(bytes, &mut log),
            Format::PcapNg => pcap::read_ng(bytes, &mut log),
            Format::Unknown => log.leave_out(0, LogError::Unknown),
        }
        log
    }

    fn leave_out(&mut self, place: usize, why: LogError) {
        self.left_out_count += 1;
        if self.left_out.len() < Self::LEFT_OUT_MAX {
            self.left_out.push(LeftOut { place, why });
        }
    }

    fn take(&mut self, place: usize, record: Result<Record, LogError>) {
        match record.and_then(|record| sound(record.at).map(|_| record)) {
            Ok(record) => self.records.push(record),
            Err(why) => self.leave_out(place, why),
        }
    }
}

/// Lines of a text that need not be UTF-8 throughout, with their numbers from 1.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, std::borrow::Cow<'_, str>)> + Clone {
    bytes
        .split(|byte| *byte == b'\n')
        .enumerate()
        .map(|(number, line)| (number + 1, String::from_utf8_lossy(line)))
}

/// Days from 1970-01-01 to a day of the Gregorian calendar, 1970 to 9999.
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
    fn days_are_those_of_the_calendar() {
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
    fn kind_of_a_file_is_found_by_its_beginning() {
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
