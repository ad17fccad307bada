//! SocketCAN: sockets, cyclic transmission by the kernel, interface configuration, and the clocks of their time stamps.
//! The only module of this crate with clocks, system calls and unsafe code.

mod bcm;
mod drain;
mod interface;
mod kernel;
mod live;
mod netlink;
mod qdisc;
mod serial;
mod socket;

pub use bcm::{Cyclic, Watch, Watched};
pub use interface::{
    Details, Interface, InterfaceError, Present, Setup, Step, bit_rate, interfaces,
};
pub use live::LivePort;
pub use serial::Serial;
pub use socket::{Clock, Filter, Options, QueuePolicy, SocketCan};

use std::time::Duration;

use nix::time::{ClockId, clock_gettime};

use crate::link::LinkError;

/// Time of `CLOCK_MONOTONIC`.
pub fn monotonic() -> Duration {
    now(ClockId::CLOCK_MONOTONIC)
}

/// Time since 1970 of `CLOCK_REALTIME`, which NTP may step; the kernel stamps frames with it.
pub fn wall() -> Duration {
    now(ClockId::CLOCK_REALTIME)
}

/// Both clocks exist on every Linux; reading them cannot fail.
fn now(clock: ClockId) -> Duration {
    clock_gettime(clock).map_or(Duration::ZERO, Duration::from)
}

/// Maps the `errno` of a socket.
fn link_error(errno: i32) -> LinkError {
    match errno {
        libc::ENOBUFS | libc::EAGAIN => LinkError::QueueFull,
        libc::ENETDOWN => LinkError::Down,
        libc::ENODEV | libc::ENXIO => LinkError::Lost,
        libc::EINVAL | libc::EMSGSIZE => LinkError::Kind,
        other => LinkError::Os(other),
    }
}

impl LinkError {
    /// The error number of the operating system.
    #[must_use]
    pub const fn errno(self) -> i32 {
        match self {
            Self::QueueFull => libc::ENOBUFS,
            Self::Down => libc::ENETDOWN,
            Self::Lost => libc::ENODEV,
            Self::Kind => libc::EINVAL,
            Self::Os(errno) => errno,
        }
    }
}
