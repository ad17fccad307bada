//! The host: its monotonic clock and its network interfaces. The only module with unsafe code and with a clock; it
//! makes no thread.

mod cable;
mod lock;
mod packet;
mod tap;
mod wait;

pub use cable::{CableEnd, cable};
pub use lock::{Holder, InterfaceLock};
pub use packet::{PacketLink, monotonic};
pub use tap::TapLink;
