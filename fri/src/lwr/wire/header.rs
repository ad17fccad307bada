//! The eight bytes at the start of both datagrams. The session evaluates the sequence numbers.

use super::codec::{Reader, Writer};
use crate::error::{DecodeError, EncodeError};

const PACKET_SIZE_OFFSET: usize = 4;
const DATAGRAM_ID_OFFSET: usize = 6;

/// Sequence numbers of a datagram; length and id of the header are constants of each message.
///
/// | offset | type | field | meaning |
/// |--:|---|---|---|
/// | 0 | u16 | sendSeqCount | the sender's counter |
/// | 2 | u16 | reflSeqCount | last sendSeqCount that the sender received |
/// | 4 | u16 | packetSize | length of the whole datagram in bytes |
/// | 6 | u16 | datagramId | kind and version |
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Header {
    /// The sender's own counter, +1 per datagram, wraps at 65535.
    #[doc(alias = "sendSeqCount")]
    pub sequence: u16,
    /// Counter of the last datagram that the sender received.
    #[doc(alias = "reflSeqCount")]
    pub reflected: u16,
}

impl Header {
    pub(super) fn read(from: &mut Reader<'_>, len: u16, id: u16) -> Result<Self, DecodeError> {
        let header = Self {
            sequence: from.u16()?,
            reflected: from.u16()?,
        };
        let packet_size = from.u16()?;
        if packet_size != len {
            let (expected, actual, offset) = (len, packet_size, PACKET_SIZE_OFFSET);
            return Err(DecodeError::PacketSize {
                expected,
                actual,
                offset,
            });
        }
        let datagram_id = from.u16()?;
        if datagram_id != id {
            let (expected, actual, offset) = (id, datagram_id, DATAGRAM_ID_OFFSET);
            return Err(DecodeError::DatagramId {
                expected,
                actual,
                offset,
            });
        }
        Ok(header)
    }

    pub(super) fn write(self, to: &mut Writer<'_>, len: u16, id: u16) -> Result<(), EncodeError> {
        to.u16(self.sequence)?;
        to.u16(self.reflected)?;
        to.u16(len)?;
        to.u16(id)
    }
}
