//! SocketCAN: sockets, cyclic sending by the kernel, interfaces; and the clocks that their time stamps are
//! on. The only room of this crate with a clock, a system call or unsafe code.

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
pub use interface::{Details, Interface, InterfaceError, Present, Setup, Step, interfaces};
pub use live::LivePort;
pub use serial::Serial;
pub use socket::{Clock, Filter, Options, QueuePolicy, SocketCan};

use std::time::Duration;

use nix::time::{ClockId, clock_gettime};

use crate::link::LinkError;

/// Time of `CLOCK_MONOTONIC`, which nobody sets.
#[must_use]
pub fn monotonic() -> Duration {
    now(ClockId::CLOCK_MONOTONIC)
}

/// Time since 1970, of `CLOCK_REALTIME`, which ntp moves; the kernel stamps frames with it.
#[must_use]
pub fn wall() -> Duration {
    now(ClockId::CLOCK_REALTIME)
}

/// Both clocks exist on every Linux, and reading them does not fail.
fn now(clock: ClockId) -> Duration {
    clock_gettime(clock).map_or(Duration::ZERO, Duration::from)
}

/// What an error number of a socket means.
fn link_error(errno: i32) -> LinkError {
    match errno {
        libc::ENOBUFS | libc::EAGAIN => LinkError::QueueFull,
        libc::ENETDOWN => LinkError::Down,
        libc::ENODEV | libc::ENXIO => LinkError::Gone,
        libc::EINVAL | libc::EMSGSIZE => LinkError::Kind,
        other => LinkError::Os(other),
    }
}
