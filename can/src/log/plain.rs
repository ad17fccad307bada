//! Terminal output of candump, as quoted in bug reports. Time stamp, direction and text after the data are optional;
//! byte-swapped and binary output is not supported.
//!
//! ```text
//!  (1436509052.249713)  can0  TX - -  701   [1]  00
//!  (2023-11-14 10:13:20.123456)  can0  605   [8]  40 41 60 00 00 00 00 00   '@A`.....'
//!   can0  705   [0]  remote request
//!   can0  123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B
//! ```

use std::time::Duration;

use super::candump::{self, Identifier};
use super::{Direction, Log, Record};
use crate::{AnyFrame, ErrorFrame, FdFrame, Frame, LogError};

const LINE: LogError = LogError::Event {
    what: "a line of candump's text",
};

/// Whether a line is in this format.
pub(super) fn is_line(line: &str) -> bool {
    parse(line).is_some()
}

/// Reads a whole text. Skips empty lines and lines that start with `#`.
pub(super) fn read(bytes: &[u8], log: &mut Log) {
    for (number, line) in super::lines(bytes) {
        let line = line.trim();
        if !line.is_empty() && !line.starts_with('#') {
            log.take(number, parse(line).ok_or(LINE));
        }
    }
}

/// Frames without a time stamp get time 0.
fn parse(line: &str) -> Option<Record> {
    let mut words: Vec<&str> = line.split_ascii_whitespace().take(WORDS_MAX).collect();
    let at = match take_stamp(&mut words) {
        Some(at) => at?,
        None => Duration::ZERO,
    };
    let length = words.iter().position(|word| word.starts_with('['))?;
    let (head, rest) = words.split_at_checked(length)?;
    let (length, data) = rest.split_first()?;
    let digits = length.strip_prefix('[')?.strip_suffix(']')?;
    let len = digits.parse::<usize>().ok().filter(|len| *len <= 64)?;
    let (id, head) = head.split_last()?;
    let (interface, flags) = match head {
        [] => (NAMELESS, &[][..]),
        [interface, flags @ ..] if interface.len() <= candump::INTERFACE_LEN_MAX => {
            (*interface, flags)
        }
        _ => return None,
    };
    let direction = match flags {
        [] => None,
        ["RX", ..] => Some(Direction::Received),
        ["TX", ..] => Some(Direction::Transmitted),
        _ => return None,
    };
    // A length of two digits means CAN FD.
    let is_fd = digits.len() == 2;
    let frame = match candump::identifier(id).ok()? {
        Identifier::Error(class) => {
            let data = bytes(data, len.min(8))?;
            let mut eight = [0; 8];
            eight
                .iter_mut()
                .zip(&data)
                .for_each(|(to, from)| *to = *from);
            ErrorFrame::new(class, eight).into()
        }
        Identifier::Frame(id) if data.starts_with(&["remote"]) => {
            Frame::remote(id, len).ok()?.into()
        }
        Identifier::Frame(id) if is_fd => {
            let mut frame = FdFrame::new(id, &bytes(data, len)?).ok()?;
            frame.bit_rate_switch = flags.contains(&"B");
            frame.sender_is_passive = flags.contains(&"E");
            AnyFrame::from(frame)
        }
        Identifier::Frame(id) => Frame::new(id, &bytes(data, len)?).ok()?.into(),
    };
    Some(Record {
        at,
        interface: interface.to_owned(),
        frame,
        direction,
    })
}

/// Maximum words of a valid line, and one more.
const WORDS_MAX: usize = 64 + 8;
/// The interface of a line that names none.
const NAMELESS: &str = "can";

/// Removes the time stamp from the words, if present: `Some(None)` for a damaged one.
fn take_stamp(words: &mut Vec<&str>) -> Option<Option<Duration>> {
    let first = words
        .first()
        .copied()
        .filter(|word| word.starts_with('('))?;
    if first.ends_with(')') {
        words.remove(0);
        return Some(candump::stamp(first));
    }
    let second = words.get(1).copied().filter(|word| word.ends_with(')'));
    let Some(second) = second else {
        return Some(None);
    };
    words.drain(..2);
    let day = first.trim_start_matches('(');
    Some(date(day, second.trim_end_matches(')')))
}

/// `2023-11-14` and `10:13:20.123456`; the file names no time zone; UTC is assumed.
fn date(day: &str, time: &str) -> Option<Duration> {
    let numbers = |text: &str, by: char| {
        let parts = text.split(by).map(|part| part.parse::<u32>().ok());
        parts.collect::<Option<Vec<_>>>()
    };
    let (time, fraction) = time.split_once('.')?;
    let [year, month, day] = numbers(day, '-')?[..] else {
        return None;
    };
    let [hour, minute, second] = numbers(time, ':')?[..] else {
        return None;
    };
    let micros = fraction
        .parse::<u64>()
        .ok()
        .filter(|_| fraction.len() == 6)?;
    let days = super::days_since_1970(year, month, day)?;
    let within = hour.min(23) * 3_600 + minute.min(59) * 60 + second.min(60);
    let seconds = Duration::from_secs(days * 86_400 + u64::from(within));
    Some(seconds + Duration::from_micros(micros))
}

fn bytes(words: &[&str], len: usize) -> Option<Vec<u8>> {
    let words = words.get(..len)?.iter();
    let byte = |word: &&str| {
        u8::from_str_radix(word, 16)
            .ok()
            .filter(|_| word.len() == 2)
    };
    words.map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Format;
    use super::*;

    fn printed(text: &str) -> Vec<String> {
        assert_eq!(Format::of(text.as_bytes()), Format::Plain, "{text}");
        let log = Log::read(text.as_bytes());
        assert_eq!(log.left_out, []);
        log.records.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn candump_text_of_every_form_is_read() {
        let text = "  can0  701   [1]  00\n\
            \x20(1436509052.249713)  can0  TX - -  605   [8]  40 41 60 00 00 00 00 00   '@A`.....'\n\
            \x20(000.000100)  any  18FEF100   [2]  AB CD\r\n\
            \x20(2023-11-14 10:13:20.123456)  can0  RX B E  123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B\n\
            \x20(1.000000)  vcan0  705   [0]  remote request\n\
            \n# the drive was off\n\
            \x20(1.000001)  can0  20000044   [8]  00 30 00 00 00 00 82 05   ERRORFRAME\n\
            701   [1]  05  heartbeat of the drive\n";
        assert_eq!(
            printed(text),
            [
                "(0000000000.000000) can0 701#00",
                "(1436509052.249713) can0 605#4041600000000000 T",
                "(0000000000.000100) any 18FEF100#ABCD",
                "(1699956800.123456) can0 123##3000102030405060708090A0B R",
                "(0000000001.000000) vcan0 705#R",
                "(0000000001.000001) can0 20000044#0030000000008205",
                "(0000000000.000000) can 701#05",
            ]
        );
    }

    #[test]
    fn candump_text_damaged_lines_are_counted() {
        let good = "  can0  701   [1]  00\n";
        for line in [
            "  can0  701   [2]  00",
            "  can0  701   [1]  0",
            "  can0  701   [1]  0G",
            "  can0  701   [9]  00",
            "  can0  801   [1]  00",
            "  can0  701   [x]  00",
            "  sixteen-letters!  701   [1]  00",
            "  can0  XX - -  701   [1]  00",
            "(1.5)  can0  701   [1]  00",
            "(2023-11-14 10:13)  can0  701   [1]  00",
            "(1.000000",
            "[1]",
            "the drive does not start",
        ] {
            let log = Log::read(format!("{good}{line}\n{good}").as_bytes());
            assert_eq!((log.records.len(), log.left_out_count), (2, 1), "{line}");
            assert_eq!((log.left_out[0].location, log.left_out[0].why), (2, LINE));
        }
    }
}
