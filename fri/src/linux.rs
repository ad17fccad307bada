//! Linux: the monotonic clock and UDP sockets. The only module that reads a clock; it has no unsafe code, `nix` has.

mod udp;

pub use udp::UdpLink;

use nix::time::{ClockId, clock_gettime};
use std::io;
use std::time::Duration;

/// Time of CLOCK_MONOTONIC, the clock of all time stamps in this module.
pub fn monotonic() -> io::Result<Duration> {
    Ok(clock_gettime(ClockId::CLOCK_MONOTONIC)?.into())
}
