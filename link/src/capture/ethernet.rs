//! Ethernet frames of a recording, without what a capture probe added: ERF records (link type 197) and the 16 bytes of
//! an ET2000. Frames are not decoded here.
#![warn(clippy::indexing_slicing)]

use std::io::Read;
use std::time::Duration;

use super::{CaptureError, Cut, LinkType, Packet, Reader};

/// A frame of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EthernetFrame {
    /// Time of the recording; the probe's time if it is known.
    pub at: Duration,
    /// Index of the recording interface in the file, or its number in the ERF record; 0 if there is only one.
    pub interface: u32,
    /// The ET2000 port at which the frame arrived, from 0; ports 2n and 2n + 1 are the two sides of line n.
    pub port: Option<u8>,
    /// Whether the probe found a checksum error.
    pub is_corrupt: bool,
    /// Whether only the beginning of the frame was recorded (`tcpdump -s`).
    pub is_truncated: bool,
    /// The frame from its destination address on, as far as recorded.
    pub bytes: Vec<u8>,
}

/// The Ethernet frames of a recording; an iterator that ends after an error.
#[derive(Debug)]
pub struct Frames<R> {
    reader: Reader<R>,
    probe: ProbeClock,
    is_ended: bool,
}

impl<R: Read> Frames<R> {
    /// Reads the header of the file.
    pub fn new(from: R) -> Result<Self, CaptureError> {
        Ok(Self {
            reader: Reader::new(from)?,
            probe: ProbeClock::default(),
            is_ended: false,
        })
    }

    /// Where the recording is cut off; known once reading has ended.
    pub const fn cut(&self) -> Option<Cut> {
        self.reader.cut()
    }

    /// The frame of a packet; `None` for an ERF record without one.
    fn frame(&mut self, packet: Packet) -> Option<Result<EthernetFrame, CaptureError>> {
        let mut frame = EthernetFrame {
            at: packet.at,
            interface: packet.interface,
            port: None,
            is_corrupt: false,
            is_truncated: usize::try_from(packet.original_len)
                .is_ok_and(|len| len > packet.data.len()),
            bytes: packet.data,
        };
        match packet.link {
            LinkType::ETHERNET => {}
            LinkType::ERF => {
                let record = Erf::decode(&frame.bytes)?;
                frame.at = record.at;
                frame.interface = record.interface.into();
                frame.is_corrupt = record.is_corrupt;
                frame.bytes = record.frame.to_vec();
            }
            other => return Some(Err(CaptureError::LinkType(other))),
        }
        if let Some((mark, bytes)) = Mark::strip(&frame.bytes) {
            let bytes = bytes.to_vec();
            frame.at = self.probe.time(frame.at, mark.at);
            frame.port = mark.port;
            frame.is_corrupt |= mark.is_corrupt;
            frame.bytes = bytes;
        }
        Some(Ok(frame))
    }
}

impl<R: Read> Iterator for Frames<R> {
    type Item = Result<EthernetFrame, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.is_ended {
            let item = match self.reader.next()? {
                Ok(packet) => self.frame(packet),
                Err(error) => Some(Err(error)),
            };
            if let Some(item) = item {
                self.is_ended = item.is_err();
                return Some(item);
            }
        }
        None
    }
}

/// An ERF record with an Ethernet frame.
///
/// | offset | bytes | field |
/// |---|---|---|
/// | 0 | 8 | seconds since 1970 with 32 bits of fraction, little-endian |
/// | 8 | 1 | type; bit 7: extension headers follow |
/// | 9 | 1 | flags: bits 0 and 1 interface, bit 4 receive error, bit 5 error of the card |
/// | 10 | 2 | length of the record |
/// | 12 | 2 | records lost, or colour |
/// | 14 | 2 | length on the wire |
/// | 16 | 8 each | extension headers; bit 7 of the first byte: another follows |
/// | after the frame | 2 | padding |
struct Erf<'a> {
    at: Duration,
    interface: u8,
    is_corrupt: bool,
    frame: &'a [u8],
}

impl<'a> Erf<'a> {
    const EXTENSION: usize = 8;
    const PADDING: usize = 2;
    /// Record types with Ethernet frames: plain, coloured, filtered and coloured, hashed and coloured.
    const ETHERNET: [u8; 4] = [2, 11, 16, 20];
    const MORE: u8 = 0x80;
    const ERRORS: u8 = 0x30;

    fn decode(bytes: &'a [u8]) -> Option<Self> {
        let (header, mut rest) = bytes.split_first_chunk::<16>()?;
        let [a, b, c, d, e, f, g, h, kind, flags, _, _, _, _, high, low] = *header;
        if !Self::ETHERNET.contains(&(kind & !Self::MORE)) {
            return None;
        }
        let mut more = kind & Self::MORE != 0;
        while more {
            let (extension, behind) = rest.split_at_checked(Self::EXTENSION)?;
            more = extension.first()? & Self::MORE != 0;
            rest = behind;
        }
        let frame = rest.get(Self::PADDING..)?;
        // Records are padded to whole words.
        let on_wire = usize::from(u16::from_be_bytes([high, low]));
        Some(Self {
            at: fixed_point(u64::from_le_bytes([a, b, c, d, e, f, g, h])),
            interface: flags & 3,
            is_corrupt: flags & Self::ERRORS != 0,
            frame: frame.get(..on_wire).unwrap_or(frame),
        })
    }
}

/// Seconds with 32 bits of fraction.
fn fixed_point(raw: u64) -> Duration {
    let nanos = ((raw & 0xFFFF_FFFF) * 1_000_000_000) >> 32;
    Duration::from_secs(raw >> 32) + Duration::from_nanos(nanos)
}

/// What an ET2000 adds after a frame, or before it.
///
/// | offset | bytes | field |
/// |---|---|---|
/// | 0 | 6 | 01 01 05 10 00 00, the fourth byte also 11h |
/// | 6 | 1 | port at which the frame arrived: bit 7 is port 0, bit 0 port 7 |
/// | 7 | 1 | bit 4 check sum error, bit 3 alignment error; bits 7, 6, 2, 1 ports 8 to 11 |
/// | 8 | 8 | time of the probe, ns, little-endian |
struct Mark {
    port: Option<u8>,
    is_corrupt: bool,
    at: Duration,
}

impl Mark {
    const LEN: usize = 16;
    const ERRORS: u8 = 0x18;
    /// Ports 8 to 11 by their bit in the second byte.
    const HIGH_PORTS: [(u8, u8); 4] = [(0x80, 8), (0x40, 9), (0x04, 10), (0x02, 11)];

    /// The mark, and the frame without it.
    fn strip(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let before = bytes
            .split_first_chunk()
            .and_then(|(mark, rest)| Some((Self::decode(mark)?, rest)));
        before.or_else(|| {
            let (rest, mark) = bytes.split_last_chunk()?;
            Some((Self::decode(mark)?, rest))
        })
    }

    fn decode(bytes: &[u8; Self::LEN]) -> Option<Self> {
        let [1, 1, 5, 0x10 | 0x11, 0, 0, low, high, time @ ..] = *bytes else {
            return None;
        };
        let by_bit = u8::try_from(low.leading_zeros()).ok().filter(|_| low != 0);
        let port = by_bit.or_else(|| {
            let of = Self::HIGH_PORTS.iter().find(|(bit, _)| high & bit != 0);
            of.map(|(_, port)| *port)
        });
        Some(Self {
            port,
            is_corrupt: high & Self::ERRORS != 0,
            at: Duration::from_nanos(u64::from_le_bytes(time)),
        })
    }
}

/// Converts the probe's time to the time of the recording host.
#[derive(Debug, Default)]
struct ProbeClock {
    /// Times of host and probe at the first frame.
    origin: Option<(Duration, Duration)>,
}

impl ProbeClock {
    /// A larger difference between the two clocks is a restart of the probe.
    const JUMP: Duration = Duration::from_secs(1);

    fn time(&mut self, host: Duration, probe: Duration) -> Duration {
        let at = self.origin.and_then(|(then, origin)| {
            let at = then.checked_add(probe.checked_sub(origin)?)?;
            (at.abs_diff(host) <= Self::JUMP).then_some(at)
        });
        at.unwrap_or_else(|| {
            self.origin = Some((host, probe));
            host
        })
    }
}
