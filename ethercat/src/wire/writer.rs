//! Writes a frame datagram by datagram, with consistent lengths and `more` flags. It sends nothing.

use super::datagram::{Address, DatagramHeader, WorkingCounter};
use super::{Command, FrameHeader};
use crate::EncodeError;

/// A frame being written to a buffer of its owner.
///
/// Starts after the Ethernet header. Without a pushed datagram, [`FrameWriter::finish`] leaves an empty frame, which no
/// slave processes.
#[derive(Debug)]
pub struct FrameWriter<'a> {
    buffer: &'a mut [u8],
    /// Length of all datagrams, bytes.
    len: u16,
    /// The header of the last datagram and its offset, to set its `more` flag.
    last: Option<(usize, DatagramHeader)>,
}

impl<'a> FrameWriter<'a> {
    /// Longest frame in bytes, with its header: the payload of an Ethernet frame.
    pub const LEN_MAX: usize = 1500;

    /// Starts a frame. It uses at most [`FrameWriter::LEN_MAX`] bytes of the buffer.
    pub fn new(buffer: &'a mut [u8]) -> Result<Self, EncodeError> {
        let len = buffer.len().min(Self::LEN_MAX);
        let mut writer = Self {
            buffer: buffer.split_at_mut(len).0,
            len: 0,
            last: None,
        };
        writer.write_frame_header()?;
        Ok(writer)
    }

    /// Adds a datagram with a working counter of zero. If it does not fit, the frame is unchanged.
    pub fn push(
        &mut self,
        command: Command,
        index: u8,
        address: Address,
        data: &[u8],
    ) -> Result<(), EncodeError> {
        let start = FrameHeader::LEN + usize::from(self.len);
        let free = self.buffer.get_mut(start..).unwrap_or_default();
        let added = DatagramHeader::LEN + data.len() + WorkingCounter::LEN;
        let full = EncodeError::Full {
            expected: added,
            actual: free.len(),
        };
        // Fits 16 bits, as it fits the buffer; checked nevertheless.
        let (Ok(len), Ok(added_len)) = (u16::try_from(data.len()), u16::try_from(added)) else {
            return Err(full);
        };
        let slot = free.get_mut(..added).ok_or(full)?;
        let header = DatagramHeader {
            command,
            index,
            address,
            len,
            circulating: false,
            more: false,
            irq: 0,
        };
        slot.fill(0);
        header.encode(slot)?;
        for (to, from) in slot.iter_mut().skip(DatagramHeader::LEN).zip(data) {
            *to = *from;
        }
        self.announce()?;
        self.last = Some((start, header));
        self.len += added_len;
        self.write_frame_header()
    }

    /// Length of the frame in bytes, with its header. The sender adds the padding to Ethernet's minimum.
    pub fn finish(self) -> usize {
        FrameHeader::LEN + usize::from(self.len)
    }

    /// Sets the `more` flag of the previous datagram.
    fn announce(&mut self) -> Result<(), EncodeError> {
        if let Some((start, header)) = self.last {
            let slot = self.buffer.get_mut(start..).unwrap_or_default();
            DatagramHeader {
                more: true,
                ..header
            }
            .encode(slot)?;
        }
        Ok(())
    }

    fn write_frame_header(&mut self) -> Result<(), EncodeError> {
        let header = FrameHeader {
            len: self.len,
            kind: FrameHeader::DATAGRAMS,
        };
        header.encode(self.buffer).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::datagram::tests::any_command_and_address;
    use super::*;
    use crate::{Datagram, Frame};

    const HERE: Address = Address::Device {
        adp: 0x1001,
        ado: 0x0910,
    };

    #[test]
    fn frame_that_does_not_fit_stays_as_it_was() {
        let mut buffer = [0xFF; 30];
        let mut writer = FrameWriter::new(&mut buffer).unwrap();
        writer.push(Command::Frmw, 7, HERE, &[1; 8]).unwrap();
        let full = EncodeError::Full {
            expected: 12,
            actual: 8,
        };
        assert_eq!(writer.push(Command::Brd, 8, HERE, &[]), Err(full));
        let len = writer.finish();
        let shown = "EtherCAT 20 bytes: FRMW #07 1001:0910 len 8 wkc 0";
        assert_eq!(Frame::decode(&buffer[..len]).unwrap().to_string(), shown);
    }

    #[test]
    fn longest_frame_is_that_of_ethernet() {
        let mut buffer = [0; 4000];
        let mut writer = FrameWriter::new(&mut buffer).unwrap();
        let full = EncodeError::Full {
            expected: 1499,
            actual: 1498,
        };
        assert_eq!(
            writer.push(Command::Lrw, 0, Address::Logical(0), &[0; 1487]),
            Err(full)
        );
        writer
            .push(Command::Lrw, 0, Address::Logical(0), &[0; 1486])
            .unwrap();
        assert_eq!(writer.finish(), FrameWriter::LEN_MAX);
        let full = EncodeError::Full {
            expected: 2,
            actual: 1,
        };
        assert_eq!(FrameWriter::new(&mut [0]).unwrap_err(), full);
    }

    proptest! {
        #[test]
        fn written_frame_reads_back(
            parts in prop::collection::vec(
                (any_command_and_address(), any::<u8>(), prop::collection::vec(any::<u8>(), 0..40)),
                1..8,
            ),
        ) {
            let mut buffer = [0xFF; 600];
            let mut writer = FrameWriter::new(&mut buffer).unwrap();
            for ((command, address), index, data) in &parts {
                writer.push(*command, *index, *address, data).unwrap();
            }
            let len = writer.finish();
            let frame = Frame::decode(&buffer[..len]).unwrap();
            let read: Vec<Datagram<'_>> = frame.datagrams().map(Result::unwrap).collect();
            prop_assert_eq!(read.len(), parts.len());
            for (datagram, ((command, address), index, data)) in read.iter().zip(&parts) {
                let header = datagram.header;
                prop_assert_eq!((header.command, header.address), (*command, *address));
                prop_assert_eq!((header.index, datagram.data), (*index, data.as_slice()));
                prop_assert_eq!(datagram.working_counter, WorkingCounter::new(0));
            }
        }
    }
}
