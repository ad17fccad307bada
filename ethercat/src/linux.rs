//! The host: its monotonic clock and its network interfaces. The only room with unsafe code and with a clock; it
//! makes no thread.

mod packet;

pub use packet::{PacketLink, monotonic};
