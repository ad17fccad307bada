//! Detects the wire format of a controller, and adds and removes the frame of the third. It keeps no history:
//! [`crate::sunrise::Session`] stores the dialect of a controller.

use super::{Dialect, Monitoring};
use crate::error::{DecodeError, EncodeError};

/// Bytes before the message in a framed datagram: its length, u32 little endian.
const HEAD: usize = 4;
/// Bytes after the message: CRC-32 (IEEE 802.3) of the message alone, u32 little endian.
const TAIL: usize = 4;

/// Returns the message in a datagram and whether it was framed, as in 2.7:
///
/// | offset | type | field |
/// |--:|---|---|
/// | 0 | u32 | length n of the message |
/// | 4 | n bytes | message |
/// | 4 + n | u32 | CRC-32 of the message |
///
/// A bare message begins with the key of its header, 0x0a, and never with its own length.
pub fn unframe(datagram: &[u8]) -> Result<(bool, &[u8]), DecodeError> {
    let Some(message) = framed(datagram) else {
        return bare(datagram);
    };
    let tail = datagram.last_chunk::<TAIL>().copied();
    let stated = u32::from_le_bytes(tail.unwrap_or_default());
    let computed = crc32fast::hash(message);
    if stated != computed {
        return Err(DecodeError::Checksum { stated, computed });
    }
    Ok((true, message))
}

/// The message in a frame whose length matches the datagram's.
fn framed(datagram: &[u8]) -> Option<&[u8]> {
    let (head, rest) = datagram.split_first_chunk::<HEAD>()?;
    let (message, _) = rest.split_last_chunk::<TAIL>()?;
    let stated = usize::try_from(u32::from_le_bytes(*head)).ok()?;
    (stated == message.len()).then_some(message)
}

fn bare(datagram: &[u8]) -> Result<(bool, &[u8]), DecodeError> {
    match datagram {
        [0x0a, ..] => Ok((false, datagram)),
        _ => Err(DecodeError::NoMessage {
            actual: datagram.len(),
        }),
    }
}

impl Dialect {
    /// Dialect of the sender of a monitoring message; `None` if it fits more than one.
    pub fn of(is_framed: bool, message: &Monitoring) -> Option<Self> {
        if is_framed {
            return Some(Self::V3);
        }
        let data = message.monitor.as_ref()?;
        if data.commanded.is_some() {
            return Some(Self::V1);
        }
        (data.measured.is_some() || data.pose.is_some()).then_some(Self::V2)
    }

    /// Whether datagrams have a frame.
    pub(crate) fn is_framed(self) -> bool {
        self == Self::V3
    }

    /// Writes a datagram: the message that `encode` writes to the front of its buffer, framed if the dialect has a
    /// frame. Returns the datagram's length.
    pub fn frame(
        self,
        buf: &mut [u8],
        encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>,
    ) -> Result<usize, EncodeError> {
        if !self.is_framed() {
            return encode(buf);
        }
        let actual = buf.len();
        let needed = HEAD + TAIL;
        let room = actual.saturating_sub(TAIL);
        let inner = buf.get_mut(HEAD..room.max(HEAD));
        let len = encode(inner.ok_or(EncodeError::Buffer { needed, actual })?)?;
        let needed = HEAD + len + TAIL;
        let full = EncodeError::Buffer { needed, actual };
        let (head, rest) = buf.split_first_chunk_mut::<HEAD>().ok_or(full)?;
        let (message, tail) = rest.split_at_mut_checked(len).ok_or(full)?;
        *head = u32::try_from(len).map_err(|_| full)?.to_le_bytes();
        *tail.first_chunk_mut().ok_or(full)? = crc32fast::hash(message).to_le_bytes();
        Ok(needed)
    }
}
