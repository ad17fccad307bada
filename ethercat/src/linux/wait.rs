//! Waiting until a descriptor has something to read, with the exactness of the system's timers. It reads nothing.

use std::io;
use std::os::fd::BorrowedFd;
use std::time::Duration;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::time::TimeSpec;

/// Sleeps until there is something to read, at most `timeout`; whether there may be. A signal ends it early.
pub(super) fn readable(fd: BorrowedFd<'_>, timeout: Duration) -> io::Result<bool> {
    let mut waits = [PollFd::new(fd, PollFlags::POLLIN)];
    match ppoll(&mut waits, Some(TimeSpec::from_duration(timeout)), None) {
        Ok(ready) => Ok(ready > 0),
        Err(Errno::EINTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}
