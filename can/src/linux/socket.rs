//! A raw CAN socket as a [`Link`]. One system call receives up to 32 frames; after opening it does
//! not allocate. It does not configure the interface; see [`super::Interface`].

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

/// Clock of the reception times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clock {
    /// `CLOCK_MONOTONIC`, the clock of cycles. Kernel time stamps are converted on reception.
    #[default]
    Monotonic,
    /// Time since 1970, as stamped by the kernel; the clock of logs.
    Wall,
}

/// Behaviour when the send queue is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum QueuePolicy {
    /// Drop the frame and return an error at once: for cycles, because the next one brings newer set-points.
    #[default]
    Refuse,
    /// Wait until the queue accepts the frame, up to this timeout: for tools that have to send every frame. The socket
    /// gets a small buffer, so that it fills before the interface does and the kernel can wake the sender.
    Wait(Duration),
}

/// Receive filter: accepts frames whose identifier equals `id` in the bits of `mask`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filter {
    id: u32,
    mask: u32,
    inverted: bool,
}

impl Filter {
    /// Accepts exactly this identifier.
    pub const fn exactly(id: Id) -> Self {
        let mask = if id.is_extended() { 0x1FFF_FFFF } else { 0x7FF };
        Self::masked(id, mask)
    }

    /// Accepts identifiers of the same length that match in the bits of `mask`.
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

    /// Inverts the filter.
    #[must_use]
    pub const fn inverted(mut self) -> Self {
        self.inverted = !self.inverted;
        self
    }
}

/// Configuration of a socket.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options<'a> {
    /// Clock of the reception times.
    pub clock: Clock,
    /// Whether this socket receives its own frames after transmission.
    pub own: bool,
    /// Whether error frames are received.
    pub errors: bool,
    /// Receive filters; empty: accept all frames.
    pub filters: &'a [Filter],
    /// Behaviour when the send queue is full.
    pub queue: QueuePolicy,
    /// Receive buffer in bytes as counted by the kernel: about 770 per frame. More than the host's limit needs root;
    /// otherwise it is clamped to the limit.
    pub receive_buffer: usize,
}

impl Default for Options<'_> {
    /// All frames except its own, monotonic clock, no blocking on send, buffer for about 2700 frames: a third of a
    /// second of a fully loaded 1 Mbit/s bus.
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
    interface: String,
    buffers: Box<Buffers>,
    /// Frames in the buffers that were not delivered yet.
    next: usize,
    filled: usize,
    batch: usize,
    /// The last read emptied the socket.
    drained: bool,
    clock: Clock,
    clocks: Clocks,
    queue: QueuePolicy,
    dropped: u32,
    refused: u64,
}

/// Enables software and hardware time stamps of received frames.
const STAMPS: u32 = libc::SOF_TIMESTAMPING_RX_SOFTWARE
    | libc::SOF_TIMESTAMPING_SOFTWARE
    | libc::SOF_TIMESTAMPING_RX_HARDWARE
    | libc::SOF_TIMESTAMPING_RAW_HARDWARE;

impl SocketCan {
    /// Opens a socket on an interface.
    ///
    /// # Errors
    /// Of the operating system: [`io::ErrorKind::NotFound`] or `ENODEV` if the interface does not exist.
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
            // The kernel raises this to its minimum.
            socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_SNDBUF, 0)?;
        }
        Ok(Self {
            socket,
            interface: interface.to_owned(),
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

    /// Sets the maximum number of frames per system call, 1 to 32; for measurements.
    pub fn set_batch(&mut self, frames: usize) {
        self.batch = frames.clamp(1, BATCH);
    }

    /// Whether the interface provides hardware time stamps.
    pub fn has_hardware_stamps(&self) -> bool {
        self.socket.has_hw_timestamps()
    }

    /// Frames dropped because the send queue was full.
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// Frames lost because this socket was not read in time. The kernel reports them with the next received frame.
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Frames lost so far, with those that no received frame has reported yet: at the end of a measurement.
    pub fn read_dropped(&mut self) -> u32 {
        if let Some(drops) = drops(self.socket.as_fd()) {
            self.dropped = self.dropped.max(drops);
        }
        self.dropped
    }

    /// The socket, to wait for several at once.
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

    fn send_with_timeout(&self, bytes: &[u8], timeout: Duration) -> Result<(), LinkError> {
        let until = monotonic() + timeout;
        loop {
            match self.try_send(bytes) {
                Err(LinkError::QueueFull) => {}
                done => return done,
            }
            let left = until.saturating_sub(monotonic());
            if left.is_zero() {
                return Err(LinkError::QueueFull);
            }
            // A full interface is reported as writable too; do not rely on it.
            self.wait(PollFlags::POLLOUT, left.min(PAUSE))?;
            self.wait(PollFlags::empty(), left.min(PAUSE / 4))?;
        }
    }

    fn fill(&mut self) -> Result<(), LinkError> {
        // Available frames were read; an error returns none.
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
                (Clock::Monotonic, Some(stamp)) => self.clocks.monotonic_of(stamp, read_clocks),
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

/// The counter of frames that a socket lost, as the kernel holds it; `None` if it does not report it.
#[expect(unsafe_code, reason = "no crate in use reads this option")]
fn drops(socket: BorrowedFd<'_>) -> Option<u32> {
    /// Index of the counter (`SK_MEMINFO_DROPS` of `linux/sock_diag.h`), and number of values.
    const DROPS: usize = 8;
    let mut values = [0_u32; DROPS + 1];
    let mut len = libc::socklen_t::try_from(size_of_val(&values)).ok()?;
    let at = std::ptr::from_mut(&mut values).cast();
    let fd = socket.as_raw_fd();
    // SAFETY: `at` and `len` describe `values`, which outlives the call; the socket is open as long as it is borrowed.
    let failed =
        unsafe { libc::getsockopt(fd, libc::SOL_SOCKET, libc::SO_MEMINFO, at, &raw mut len) };
    let is_whole = usize::try_from(len).ok()? == size_of_val(&values);
    (failed == 0 && is_whole).then(|| values[DROPS])
}

/// Waits until a socket is readable or writable; restarts after a signal.
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

/// Maximum age of a frame when it is read, ns; older time stamps are clamped.
const STAMP_AGE_MAX: u64 = 100_000_000;
/// A clock reading is reused for frames stamped up to this time after it, ns.
const READING_VALID: u64 = 10_000_000;

/// Maximum time to read both clocks, ns, and the number of attempts.
const READING_MAX: u64 = 50_000;
const READINGS_MAX: u32 = 4;

/// Both clocks, read together, ns.
#[derive(Clone, Copy, Debug, Default)]
struct Clocks {
    monotonic: u64,
    wall: u64,
}

impl Clocks {
    /// Converts a wall clock time stamp to the monotonic clock. The clocks are only read again for a stamp that is not
    /// close to the last reading: where clock reading is a system call, it costs as much as receiving a frame.
    ///
    /// If the wall clock is set between stamp and reading, frames would seem to come from the future, or heartbeats
    /// from long ago; such stamps are clamped.
    #[inline]
    fn monotonic_of(&mut self, stamp: u64, read: impl FnOnce() -> Self) -> Duration {
        let near =
            self.wall.saturating_sub(STAMP_AGE_MAX)..=self.wall.saturating_add(READING_VALID);
        let mut latest = self.monotonic.saturating_add(READING_VALID);
        if self.wall == 0 || !near.contains(&stamp) {
            *self = read();
            latest = self.monotonic;
        }
        let at = stamp.saturating_sub(self.wall.saturating_sub(self.monotonic));
        let earliest = self.monotonic.saturating_sub(STAMP_AGE_MAX);
        Duration::from_nanos(at.clamp(earliest, latest))
    }
}

/// Reads the monotonic clock first, so that no frame comes from the future; retries after an
/// interruption.
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

/// Maximum sleep between two attempts to send.
const PAUSE: Duration = Duration::from_millis(2);

fn kernel_filter(filter: &Filter) -> CanFilter {
    if filter.inverted {
        CanFilter::new_inverted(filter.id, filter.mask)
    } else {
        CanFilter::new(filter.id, filter.mask)
    }
}

/// Exceeds the host's limit if permitted.
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
            QueuePolicy::Wait(timeout) => self.send_with_timeout(encoded.as_slice(), timeout),
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
        // An empty socket need not be read before waiting.
        let reads = timeout.is_zero() || !self.drained;
        if reads {
            self.fill()?;
        }
        if !timeout.is_zero() && (!reads || self.filled == 0) {
            self.wait(PollFlags::POLLIN, timeout)?;
            self.fill()?;
        }
        Ok(self.take())
    }

    fn interface(&self) -> Option<&str> {
        Some(&self.interface)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use nix::sys::pthread::{pthread_kill, pthread_self};
    use nix::sys::signal::{SaFlags, SigAction, SigHandler, SigSet, Signal, sigaction};

    use super::*;

    const MS: u64 = 1_000_000;
    /// The wall clock at monotonic time 0, ns.
    const AGE: u64 = 1_700_000_000_000 * MS;

    /// The clocks this many ms after monotonic time 0.
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
    fn socket_wall_clock_step_does_not_shift_frames() {
        let of = |stamp| ms(Clocks::default().monotonic_of(stamp, || clocks(5_000, AGE)));
        assert_eq!(of(AGE + 4_999 * MS), 4_999, "as it is");
        assert_eq!(of(AGE + 8_600_000 * MS), 5_000, "set back by hours");
        assert_eq!(of(AGE - 60_000 * MS), 4_900, "set on by minutes");
        assert_eq!(of(0), 4_900, "set on by years");
        assert_eq!(of(u64::MAX), 5_000);
        let young = Clocks::default().monotonic_of(7 * MS, || clocks(20, 0));
        assert_eq!(ms(young), 7);
    }

    #[test]
    fn socket_clocks_are_read_once_for_close_frames() {
        let mut last = Clocks::default();
        // Time of reading, monotonic time of the stamp, wall clock offset; expected result.
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
            let found = last.monotonic_of(age + stamp * MS, || {
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

    /// Any datagram socket works.
    #[test]
    #[expect(unsafe_code, reason = "a signal handler is installed")]
    fn socket_wait_continues_after_signal() {
        let action = SigAction::new(
            SigHandler::Handler(count),
            SaFlags::empty(),
            SigSet::empty(),
        );
        // SAFETY: the handler only counts, which is safe in a signal, and no other test uses this signal.
        unsafe { sigaction(Signal::SIGURG, &action) }.unwrap();
        let (socket, peer) = std::os::unix::net::UnixDatagram::pair().unwrap();
        let timeout = Duration::from_secs(60);
        let (thread, waiter) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            let waits = scope.spawn(|| {
                thread.send(pthread_self()).unwrap();
                wait(socket.as_fd(), PollFlags::POLLIN, timeout).unwrap();
                let mut buffers = Buffers::new();
                buffers.fill(socket.as_fd(), BATCH).unwrap()
            });
            let waiter = waiter.recv().unwrap();
            // Each one is counted when the thread handled it; the last one certainly interrupted its wait.
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

    /// Of any socket: none is lost while it is read, and a full buffer loses the rest.
    #[test]
    fn socket_drop_counter_is_read_without_a_frame() {
        let to = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        assert_eq!(drops(to.as_fd()), Some(0));
        let from = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        for _ in 0..2000 {
            from.send_to(&[0; 1000], to.local_addr().unwrap()).unwrap();
        }
        assert!(drops(to.as_fd()).unwrap() > 0);
    }
}
