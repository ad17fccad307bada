//! Adds and removes the Ethernet header between an EtherCAT frame and a [`Link`]. Frames of other types are skipped;
//! the source address is not checked, as a returning frame carries the address of its sender.

use std::io;
use std::time::Duration;

use super::{ETHER_TYPE, FRAME_MAX, FRAME_MIN, HEADER_LEN, Link};

/// Maximum number of foreign frames skipped in one call.
const FOREIGN_MAX: usize = 16;

/// A port of a master: a link and its source address.
#[derive(Debug)]
pub struct Port<L> {
    link: L,
    /// Buffer of the sent or received frame, with its header.
    frame: [u8; FRAME_MAX],
    source: [u8; 6],
    foreign: u64,
}

impl<L: Link> Port<L> {
    /// A port with a source MAC address; it sends to the broadcast address.
    pub const fn new(link: L, source: [u8; 6]) -> Self {
        Self {
            link,
            frame: [0; FRAME_MAX],
            source,
            foreign: 0,
        }
    }

    /// The link.
    pub const fn link(&mut self) -> &mut L {
        &mut self.link
    }

    /// Its source MAC address.
    pub const fn source(&self) -> [u8; 6] {
        self.source
    }

    /// Whether the frame that was received last was sent with this source address. Slaves may set its bit 1 (locally
    /// administered) while they forward a frame.
    pub fn received_from(&self, source: [u8; 6]) -> bool {
        let plain = |mut mac: [u8; 6]| {
            mac[0] &= !0x02;
            mac
        };
        let sender = self.frame.get(6..).and_then(|rest| rest.first_chunk());
        sender.is_some_and(|sender| plain(*sender) == plain(source))
    }

    /// Number of frames skipped because they were not EtherCAT.
    pub const fn foreign(&self) -> u64 {
        self.foreign
    }

    /// Sends an EtherCAT frame: adds header and padding. A frame longer than an Ethernet frame is refused.
    pub fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let end = HEADER_LEN + frame.len();
        let Some(body) = self.frame.get_mut(HEADER_LEN..end) else {
            let text = "an EtherCAT frame has at most 1500 bytes";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
        };
        body.copy_from_slice(frame);
        let len = end.max(FRAME_MIN);
        self.frame[end..len].fill(0);
        let [a, b] = ETHER_TYPE.to_be_bytes();
        self.frame[..6].fill(0xFF);
        self.frame[6..12].copy_from_slice(&self.source);
        self.frame[12..HEADER_LEN].copy_from_slice(&[a, b]);
        self.link.send(&self.frame[..len]).map(drop)
    }

    /// Waits at most `timeout` for an EtherCAT frame; returns it without its header, and its time of arrival.
    pub fn receive(&mut self, timeout: Duration) -> io::Result<Option<(&[u8], Duration)>> {
        for _ in 0..FOREIGN_MAX {
            let Some((len, at)) = self.link.receive(&mut self.frame, timeout)? else {
                return Ok(None);
            };
            if len > HEADER_LEN && self.frame[12..HEADER_LEN] == ETHER_TYPE.to_be_bytes() {
                return Ok(self.frame.get(HEADER_LEN..len).map(|frame| (frame, at)));
            }
            self.foreign += 1;
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::super::pair;
    use super::*;

    #[test]
    fn short_frames_are_padded_and_foreign_ones_skipped() {
        let (near, mut far) = pair();
        let mut port = Port::new(near, [2, 0, 0, 0, 0, 1]);
        port.send(&[7; 20]).unwrap();
        let mut frame = [0xEE; FRAME_MAX];
        let (len, _) = far.receive(&mut frame, Duration::ZERO).unwrap().unwrap();
        assert_eq!(len, FRAME_MIN);
        assert_eq!(
            &frame[..16],
            &[
                255, 255, 255, 255, 255, 255, 2, 0, 0, 0, 0, 1, 0x88, 0xA4, 7, 7
            ]
        );
        assert_eq!(&frame[34..60], &[0; 26]);
        let mut other = frame;
        other[12..14].copy_from_slice(&[0x08, 0x06]);
        far.send(&other[..60]).unwrap();
        far.send(&frame[..60]).unwrap();
        let (body, _) = port.receive(Duration::ZERO).unwrap().unwrap();
        assert_eq!((body.len(), body[19], body[20]), (46, 7, 0));
        assert!(port.received_from([0, 0, 0, 0, 0, 1]) && port.received_from(port.source()));
        assert!(!port.received_from([2, 0, 0, 0, 0, 2]));
        assert_eq!(port.foreign(), 1);
        assert!(port.receive(Duration::ZERO).unwrap().is_none());
        assert!(port.send(&[0; 1501]).is_err());
    }
}
