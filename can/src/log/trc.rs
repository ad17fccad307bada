//! TRC files: the text format of PEAK's tools (PCAN-View, PCAN-Explorer), versions 1.0 to 2.1. Reads frames and error
//! frames; skips lines about the hardware state.
//!
//! ```text
//! ;$FILEVERSION=1.1                                    ;$FILEVERSION=2.1
//! ;$STARTTIME=43008.9200944806                         ;$STARTTIME=43008.9200944806
//!                                                      ;$COLUMNS=N,O,T,B,I,d,R,L,D
//!      1)      1059.9  Rx     0300  2  00 01               1      1059.900 DT 1     0300 Rx - 2    00 01
//! ```
//!
//! | letter | column | | letter | column |
//! |---|---|---|---|---|
//! | N | number | | d | direction; in version 1 also the type |
//! | O | time since the start, ms | | R | reserved |
//! | T | type: DT, FD, FB, FE, BI, RR, ER, ... | | l | length code |
//! | B | bus | | L | bytes of data |
//! | I | identifier: 4 digits for 11 bits, 8 for 29 | | D | data |

use std::time::Duration;

use super::{Direction, Log, Record};
use crate::fault::class;
use crate::{AnyFrame, ErrorFrame, FdFrame, Frame, Id, LogError};

const LINE: LogError = LogError::Event {
    what: "a line of a TRC file",
};
const COLUMNS: LogError = LogError::Unsupported {
    what: "a TRC file of an unknown version",
};

/// Whether a file starts like a TRC file.
pub(super) fn is_trc(bytes: &[u8]) -> bool {
    let first = super::lines(bytes).find(|(_, line)| !line.trim().is_empty());
    first.is_some_and(|(_, line)| {
        let line = line.trim_start();
        [";$FILEVERSION", ";$STARTTIME", ";##"]
            .iter()
            .any(|start| line.starts_with(start))
    })
}

/// Settings from the file header.
#[derive(Debug)]
struct Reader {
    /// `None` for an unknown version.
    columns: Option<Vec<char>>,
    /// Epoch of the time stamps, from `$STARTTIME` and from the comment.
    start: Option<Duration>,
    remarked: Option<Duration>,
}

pub(super) fn read(bytes: &[u8], log: &mut Log) {
    let mut reader = Reader {
        columns: version("1.0"),
        start: None,
        remarked: None,
    };
    for (number, line) in super::lines(bytes) {
        let line = line.trim();
        match line.strip_prefix(';') {
            Some(head) => reader.head(head),
            None if line.is_empty() => {}
            None if reader.columns.is_none() => return log.leave_out(number, COLUMNS),
            None => {
                if let Some(record) = reader.line(line) {
                    log.take(number, record.ok_or(LINE));
                }
            }
        }
    }
}

/// Columns of a version whose files do not name them.
fn version(version: &str) -> Option<Vec<char>> {
    let columns = match version {
        "1.0" => "NOIlD",
        "1.1" => "NOdIlD",
        "1.2" => "NOBdIlD",
        "1.3" => "NOBdIRlD",
        "2.0" => "NOTIdlD",
        "2.1" => "NOTBIdRlD",
        _ => return None,
    };
    Some(columns.chars().collect())
}

impl Reader {
    fn head(&mut self, head: &str) {
        if let Some(value) = head.strip_prefix("$FILEVERSION=") {
            self.columns = version(value.trim());
        } else if let Some(value) = head.strip_prefix("$STARTTIME=") {
            self.start = days(value.trim());
        } else if let Some(value) = head.strip_prefix("$COLUMNS=") {
            let columns = value.chars().filter(|c| !c.is_whitespace() && *c != ',');
            self.columns = Some(columns.take(COLUMNS_MAX).collect());
        } else if let Some(value) = head.trim_start().strip_prefix("Start time:") {
            self.remarked = date(value.trim());
        }
    }

    /// `None` for a line without a frame.
    fn line(&self, line: &str) -> Option<Option<Record>> {
        let mut words = line.split_ascii_whitespace();
        let mut row = Row::default();
        for column in self.columns.iter().flatten() {
            if *column == 'D' {
                break;
            }
            let Some(word) = words.next() else {
                return Some(None);
            };
            match column {
                'O' => row.offset = millis(word),
                'T' => row.kind = word,
                // A number, as in candump logs.
                'B' if word.parse::<u16>().is_ok() => row.bus = word,
                'I' => row.id = word,
                'd' => row.direction = word,
                'l' => row.code = word.parse().ok(),
                'L' => row.len = word.parse().ok(),
                _ => {}
            }
        }
        let data: Vec<&str> = words.collect();
        // Hardware state, error counters and events.
        if matches!(row.kind, "ST" | "EC" | "EV") || row.direction == "Warng" {
            return None;
        }
        let frame = row.frame(&data);
        let start = self.start.or(self.remarked).unwrap_or_default();
        Some(frame.zip(row.offset).map(|(frame, offset)| Record {
            at: start.saturating_add(offset),
            interface: row.bus.to_owned(),
            frame,
            direction: row.direction(),
        }))
    }
}

/// Upper bound of columns over all versions.
const COLUMNS_MAX: usize = 16;

/// A line, column by column.
#[derive(Debug)]
struct Row<'a> {
    offset: Option<Duration>,
    kind: &'a str,
    bus: &'a str,
    id: &'a str,
    direction: &'a str,
    code: Option<u8>,
    len: Option<usize>,
}

impl Default for Row<'_> {
    fn default() -> Self {
        Self {
            offset: None,
            kind: "DT",
            bus: "1",
            id: "",
            direction: "",
            code: None,
            len: None,
        }
    }
}

impl Row<'_> {
    fn direction(&self) -> Option<Direction> {
        match self.direction {
            "Rx" => Some(Direction::Received),
            "Tx" => Some(Direction::Transmitted),
            _ => None,
        }
    }

    fn frame(&self, data: &[&str]) -> Option<AnyFrame> {
        if self.kind == "ER" || self.direction == "Error" {
            // The kind of error has a vendor-specific encoding.
            return Some(ErrorFrame::new(class::BUS_ERROR, [0; 8]).into());
        }
        let id = id(self.id)?;
        let is_fd = matches!(self.kind, "FD" | "FB" | "FE" | "BI");
        let len = match (self.len, self.code) {
            (Some(len), _) => len,
            (None, Some(code)) if is_fd => FdFrame::len_of_code(code)?,
            (None, Some(code)) => usize::from(code.min(8)),
            (None, None) => return None,
        };
        if self.kind == "RR" || data.starts_with(&["RTR"]) {
            return Some(Frame::remote(id, len).ok()?.into());
        }
        let words = data.get(..len).filter(|_| len <= 64)?.iter();
        let data = words.map(|word| u8::from_str_radix(word, 16).ok());
        let data = data.collect::<Option<Vec<u8>>>()?;
        if is_fd {
            let mut frame = FdFrame::new(id, &data).ok()?;
            frame.bit_rate_switch = matches!(self.kind, "FB" | "BI");
            frame.sender_is_passive = matches!(self.kind, "FE" | "BI");
            return Some(frame.into());
        }
        if self.kind != "DT" {
            return None;
        }
        let frame = Frame::new(id, &data).ok()?;
        let frame = match self.code.filter(|code| *code > 8) {
            Some(code) => frame.with_raw_dlc(code).ok()?,
            None => frame,
        };
        Some(frame.into())
    }
}

/// Four digits are 11 bits, more are 29.
fn id(word: &str) -> Option<Id> {
    let raw = u32::from_str_radix(word, 16).ok()?;
    if word.len() > 4 {
        Id::extended(raw).ok()
    } else {
        Id::standard(raw.try_into().ok()?).ok()
    }
}

/// Milliseconds with a fraction of any length, parsed without floating point.
fn millis(word: &str) -> Option<Duration> {
    let (whole, fraction) = word.split_once('.').unwrap_or((word, "0"));
    let nanos = decimal(fraction, 1_000_000)?;
    let whole = Duration::from_millis(whole.parse().ok()?);
    whole.checked_add(Duration::from_nanos(nanos))
}

/// The digits after a decimal point as a fraction of `whole`.
fn decimal(digits: &str, whole: u128) -> Option<u64> {
    let digits = digits.get(..digits.len().min(18))?;
    if digits.is_empty() || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let ten = 10_u128.pow(u32::try_from(digits.len()).ok()?);
    u64::try_from(digits.parse::<u128>().ok()? * whole / ten).ok()
}

/// Days since 1899-12-30 with a fraction, as in `$STARTTIME`. The file names no time zone; UTC is assumed.
fn days(word: &str) -> Option<Duration> {
    /// Days from 1899-12-30 to 1970.
    const BEFORE: u64 = 25_569;
    const DAY_NS: u128 = 86_400_000_000_000;
    let (whole, fraction) = word.split_once('.').unwrap_or((word, "0"));
    let days = whole.parse::<u64>().ok()?.checked_sub(BEFORE)?;
    let seconds = days.checked_mul(86_400)?;
    Some(Duration::from_secs(seconds) + Duration::from_nanos(decimal(fraction, DAY_NS)?))
}

/// `11.09.2002 16:03:27.682`, in some versions with more digits or the suffix `.0`.
fn date(text: &str) -> Option<Duration> {
    let (day, time) = text.split_once(char::is_whitespace)?;
    let mut day = day.split('.').map(|part| part.parse::<u32>().ok());
    let (day, month, year) = (day.next()??, day.next()??, day.next()??);
    let mut time = time.trim().splitn(3, ':');
    let (hour, minute, second) = (time.next()?, time.next()?, time.next()?);
    let (hour, minute) = (hour.parse::<u64>().ok()?, minute.parse::<u64>().ok()?);
    let mut parts = second.split('.');
    let second = parts.next()?.parse::<u64>().ok()?;
    let fraction = decimal(parts.next().unwrap_or("0"), 1_000_000_000)?;
    let days = super::days_since_1970(year, month, day)?;
    let within = hour.min(23) * 3_600 + minute.min(59) * 60 + second.min(60);
    Some(Duration::from_secs(days * 86_400 + within) + Duration::from_nanos(fraction))
}

#[cfg(test)]
mod tests {
    use super::super::Format;
    use super::*;

    fn printed(text: &str) -> Vec<String> {
        assert_eq!(Format::of(text.as_bytes()), Format::Trc, "{text}");
        let log = Log::read(text.as_bytes());
        assert_eq!(log.left_out, [], "{text}");
        log.records.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn trc_of_every_version_is_read() {
        let start = ";$STARTTIME=45244.42592592593\n";
        let head = |version: &str| format!(";$FILEVERSION={version}\n{start};   remark\n");
        let rows = |rows: &[&str]| rows.join("\n") + "\n";
        let first = [
            (
                ";##########\n;   C:\\x.trc\n;    Start time: 14.11.2023 10:13:20.000\n".to_owned(),
                rows(&[
                    "1)      1841   0300  2  00 01",
                    "2)  1842  18EFC034 0",
                    "3) 1842 0300 4 RTR",
                ]),
                [" 1 300#0001", " 1 18EFC034#", " 1 300#R4"],
            ),
            (
                head("1.1"),
                rows(&[
                    "     1)      1841.0  Rx         0300  2  00 01",
                    "     2)      1842.0  Tx     18EFC034  0",
                    "     3)      1842.0  Rx         0300  4  RTR",
                    "     4)      1842.0  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY",
                ]),
                [" 1 300#0001 R", " 1 18EFC034# T", " 1 300#R4 R"],
            ),
            (
                head("1.3"),
                rows(&[
                    "     1)      1841.0 2  Rx        0300 -  2    00 01",
                    "     2)      1842.0 1  Tx    18EFC034 -  0",
                    "     3)      1842.0 1  Rx        0300 -  4    RTR",
                ]),
                [" 2 300#0001 R", " 1 18EFC034# T", " 1 300#R4 R"],
            ),
            (
                head("2.0") + ";$COLUMNS=N,O,T,I,d,l,D\n",
                rows(&[
                    "      1      1841.000 DT     0300 Rx 2  00 01",
                    "      2      1842.000 DT 18EFC034 Tx 0",
                    "      3      1842.000 RR     0300 Rx 4",
                    "      4      1842.000 ST          Rx    00 00 00 08",
                ]),
                [" 1 300#0001 R", " 1 18EFC034# T", " 1 300#R4 R"],
            ),
            (
                head("2.1") + ";$COLUMNS=N,O,T,B,I,d,R,L,D\n",
                rows(&[
                    "      1      1841.000 DT 2      0300 Rx -  2    00 01",
                    "      2      1842.000 DT 1  18EFC034 Tx -  0",
                    "      3      1842.000 RR 1      0300 Rx -  4",
                    "      4      1842.000 EV 1 hello there and so on",
                ]),
                [" 2 300#0001 R", " 1 18EFC034# T", " 1 300#R4 R"],
            ),
        ];
        for (head, rows, expected) in first {
            let stamps = ["841", "842", "842"].map(|ms| format!("(1699956801.{ms}000)"));
            let expected = stamps.iter().zip(expected);
            let expected: Vec<_> = expected
                .map(|(stamp, rest)| format!("{stamp}{rest}"))
                .collect();
            assert_eq!(printed(&(head + &rows)), expected);
        }
    }

    #[test]
    fn trc_frames_of_can_fd_and_errors_are_read() {
        let long = |n: usize| vec!["AB"; n].join(" ");
        let text = format!(
            ";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,l,D\n\
             1 1.000 FD 1 0300 Rx - 9 {}\n2 2.000 FB 1 0300 Rx - 15 {}\n3 3.000 FE 1 0300 Rx - 1 AB\n\
             4 4.000 BI 1 0300 Tx - 0\n5 5.000 ER 1 - Rx - 5 04 00 02 00 00\n6 6.000 DT 1 0300 Rx - 15 {}\n",
            long(12),
            long(64),
            long(8)
        );
        let found = printed(&text);
        let ab = |n: usize| "AB".repeat(n);
        assert_eq!(
            found,
            [
                format!("(0000000000.001000) 1 300##0{} R", ab(12)),
                format!("(0000000000.002000) 1 300##1{} R", ab(64)),
                "(0000000000.003000) 1 300##2AB R".to_owned(),
                "(0000000000.004000) 1 300##3 T".to_owned(),
                "(0000000000.005000) 1 20000080#0000000000000000 R".to_owned(),
                format!("(0000000000.006000) 1 300#{}_F R", ab(8)),
            ]
        );
    }

    #[test]
    fn trc_damaged_lines_are_counted() {
        for line in [
            "1)",
            "1) x Rx 0300 2 00 01",
            "1) 1.0 Rx 0800 2 00 01",
            "1) 1.0 Rx 0300 2 00",
            "1) 1.0 Rx 0300 2 00 GG",
            "1) 1.0 Rx 0300 x 00 01",
            "1) 99999999999999999999.0 Rx 0300 0",
        ] {
            let text = format!(";$FILEVERSION=1.1\n{line}\n");
            let log = Log::read(text.as_bytes());
            assert_eq!((log.records.len(), log.left_out_count), (0, 1), "{line}");
        }
        let text = ";$FILEVERSION=1.3\n1) 1.0 no-bus-at-all Rx 0300 - 0\n";
        assert_eq!(printed(text), ["(0000000000.001000) 1 300# R"]);
        let log = Log::read(b";$FILEVERSION=9.9\n1) 1.0\n2) 1.0\n");
        assert_eq!((log.left_out_count, log.left_out[0].why), (1, COLUMNS));
    }
}
