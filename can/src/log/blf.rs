//! BLF files: the binary log format of Vector's tools and python-can. Reads CAN frames and error frames; skips other
//! objects. There is no public standard; this module follows what those programs write.
//!
//! | bytes of an object | content |
//! |---|---|
//! | 0 to 3 | `LOBJ` |
//! | 4, 5 | header length |
//! | 6, 7 | header version, 1 or 2 |
//! | 8 to 11 | total length |
//! | 12 to 15 | object type |
//! | 16 to 19 | unit of the time stamp: 1 for 10 µs, 2 for 1 ns |
//! | 24 to 31 | time stamp, relative to the start of the file |
//!
//! All integers are little-endian. Containers (type 10) hold a sequence of objects, mostly compressed by zlib; an
//! object may start in one container and end in the next.

use std::io::Read as _;
use std::time::Duration;

use super::{Direction, Log, Record};
use crate::fault::{class, violation};
use crate::{AnyFrame, ErrorFrame, FdFrame, Frame, Id, LogError};

pub(super) const MAGIC: &[u8] = b"LOGG";

const OBJECT: &[u8] = b"LOBJ";

/// Minimum length of an object: the common header.
const BASE_LEN: usize = 16;

/// Maximum unpacked size of a container. Writers use 128 KiB.
const CONTAINER_MAX: usize = 64 << 20;

/// Maximum size of an object in a container. CAN objects have a few hundred bytes at most.
const OBJECT_MAX: usize = 1 << 20;

/// Object types.
mod kind {
    pub(super) const CAN_MESSAGE: u32 = 1;
    pub(super) const CONTAINER: u32 = 10;
    pub(super) const CAN_ERROR_EXT: u32 = 73;
    pub(super) const CAN_MESSAGE2: u32 = 86;
    pub(super) const CAN_FD_MESSAGE: u32 = 100;
    pub(super) const CAN_FD_MESSAGE_64: u32 = 101;
}

const fn broken(what: &'static str) -> LogError {
    LogError::Event { what }
}

fn u8_at(bytes: &[u8], at: usize) -> Option<u8> {
    bytes.get(at).copied()
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn len_at(bytes: &[u8], at: usize) -> Option<usize> {
    usize::try_from(u32_at(bytes, at)?).ok()
}

pub(super) fn read(bytes: &[u8], log: &mut Log) {
    let Some(head) = len_at(bytes, 4).filter(|len| *len <= bytes.len()) else {
        return log.leave_out(0, broken("the header of a BLF file"));
    };
    let mut reader = Reader {
        start: start(bytes).unwrap_or_default(),
        rest: Vec::new(),
    };
    let file = bytes.get(head..).unwrap_or_default();
    let used = reader.objects(file, head, true, log);
    if used < file.len() || !reader.rest.is_empty() {
        log.leave_out(
            head + used,
            broken("an object that is truncated by the end of the file"),
        );
    }
}

/// Year, month, day of the week, day, hour, minute, second, millisecond, from byte 40 on. The file names no time zone;
/// UTC is assumed.
fn start(bytes: &[u8]) -> Option<Duration> {
    let field = |number: usize| u16_at(bytes, 40 + 2 * number).map(u32::from);
    let days = super::days_since_1970(field(0)?, field(1)?, field(3)?)?;
    let seconds = field(4)?.min(23) * 3_600 + field(5)?.min(59) * 60 + field(6)?.min(59);
    let ms = Duration::from_millis(u64::from(field(7)?.min(999)));
    Some(Duration::from_secs(days * 86_400 + u64::from(seconds)) + ms)
}

struct Reader {
    start: Duration,
    /// Start of an object that ends in the next container.
    rest: Vec<u8>,
}

impl Reader {
    /// Reads consecutive objects; returns the number of bytes of complete objects. `location` is the offset of the
    /// bytes in the file.
    fn objects(&mut self, bytes: &[u8], location: usize, is_file: bool, log: &mut Log) -> usize {
        let mut at = 0;
        loop {
            // Up to seven bytes of padding may separate two objects.
            let rest = bytes.get(at..).unwrap_or_default();
            let window = rest
                .get(..rest.len().min(8 + OBJECT.len()))
                .unwrap_or_default();
            let gap = window.windows(OBJECT.len()).position(|w| w == OBJECT);
            let Some(gap) = gap else {
                if window.len() > 8 {
                    log.leave_out(
                        location + at,
                        broken("the start of an object of a BLF file"),
                    );
                    return bytes.len();
                }
                // Padding at the end counts as consumed; bytes that may start an object do not.
                let padding = rest.iter().all(|byte| *byte == 0);
                return if padding { bytes.len() } else { at };
            };
            let begin = at + gap;
            let len = len_at(bytes, begin + 8).unwrap_or(BASE_LEN).max(BASE_LEN);
            if !is_file && len > OBJECT_MAX {
                log.leave_out(
                    location,
                    broken("an object of more than 1 MiB in a BLF file"),
                );
                return bytes.len();
            }
            let Some(object) = bytes.get(begin..begin.saturating_add(len)) else {
                return begin;
            };
            let in_file = if is_file { location + begin } else { location };
            self.object(object, in_file, is_file, log);
            at = begin + len;
        }
    }

    fn object(&mut self, object: &[u8], location: usize, is_file: bool, log: &mut Log) {
        match u32_at(object, 12) {
            Some(kind::CONTAINER) if is_file => match unpack(object) {
                Ok(content) => {
                    let mut bytes = std::mem::take(&mut self.rest);
                    bytes.extend(content);
                    let used = self.objects(&bytes, location, false, log);
                    self.rest = bytes.split_off(used.min(bytes.len()));
                }
                Err(why) => log.leave_out(location, why),
            },
            Some(_) => {
                if let Some(record) = self.record(object) {
                    log.take(location, record);
                }
            }
            None => {}
        }
    }

    /// `None` for an object without a frame.
    fn record(&self, object: &[u8]) -> Option<Result<Record, LogError>> {
        let content = object.get(usize::from(u16_at(object, 4)?)..)?;
        let read: fn(&[u8]) -> Option<Found> = match u32_at(object, 12)? {
            kind::CAN_MESSAGE | kind::CAN_MESSAGE2 => message,
            kind::CAN_FD_MESSAGE => fd_message,
            kind::CAN_FD_MESSAGE_64 => fd_message_64,
            kind::CAN_ERROR_EXT => error,
            _ => return None,
        };
        let found = read(content).zip(stamp(object));
        Some(match found {
            Some(((channel, frame, direction), stamp)) => Ok(Record {
                at: self.start.saturating_add(stamp),
                interface: channel.to_string(),
                frame,
                direction,
            }),
            None => Err(broken("a CAN object of a BLF file")),
        })
    }
}

fn stamp(object: &[u8]) -> Option<Duration> {
    let stamp = u64_at(object, 24)?;
    match u32_at(object, 16)? {
        1 => Some(Duration::from_nanos(stamp.checked_mul(10_000)?)),
        _ => Some(Duration::from_nanos(stamp)),
    }
}

/// | bytes | content |
/// |---|---|
/// | 16, 17 | 0: uncompressed; 2: zlib |
/// | 24 to 27 | unpacked length |
/// | 32 ... | the content |
fn unpack(object: &[u8]) -> Result<Vec<u8>, LogError> {
    let cut = broken("a truncated container of a BLF file");
    let content = object.get(32..).ok_or(cut)?;
    match u16_at(object, 16) {
        Some(0) => Ok(content.to_vec()),
        Some(2) => {
            let len = len_at(object, 24).filter(|len| *len <= CONTAINER_MAX);
            let len = len.ok_or(broken("a container of more than 64 MiB in a BLF file"))?;
            let mut bytes = Vec::new();
            let mut unpacker = flate2::read::ZlibDecoder::new(content).take(len as u64);
            match unpacker.read_to_end(&mut bytes) {
                Ok(_) if bytes.len() == len => Ok(bytes),
                Ok(_) | Err(_) => Err(broken("the compressed content of a BLF container")),
            }
        }
        _ => Err(broken("a container of a BLF file with unknown compression")),
    }
}

/// Channel, frame, direction.
type Found = (u16, AnyFrame, Option<Direction>);

/// Bit 31 means 29 bits.
fn id(raw: u32) -> Option<Id> {
    if raw & 1 << 31 != 0 {
        Id::extended(raw & 0x1FFF_FFFF).ok()
    } else {
        Id::standard(raw.try_into().ok()?).ok()
    }
}

fn direction(sent: bool) -> Option<Direction> {
    Some(if sent {
        Direction::Transmitted
    } else {
        Direction::Received
    })
}

/// | bytes | content |
/// |---|---|
/// | 0, 1 | channel |
/// | 2 | flags: bit 0 sent, bit 7 remote |
/// | 3 | length code |
/// | 4 to 7 | identifier |
/// | 8 to 15 | data |
fn message(content: &[u8]) -> Option<Found> {
    let (flags, code) = (u8_at(content, 2)?, u8_at(content, 3)? & 0x0F);
    let id = id(u32_at(content, 4)?)?;
    let len = usize::from(code.min(8));
    let frame = if flags & 0x80 == 0 {
        Frame::new(id, content.get(8..8 + len)?)
    } else {
        Frame::remote(id, len)
    };
    let frame = frame.ok()?;
    let frame = if code > 8 {
        frame.with_raw_dlc(code).ok()?
    } else {
        frame
    };
    Some((u16_at(content, 0)?, frame.into(), direction(flags & 1 != 0)))
}

/// | bytes | content |
/// |---|---|
/// | 0 to 7 | as [`message`] |
/// | 13 | bit 0 CAN FD, bit 1 bit rate switch, bit 2 sender is error-passive |
/// | 14 | bytes of data |
/// | 20 to 83 | data |
fn fd_message(content: &[u8]) -> Option<Found> {
    let (flags, fd_flags) = (u8_at(content, 2)?, u8_at(content, 13)?);
    let id = id(u32_at(content, 4)?)?;
    let len = usize::from(u8_at(content, 14)?);
    let data = content.get(20..20 + len)?;
    let frame: AnyFrame = match (fd_flags & 1 != 0, flags & 0x80 != 0) {
        (true, _) => FdFrame::new(id, data)
            .ok()?
            .with_flags(fd_flags >> 1)
            .into(),
        (false, false) => Frame::new(id, data).ok()?.into(),
        (false, true) => Frame::remote(id, usize::from(u8_at(content, 3)?.min(8)))
            .ok()?
            .into(),
    };
    Some((u16_at(content, 0)?, frame, direction(flags & 1 != 0)))
}

/// | bytes | content |
/// |---|---|
/// | 0 | channel |
/// | 1 | length code |
/// | 2 | bytes of data |
/// | 4 to 7 | identifier |
/// | 12 to 15 | bit 4 remote, bit 12 CAN FD, bit 13 bit rate switch, bit 14 sender is error-passive |
/// | 34 | 1: sent |
/// | 40 ... | data; missing bytes are 0 |
fn fd_message_64(content: &[u8]) -> Option<Found> {
    let id = id(u32_at(content, 4)?)?;
    let flags = u32_at(content, 12)?;
    let len = usize::from(u8_at(content, 2)?);
    // Loggers truncate trailing zero bytes of the object.
    let mut data = [0; 64];
    let data = data.get_mut(..len)?;
    let present = content.get(40..)?;
    data.iter_mut()
        .zip(present)
        .for_each(|(to, from)| *to = *from);
    let data = &*data;
    let frame: AnyFrame = if flags & 0x1000 != 0 {
        let mut frame = FdFrame::new(id, data).ok()?;
        frame.bit_rate_switch = flags & 0x2000 != 0;
        frame.sender_is_passive = flags & 0x4000 != 0;
        frame.into()
    } else if flags & 0x10 != 0 {
        Frame::remote(id, usize::from(u8_at(content, 1)?.min(8)))
            .ok()?
            .into()
    } else {
        Frame::new(id, data).ok()?.into()
    };
    let sent = u8_at(content, 34)? != 0;
    Some((u16::from(u8_at(content, 0)?), frame, direction(sent)))
}

/// | bytes | content |
/// |---|---|
/// | 0, 1 | channel |
/// | 8 | error code capture of the controller: bits 0 to 4 location in the frame, bit 5 reception, bits 6 and 7 bit, form, stuff or another error; 0 from programs that log the kernel's error frames |
/// | 16 to 19 | in that case the kernel's error class; else the frame's identifier |
/// | 24 to 31 | in that case the kernel's data |
fn error(content: &[u8]) -> Option<Found> {
    let channel = u16_at(content, 0)?;
    let capture = u8_at(content, 8)?;
    let frame = if capture == 0 {
        let data = *content.get(24..)?.first_chunk()?;
        let raw_class = u32_at(content, 16)?;
        ErrorFrame::new(
            if raw_class == 0 {
                class::BUS_ERROR
            } else {
                raw_class
            },
            data,
        )
    } else {
        let types = match capture >> 6 {
            0 => violation::BIT,
            1 => violation::FORM,
            2 => violation::STUFF,
            _ => 0,
        };
        let direction_bit = if capture & 0x20 == 0 {
            violation::TRANSMITTING
        } else {
            0
        };
        let data = [0, 0, types | direction_bit, capture & 0x1F, 0, 0, 0, 0];
        ErrorFrame::new(class::BUS_ERROR | class::PROTOCOL, data)
    };
    Some((channel, frame.into(), None))
}

#[cfg(test)]
mod tests;
