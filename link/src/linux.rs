//! The host: its monotonic clock, waiting for a descriptor, its addresses and ports, captured packets, and a cable
//! between two threads. The only module with a clock; it has no unsafe code.

use std::io;
use std::os::fd::BorrowedFd;
use std::time::Duration;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, clock_gettime};

mod cable;
pub mod host;
mod sniffer;
mod stamps;

pub use cable::{CableEnd, cable};
pub use sniffer::Sniffer;
pub use stamps::{receive_frame, receive_from, stamp_arrivals};

/// Time of `CLOCK_MONOTONIC`, the clock of all time stamps of links on this host.
pub fn monotonic() -> io::Result<Duration> {
    Ok(clock_gettime(ClockId::CLOCK_MONOTONIC)?.into())
}

/// Sleeps until the descriptor is readable, at most `timeout`, with the resolution of the host's timers; returns whether
/// it may be readable. A signal ends the wait early.
pub fn readable(fd: BorrowedFd<'_>, timeout: Duration) -> io::Result<bool> {
    let mut waits = [PollFd::new(fd, PollFlags::POLLIN)];
    match ppoll(&mut waits, Some(TimeSpec::from_duration(timeout)), None) {
        Ok(ready) => Ok(ready > 0),
        Err(Errno::EINTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}
