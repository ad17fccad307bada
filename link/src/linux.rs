//! The host: its monotonic clock, waiting for a descriptor, its addresses and ports, captured packets, and a cable
//! between two threads. The only module with a clock; it has no unsafe code.

use std::io;
use std::time::Duration;

mod cable;
pub mod host;
mod sniffer;
mod stamps;

pub use cable::{CableEnd, cable};
pub use sniffer::Sniffer;
pub use stamps::{receive_frame, receive_from, stamp_arrivals};
pub use takt_rt::readable;

/// Time of [`takt_rt::monotonic`], the clock of all time stamps of links on this host.
pub fn monotonic() -> io::Result<Duration> {
    takt_rt::monotonic().try_into().map_err(io::Error::other)
}
