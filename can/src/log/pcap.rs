//! Recordings of SocketCAN by tcpdump, dumpcap and Wireshark: pcap and pcapng with the link types of CAN (227) and of
//! the Linux "any" device (113, 276). Packets of other protocols are skipped.
//!
//! | bytes of a frame | content |
//! |---|---|
//! | 0 to 3 | identifier; bit 31 extended, bit 30 remote, bit 29 error. Big-endian; in the host's order after a header of "any" |
//! | 4 | length of the data, bytes; bit 7 marks CAN XL |
//! | 5 | CAN FD: bit 0 bit rate switch, bit 1 sender is passive, bit 2 it is a CAN FD frame |
//! | 7 | length code, if it differs from the length |
//! | 8 ... | data |

use takt_link::capture::{CaptureError, LinkType, Packet, Reader};

use super::{Direction, Log, Record};
use crate::{AnyFrame, ErrorFrame, FdFrame, Frame, Id, LogError};

const DAMAGED: LogError = LogError::Event {
    what: "a packet of a pcap file, cut off or damaged,",
};
const FRAME: LogError = LogError::Event {
    what: "a CAN frame in a pcap file",
};
/// The interface of a file that names none.
const NAMELESS: &str = "can";

pub(super) fn read(bytes: &[u8], log: &mut Log) {
    let Ok(mut reader) = Reader::new(bytes) else {
        return log.leave_out(0, DAMAGED);
    };
    while let Some(packet) = reader.next() {
        match packet {
            Ok(packet) => {
                let name = reader.interface_name(packet.interface);
                let interface = name.filter(|name| is_word(name)).unwrap_or(NAMELESS);
                if !take(&packet, interface, log) {
                    return;
                }
            }
            Err(CaptureError::Damaged { offset, .. }) => log.leave_out(location(offset), DAMAGED),
            Err(_) => log.leave_out(bytes.len(), DAMAGED),
        }
    }
    if let Some(cut) = reader.cut() {
        log.leave_out(bytes.len().saturating_sub(location(cut.left)), DAMAGED);
    }
}

fn location(offset: u64) -> usize {
    usize::try_from(offset).unwrap_or(usize::MAX)
}

/// Whether a candump log can hold the name.
fn is_word(name: &str) -> bool {
    (1..=15).contains(&name.len()) && name.bytes().all(|byte| byte.is_ascii_graphic())
}

/// Reads the frame of a packet; returns false for a link type that carries none.
fn take(packet: &Packet, interface: &str, log: &mut Log) -> bool {
    let location = location(packet.offset);
    let Some(frame) = unwrap(packet, interface) else {
        let link = packet.link.0;
        log.leave_out(location, LogError::LinkType { link });
        return false;
    };
    if let Some((direction, interface, is_big_endian, bytes)) = frame {
        let frame = frame_of(bytes, is_big_endian);
        let record = frame.map(|frame| Record {
            at: packet.at,
            interface,
            frame,
            direction,
        });
        log.take(location, record);
    }
    true
}

/// Direction, interface, whether the identifier is big-endian, frame.
type Unwrapped<'a> = (Option<Direction>, String, bool, &'a [u8]);

/// Removes the header of the link. `None` for an unknown link type; `Some(None)` for another protocol.
fn unwrap<'a>(packet: &'a Packet, interface: &str) -> Option<Option<Unwrapped<'a>>> {
    let data = packet.data.as_slice();
    let two = |at: usize| {
        let bytes = data.get(at..)?.first_chunk()?;
        Some(u16::from_be_bytes(*bytes))
    };
    let is_can = |protocol: u16| matches!(protocol, 0x0C..=0x0E);
    // Packets of type 4 were sent by the host itself.
    let direction = |kind: u16| match kind {
        4 => Direction::Transmitted,
        _ => Direction::Received,
    };
    let (interface, order) = (interface.to_owned(), packet.is_big_endian);
    Some(match packet.link {
        LinkType::CAN_SOCKETCAN => Some((None, interface, true, data)),
        LinkType::LINUX_SLL => data.get(16..).zip(two(0)).and_then(|(frame, kind)| {
            let is_can = two(14).is_some_and(is_can);
            is_can.then(|| (Some(direction(kind)), interface, order, frame))
        }),
        LinkType::LINUX_SLL2 => data.get(20..).and_then(|frame| {
            let is_can = two(0).is_some_and(is_can);
            let index = data.get(4..)?.first_chunk()?;
            let name = format!("if{}", u32::from_be_bytes(*index));
            let kind = u16::from(*data.get(10)?);
            is_can.then(|| (Some(direction(kind)), name, order, frame))
        }),
        _ => return None,
    })
}

fn frame_of(bytes: &[u8], is_big_endian: bool) -> Result<AnyFrame, LogError> {
    let (head, data) = bytes.split_first_chunk::<8>().ok_or(FRAME)?;
    let [a, b, c, d, len, flags, _, code] = *head;
    if len & 0x80 != 0 {
        return Err(LogError::Unsupported {
            what: "a CAN XL frame",
        });
    }
    let raw = if is_big_endian {
        u32::from_be_bytes([a, b, c, d])
    } else {
        u32::from_le_bytes([a, b, c, d])
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
