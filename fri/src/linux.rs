//! The host: its monotonic clock and its UDP sockets. The only room that reads a clock; it has no unsafe code, `nix`
//! carries that.

mod udp;

pub use udp::UdpLink;

use nix::time::{ClockId, clock_gettime};
use std::io;
use std::time::Duration;

/// Time of CLOCK_MONOTONIC, the clock of every stamp in this room.
pub fn monotonic() -> io::Result<Duration> {
    Ok(clock_gettime(ClockId::CLOCK_MONOTONIC)?.into())
}
