//! Runs an emulated cabinet on a link in real time. It makes no thread and asks for no priority: its caller does.

use super::cabinet::Cabinet;
use super::status::CabinetStatus;
use crate::emulator::Controller;
use crate::link::Link;
use std::io;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Serves `cabinet` on `link` until `stop`; the clock is [`crate::linux::monotonic`], which must also have given the start of
/// `cabinet`. After the first cycle nothing is allocated.
pub fn serve<L: Link>(
    cabinet: &mut Cabinet,
    link: &mut L,
    status: &CabinetStatus,
    stop: &AtomicBool,
) -> io::Result<()> {
    crate::emulator::serve(cabinet, link, status, stop)
}

impl Controller for Cabinet {
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
