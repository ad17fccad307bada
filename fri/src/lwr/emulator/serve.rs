//! Runs an emulated KRC on a link in real time. It makes no thread and asks for no priority: its caller does.

use super::krc::Krc;
use super::status::KrcStatus;
use crate::emulator::Controller;
use crate::link::Link;
use std::io;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Serves `krc` on `link` until `stop`; the clock is [`crate::linux::monotonic`], which must also have given the start of
/// `krc`. Whoever is late skips to the grid, see [`Krc`]. After the first cycle nothing is allocated.
pub fn serve<L: Link>(
    krc: &mut Krc,
    link: &mut L,
    status: &KrcStatus,
    stop: &AtomicBool,
) -> io::Result<()> {
    crate::emulator::serve(krc, link, status, stop)
}

impl Controller for Krc {
    fn poll_transmit(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize> {
        self.poll_transmit(now, buf)
    }

    fn take(&mut self, bytes: &[u8], now: Duration) {
        let _malformed = self.handle_datagram(bytes, now);
    }

    fn poll_timeout(&self) -> Duration {
        self.poll_timeout()
    }
}
