//! Bus recordings: reads and writes candump logs; reads candump terminal text, ASC, BLF, TRC, pcap and pcapng files.
//! Content that is not a frame is counted and reported, never guessed. It opens no files; the caller passes their
//! bytes.

mod asc;
mod blf;
mod candump;
mod pcap;
mod plain;
mod record;
mod text;
mod trc;

use std::fmt;
use std::time::Duration;

use takt_link::capture::Container;

use record::sound;
pub use record::{Direction, LeftOut, Log, Record};
use text::{days_since_1970, lines};

pub use crate::error::LogError;
use crate::{AnyFrame, Frame};

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

impl Log {
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
