//! Lines of a candump log: `(1700000000.000125) can0 123#DEADBEEF R`. The format of `candump -L`, `-l` and `canplayer`
//! (can-utils), for all frames except CAN XL, which is reported as unsupported.

use std::fmt;
use std::time::Duration;

use super::{Direction, Log, Record};
use crate::fault::ERROR_FLAG;
use crate::{AnyFrame, ErrorFrame, FdFrame, Frame, FrameError, Id, LogError};

/// Maximum length of an interface name in the kernel.
pub(super) const INTERFACE_LEN_MAX: usize = 15;

/// A parsed line.
pub(super) struct Line<'a> {
    pub(super) at: Duration,
    pub(super) interface: &'a str,
    pub(super) frame: AnyFrame,
    pub(super) direction: Option<Direction>,
}

impl<'a> Line<'a> {
    pub(super) fn parse(line: &'a str) -> Result<Self, LogError> {
        let mut words = line.split_ascii_whitespace();
        let at = words.next().and_then(stamp).ok_or(LogError::Stamp)?;
        let at = super::sound(at)?;
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

pub(super) fn write(
    f: &mut fmt::Formatter<'_>,
    at: Duration,
    interface: &str,
    frame: &dyn fmt::Display,
    direction: Option<Direction>,
) -> fmt::Result {
    let (seconds, micros) = (at.as_secs(), at.subsec_micros());
    write!(f, "({seconds:010}.{micros:06}) {interface} {frame}")?;
    direction.map_or(Ok(()), |direction| write!(f, " {direction}"))
}

/// Reads a whole log. Skips empty lines and lines that start with `#`.
pub(super) fn read(bytes: &[u8], log: &mut Log) {
    for (number, line) in super::lines(bytes) {
        if !line.trim().is_empty() && !line.starts_with('#') {
            log.take(number, Record::parse(&line));
        }
    }
}

/// Microseconds, or nanoseconds as newer versions of candump can write.
pub(super) fn stamp(word: &str) -> Option<Duration> {
    let (seconds, fraction) = word.strip_prefix('(')?.strip_suffix(')')?.split_once('.')?;
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(fraction) || !digits(seconds) {
        return None;
    }
    let fraction: u32 = match fraction.len() {
        6 => fraction.parse::<u32>().ok()? * 1_000,
        9 => fraction.parse().ok()?,
        _ => return None,
    };
    Some(Duration::new(seconds.parse().ok()?, fraction))
}

fn direction(word: &str) -> Result<Direction, LogError> {
    match word {
        "R" => Ok(Direction::Received),
        "T" => Ok(Direction::Transmitted),
        _ => Err(LogError::Direction),
    }
}

/// Parses the frame between interface and direction.
pub(super) fn frame(word: &str) -> Result<AnyFrame, LogError> {
    let (id, rest) = word.split_once('#').ok_or(LogError::Id)?;
    if rest.contains(':') {
        return Err(LogError::Unsupported {
            what: "a CAN XL frame",
        });
    }
    let id = match identifier(id)? {
        Identifier::Error(class) => return Ok(error_frame(class, rest)?.into()),
        Identifier::Frame(id) => id,
    };
    if let Some(rest) = rest.strip_prefix('#') {
        return Ok(fd_frame(id, rest)?.into());
    }
    let (rest, raw_dlc) = match rest.split_once('_') {
        Some((rest, raw)) => (rest, Some(raw)),
        None => (rest, None),
    };
    let frame = match rest.strip_prefix('R') {
        Some(len) => Frame::remote(id, remote_len(len)?)?,
        None => Frame::new(id, Bytes::<9>::parse(rest)?.as_slice())?,
    };
    let frame = match raw_dlc.map(|raw| u8::from_str_radix(raw, 16)) {
        Some(Ok(raw)) => frame.with_raw_dlc(raw)?,
        Some(Err(_)) => return Err(LogError::Data),
        None => frame,
    };
    Ok(frame.into())
}

/// The identifier before the data.
pub(super) enum Identifier {
    Frame(Id),
    Error(u32),
}

/// Up to three digits are 11 bits, eight are 29, and bit 29 of eight marks an error frame.
pub(super) fn identifier(digits: &str) -> Result<Identifier, LogError> {
    if !digits.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(LogError::Id);
    }
    let raw = u32::from_str_radix(digits, 16).map_err(|_| LogError::Id);
    match digits.len() {
        1..=3 => {
            let raw = u16::try_from(raw?).map_err(|_| LogError::Id)?;
            Ok(Identifier::Frame(Id::standard(raw)?))
        }
        8 => match raw? {
            raw if raw & ERROR_FLAG != 0 => Ok(Identifier::Error(raw)),
            raw => Ok(Identifier::Frame(Id::extended(raw)?)),
        },
        _ => Err(LogError::Id),
    }
}

/// Some writers omit trailing bytes; they are 0.
fn error_frame(class: u32, text: &str) -> Result<ErrorFrame, LogError> {
    let bytes = Bytes::<9>::parse(text)?;
    let given = bytes.as_slice();
    let mut data = [0; 8];
    let slot = data.get_mut(..given.len());
    slot.ok_or(FrameError::TooLong { len: given.len() })?
        .copy_from_slice(given);
    Ok(ErrorFrame::new(class, data))
}

fn fd_frame(id: Id, text: &str) -> Result<FdFrame, LogError> {
    let (flags, data) = text.split_at_checked(1).ok_or(LogError::Data)?;
    let flags = u8::from_str_radix(flags, 16).map_err(|_| LogError::Data)?;
    let data = Bytes::<65>::parse(data)?;
    Ok(FdFrame::new(id, data.as_slice())?.with_flags(flags))
}

/// `R` alone requests no bytes.
fn remote_len(digits: &str) -> Result<usize, LogError> {
    match digits.as_bytes() {
        [] => Ok(0),
        [digit] if digit.is_ascii_digit() => Ok(usize::from(digit - b'0')),
        _ => Err(LogError::Data),
    }
}

/// Byte pairs, optionally separated by dots. `N` is one more than the maximum, to distinguish excess length from bad
/// digits.
struct Bytes<const N: usize> {
    bytes: [u8; N],
    len: usize,
}

impl<const N: usize> Bytes<N> {
    fn parse(text: &str) -> Result<Self, LogError> {
        let (mut bytes, mut len) = ([0; N], 0);
        let mut rest = text.as_bytes();
        while let Some((pair, tail)) = rest.split_first_chunk::<2>() {
            let slot = bytes.get_mut(len).ok_or(FrameError::TooLong {
                len: text.len() / 2,
            })?;
            *slot = byte(*pair).ok_or(LogError::Data)?;
            len += 1;
            rest = match tail {
                [b'.', more @ ..] if !more.is_empty() => more,
                _ => tail,
            };
        }
        if rest.is_empty() {
            Ok(Self { bytes, len })
        } else {
            Err(LogError::Data)
        }
    }

    fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

fn byte([high, low]: [u8; 2]) -> Option<u8> {
    let digit = |c: u8| u8::try_from(char::from(c).to_digit(16)?).ok();
    Some(digit(high)? << 4 | digit(low)?)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{LogLine, parse_frame};
    use super::*;

    #[test]
    fn candump_line_is_read_and_printed() {
        let line = LogLine::parse("(1436509052.249713) vcan0 044#2A366C2BBA\n").unwrap();
        assert_eq!(line.at, Duration::new(1_436_509_052, 249_713_000));
        assert_eq!((line.interface, line.direction), ("vcan0", None));
        assert_eq!(line.frame.data(), [0x2A, 0x36, 0x6C, 0x2B, 0xBA]);
        assert_eq!(line.to_string(), "(1436509052.249713) vcan0 044#2A366C2BBA");
    }

    #[test]
    fn candump_other_spellings_are_read() {
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
                "(0000000001.000000007) c 123#1122334455667788_e",
                "(0000000001.000000) c 123#1122334455667788_E",
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
    fn candump_each_damaged_part_has_its_error() {
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
    fn candump_each_invalid_frame_has_its_error() {
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
            ("123#45:67:89ABCDEF#11", unsupported("a CAN XL frame")),
            (
                "20000080#001122334455667788",
                LogError::Frame(FrameError::TooLong { len: 9 }),
            ),
            ("123##", LogError::Data),
            ("123##G", LogError::Data),
            ("123##1AAB", LogError::Data),
            (
                "123##1112233445566778899",
                LogError::Frame(FrameError::FdLength { len: 9 }),
            ),
            (
                "123#11_E",
                LogError::Frame(FrameError::RawDlc { raw: 14, len: 1 }),
            ),
            (
                "123#1122334455667788_8",
                LogError::Frame(FrameError::RawDlc { raw: 8, len: 8 }),
            ),
            ("123#1122334455667788_", LogError::Data),
        ] {
            assert_eq!(parse_frame(text), Err(error), "{text}");
        }
    }

    #[test]
    fn candump_every_kind_of_frame_is_kept() {
        for text in [
            "(1700000000.000125) can0 123#DEADBEEF R",
            "(1700000000.000125) can0 123#R4 T",
            "(1700000000.000125) can0 123#1122334455667788_C",
            "(1700000000.000125) can0 1FFFFFFF##3112233445566778899AABBCC",
            "(1700000000.000125) can0 20000044#0030000000008205 R",
            "(1700000000.000125) can0 20000080#0000000000000000",
        ] {
            assert_eq!(Record::parse(text).unwrap().to_string(), text);
        }
        // Some programs write the CAN FD mark among the flags, or an error frame without data.
        let record = Record::parse("(1.000000) can0 123##5AA").unwrap();
        assert!(record.to_string().ends_with("123##1AA"));
        let record = Record::parse("(1.000000) can0 20000080#").unwrap();
        assert!(record.to_string().ends_with("20000080#0000000000000000"));
    }

    #[test]
    fn log_line_names_unsupported_frames() {
        for (text, what) in [
            ("20000080#0000000000000000", "an error frame"),
            ("123##1AABB", "a CAN FD frame"),
        ] {
            let line = format!("(1.000000) can0 {text}");
            assert_eq!(LogLine::parse(&line), Err(LogError::Unsupported { what }));
        }
    }

    #[test]
    fn candump_damaged_lines_are_counted_and_reported() {
        let text = "(1.000000) can0 123#11\n\n# a remark\n(1.000000) can0 123#1\r\n\
                    (1.000000) can0 123#45:67:89ABCDEF#11\n(2.000000) can0 123#22 T\r\n";
        let log = Log::read(text.as_bytes());
        assert_eq!((log.records.len(), log.left_out_count), (2, 2));
        assert_eq!(
            (log.left_out[0].location, log.left_out[0].why),
            (4, LogError::Data)
        );
        assert_eq!(log.left_out[1].location, 5);
        let bad = Log::read("(x) can0 1#\n".repeat(100).as_bytes());
        assert_eq!((bad.left_out.len(), bad.left_out_count), (16, 100));
    }

    fn any_frame() -> impl Strategy<Value = AnyFrame> {
        prop_oneof![
            any_classic().prop_map(AnyFrame::from),
            (any_classic(), 0..16_u8, 0..4_u8, any::<[u8; 64]>()).prop_map(
                |(frame, code, flags, data)| {
                    let len = FdFrame::len_of_code(code).unwrap();
                    FdFrame::new(frame.id(), &data[..len])
                        .unwrap()
                        .with_flags(flags)
                        .into()
                }
            ),
            (any::<u32>(), any::<[u8; 8]>())
                .prop_map(|(class, data)| ErrorFrame::new(class, data).into()),
        ]
    }

    fn any_classic() -> impl Strategy<Value = Frame> {
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

    #[test]
    fn candump_times_beyond_year_9999_are_reported() {
        for seconds in [253_402_300_800, u64::MAX] {
            let line = format!("({seconds}.000000) can0 705#05");
            assert_eq!(Record::parse(&line), Err(LogError::Late));
            assert_eq!(LogLine::parse(&line), Err(LogError::Late));
            assert_eq!(Log::read(line.as_bytes()).left_out_count, 1);
        }
        assert!(Record::parse("(253402300799.999999) can0 705#05").is_ok());
    }

    proptest! {
        #[test]
        fn candump_printed_line_reads_back(
            frame in any_frame(), seconds in 0..253_402_300_800_u64, micros in 0..1_000_000_u32,
            direction in any_direction(), interface in "[a-z]{1,13}[0-9]{0,2}",
        ) {
            let at = Duration::new(seconds, micros * 1_000);
            let record = Record { at, interface, frame, direction };
            let printed = record.to_string();
            prop_assert_eq!(Record::parse(&printed), Ok(record.clone()));
            let classic = LogLine::parse(&printed);
            prop_assert_eq!(classic.is_ok(), record.frame.classic().is_some());
        }

        #[test]
        fn candump_any_text_is_line_or_error(text in "\\PC{0,60}") {
            let _ = (LogLine::parse(&text), Log::read(text.as_bytes()));
        }

        #[test]
        fn candump_any_similar_line_is_line_or_error(text in "\\([0-9.]{0,12}\\) [a-z0-9]{1,17} [0-9A-F]{0,9}#{0,2}[0-9A-FR._:]{0,20} ?[RT]?") {
            if let Ok(mut record) = Record::parse(&text) {
                record.at = Duration::from_micros(u64::try_from(record.at.as_micros()).unwrap());
                let printed = record.to_string();
                prop_assert_eq!(Record::parse(&printed), Ok(record));
            }
        }
    }
}
