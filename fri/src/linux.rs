//! Linux: the monotonic clock and UDP sockets.

mod udp;

pub use takt_link::linux::monotonic;
pub use udp::UdpLink;
