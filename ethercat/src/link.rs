//! The smallest interface that a master or a segment needs: sends and receives one Ethernet frame, with its time of
//! arrival. It never retries, and it does not match answers to requests.

use std::io;
use std::time::Duration;

mod pair;
mod port;
mod replay;

pub use pair::{Memory, pair};
pub use port::Port;
pub use replay::Replay;

/// Ethernet type of EtherCAT.
pub const ETHER_TYPE: u16 = 0x88A4;
/// Destination, source, type: bytes before an EtherCAT frame.
pub const HEADER_LEN: usize = 14;
/// Shortest Ethernet frame without its check sequence; shorter ones are padded with zeros.
pub const FRAME_MIN: usize = 60;
/// Longest Ethernet frame without its check sequence.
pub const FRAME_MAX: usize = HEADER_LEN + 1500;

/// An endpoint of a cable. Frames are complete Ethernet frames without check sequence.
pub trait Link {
    /// Sends one frame.
    fn send(&mut self, frame: &[u8]) -> io::Result<()>;

    /// Waits at most `timeout` for one frame; `None` on timeout. Zero polls without waiting.
    ///
    /// Returns the length and the time of arrival on the link's clock. A frame longer than `buf` is cut.
    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>>;

    /// The network interface of this host that it is at, if it is at one.
    fn interface(&self) -> Option<&str> {
        None
    }
}

impl<L: Link + ?Sized> Link for Box<L> {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        (**self).send(frame)
    }

    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>> {
        (**self).receive(buf, timeout)
    }

    fn interface(&self) -> Option<&str> {
        (**self).interface()
    }
}
