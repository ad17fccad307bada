//! Recordings of SocketCAN by tcpdump, dumpcap and Wireshark: pcap and pcapng with the link types of CAN (227) and of
//! the Linux "any" device (113, 276). Packets of other protocols are passed over.
//!
//! | bytes of a frame | what |
//! |---|---|
//! | 0 to 3 | identifier; bit 31 of 29 bits, bit 30 remote, bit 29 error. Big-endian, behind a header of "any" as the file |
//! | 4 | bytes of data; bit 7 marks CAN XL |
//! | 5 | of CAN FD: bit 0 bit rate switch, bit 1 sender is passive, bit 2 it is one |
//! | 7 | length code, if it is none of the length |
//! | 8 ... | data |

use std::time::Duration;

use pcap_file::Endianness;
use pcap_file::pcap::PcapParser;
use pcap_file::pcapng::blocks::interface_description::{
    InterfaceDescriptionBlock, InterfaceDescriptionOption,
};
use pcap_file::pcapng::{Block, PcapNgParser};

use super::{Direction, Log, Record};
use crate::{AnyFrame, ErrorFrame, FdFrame, Frame, Id, LogError};

const NG: [u8; 4] = [0x0A, 0x0D, 0x0D, 0x0A];
const CLASSIC: [[u8; 4]; 4] = [
    [0xA1, 0xB2, 0xC3, 0xD4],
    [0xD4, 0xC3, 0xB2, 0xA1],
    [0xA1, 0xB2, 0x3C, 0x4D],
    [0x4D, 0x3C, 0xB2, 0xA1],
];

const CAN: u32 = 227;
const COOKED: u32 = 113;
const COOKED_2: u32 = 276;

const BROKEN: LogError = LogError::Event {
    what: "a packet of a pcap file, cut off or damaged,",
};
const FRAME: LogError = LogError::Event {
    what: "a CAN frame in a pcap file",
};

/// Which of the two a file is by its first bytes.
pub(super) fn is_pcap(bytes: &[u8]) -> bool {
    bytes
        .first_chunk()
        .is_some_and(|first| CLASSIC.contains(first))
}

/// The same for pcapng.
pub(super) fn is_pcapng(bytes: &[u8]) -> bool {
    bytes.starts_with(&NG)
}

/// A packet with what its file says of it.
#[derive(Clone, Copy, Debug)]
struct Packet<'a> {
    at: Duration,
    link: u32,
    order: Endianness,
    interface: &'a str,
    data: &'a [u8],
}

/// The interface of a file that names none.
const NAMELESS: &str = "can";

pub(super) fn read(bytes: &[u8], log: &mut Log) {
    let Ok((mut rest, parser)) = PcapParser::new(bytes) else {
        return log.leave_out(0, BROKEN);
    };
    let header = parser.header();
    let unit = match header.ts_resolution {
        pcap_file::TsResolution::MicroSecond => 1_000,
        pcap_file::TsResolution::NanoSecond => 1,
    };
    while !rest.is_empty() {
        let place = bytes.len() - rest.len();
        let Ok((behind, raw)) = parser.next_raw_packet(rest) else {
            return log.leave_out(place, BROKEN);
        };
        rest = behind;
        let fraction = Duration::from_nanos(u64::from(raw.ts_frac) * unit);
        let packet = Packet {
            at: Duration::from_secs(raw.ts_sec.into()) + fraction,
            link: header.datalink.into(),
            order: header.endianness,
            interface: NAMELESS,
            data: &raw.data,
        };
        if !take(place, &packet, log) {
            return;
        }
    }
}

pub(super) fn read_ng(bytes: &[u8], log: &mut Log) {
    let Ok((mut rest, mut parser)) = PcapNgParser::new(bytes) else {
        return log.leave_out(0, BROKEN);
    };
    while !rest.is_empty() {
        let place = bytes.len() - rest.len();
        let order = parser.section().endianness;
        let Ok((behind, block)) = parser.next_block(rest) else {
            log.leave_out(place, BROKEN);
            // The length of a block whose content is damaged still says where the next one begins.
            match rest.get(block_len(rest, order)..) {
                Some(next) if next.len() < rest.len() => rest = next,
                Some(_) | None => return,
            }
            continue;
        };
        rest = behind;
        let Block::EnhancedPacket(packet) = block else {
            continue;
        };
        let Some(interface) = parser.packet_interface(&packet) else {
            log.leave_out(place, BROKEN);
            continue;
        };
        let packet = Packet {
            at: time(&packet.timestamp, interface),
            link: interface.linktype.into(),
            order,
            interface: name(interface),
            data: &packet.data,
        };
        if !take(place, &packet, log) {
            return;
        }
    }
}

/// Total length of a block; 0 if it has none that can be.
fn block_len(block: &[u8], order: Endianness) -> usize {
    let len = block.get(4..).and_then(|rest| rest.first_chunk());
    let len = len.map_or(0, |bytes| match order {
        Endianness::Big => u32::from_be_bytes(*bytes),
        Endianness::Little => u32::from_le_bytes(*bytes),
    });
    usize::try_from(len).unwrap_or(usize::MAX)
}

fn name<'a>(interface: &'a InterfaceDescriptionBlock<'_>) -> &'a str {
    let mut options = interface.options.iter();
    let name = options.find_map(|option| {
        if let InterfaceDescriptionOption::IfName(name) = option {
            Some(name.as_ref())
        } else {
            None
        }
    });
    // As candump logs hold it: one word.
    let is_word = |name: &&str| {
        !name.is_empty() && name.len() <= 15 && name.bytes().all(|b| b.is_ascii_graphic())
    };
    name.filter(is_word).unwrap_or(NAMELESS)
}

/// The library takes the ticks of a file for nanoseconds, whatever the interface says: 10^-n s, or 2^-n s with the
/// highest bit set; 10^-6 s without a word.
fn time(ticks: &Duration, interface: &InterfaceDescriptionBlock<'_>) -> Duration {
    let mut options = interface.options.iter();
    let resolution = options.find_map(|option| {
        if let InterfaceDescriptionOption::IfTsResol(resolution) = option {
            Some(*resolution)
        } else {
            None
        }
    });
    let resolution = resolution.unwrap_or(6);
    let base: u128 = if resolution & 0x80 == 0 { 10 } else { 2 };
    let per_second = base.checked_pow(u32::from(resolution & 0x7F));
    let nanos = ticks.as_nanos().saturating_mul(1_000_000_000) / per_second.unwrap_or(u128::MAX);
    Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX))
}

/// Takes the frame out of a packet; returns whether it is worth while to go on.
fn take(place: usize, packet: &Packet<'_>, log: &mut Log) -> bool {
    let Some(frame) = unwrap(packet) else {
        let link = packet.link;
        log.leave_out(place, LogError::LinkType { link });
        return false;
    };
    if let Some((direction, interface, order, bytes)) = frame {
        let frame = frame_of(bytes, order);
        let record = frame.map(|frame| Record {
            at: packet.at,
            interface,
            frame,
            direction,
        });
        log.take(place, record);
    }
    true
}

type Unwrapped<'a> = (Option<Direction>, String, Endianness, &'a [u8]);

/// Takes the header of the link off. `None` for a link type that is not known; `Some(None)` for another protocol.
fn unwrap<'a>(packet: &Packet<'a>) -> Option<Option<Unwrapped<'a>>> {
    let data = packet.data;
    let two = |at: usize| {
        let bytes = data.get(at..)?.first_chunk()?;
        Some(u16::from_be_bytes(*bytes))
    };
    let is_can = |protocol: u16| matches!(protocol, 0x0C..=0x0E);
    // Packets of type 4 were sent by the host itself.
    let way = |kind: u16| match kind {
        4 => Direction::Transmitted,
        _ => Direction::Received,
    };
    let interface = packet.interface.to_owned();
    Some(match packet.link {
        CAN => Some((None, interface, Endianness::Big, data)),
        COOKED => data.get(16..).zip(two(0)).and_then(|(frame, kind)| {
            let is_can = two(14).is_some_and(is_can);
            is_can.then(|| (Some(way(kind)), interface, packet.order, frame))
        }),
        COOKED_2 => data.get(20..).and_then(|frame| {
            let is_can = two(0).is_some_and(is_can);
            let index = data.get(4..)?.first_chunk()?;
            let name = format!("if{}", u32::from_be_bytes(*index));
            let kind = u16::from(*data.get(10)?);
            is_can.then(|| (Some(way(kind)), name, packet.order, frame))
        }),
        _ => return None,
    })
}

fn frame_of(bytes: &[u8], order: Endianness) -> Result<AnyFrame, LogError> {
    let (head, data) = bytes.split_first_chunk::<8>().ok_or(FRAME)?;
    let [a, b, c, d, len, flags, _, code] = *head;
    if len & 0x80 != 0 {
        return Err(LogError::Unsupported {
            what: "a CAN XL frame",
        });
    }
    let raw = match order {
        Endianness::Big => u32::from_be_bytes([a, b, c, d]),
        Endianness::Little => u32::from_le_bytes([a, b, c, d]),
    };
    let len = usize::from(len);
    let bit = |bit: u32| raw >> bit & 1 == 1;
    if bit(29) {
        let mut eight = [0; 8];
        eight
            .iter_mut()
            .zip(data)
            .for_each(|(to, from)| *to = *from);
        return Ok(ErrorFrame::new(raw & 0x1FFF_FFFF, eight).into());
    }
    let id = if bit(31) {
        Id::extended(raw & 0x1FFF_FFFF)?
    } else {
        Id::standard((raw & 0x1FFF_FFFF).try_into().map_err(|_| FRAME)?)?
    };
    if bit(30) {
        return Ok(Frame::remote(id, len)?.into());
    }
    let data = data.get(..len).ok_or(FRAME)?;
    // Older recordings do not mark CAN FD; more than eight bytes are.
    if flags & 0x04 != 0 || len > 8 {
        let mut frame = FdFrame::new(id, data)?;
        frame.bit_rate_switch = flags & 0x01 != 0;
        frame.sender_is_passive = flags & 0x02 != 0;
        return Ok(frame.into());
    }
    let frame = Frame::new(id, data)?;
    Ok(match code {
        9..=15 if len == 8 => frame.with_raw_dlc(code)?.into(),
        _ => frame.into(),
    })
}

#[cfg(test)]
mod tests;
