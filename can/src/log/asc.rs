//! ASC files: the text format of Vector's tools and compatible programs. Reads frames and error frames; skips
//! statistics, markers and other buses.
//!
//! ```text
//! date Tue Nov 14 10:13:20.123 2023
//! base hex  timestamps absolute
//!    0.000125 1  123             Rx   d 4 DE AD BE EF
//!    0.000250 CANFD   1 Rx        321   NAME      1 0 9 12 00 01 02 03 04 05 06 07 08 09 0A 0B ...
//! ```

use std::time::Duration;

use super::{Direction, Log, Record};
use crate::fault::class;
use crate::{ErrorFrame, FdFrame, Frame, Id, LogError};

/// Whether a file starts like an ASC file.
pub(super) fn is_asc(bytes: &[u8]) -> bool {
    let first = super::lines(bytes).find(|(_, line)| !line.trim().is_empty());
    first.is_some_and(|(_, line)| {
        let line = line.trim_start();
        ["date ", "base ", "// version", "; "]
            .iter()
            .any(|start| line.starts_with(start))
    })
}

/// Settings from the file header.
#[derive(Debug)]
struct Reader {
    /// Number base: 10 or 16.
    base: u32,
    /// Whether time stamps are relative to the previous line.
    relative: bool,
    /// Epoch of the time stamps.
    start: Duration,
    /// The previous time stamp.
    last: Duration,
}

pub(super) fn read(bytes: &[u8], log: &mut Log) {
    let mut reader = Reader {
        base: 16,
        relative: false,
        start: Duration::ZERO,
        last: Duration::ZERO,
    };
    for (number, line) in super::lines(bytes) {
        if let Some(record) = reader.line(line.trim()) {
            log.take(number, record);
        }
    }
}

const FRAME: LogError = LogError::Event {
    what: "a line of an ASC file",
};

impl Reader {
    /// `None` for a line without a frame.
    fn line(&mut self, line: &str) -> Option<Result<Record, LogError>> {
        let (first, rest) = line.split_once(char::is_whitespace)?;
        match first.to_ascii_lowercase().as_str() {
            "date" => self.start = date(rest).unwrap_or(self.start),
            "begin" => {
                let date = rest
                    .split_once(char::is_whitespace)
                    .and_then(|(_, d)| date(d));
                self.start = date.unwrap_or(self.start);
            }
            "base" => {
                self.base = if rest.trim_start().starts_with("dec") {
                    10
                } else {
                    16
                };
                self.relative = rest.contains("relative");
            }
            _ => return self.event(first, rest),
        }
        None
    }

    fn event(&mut self, stamp: &str, rest: &str) -> Option<Result<Record, LogError>> {
        let stamp = seconds(stamp)?;
        let stamp = if self.relative {
            self.last.saturating_add(stamp)
        } else {
            stamp
        };
        self.last = stamp;
        let words: Vec<&str> = rest.split_ascii_whitespace().collect();
        let is_channel = |word: &&str| word.parse::<u16>().is_ok();
        let (&channel, found) = match words.as_slice() {
            ["CANFD", channel, rest @ ..] if is_channel(channel) => (channel, self.fd(rest)),
            [channel, "ErrorFrame", ..] if is_channel(channel) => (channel, Some(error())),
            [channel, id, "Rx" | "Tx", ..] if is_channel(channel) => {
                let _ = id;
                (channel, self.classic(words.get(1..).unwrap_or_default()))
            }
            _ => return None,
        };
        Some(found.ok_or(FRAME).map(|(frame, direction)| Record {
            at: self.start.saturating_add(stamp),
            interface: channel.to_owned(),
            frame,
            direction,
        }))
    }

    /// `123 Rx d 4 DE AD BE EF`, `123 Rx r 1`; more text may follow.
    fn classic(&self, words: &[&str]) -> Option<Found> {
        let [id, dir, kind, rest @ ..] = words else {
            return None;
        };
        let id = self.id(id)?;
        let frame = match (*kind, rest) {
            // The length is optional; further fields are named.
            ("r", [len, ..]) => {
                Frame::remote(id, usize::from_str_radix(len, 16).unwrap_or(0)).ok()?
            }
            ("r", []) => Frame::remote(id, 0).ok()?,
            ("d", [code, data @ ..]) => {
                let code = u8::from_str_radix(code, 16)
                    .ok()
                    .filter(|code| *code < 16)?;
                let data = self.bytes(data, usize::from(code.min(8)))?;
                let frame = Frame::new(id, &data).ok()?;
                if code > 8 {
                    frame.with_raw_dlc(code).ok()?
                } else {
                    frame
                }
            }
            _ => return None,
        };
        Some((frame.into(), direction(dir)))
    }

    /// `Rx 321 NAME 1 0 9 12 00 01 ...`: the name may be missing. Bit 12 of the flags after the data marks CAN FD;
    /// without flags the frame is CAN FD.
    fn fd(&self, words: &[&str]) -> Option<Found> {
        let [dir, id, rest @ ..] = words else {
            return None;
        };
        let (dir, id) = (direction(dir), self.id(id)?);
        let rest = match rest {
            [switch, ..] if matches!(*switch, "0" | "1") => rest,
            [_, rest @ ..] => rest,
            [] => return None,
        };
        let [switch, passive, code, len, rest @ ..] = rest else {
            return None;
        };
        let code = u8::from_str_radix(code, 16).ok()?;
        let len: usize = len.parse().ok().filter(|len| *len <= 64)?;
        let data = self.bytes(rest, len)?;
        // Duration and length of the frame, then its flags.
        let flags = rest
            .get(len + 2)
            .and_then(|word| u32::from_str_radix(word, 16).ok());
        // Some writers leave the flags 0; more than eight bytes are always CAN FD.
        if len <= 8 && flags.is_some_and(|flags| flags & 0x1000 == 0) {
            let remote = flags.is_some_and(|flags| flags & 0x10 != 0);
            let frame = match remote {
                true => Frame::remote(id, usize::from(code)).ok()?,
                false => Frame::new(id, &data).ok()?,
            };
            return Some((frame.into(), dir));
        }
        let mut frame = FdFrame::new(id, &data).ok()?;
        frame.bit_rate_switch = *switch == "1";
        frame.sender_is_passive = *passive == "1";
        Some((frame.into(), dir))
    }

    /// The suffix `x` means 29 bits.
    fn id(&self, word: &str) -> Option<Id> {
        let raw = |digits| u32::from_str_radix(digits, self.base).ok();
        match word.strip_suffix(['x', 'X']) {
            Some(digits) => Id::extended(raw(digits)?).ok(),
            None => Id::standard(raw(word)?.try_into().ok()?).ok(),
        }
    }

    fn bytes(&self, words: &[&str], len: usize) -> Option<Vec<u8>> {
        let words = words.get(..len)?.iter();
        words
            .map(|word| u8::from_str_radix(word, self.base).ok())
            .collect()
    }
}

type Found = (crate::AnyFrame, Option<Direction>);

/// Writers have no common notation for the kind of error.
fn error() -> Found {
    (ErrorFrame::new(class::BUS_ERROR, [0; 8]).into(), None)
}

fn direction(word: &str) -> Option<Direction> {
    match word {
        "Rx" => Some(Direction::Received),
        "Tx" => Some(Direction::Transmitted),
        _ => None,
    }
}

/// Seconds with a fraction of any length, parsed without floating point.
fn seconds(text: &str) -> Option<Duration> {
    let (whole, fraction) = text.split_once('.')?;
    if fraction.is_empty() || !fraction.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let nanos = format!("{fraction:0<9}");
    Some(Duration::new(
        whole.parse().ok()?,
        nanos.get(..9)?.parse().ok()?,
    ))
}

/// Month names in English and German, depending on the language of the writing tool.
const MONTHS: [&[&str]; 12] = [
    &["jan"],
    &["feb"],
    &["mar", "mär", "mrz"],
    &["apr"],
    &["may", "mai"],
    &["jun"],
    &["jul"],
    &["aug"],
    &["sep"],
    &["oct", "okt"],
    &["nov"],
    &["dec", "dez"],
];

/// `Tue Nov 14 10:13:20.123 2023`, or `... 10:13:20.123 am 2023`, as time since 1970. The file names no time zone; UTC
/// is assumed.
fn date(text: &str) -> Option<Duration> {
    let words: Vec<String> = text
        .split_ascii_whitespace()
        .map(str::to_lowercase)
        .collect();
    let [_, month, day, time, rest @ ..] = words.as_slice() else {
        return None;
    };
    let is_month = |names: &&[&str]| names.iter().any(|name| month.starts_with(name));
    let month = MONTHS.iter().position(is_month)? + 1;
    let year = rest.last()?.parse().ok()?;
    let (hour, rest_of_time) = time.split_once(':')?;
    let (minute, second) = rest_of_time.split_once(':')?;
    let second = if second.contains('.') {
        seconds(second)?
    } else {
        Duration::from_secs(second.parse().ok()?)
    };
    let second = second.min(Duration::from_secs(60));
    let hour: u32 = hour.parse().ok()?;
    let hour = match rest.first().map(String::as_str) {
        Some("am") => hour % 12,
        Some("pm") => hour % 12 + 12,
        Some(_) | None => hour,
    };
    let minute: u32 = minute.parse().ok()?;
    let days = super::days_since_1970(year, u32::try_from(month).ok()?, day.parse().ok()?)?;
    let within = u64::from(hour.min(23) * 3_600 + minute.min(59) * 60);
    Some(Duration::from_secs(days * 86_400 + within) + second)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn printed(text: &str) -> Vec<String> {
        let log = Log::read(text.as_bytes());
        assert_eq!(log.left_out, []);
        log.records.iter().map(ToString::to_string).collect()
    }

    /// ASC files do not keep the class and data of an error frame.
    #[test]
    fn asc_file_of_python_can_is_read() {
        let text = include_str!("../../tests/captures/python_can.asc");
        let long: String = (0..64).map(|byte| format!("{byte:02X}")).collect();
        // python-can rounds the start time to whole seconds and counts from the first frame.
        assert_eq!(
            printed(text),
            [
                "(1700000000.000000) 1 123#DEADBEEF R".to_owned(),
                "(1700000000.000875) 1 7FF# T".to_owned(),
                "(1700000000.002375) 2 18FEF100#0001020304050607 R".to_owned(),
                "(1700000000.002875) 1 705#R1 R".to_owned(),
                format!("(1700000000.003875) 1 321##1{long} R"),
                "(1700000000.004875) 1 20000080#0000000000000000".to_owned(),
                "(1700000000.005875) 1 1FFFFFFF##2000102030405060708090A0B T".to_owned(),
            ]
        );
    }

    #[test]
    fn asc_decimal_base_and_relative_times_are_read() {
        let text = "date Die Okt 3 02:00:01.5 pm 2023\nbase dec  timestamps relative\n\
                    no internal events logged\n\
                    0.100000 1  291             Rx   d 2 255 16 Length = 0 BitCount = 0\n\
                    0.1 1 Statistic: D 0 R 0\n\
                    0.000100000 1  291x            Tx   r\n\
                    0.5 1  291             Rx   d c 1 2 3 4 5 6 7 8\n";
        assert_eq!(
            printed(text),
            [
                "(1696341601.600000) 1 123#FF10 R",
                "(1696341601.700100) 1 00000123#R T",
                "(1696341602.200100) 1 123#0102030405060708_C R",
            ]
        );
    }

    #[test]
    fn asc_fd_frame_name_is_optional() {
        let text = "base hex timestamps absolute\n\
            1.0 CANFD 3 Tx 10 Name_1 1 1 2 2 AA BB 0 0 3000 0 0 0 0 0\n\
            1.0 CANFD 3 Tx 10 0 0 2 2 AA BB\n\
            1.0 CANFD 3 Rx 10 0 0 2 2 AA BB 0 0 0 0 0 0 0 0\n\
            1.0 CANFD 3 Rx 10 0 0 2 0 0 0 10 0 0 0 0 0\n\
            1.0 CANFD 3 Rx 10 0 0 9 12 1 2 3 4 5 6 7 8 9 A B C 1331984 11 0 0 0 0 0 0\n";
        assert_eq!(
            printed(text),
            [
                "(0000000001.000000) 3 010##3AABB T",
                "(0000000001.000000) 3 010##0AABB T",
                "(0000000001.000000) 3 010#AABB R",
                "(0000000001.000000) 3 010#R2 R",
                "(0000000001.000000) 3 010##00102030405060708090A0B0C R",
            ]
        );
    }

    #[test]
    fn asc_damaged_lines_are_reported() {
        for line in [
            "1.0 1 800 Rx d 0",
            "1.0 1 123 Rx d 2 AA",
            "1.0 1 123 Rx d 2 AA GG",
            "1.0 1 123 Rx d 1F AA",
            "1.0 1 123 Rx",
            "1.0 CANFD 1 Rx 123 0 0 9 9 1 2 3 4 5 6 7 8 9",
            "1.0 CANFD 1 Rx 123",
        ] {
            let log = Log::read(format!("base hex\n{line}\n").as_bytes());
            assert_eq!((log.records.len(), log.left_out_count), (0, 1), "{line}");
            assert_eq!(log.left_out[0].location, 2);
        }
    }

    #[test]
    fn asc_impossible_times_are_reported() {
        let most = u64::MAX;
        for text in [
            format!("base hex\n{most}.0 1 123 Rx d 0\n"),
            format!("base hex timestamps relative\n{most}.9 1 123 Rx d 0\n{most}.9 1 123 Rx d 0\n"),
            format!("date Tue Nov 14 10:13:{most} 9999\n{most}.0 1 123 Rx d 0\n"),
            format!("date Tue Nov 14 10:13:{most}.5 9999\n{most}.0 1 123 Rx d 0\n"),
        ] {
            let log = Log::read(text.as_bytes());
            assert_eq!(log.records, [], "{text}");
            assert!(
                log.left_out.iter().all(|left| left.why == LogError::Late)
                    && log.left_out_count > 0,
                "{text}: {:?}",
                log.left_out
            );
        }
    }

    proptest! {
        #[test]
        fn asc_any_text_does_not_panic(
            lines in prop::collection::vec(
                "(date|base|begin|[0-9]{1,20}\\.[0-9]{0,12}) (CANFD )?[0-9a-zA-Z:. ]{0,60}", 0..8),
        ) {
            let _ = Log::read(format!("base hex\n{}", lines.join("\n")).as_bytes());
        }
    }
}
