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
    /// The last time of reading found all that there was.
    drained: bool,
    clock: Clock,
    clocks: Clocks,
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
            drained: false,
            clock: options.clock,
            clocks: Clocks::default(),
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

    fn wait(&self, event: PollFlags, timeout: Duration) -> Result<(), LinkError> {
        wait(self.socket.as_fd(), event, timeout)
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
        // What is there was taken; an error brings nothing.
        (self.next, self.filled) = (0, 0);
        let filled = self.buffers.fill(self.socket.as_fd(), self.batch);
        self.filled = filled.map_err(|error| link_error(error.raw_os_error().unwrap_or(0)))?;
        self.drained = self.filled < self.batch;
        Ok(())
    }

    #[inline]
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

    #[inline]
    fn received(&mut self, stamped: &Stamped) -> Option<Received> {
        self.dropped = stamped.dropped.unwrap_or(self.dropped);
        Some(Received {
            frame: stamped.frame?,
            at: match (self.clock, stamped.software) {
                (Clock::Monotonic, Some(stamp)) => self.clocks.carry_over(stamp, read_clocks),
                (Clock::Monotonic, None) => monotonic(),
                (Clock::Wall, Some(stamp)) => Duration::from_nanos(stamp),
                (Clock::Wall, None) => wall(),
            },
            hardware: stamped.hardware.map(Duration::from_nanos),
            origin: stamped.origin,
            dropped: self.dropped,
        })
    }
}

/// Waits until a socket may be written to or read from. A signal does not end it.
fn wait(socket: BorrowedFd<'_>, event: PollFlags, timeout: Duration) -> Result<(), LinkError> {
    let until = monotonic().saturating_add(timeout);
    let mut left = timeout;
    loop {
        let mut fds = [PollFd::new(socket, event)];
        match ppoll(&mut fds, Some(TimeSpec::from_duration(left)), None) {
            Ok(_) => return Ok(()),
            Err(Errno::EINTR) => left = until.saturating_sub(monotonic()),
            Err(errno) => return Err(link_error(errno as i32)),
        }
    }
}

/// Longest time that a frame is taken to have waited for being read, ns.
const WAITED_MAX: u64 = 100_000_000;
/// A reading of the clocks serves for frames that were stamped until so long after it, ns.
const READING_LASTS: u64 = 10_000_000;

/// Longest time that reading both clocks may take, ns, and how often that is tried.
const READING_MAX: u64 = 50_000;
const READINGS_MAX: u32 = 4;

/// Both clocks as they were read together, ns.
#[derive(Clone, Copy, Debug, Default)]
struct Clocks {
    monotonic: u64,
    wall: u64,
}

impl Clocks {
    /// A stamp of the wall clock on the monotonic one. Clocks are read anew for a stamp that is not near the
    /// last reading: to read them for each frame costs as much as to receive it where the kernel has to be
    /// asked.
    ///
    /// Whoever sets the wall clock between stamp and reading would make frames come from the future, or
    /// heartbeats from long ago: what cannot be is not told.
    #[inline]
    fn carry_over(&mut self, stamp: u64, read: impl FnOnce() -> Self) -> Duration {
        let near = self.wall.saturating_sub(WAITED_MAX)..=self.wall.saturating_add(READING_LASTS);
        let mut latest = self.monotonic.saturating_add(READING_LASTS);
        if self.wall == 0 || !near.contains(&stamp) {
            *self = read();
            latest = self.monotonic;
        }
        let at = stamp.saturating_sub(self.wall.saturating_sub(self.monotonic));
        let earliest = self.monotonic.saturating_sub(WAITED_MAX);
        Duration::from_nanos(at.clamp(earliest, latest))
    }
}

/// The monotonic one first, so that no frame comes from the future; anew if something came between.
fn read_clocks() -> Clocks {
    let nanos = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
    let mut clocks = Clocks::default();
    for _ in 0..READINGS_MAX {
        clocks.monotonic = nanos(monotonic());
        clocks.wall = nanos(wall());
        if nanos(monotonic()).saturating_sub(clocks.monotonic) < READING_MAX {
            break;
        }
    }
    clocks
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
        if self.next < self.filled
            && let Some(received) = self.take()
        {
            return Ok(Some(received));
        }
        // Who waits behind an empty queue need not ask it first.
        let asks = timeout.is_zero() || !self.drained;
        if asks {
            self.fill()?;
        }
        if !timeout.is_zero() && (!asks || self.filled == 0) {
            self.wait(PollFlags::POLLIN, timeout)?;
            self.fill()?;
        }
        Ok(self.take())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use nix::sys::pthread::{pthread_kill, pthread_self};
    use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};

    use super::*;

    const MS: u64 = 1_000_000;
    /// The wall clock when the monotonic one was 0, ns.
    const AGE: u64 = 1_700_000_000_000 * MS;

    /// The clocks so many ms after the monotonic one began.
    fn clocks(ms: u64, age: u64) -> Clocks {
        let monotonic = ms * MS;
        Clocks {
            monotonic,
            wall: age + monotonic,
        }
    }

    fn ms(at: Duration) -> u128 {
        at.as_millis()
    }

    #[test]
    fn a_wall_clock_that_is_set_moves_no_frame_out_of_its_time() {
        let of = |stamp| ms(Clocks::default().carry_over(stamp, || clocks(5_000, AGE)));
        assert_eq!(of(AGE + 4_999 * MS), 4_999, "as it is");
        assert_eq!(of(AGE + 8_600_000 * MS), 5_000, "set back by hours");
        assert_eq!(of(AGE - 60_000 * MS), 4_900, "set on by minutes");
        assert_eq!(of(0), 4_900, "set on by years");
        assert_eq!(of(u64::MAX), 5_000);
        let young = Clocks::default().carry_over(7 * MS, || clocks(20, 0));
        assert_eq!(ms(young), 7);
    }

    #[test]
    fn clocks_are_read_once_for_frames_that_come_close_together() {
        let mut last = Clocks::default();
        // When it is read, how old the monotonic clock was at the stamp, the wall clock; and what comes of it.
        for (now, stamp, age, at, read, why) in [
            (1_000, 999, AGE, 999, true, "the first"),
            (1_000, 950, AGE, 950, false, "it waited longer"),
            (1_010, 1_009, AGE, 1_009, false, "soon after"),
            (1_012, 1_011, AGE, 1_011, true, "too long after"),
            (1_014, 1_013, AGE + 3_600_000 * MS, 1_013, true, "set on"),
            (1_015, 1_014, AGE, 1_014, true, "set back"),
            (1_016, 1_015, AGE, 1_015, false, "as it was"),
        ] {
            let mut was_read = false;
            let found = last.carry_over(age + stamp * MS, || {
                was_read = true;
                clocks(now, age)
            });
            assert_eq!((ms(found), was_read), (at, read), "{why}");
        }
    }

    static SIGNALS: AtomicU32 = AtomicU32::new(0);

    extern "C" fn count(_signal: libc::c_int) {
        SIGNALS.fetch_add(1, Ordering::Relaxed);
    }

    /// Any socket of datagrams will do.
    #[test]
    #[expect(unsafe_code, reason = "a handler is put in place")]
    fn a_signal_does_not_end_a_wait() {
        let action = SigAction::new(
            SigHandler::Handler(count),
            SaFlags::empty(),
            SigSet::empty(),
        );
        // SAFETY: the handler only counts, which is safe in a signal, and nobody else here uses this signal.
        unsafe { sigaction(Signal::SIGURG, &action) }.unwrap();
        let (socket, peer) = std::os::unix::net::UnixDatagram::pair().unwrap();
        let patience = Duration::from_secs(60);
        let (told, waiter) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            let waits = scope.spawn(|| {
                told.send(pthread_self()).unwrap();
                wait(socket.as_fd(), PollFlags::POLLIN, patience).unwrap();
                let mut buffers = Buffers::new();
                buffers.fill(socket.as_fd(), BATCH).unwrap()
            });
            let waiter = waiter.recv().unwrap();
            // Each one is counted when the thread handled it; the last of them surely found it waiting.
            for signal in 1..=50 {
                pthread_kill(waiter, Signal::SIGURG).unwrap();
                while SIGNALS.load(Ordering::Relaxed) < signal && !waits.is_finished() {
                    std::thread::yield_now();
                }
                assert!(!waits.is_finished(), "a signal ended it");
            }
            peer.send(&[0; kernel::CLASSIC_LEN]).unwrap();
            assert_eq!(waits.join().unwrap(), 1);
        });
    }
}
