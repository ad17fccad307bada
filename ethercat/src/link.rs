//! Ethernet frames between a master or a segment and its wire. A port never retries, and it does not match answers to
//! requests.

mod port;

pub use port::Port;
pub use takt_link::{Link, Memory, pair};

/// Ethernet type of EtherCAT.
pub const ETHER_TYPE: u16 = 0x88A4;
/// Destination, source, type: bytes before an EtherCAT frame.
pub const HEADER_LEN: usize = 14;
/// Shortest Ethernet frame without its check sequence; shorter ones are padded with zeros.
pub(crate) const FRAME_MIN: usize = 60;
/// Longest Ethernet frame without its check sequence.
pub const FRAME_MAX: usize = HEADER_LEN + 1500;
