//! One line of a candump log: `(1700000000.000125) can0 123#DEADBEEF R`. Reads from text it is
//! given and writes by `Display`; opens no file.

use std::fmt;
use std::time::Duration;

use crate::{Frame, Id, LogError};

/// Longest name the kernel gives an interface.
const INTERFACE_LEN_MAX: usize = 15;

/// Bit 29 of eight digits marks an error frame.
const ERROR_FLAG: u32 = 0x2000_0000;

/// Which way a frame went, seen from the machine that logged it (`candump -x`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the bus.
    Received,
    /// Sent by the machine itself.
    Transmitted,
}

/// A frame, when and where it was seen.
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
        let mut words = line.split_ascii_whitespace();
        let at = words.next().and_then(stamp).ok_or(LogError::Stamp)?;
        let fits = |name: &&str| name.len() <= INTERFACE_LEN_MAX;
        let interface = words.next().filter(fits).ok_or(LogError::Interface)?;
        let frame = frame(words.next().ok_or(LogError::Id)?)?;
        let direction = words.next().map(direction).transpose()?;
        match words.next() {
            None => Ok(Self {
                at,
                interface,
                frame,
                direction,
            }),
            Some(_) => Err(LogError::Direction),
        }
    }
}

fn stamp(word: &str) -> Option<Duration> {
    let (seconds, micros) = word.strip_prefix('(')?.strip_suffix(')')?.split_once('.')?;
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if micros.len() != 6 || !digits(micros) || !digits(seconds) {
        return None;
    }
    let micros: u32 = micros.parse().ok()?;
    Some(Duration::new(seconds.parse().ok()?, micros * 1_000))
}

fn direction(word: &str) -> Result<Direction, LogError> {
    match word {
        "R" => Ok(Direction::Received),
        "T" => Ok(Direction::Transmitted),
        _ => Err(LogError::Direction),
    }
}

fn frame(word: &str) -> Result<Frame, LogError> {
    let (id, rest) = word.split_once('#').ok_or(LogError::Id)?;
    let id = identifier(id)?;
    let unsupported = |what| Err(LogError::Unsupported { what });
    if rest.starts_with('#') {
        return unsupported("a CAN FD frame");
    }
    if rest.contains(':') {
        return unsupported("a CAN XL frame");
    }
    if rest.contains('_') {
        return unsupported("a raw DLC");
    }
    match rest.strip_prefix('R') {
        Some(len) => Ok(Frame::remote(id, remote_len(len)?)?),
        None => data_frame(id, rest),
    }
}

fn identifier(digits: &str) -> Result<Id, LogError> {
    if !digits.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(LogError::Id);
    }
    match digits.len() {
        1..=3 => Ok(Id::standard(
            u16::from_str_radix(digits, 16).map_err(|_| LogError::Id)?,
        )?),
        8 => match u32::from_str_radix(digits, 16).map_err(|_| LogError::Id)? {
            raw if raw & ERROR_FLAG != 0 => Err(LogError::Unsupported {
                what: "an error frame",
            }),
            raw => Ok(Id::extended(raw)?),
        },
        _ => Err(LogError::Id),
    }
}

/// `R` alone asks for no bytes.
fn remote_len(digits: &str) -> Result<usize, LogError> {
    match digits.as_bytes() {
        [] => Ok(0),
        [digit] if digit.is_ascii_digit() => Ok(usize::from(digit - b'0')),
        _ => Err(LogError::Data),
    }
}

/// Byte pairs, with a dot between two of them or without.
fn data_frame(id: Id, text: &str) -> Result<Frame, LogError> {
    // One more than fits, so that a frame too long is told from bad digits.
    let mut data = [0; Frame::LEN_MAX + 1];
    let mut len = 0;
    let mut rest = text.as_bytes();
    while let Some((pair, tail)) = rest.split_first_chunk::<2>() {
        let place = data.get_mut(len).ok_or(crate::FrameError::TooLong {
            len: text.len() / 2,
        })?;
        *place = byte(*pair).ok_or(LogError::Data)?;
        len += 1;
        rest = match tail {
            [b'.', more @ ..] if !more.is_empty() => more,
            _ => tail,
        };
    }
    if !rest.is_empty() {
        return Err(LogError::Data);
    }
    Ok(Frame::new(id, data.get(..len).unwrap_or_default())?)
}

fn byte([high, low]: [u8; 2]) -> Option<u8> {
    let digit = |c: u8| u8::try_from(char::from(c).to_digit(16)?).ok();
    Some(digit(high)? << 4 | digit(low)?)
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Received => "R",
            Self::Transmitted => "T",
        })
    }
}

impl fmt::Display for LogLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, micros) = (self.at.as_secs(), self.at.subsec_micros());
        write!(
            f,
            "({seconds:010}.{micros:06}) {} {}",
            self.interface, self.frame
        )?;
        self.direction
            .map_or(Ok(()), |direction| write!(f, " {direction}"))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::FrameError;

    fn parse_frame(text: &str) -> Result<Frame, LogError> {
        frame(text)
    }

    #[test]
    fn line_of_candump() {
        let line = LogLine::parse("(1436509052.249713) vcan0 044#2A366C2BBA\n").unwrap();
        assert_eq!(line.at, Duration::new(1_436_509_052, 249_713_000));
        assert_eq!((line.interface, line.direction), ("vcan0", None));
        assert_eq!(line.frame.data(), [0x2A, 0x36, 0x6C, 0x2B, 0xBA]);
        assert_eq!(line.to_string(), "(1436509052.249713) vcan0 044#2A366C2BBA");
    }

    #[test]
    fn other_spellings_are_read() {
        for (text, printed) in [
            (
                "(0.000001)  can0\t1#ab.cd.EF   T",
                "(0000000000.000001) can0 001#ABCDEF T",
            ),
            (
                "(0000000001.000000) any 1FFFFFFF#R8 R",
                "(0000000001.000000) any 1FFFFFFF#R8 R",
            ),
            ("(0000000001.000000) c 123#R", "(0000000001.000000) c 123#R"),
            (
                "(0000000001.000000) c 123#R0",
                "(0000000001.000000) c 123#R",
            ),
            (
                "(0000000001.000000) c 00000123#",
                "(0000000001.000000) c 00000123#",
            ),
        ] {
            assert_eq!(
                LogLine::parse(text).map(|line| line.to_string()).as_deref(),
                Ok(printed)
            );
        }
    }

    #[test]
    fn each_part_has_its_error() {
        for (text, error) in [
            ("", LogError::Stamp),
            ("(1.5) can0 1#", LogError::Stamp),
            ("(1.0000005) can0 1#", LogError::Stamp),
            ("(1.+00005) can0 1#", LogError::Stamp),
            ("(-1.000005) can0 1#", LogError::Stamp),
            ("1.000005 can0 1#", LogError::Stamp),
            ("(1.000005)", LogError::Interface),
            ("(1.000005) sixteen-letters! 1#", LogError::Interface),
            ("(1.000005) can0", LogError::Id),
            ("(1.000005) can0 123", LogError::Id),
            ("(1.000005) can0 1# X", LogError::Direction),
            ("(1.000005) can0 1# R T", LogError::Direction),
        ] {
            assert_eq!(LogLine::parse(text), Err(error), "{text}");
        }
    }

    #[test]
    fn each_fault_of_a_frame_has_its_error() {
        let unsupported = |what| LogError::Unsupported { what };
        for (text, error) in [
            ("#11", LogError::Id),
            ("1234#11", LogError::Id),
            ("+12#11", LogError::Id),
            ("7FF#1", LogError::Data),
            ("7FF#1G", LogError::Data),
            ("7FF#11.", LogError::Data),
            ("7FF#11..22", LogError::Data),
            ("7FF#R10", LogError::Data),
            (
                "800#11",
                LogError::Frame(FrameError::StandardId { id: 0x800 }),
            ),
            ("7FF#R9", LogError::Frame(FrameError::TooLong { len: 9 })),
            (
                "7FF#112233445566778899",
                LogError::Frame(FrameError::TooLong { len: 9 }),
            ),
            (
                "7FF#11223344556677889900",
                LogError::Frame(FrameError::TooLong { len: 10 }),
            ),
            ("20000080#0000000000000000", unsupported("an error frame")),
            ("123##1AABB", unsupported("a CAN FD frame")),
            ("123#45:67:89ABCDEF#11", unsupported("a CAN XL frame")),
            ("123#1122334455667788_E", unsupported("a raw DLC")),
        ] {
            assert_eq!(parse_frame(text), Err(error), "{text}");
        }
    }

    fn any_frame() -> impl Strategy<Value = Frame> {
        let id = prop_oneof![
            (0..0x800_u16).prop_map(|id| Id::standard(id).unwrap()),
            (0..0x2000_0000_u32).prop_map(|id| Id::extended(id).unwrap()),
        ];
        let data = prop::collection::vec(any::<u8>(), 0..=8);
        (id, data, any::<bool>()).prop_map(|(id, data, remote)| {
            if remote {
                Frame::remote(id, data.len())
            } else {
                Frame::new(id, &data)
            }
            .unwrap()
        })
    }

    fn any_direction() -> impl Strategy<Value = Option<Direction>> {
        let some = [
            None,
            Some(Direction::Received),
            Some(Direction::Transmitted),
        ];
        prop::sample::select(some.to_vec())
    }

    proptest! {
        #[test]
        fn printed_line_reads_back(
            frame in any_frame(), seconds in any::<u64>(), micros in 0..1_000_000_u32,
            direction in any_direction(), interface in "[a-z]{1,13}[0-9]{0,2}",
        ) {
            let at = Duration::new(seconds, micros * 1_000);
            let line = LogLine { at, interface: &interface, frame, direction };
            let printed = line.to_string();
            prop_assert_eq!(LogLine::parse(&printed), Ok(line));
        }

        #[test]
        fn any_text_is_answered(text in "\\PC{0,60}") {
            let _ = LogLine::parse(&text);
        }

        #[test]
        fn any_text_like_a_line_is_answered(text in "\\([0-9.]{0,12}\\) [a-z0-9]{1,17} [0-9A-F]{0,9}#{0,2}[0-9A-FR._:]{0,20} ?[RT]?") {
            if let Ok(line) = LogLine::parse(&text) {
                let printed = line.to_string();
                prop_assert_eq!(LogLine::parse(&printed), Ok(line));
            }
        }
    }
}
