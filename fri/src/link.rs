//! The smallest transport that a session owner needs: one datagram and its time of arrival. It never retries.

use std::io;
use std::time::Duration;

mod pair;

pub use pair::{Memory, pair};

/// Transport of datagrams to one peer.
pub trait Link {
    /// Sends one datagram and returns its length; 0 while no peer is known.
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize>;

    /// Waits at most `timeout` for one datagram; `None` on timeout.
    ///
    /// Returns length and time of arrival on the link's clock. A datagram longer than `buf` is truncated, so a buffer
    /// one byte longer than the expected datagram lets the decoder see the wrong length.
    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>>;
}
