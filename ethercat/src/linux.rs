//! The host: its monotonic clock and its network interfaces. The only module with unsafe code and with a clock; it
//! makes no thread.

mod lock;
mod packet;
mod tap;

pub use lock::{Holder, InterfaceLock};
pub use packet::PacketLink;
pub use takt_link::linux::{CableEnd, cable, monotonic};
pub use tap::TapLink;
