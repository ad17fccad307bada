//! The smallest interface that a protocol needs of its wire: send and receive one frame or datagram, with its time of
//! arrival. It never retries, and it does not match answers to requests.

use std::io;
use std::time::Duration;

/// An endpoint of a wire that carries Ethernet frames (complete, without check sequence) or the datagrams of one peer.
pub trait Link {
    /// Sends one frame or datagram and returns its length; 0 while no peer is known.
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize>;

    /// Waits at most `timeout` for one frame or datagram; `None` on timeout. Zero polls without waiting.
    ///
    /// Returns length and time of arrival on the link's clock. What is longer than `buf` is truncated, so a buffer one
    /// byte longer than the expected datagram lets the decoder see the wrong length.
    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>>;

    /// The network interface of this host to which the link is bound, if any.
    fn interface(&self) -> Option<&str> {
        None
    }
}

impl<L: Link + ?Sized> Link for Box<L> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
        (**self).send(bytes)
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
