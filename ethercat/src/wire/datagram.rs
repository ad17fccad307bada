//! One datagram: header, data, working counter. The data is not interpreted.

use std::fmt;

use super::{Command, LENGTH_MASK};
use crate::{DecodeError, EncodeError};

/// Working counter: number of slaves that executed a datagram, weighted by the command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct WorkingCounter(u16);

impl WorkingCounter {
    /// Bytes on the wire.
    pub(crate) const LEN: usize = 2;

    /// From the raw value; any 16 bits are a counter.
    pub const fn new(raw: u16) -> Self {
        Self(raw)
    }

    /// The number.
    pub const fn raw(self) -> u16 {
        self.0
    }
}

impl fmt::Display for WorkingCounter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Address of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Address {
    /// A slave and an address in its memory.
    Device {
        /// Position (each slave adds one) or station address, by the command.
        adp: u16,
        /// Register or memory address.
        ado: u16,
    },
    /// An address in the logical address space, which the slaves' FMMUs map.
    Logical(u32),
}

impl Address {
    fn from_bytes(command: Command, bytes: [u8; 4]) -> Self {
        if command.is_logical() {
            return Self::Logical(u32::from_le_bytes(bytes));
        }
        let [a, b, c, d] = bytes;
        Self::Device {
            adp: u16::from_le_bytes([a, b]),
            ado: u16::from_le_bytes([c, d]),
        }
    }

    fn to_bytes(self) -> [u8; 4] {
        match self {
            Self::Logical(address) => address.to_le_bytes(),
            Self::Device { adp, ado } => {
                let ([a, b], [c, d]) = (adp.to_le_bytes(), ado.to_le_bytes());
                [a, b, c, d]
            }
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device { adp, ado } => write!(f, "{adp:04x}:{ado:04x}"),
            Self::Logical(address) => write!(f, "{address:08x}"),
        }
    }
}

/// Header of a datagram. All numbers little-endian (ETG.1000.4):
///
/// | byte | field |
/// |--:|---|
/// | 0 | command |
/// | 1 | index, echoed |
/// | 2 | address: ADP and ADO, or one logical number |
/// | 6 | bits 0 to 10 length of the data, 14 circulating, 15 more follow |
/// | 8 | event request of the slaves, OR-ed |
/// | 10 | data, then the working counter |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DatagramHeader {
    /// The command.
    pub command: Command,
    /// Chosen by the master to match the answer; slaves do not change it.
    pub index: u8,
    /// The address.
    pub address: Address,
    /// Bytes of data, 0 to 2047.
    pub len: u16,
    /// Set by a slave that forwards the frame in an interrupted ring; a frame that returns with it is dropped.
    pub circulating: bool,
    /// Another datagram follows in the frame.
    pub more: bool,
    /// ECAT event request (register 0210h) of the slaves that have one unmasked.
    pub irq: u16,
}

const CIRCULATING: u16 = 1 << 14;
const MORE: u16 = 1 << 15;

impl DatagramHeader {
    /// Bytes on the wire.
    pub const LEN: usize = 10;

    /// Reads the header at the start of `bytes`.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let truncated = DecodeError::Truncated {
            item: "datagram header",
            expected: Self::LEN,
            actual: bytes.len(),
        };
        let header: &[u8; Self::LEN] = bytes.first_chunk().ok_or(truncated)?;
        let [
            code,
            index,
            a,
            b,
            c,
            d,
            length_low,
            length_high,
            irq_low,
            irq_high,
        ] = *header;
        let command = Command::from(code);
        let length = u16::from_le_bytes([length_low, length_high]);
        Ok(Self {
            command,
            index,
            address: Address::from_bytes(command, [a, b, c, d]),
            len: length & LENGTH_MASK,
            circulating: length & CIRCULATING != 0,
            more: length & MORE != 0,
            irq: u16::from_le_bytes([irq_low, irq_high]),
        })
    }

    /// Writes the header at the start of `buffer`; returns its length.
    pub fn encode(&self, buffer: &mut [u8]) -> Result<usize, EncodeError> {
        if self.len > LENGTH_MASK {
            return Err(EncodeError::Length { len: self.len });
        }
        let full = EncodeError::Full {
            expected: Self::LEN,
            actual: buffer.len(),
        };
        let header: &mut [u8; Self::LEN] = buffer.first_chunk_mut().ok_or(full)?;
        let flag = |set: bool, bit: u16| if set { bit } else { 0 };
        let length = self.len | flag(self.circulating, CIRCULATING) | flag(self.more, MORE);
        let ([a, b, c, d], [e, f], [g, h]) = (
            self.address.to_bytes(),
            length.to_le_bytes(),
            self.irq.to_le_bytes(),
        );
        *header = [self.command.into(), self.index, a, b, c, d, e, f, g, h];
        Ok(Self::LEN)
    }
}

/// A datagram as received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram<'a> {
    /// The header.
    pub header: DatagramHeader,
    /// `header.len` bytes.
    pub data: &'a [u8],
    /// The working counter.
    pub working_counter: WorkingCounter,
}

impl<'a> Datagram<'a> {
    /// Reads the datagram at the start of `bytes`; also returns the remaining bytes.
    pub fn decode(bytes: &'a [u8]) -> Result<(Self, &'a [u8]), DecodeError> {
        let header = DatagramHeader::decode(bytes)?;
        let rest = bytes.get(DatagramHeader::LEN..).unwrap_or_default();
        let len = usize::from(header.len);
        let truncated = DecodeError::Truncated {
            item: "datagram data and working counter",
            expected: len + WorkingCounter::LEN,
            actual: rest.len(),
        };
        let (data, rest) = rest.split_at_checked(len).ok_or(truncated)?;
        let (counter, rest) = rest.split_first_chunk().ok_or(truncated)?;
        let working_counter = WorkingCounter(u16::from_le_bytes(*counter));
        Ok((
            Self {
                header,
                data,
                working_counter,
            },
            rest,
        ))
    }
}

impl fmt::Display for Datagram<'_> {
    /// `FPRD #03 1001:0130 len 2 wkc 1`, with the event request if there is one.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DatagramHeader {
            command,
            index,
            address,
            len,
            circulating,
            irq,
            ..
        } = self.header;
        write!(
            f,
            "{command} #{index:02x} {address} len {len} wkc {}",
            self.working_counter
        )?;
        if irq != 0 {
            write!(f, " irq {irq:04x}")?;
        }
        if circulating {
            f.write_str(" circulating")
        } else {
            Ok(())
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use proptest::prelude::*;

    use super::*;

    /// By hand from the layout above: FPRD of 0130h in station 1001h, two bytes, more to follow.
    const FPRD: [u8; 14] = [
        0x04, 0x03, 0x01, 0x10, 0x30, 0x01, 0x02, 0x80, 0x04, 0x00, 0x08, 0x00, 0x01, 0x00,
    ];

    #[test]
    fn header_fields_sit_where_the_standard_puts_them() {
        let header = DatagramHeader::decode(&FPRD).unwrap();
        let expected = DatagramHeader {
            command: Command::Fprd,
            index: 3,
            address: Address::Device {
                adp: 0x1001,
                ado: 0x0130,
            },
            len: 2,
            circulating: false,
            more: true,
            irq: 4,
        };
        assert_eq!(header, expected);
        let mut buffer = [0xFF; 10];
        assert_eq!(header.encode(&mut buffer), Ok(10));
        assert_eq!(buffer, FPRD[..10]);
    }

    #[test]
    fn datagram_is_one_line() {
        let (datagram, rest) = Datagram::decode(&FPRD).unwrap();
        assert_eq!(
            datagram.to_string(),
            "FPRD #03 1001:0130 len 2 wkc 1 irq 0004"
        );
        assert_eq!((datagram.data, rest), (&[8, 0][..], &[][..]));
    }

    #[test]
    fn logical_address_is_one_number() {
        let mut bytes = FPRD;
        bytes[0] = 12;
        bytes[7] = 0x40;
        let (datagram, _) = Datagram::decode(&bytes).unwrap();
        assert_eq!(datagram.header.address, Address::Logical(0x0130_1001));
        let shown = "LRW #03 01301001 len 2 wkc 1 irq 0004 circulating";
        assert_eq!(datagram.to_string(), shown);
    }

    #[test]
    fn datagram_truncated_anywhere_is_an_error() {
        for len in 0..10 {
            let expected = DecodeError::Truncated {
                item: "datagram header",
                expected: 10,
                actual: len,
            };
            assert_eq!(Datagram::decode(&FPRD[..len]), Err(expected));
        }
        for len in 10..14 {
            let item = "datagram data and working counter";
            let expected = DecodeError::Truncated {
                item,
                expected: 4,
                actual: len - 10,
            };
            assert_eq!(Datagram::decode(&FPRD[..len]), Err(expected));
        }
    }

    #[test]
    fn datagram_that_does_not_fit_is_refused() {
        let mut header = DatagramHeader::decode(&FPRD).unwrap();
        let full = EncodeError::Full {
            expected: 10,
            actual: 9,
        };
        assert_eq!(header.encode(&mut [0; 9]), Err(full));
        header.len = 2048;
        assert_eq!(
            header.encode(&mut [0; 10]),
            Err(EncodeError::Length { len: 2048 })
        );
    }

    pub(in crate::wire) fn any_command_and_address() -> impl Strategy<Value = (Command, Address)> {
        (any::<u8>(), any::<[u8; 4]>()).prop_map(|(code, bytes)| {
            let command = Command::from(code % 17);
            (command, Address::from_bytes(command, bytes))
        })
    }

    proptest! {
        #[test]
        fn random_header_reads_back(
            (command, address) in any_command_and_address(), index in any::<u8>(), len in 0..2048_u16,
            circulating in any::<bool>(), more in any::<bool>(), irq in any::<u16>(),
        ) {
            let header = DatagramHeader { command, index, address, len, circulating, more, irq };
            let mut buffer = [0; DatagramHeader::LEN];
            header.encode(&mut buffer).unwrap();
            prop_assert_eq!(DatagramHeader::decode(&buffer), Ok(header));
        }
    }
}
