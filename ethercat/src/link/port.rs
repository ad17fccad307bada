//! What lies between an EtherCAT frame and a [`Link`]: the Ethernet header. Frames of other kinds are passed over;
//! who sent one is not checked, as a frame that comes back carries its sender's own address.

use std::io;
use std::time::Duration;

use super::{ETHER_TYPE, FRAME_MAX, FRAME_MIN, HEADER_LEN, Link};

/// Foreign frames passed over in one call before it gives up.
const FOREIGN_MAX: usize = 16;

/// A port of a master: a link and the address it sends from.
#[derive(Debug)]
pub struct Port<L> {
    link: L,
    /// The frame that is sent or was received, with its header.
    frame: [u8; FRAME_MAX],
    source: [u8; 6],
    foreign: u64,
}

impl<L: Link> Port<L> {
    /// A port that sends from a MAC address, to all.
    #[must_use]
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

    /// Frames passed over because they were not EtherCAT.
    #[must_use]
    pub const fn foreign(&self) -> u64 {
        self.foreign
    }

    /// Sends an EtherCAT frame: puts the header before and the padding behind it. More than an Ethernet frame holds
    /// is refused.
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
        self.link.send(&self.frame[..len])
    }

    /// Waits at most `timeout` for an EtherCAT frame; gives it without its header, and when it came.
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
    fn short_frames_are_padded_and_foreign_ones_passed_over() {
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
        assert_eq!(port.foreign(), 1);
        assert!(port.receive(Duration::ZERO).unwrap().is_none());
        assert!(port.send(&[0; 1501]).is_err());
    }
}
