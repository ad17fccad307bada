//! An EtherCAT frame as received: its header and an iterator over its datagrams. It starts after the Ethernet header;
//! the sender is not checked.

use std::fmt;
use std::iter::FusedIterator;

use super::{Datagram, LENGTH_MASK};
use crate::{DecodeError, EncodeError};

/// The two bytes before the datagrams, little-endian: bits 0 to 10 length of all datagrams, bits 12
/// to 15 type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// Length of the following data without padding, bytes; 0 to 2047.
    pub len: u16,
    /// Type, 0 to 15; 1 for datagrams.
    pub kind: u8,
}

impl FrameHeader {
    /// Bytes on the wire.
    pub const LEN: usize = 2;
    /// The type of a frame that holds datagrams.
    pub(crate) const DATAGRAMS: u8 = 1;

    /// Reads the header at the start of `bytes`.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let truncated = DecodeError::Truncated {
            item: "frame header",
            expected: Self::LEN,
            actual: bytes.len(),
        };
        let [low, high] = *bytes.first_chunk().ok_or(truncated)?;
        Ok(Self {
            len: u16::from_le_bytes([low, high]) & LENGTH_MASK,
            kind: high >> 4,
        })
    }

    /// Writes the header at the start of `buffer`; returns its length. Only the low four bits of `kind` are written.
    pub fn encode(&self, buffer: &mut [u8]) -> Result<usize, EncodeError> {
        if self.len > LENGTH_MASK {
            return Err(EncodeError::Length { len: self.len });
        }
        let full = EncodeError::Full {
            expected: Self::LEN,
            actual: buffer.len(),
        };
        let header: &mut [u8; Self::LEN] = buffer.first_chunk_mut().ok_or(full)?;
        *header = (self.len | u16::from(self.kind) << 12).to_le_bytes();
        Ok(Self::LEN)
    }
}

/// A frame as received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Its length and type.
    pub header: FrameHeader,
    /// `header.len` bytes.
    pub payload: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Reads a frame from the payload of an Ethernet frame; bytes after the declared length are padding.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let header = FrameHeader::decode(bytes)?;
        let rest = bytes.get(FrameHeader::LEN..).unwrap_or_default();
        let expected = usize::from(header.len);
        let truncated = DecodeError::Truncated {
            item: "frame payload",
            expected,
            actual: rest.len(),
        };
        Ok(Self {
            header,
            payload: rest.get(..expected).ok_or(truncated)?,
        })
    }

    /// The datagrams in order, ended by the first error.
    pub const fn datagrams(&self) -> Datagrams<'a> {
        let next = if self.header.kind == FrameHeader::DATAGRAMS {
            Next::Datagram(self.payload)
        } else {
            Next::Error(DecodeError::NoDatagrams {
                kind: self.header.kind,
            })
        };
        Datagrams { next }
    }
}

/// Iterator over the datagrams of a frame.
#[derive(Clone, Debug)]
pub struct Datagrams<'a> {
    next: Next<'a>,
}

#[derive(Clone, Copy, Debug)]
enum Next<'a> {
    Datagram(&'a [u8]),
    Error(DecodeError),
    End,
}

impl<'a> Iterator for Datagrams<'a> {
    type Item = Result<Datagram<'a>, DecodeError>;

    fn next(&mut self) -> Option<Self::Item> {
        let item = match self.next {
            Next::Datagram(bytes) => Datagram::decode(bytes),
            Next::Error(error) => Err(error),
            Next::End => return None,
        };
        self.next = item.map_or(Next::End, |(datagram, rest)| after(&datagram, rest));
        Some(item.map(|(datagram, _)| datagram))
    }
}

impl FusedIterator for Datagrams<'_> {}

/// Compares the `more` flag with the remaining bytes.
const fn after<'a>(datagram: &Datagram<'_>, rest: &'a [u8]) -> Next<'a> {
    match (datagram.header.more, rest.len()) {
        (true, 0) => Next::Error(DecodeError::MissingDatagram),
        (true, _) => Next::Datagram(rest),
        (false, 0) => Next::End,
        (false, count) => Next::Error(DecodeError::TrailingBytes { count }),
    }
}

impl fmt::Display for Frame<'_> {
    /// All datagrams in one line, `;` between them, the error last if there is one.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "EtherCAT {} bytes:", self.header.len)?;
        for (number, datagram) in self.datagrams().enumerate() {
            f.write_str(if number == 0 { " " } else { "; " })?;
            match datagram {
                Ok(datagram) => datagram.fmt(f)?,
                Err(error) => write!(f, "[{error}]")?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// By hand from the layout: a BRD of 0000h with one byte, answered by three slaves, and the
    /// padding that a frame this short has.
    const BRD: [u8; 20] = [
        0x0D, 0x10, 0x07, 0x01, 0x03, 0x00, 0x00, 0x00, 0x01, 0x00, 0x00, 0x00, 0x11, 0x03,
        0x00, //
        0, 0, 0, 0, 0,
    ];

    /// By hand: FRMW of the system time (0910h) of station 1001h, then LRW of four bytes at
    /// 00010000h.
    const CYCLIC: [u8; 38] = [
        0x24, 0x10, //
        0x0E, 0x20, 0x01, 0x10, 0x10, 0x09, 0x08, 0x80, 0x00, 0x00, //
        0x88, 0x77, 0x66, 0x55, 0x44, 0x33, 0x22, 0x11, 0x02, 0x00, //
        0x0C, 0x21, 0x00, 0x00, 0x01, 0x00, 0x04, 0x00, 0x00, 0x00, //
        0x0F, 0x00, 0x37, 0x12, 0x03, 0x00,
    ];

    #[test]
    fn padding_behind_the_length_is_ignored() {
        let frame = Frame::decode(&BRD).unwrap();
        let shown = "EtherCAT 13 bytes: BRD #01 0003:0000 len 1 wkc 3";
        assert_eq!(frame.to_string(), shown);
        assert_eq!(frame.datagrams().count(), 1);
    }

    #[test]
    fn cyclic_frame_of_two_datagrams() {
        let frame = Frame::decode(&CYCLIC).unwrap();
        let shown = "EtherCAT 36 bytes: FRMW #20 1001:0910 len 8 wkc 2; \
                     LRW #21 00010000 len 4 wkc 3";
        assert_eq!(frame.to_string(), shown);
        let data: Vec<&[u8]> = frame.datagrams().map(|item| item.unwrap().data).collect();
        assert_eq!(data, [&CYCLIC[12..20], &CYCLIC[32..36]]);
    }

    fn last_error(bytes: &[u8]) -> DecodeError {
        let frame = match Frame::decode(bytes) {
            Ok(frame) => frame,
            Err(error) => return error,
        };
        frame.datagrams().last().unwrap().unwrap_err()
    }

    fn changed(offset: usize, byte: u8) -> [u8; 38] {
        let mut bytes = CYCLIC;
        bytes[offset] = byte;
        bytes
    }

    #[test]
    fn each_wrong_length_has_its_error() {
        let truncated = |item, expected, actual| DecodeError::Truncated {
            item,
            expected,
            actual,
        };
        let data = "datagram data and working counter";
        for (bytes, error) in [
            (&CYCLIC[..1], truncated("frame header", 2, 1)),
            (&CYCLIC[..37], truncated("frame payload", 36, 35)),
            (&changed(0, 0x25), truncated("frame payload", 37, 36)),
            (&changed(0, 0x23), truncated(data, 6, 5)),
            (&changed(28, 0x05), truncated(data, 7, 6)),
            (&changed(28, 0x03), DecodeError::TrailingBytes { count: 1 }),
            (&changed(29, 0x80), DecodeError::MissingDatagram),
            (&changed(9, 0x00), DecodeError::TrailingBytes { count: 16 }),
            (&changed(0, 0x14), DecodeError::MissingDatagram),
            (&changed(0, 0x00), truncated("datagram header", 10, 0)),
            (&changed(1, 0x50), DecodeError::NoDatagrams { kind: 5 }),
        ] {
            assert_eq!(last_error(bytes), error);
        }
    }

    #[test]
    fn iterator_ends_after_an_error() {
        let bytes = changed(29, 0x80);
        let mut datagrams = Frame::decode(&bytes).unwrap().datagrams();
        let good = datagrams.by_ref().take_while(Result::is_ok).count();
        assert_eq!((good, datagrams.next(), datagrams.next()), (2, None, None));
    }

    #[test]
    fn header_keeps_length_and_type() {
        let mut buffer = [0; 2];
        for header in [
            FrameHeader {
                len: 2047,
                kind: 15,
            },
            FrameHeader { len: 0, kind: 0 },
        ] {
            assert_eq!(header.encode(&mut buffer), Ok(2));
            assert_eq!(FrameHeader::decode(&buffer), Ok(header));
        }
        let long = FrameHeader { len: 2048, kind: 1 };
        assert_eq!(
            long.encode(&mut buffer),
            Err(EncodeError::Length { len: 2048 })
        );
        let full = EncodeError::Full {
            expected: 2,
            actual: 1,
        };
        assert_eq!(FrameHeader { len: 1, kind: 1 }.encode(&mut [0]), Err(full));
    }

    proptest! {
        #[test]
        fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            if let Ok(frame) = Frame::decode(&bytes) {
                let errors = frame.datagrams().filter(Result::is_err).count();
                prop_assert!(errors <= 1);
                prop_assert!(!frame.to_string().contains('\n'));
            }
        }

        #[test]
        fn any_change_of_a_good_frame_is_answered(offset in 0..38_usize, byte in any::<u8>()) {
            let bytes = changed(offset, byte);
            if let Ok(frame) = Frame::decode(&bytes) {
                prop_assert!(frame.datagrams().count() <= 3);
            }
        }
    }
}
