//! The smallest thing an owner of a machine needs: move one datagram, with its time of arrival. It never retries.

use std::io;
use std::time::Duration;

mod pair;

pub use pair::{Memory, pair};

/// A way for datagrams to one peer.
pub trait Link {
    /// Sends one datagram and returns its length; 0 when there is nobody to send to yet.
    fn send(&mut self, bytes: &[u8]) -> io::Result<usize>;

    /// Waits at most `timeout` for one datagram; `None` when none came.
    ///
    /// On success the length and the time of arrival on the link's clock. A datagram longer than `buf` is cut, so a buffer
    /// one byte longer than the expected datagram lets the decoder see the wrong length.
    fn receive(
        &mut self,
        buf: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<(usize, Duration)>>;
}
