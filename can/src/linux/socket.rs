//! A raw CAN socket as a [`Link`]. One system call takes up to 32 frames; after opening nothing is
//! allocated. It does not set the interface up; see [`super::Interface`].

use std::io;
use std::os::fd::{AsFd as _, AsRawFd as _, BorrowedFd};
use std::time::Duration;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, ppoll};
use nix::sys::socket::{MsgFlags, send};
use nix::sys::time::TimeSpec;
use socketcan::socket::SocketOptions as _;
use socketcan::{CanFdSocket, CanFilter, Socket as _};

use super::drain::{BATCH, Buffers, Stamped};
use super::{kernel, link_error, monotonic, wall};
use crate::link::{Link, LinkError, Received};
use crate::{AnyFrame, Id};

/// The clock that times of arrival are on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clock {
    /// `CLOCK_MONOTONIC`: what cycles count by. Stamps of the kernel are brought over when they are read.
    #[default]
    Monotonic,
    /// Since 1970, as the kernel stamps: what logs count by.
    Wall,
}

/// What to do when the interface has no room for a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum QueuePolicy {
    /// Say so at once and drop the frame: what a cycle needs, as the next one brings newer set-points.
    #[default]
    Refuse,
    /// Wait for room, at most so long: what a tool needs that has to send everything. The socket is given
    /// a small buffer, so that it is full before the interface is and the kernel can wake the sender.
    Wait(Duration),
}

/// Which frames a socket receives: those whose identifier is `id` in the bits of `mask`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filter {
    id: u32,
    mask: u32,
    inverted: bool,
}

impl Filter {
    /// Frames with this very identifier.
    #[must_use]
    pub const fn exactly(id: Id) -> Self {
        let mask = if id.is_extended() { 0x1FFF_FFFF } else { 0x7FF };
        Self::masked(id, mask)
    }

    /// Frames whose identifier has the same length and agrees in the bits of `mask`.
    #[must_use]
    pub const fn masked(id: Id, mask: u32) -> Self {
        let extended = if id.is_extended() {
            libc::CAN_EFF_FLAG
        } else {
            0
        };
        Self {
            id: id.raw() | extended,
            mask: mask & 0x1FFF_FFFF | libc::CAN_EFF_FLAG,
            inverted: false,
        }
    }

    /// All that this filter does not let through.
    #[must_use]
    pub const fn inverted(mut self) -> Self {
        self.inverted = !self.inverted;
        self
    }
}

/// How a socket is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options<'a> {
    /// The clock of times of arrival.
    pub clock: Clock,
    /// Whether frames that this socket sent come back when they were on the wire.
    pub own: bool,
    /// Whether reports of errors are received.
    pub errors: bool,
    /// What is received; empty: everything.
    pub filters: &'a [Filter],
    /// What to do when there is no room for a frame.
    pub queue: QueuePolicy,
    /// Memory for frames that wait for being read, in bytes as the kernel counts: about 770 for each frame.
    /// More than the host's limit needs root and is cut to the limit without.
    pub receive_buffer: usize,
}

impl Default for Options<'_> {
    /// Everything but own frames, on the monotonic clock, refusing, with room for about 2700 frames: a
    /// third of a second of a fully loaded bus of 1 Mbit/s.
    fn default() -> Self {
        Self {
            clock: Clock::Monotonic,
            own: false,
            errors: true,
            filters: &[],
            queue: QueuePolicy::Refuse,
            receive_buffer: 2 << 20,
        }
    }
}

/// A socket on one CAN interface.
#[derive(Debug)]
pub struct SocketCan {
    socket: CanFdSocket,
    buffers: Box<Buffers>,
    /// What of the buffers is not handed out yet.
    next: usize,
    filled: usize,
    batch: usize,
    clock: Clock,
    /// From the kernel's clock to the monotonic one, and that one, taken when the buffers were filled.
    age: Duration,
    filled_at: Duration,
    queue: QueuePolicy,
    dropped: u32,
    refused: u64,
}

/// Software and hardware stamps of received frames, as control messages.
const STAMPS: u32 = libc::SOF_TIMESTAMPING_RX_SOFTWARE
    | libc::SOF_TIMESTAMPING_SOFTWARE
    | libc::SOF_TIMESTAMPING_RX_HARDWARE
    | libc::SOF_TIMESTAMPING_RAW_HARDWARE;

impl SocketCan {
    /// Opens a socket on an interface.
    ///
    /// # Errors
    /// Of the operating system: [`io::ErrorKind::NotFound`] or `ENODEV` if there is no such interface.
    pub fn open(interface: &str, options: &Options<'_>) -> io::Result<Self> {
        let socket = CanFdSocket::open(interface)?;
        socket.set_nonblocking(true)?;
        socket.set_recv_own_msgs(options.own)?;
        if options.errors {
            socket.set_error_filter_accept_all()?;
        }
        if !options.filters.is_empty() {
            let filters: Vec<CanFilter> = options.filters.iter().map(kernel_filter).collect();
            socket.set_filters(&filters)?;
        }
        socket.set_timestamping(STAMPS)?;
        socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1)?;
        set_receive_buffer(&socket, options.receive_buffer)?;
        if options.queue != QueuePolicy::Refuse {
            // The kernel raises this to its least.
            socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_SNDBUF, 0)?;
        }
        Ok(Self {
            socket,
            buffers: Buffers::new(),
            next: 0,
            filled: 0,
            batch: BATCH,
            clock: options.clock,
            age: Duration::ZERO,
            filled_at: Duration::ZERO,
            queue: options.queue,
            dropped: 0,
            refused: 0,
        })
    }

    /// Takes at most so many frames by one system call, 1 to 32; for measurements.
    pub fn set_batch(&mut self, frames: usize) {
        self.batch = frames.clamp(1, BATCH);
    }

    /// Whether the interface stamps frames by its own clock.
    #[must_use]
    pub fn has_hardware_stamps(&self) -> bool {
        self.socket.has_hw_timestamps()
    }

    /// Frames that there was no room for.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// Frames lost because this socket was not read in time, as far as the kernel has told: it tells with
    /// the next frame that finds room.
    #[must_use]
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// The socket, for those who wait for several at once.
    #[must_use]
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }

    fn try_send(&self, bytes: &[u8]) -> Result<(), LinkError> {
        match send(self.socket.as_raw_fd(), bytes, MsgFlags::MSG_DONTWAIT) {
            Ok(_) => Ok(()),
            Err(errno) => Err(link_error(errno as i32)),
        }
    }

    /// Waits until the socket may be written to or read from.
    fn wait(&self, event: PollFlags, timeout: Duration) -> Result<(), LinkError> {
        let mut fds = [PollFd::new(self.socket.as_fd(), event)];
        match ppoll(&mut fds, Some(TimeSpec::from_duration(timeout)), None) {
            Ok(_) | Err(Errno::EINTR) => Ok(()),
            Err(errno) => Err(link_error(errno as i32)),
        }
    }

    fn send_patiently(&self, bytes: &[u8], patience: Duration) -> Result<(), LinkError> {
        let until = monotonic() + patience;
        loop {
            match self.try_send(bytes) {
                Err(LinkError::QueueFull) => {}
                done => return done,
            }
            let left = until.saturating_sub(monotonic());
            if left.is_zero() {
                return Err(LinkError::QueueFull);
            }
            // A full interface is told as "may be written" too, so never rely on that alone.
            self.wait(PollFlags::POLLOUT, left.min(PAUSE))?;
            self.wait(PollFlags::empty(), left.min(PAUSE / 4))?;
        }
    }

    fn fill(&mut self) -> Result<(), LinkError> {
        self.next = 0;
        let filled = self.buffers.fill(self.socket.as_fd(), self.batch);
        self.filled = filled.map_err(|error| link_error(error.raw_os_error().unwrap_or(0)))?;
        if self.filled > 0 && self.clock == Clock::Monotonic {
            self.filled_at = monotonic();
            self.age = wall().saturating_sub(self.filled_at);
        }
        Ok(())
    }

    fn take(&mut self) -> Option<Received> {
        while self.next < self.filled {
            let stamped = self.buffers.get(self.next);
            self.next += 1;
            if let Some(received) = self.received(&stamped) {
                return Some(received);
            }
        }
        None
    }

    fn received(&mut self, stamped: &Stamped) -> Option<Received> {
        self.dropped = stamped.dropped.unwrap_or(self.dropped);
        let at = stamped.software.unwrap_or_else(wall);
        Some(Received {
            frame: stamped.frame?,
            at: match self.clock {
                Clock::Monotonic => carried_over(at, self.age, self.filled_at),
                Clock::Wall => at,
            },
            hardware: stamped.hardware,
            origin: stamped.origin,
            dropped: self.dropped,
        })
    }
}

/// Longest time that a frame is taken to have waited for being read.
const WAITED_MAX: Duration = Duration::from_millis(100);

/// A stamp of the wall clock on the monotonic one. Whoever sets the wall clock between stamp and reading
/// would make frames come from the future, or heartbeats from long ago: what cannot be is not told.
fn carried_over(stamp: Duration, age: Duration, now: Duration) -> Duration {
    let earliest = now.saturating_sub(WAITED_MAX);
    stamp.saturating_sub(age).clamp(earliest, now)
}

/// Longest sleep between two attempts to send.
const PAUSE: Duration = Duration::from_millis(2);

fn kernel_filter(filter: &Filter) -> CanFilter {
    if filter.inverted {
        CanFilter::new_inverted(filter.id, filter.mask)
    } else {
        CanFilter::new(filter.id, filter.mask)
    }
}

/// Beyond the host's limit if that is allowed.
fn set_receive_buffer(socket: &CanFdSocket, bytes: usize) -> io::Result<()> {
    let bytes = libc::c_int::try_from(bytes / 2).unwrap_or(libc::c_int::MAX / 2);
    let set = |option| socket.set_socket_option_int(libc::SOL_SOCKET, option, bytes);
    set(libc::SO_RCVBUFFORCE).or_else(|_| set(libc::SO_RCVBUF))
}

impl Link for SocketCan {
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError> {
        let encoded = kernel::encode(frame);
        let sent = match self.queue {
            QueuePolicy::Refuse => self.try_send(encoded.as_slice()),
            QueuePolicy::Wait(patience) => self.send_patiently(encoded.as_slice(), patience),
        };
        if sent == Err(LinkError::QueueFull) {
            self.refused += 1;
        }
        sent
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, LinkError> {
        if let Some(received) = self.take() {
            return Ok(Some(received));
        }
        self.fill()?;
        if self.filled == 0 && !timeout.is_zero() {
            self.wait(PollFlags::POLLIN, timeout)?;
            self.fill()?;
        }
        Ok(self.take())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_clock_that_is_set_moves_no_frame_out_of_its_time() {
        let ms = Duration::from_millis;
        let (age, now) = (ms(1_700_000_000_000), ms(5_000));
        let of = |stamp| carried_over(stamp, age, now);
        assert_eq!(of(age + ms(4_999)), ms(4_999), "as it is");
        assert_eq!(of(age + ms(8_600_000)), now, "set back by hours");
        assert_eq!(of(age - ms(60_000)), ms(4_900), "set on by minutes");
        assert_eq!(of(Duration::ZERO), ms(4_900), "set on by years");
        assert_eq!(carried_over(ms(7), Duration::ZERO, ms(20)), ms(7));
    }
}
