//! The thread of the stop channel: it takes connections, reads one request from each, turns the switch, waits until
//! net threads have answered, and responds. All its memory is allocated before it starts. It does not access nets.

use std::io::{self, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use constant_time_eq::constant_time_eq;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{getsockopt, sockopt::PeerCredentials};
use takt_rt::Nanos;
use takt_rt::thread::{Thread, ThreadConfig};

use super::answer::{Answer, Done, of_state, refusal};
use super::http::{Order, REQUEST_BYTES_MAX, Read, Request, read};
use super::switch::{Origin, StopSwitch};
use crate::error::Error;

pub use super::folder::{default_socket, socket_folders};

/// `SCHED_FIFO` priority of the thread: above net threads (80) and drivers (85).
pub const PRIORITY: u8 = 95;
/// Maximum number of connections accepted per turn from each of its two listeners.
const ACCEPTS_A_TURN: usize = 4;
/// Maximum number of turns in a [`WINDOW`]; then it sleeps until its end.
const TURNS_A_WINDOW: u32 = 16;
/// See [`TURNS_A_WINDOW`].
const WINDOW: Nanos = Nanos::from_millis(10);
/// Maximum number of open connections of a kind; the oldest is closed for a new one.
const SLOTS: usize = 8;
/// Timeout of a client's request.
const REQUEST_TIMEOUT: Nanos = Nanos::from_millis(1000);
/// Interval at which the answers of net threads are polled.
const POLL_INTERVAL: Nanos = Nanos::from_micros(50);
/// Time beyond three periods that net threads may take to answer.
const GRACE: Nanos = Nanos::from_millis(50);
/// Characters of the page's key: 128 bits.
const KEY_BYTES: usize = 16;

/// Where the channel listens and who may stop.
#[derive(Clone, Default)]
pub struct StopChannelConfig {
    /// The Unix socket, for processes of the same user, of the same group, and root.
    pub socket: Option<PathBuf>,
    /// TCP address; requests need the token, on loopback too.
    pub tcp: Option<SocketAddr>,
    /// The token.
    pub token: Option<String>,
    /// `SCHED_FIFO` priority; `None` for an ordinary thread.
    pub priority: Option<u8>,
}

impl std::fmt::Debug for StopChannelConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("StopChannelConfig")
            .field("socket", &self.socket)
            .field("tcp", &self.tcp)
            .finish_non_exhaustive()
    }
}

/// The running channel; dropping it ends it.
pub struct StopChannel {
    socket: Option<PathBuf>,
    tcp: Option<SocketAddr>,
    key: String,
    /// Closing this endpoint ends the thread.
    wake: Option<UnixStream>,
    thread: Option<Thread<()>>,
}

impl std::fmt::Debug for StopChannel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("StopChannel")
            .field("socket", &self.socket)
            .field("tcp", &self.tcp)
            .finish_non_exhaustive()
    }
}

impl StopChannel {
    /// Listens and starts the thread. To be called before a controller starts with the same switch.
    ///
    /// # Errors
    /// If an address or path cannot be bound, or the thread cannot be started.
    pub fn start(config: StopChannelConfig, switch: StopSwitch) -> Result<Self, Error> {
        let unix = config.socket.as_deref().map(listen_unix).transpose()?;
        let tcp = config.tcp.map(listen_tcp).transpose()?;
        let address = tcp.as_ref().and_then(|l| l.local_addr().ok());
        let key = make_key().map_err(|source| Error::File {
            path: "/dev/urandom".into(),
            source,
        })?;
        let (wake, woken) = UnixStream::pair().map_err(|source| channel("a wake-up", source))?;
        let keys = [Some(key.clone()), config.token];
        let mut listener = Box::new(Listener::new(unix, tcp, woken, keys, switch)?);
        let name = "takt-stop".to_owned();
        let thread = ThreadConfig {
            priority: config.priority,
            stack_bytes: 256 << 10,
            ..ThreadConfig::new(name.clone())
        };
        let thread = takt_rt::thread::spawn(thread, move || listener.run())
            .map_err(|source| Error::Thread { name, source })?;
        Ok(Self {
            socket: config.socket,
            tcp: address,
            key,
            wake: Some(wake),
            thread: Some(thread),
        })
    }

    /// Its Unix socket.
    #[must_use]
    pub fn socket(&self) -> Option<&Path> {
        self.socket.as_deref()
    }

    /// Where it takes TCP connections.
    #[must_use]
    pub const fn tcp_address(&self) -> Option<SocketAddr> {
        self.tcp
    }

    /// Key with which a page of the server authenticates itself; new at each start.
    #[must_use]
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Settings that the host granted to the thread.
    #[must_use]
    pub fn grants(&self) -> &[takt_rt::Grant] {
        self.thread.as_ref().map_or(&[], Thread::grants)
    }
}

impl Drop for StopChannel {
    fn drop(&mut self) {
        drop(self.wake.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the stop channel thread panicked");
        }
        if let Some(socket) = &self.socket {
            // It may already be removed.
            let _ = std::fs::remove_file(socket);
        }
    }
}

fn channel(address: &str, source: io::Error) -> Error {
    Error::StopChannel {
        address: address.to_owned(),
        source,
    }
}

fn listen_tcp(address: SocketAddr) -> Result<TcpListener, Error> {
    let listener = TcpListener::bind(address).and_then(|listener| {
        listener.set_nonblocking(true)?;
        Ok(listener)
    });
    listener.map_err(|source| channel(&format!("{address}"), source))
}

/// Listens at a path. Removes the stale socket of a controller that has ended.
fn listen_unix(path: &Path) -> Result<UnixListener, Error> {
    let failed = |source| channel(&path.display().to_string(), source);
    if let Ok(owner) = UnixStream::connect(path) {
        return Err(failed(crate::local_socket::taken(&owner)));
    }
    let _ = std::fs::remove_file(path);
    let listener = UnixListener::bind(path).map_err(failed)?;
    // Clients are checked by the kernel's peer credentials, so that rejected ones receive the reason.
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o666)).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    Ok(listener)
}

fn make_key() -> io::Result<String> {
    use std::fmt::Write as _;
    let mut bytes = [0; KEY_BYTES];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().fold(String::new(), |mut key, byte| {
        let _ = write!(key, "{byte:02x}");
        key
    }))
}

/// A connection of either kind.
#[derive(Debug)]
enum Stream {
    Unix(UnixStream),
    Tcp(TcpStream, SocketAddr),
}

impl Stream {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Unix(stream) => stream.read(into),
            Self::Tcp(stream, _) => stream.read(into),
        }
    }

    /// Sends a response, as far as the kernel's buffer permits, and closes this direction.
    fn finish(&mut self, answer: &Answer) {
        // The stop is effective even if the client has disconnected.
        let _ = match self {
            Self::Unix(stream) => stream
                .write_all(answer.as_bytes())
                .and_then(|()| stream.shutdown(std::net::Shutdown::Write)),
            Self::Tcp(stream, _) => stream
                .write_all(answer.as_bytes())
                .and_then(|()| stream.shutdown(std::net::Shutdown::Write)),
        };
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Unix(stream) => stream.as_fd(),
            Self::Tcp(stream, _) => stream.as_fd(),
        }
    }
}

/// Slot of a connection.
struct Slot {
    stream: Option<Stream>,
    since: Nanos,
    bytes: [u8; REQUEST_BYTES_MAX],
    length: usize,
}

impl Slot {
    const EMPTY: Self = Self {
        stream: None,
        since: Nanos::ZERO,
        bytes: [0; REQUEST_BYTES_MAX],
        length: 0,
    };

    fn begin(&mut self, stream: Stream, now: Nanos) {
        (self.stream, self.since, self.length) = (Some(stream), now, 0);
    }
}

/// State of the thread.
struct Listener {
    unix: Option<UnixListener>,
    tcp: Option<TcpListener>,
    woken: UnixStream,
    /// Connections over the Unix socket; TCP connections cannot evict them.
    local: [Slot; SLOTS],
    remote: [Slot; SLOTS],
    /// Spare descriptor, closed for a moment when the process has none left.
    spare: Option<OwnedFd>,
    keys: [Option<String>; 2],
    /// The user and group of this process.
    own: (u32, u32),
    switch: StopSwitch,
}

impl Listener {
    fn new(
        unix: Option<UnixListener>,
        tcp: Option<TcpListener>,
        woken: UnixStream,
        keys: [Option<String>; 2],
        switch: StopSwitch,
    ) -> Result<Self, Error> {
        let own = std::fs::metadata("/proc/self").map_err(|source| Error::File {
            path: "/proc/self".into(),
            source,
        })?;
        let spare = woken.try_clone().map_err(|e| channel("a file", e))?;
        Ok(Self {
            unix,
            tcp,
            woken,
            local: [Slot::EMPTY; SLOTS],
            remote: [Slot::EMPTY; SLOTS],
            spare: Some(spare.into()),
            keys,
            own: (own.uid(), own.gid()),
            switch,
        })
    }

    fn run(&mut self) {
        // One turn without waiting, so that all its memory is resident before it counts as real-time.
        self.wait(0);
        self.turn(takt_rt::monotonic());
        let scope = takt_rt::alloc::enter_real_time();
        let (mut window, mut turns) = (takt_rt::monotonic(), 0);
        while self.wait(60_000) {
            let now = takt_rt::monotonic();
            if now - window > WINDOW {
                (window, turns) = (now, 0);
            }
            self.turn(now);
            turns += 1;
            if turns >= TURNS_A_WINDOW {
                // Bounds the time that a flood takes from net threads and drivers.
                let _ = takt_rt::sleep_until(window + WINDOW);
            }
        }
        drop(scope);
    }

    /// Waits for events, at most so many milliseconds; returns whether the thread continues.
    fn wait(&self, most_ms: u16) -> bool {
        let woken = self.woken.as_fd();
        let nothing = PollFd::new(woken, PollFlags::empty());
        let mut polled: [PollFd<'_>; 3 + 2 * SLOTS] = std::array::from_fn(|_| nothing.clone());
        if let Some(first) = polled.first_mut() {
            *first = PollFd::new(woken, PollFlags::POLLIN);
        }
        let listeners = [
            self.unix.as_ref().map(AsFd::as_fd),
            self.tcp.as_ref().map(AsFd::as_fd),
        ];
        let slots = self.local.iter().chain(&self.remote);
        let streams = slots.filter_map(|slot| slot.stream.as_ref().map(Stream::as_fd));
        let (mut count, mut open) = (1, false);
        for (i, fd) in listeners.into_iter().flatten().chain(streams).enumerate() {
            if let Some(place) = polled.get_mut(i + 1) {
                *place = PollFd::new(fd, PollFlags::POLLIN);
                count = i + 2;
            }
        }
        let slots = self.local.iter().chain(&self.remote);
        open |= slots.filter(|slot| slot.stream.is_some()).count() > 0;
        let timeout = if open { most_ms.min(100) } else { most_ms };
        let polled = polled.get_mut(..count).unwrap_or_default();
        // A signal counts as a timeout.
        let _ = poll(polled, PollTimeout::from(timeout));
        let ended = polled.first().and_then(PollFd::revents);
        ended.is_none_or(|events| events.is_empty())
    }

    /// Accepts connections, reads from them, and answers complete requests.
    fn turn(&mut self, now: Nanos) {
        for _ in 0..ACCEPTS_A_TURN {
            let Some(stream) = self.accept_local() else {
                break;
            };
            place(&mut self.local, stream, now);
        }
        for _ in 0..ACCEPTS_A_TURN {
            let Some(stream) = self.accept_remote() else {
                break;
            };
            place(&mut self.remote, stream, now);
        }
        for number in 0..2 * SLOTS {
            self.serve(number, now);
        }
        if self.spare.is_none() {
            self.spare = self.woken.try_clone().ok().map(OwnedFd::from);
        }
    }

    fn accept_local(&mut self) -> Option<Stream> {
        let listener = self.unix.as_ref()?;
        let spare = &mut self.spare;
        let (stream, _) = accept(spare, || listener.accept())?;
        stream.set_nonblocking(true).ok()?;
        Some(Stream::Unix(stream))
    }

    fn accept_remote(&mut self) -> Option<Stream> {
        let listener = self.tcp.as_ref()?;
        let spare = &mut self.spare;
        let (stream, address) = accept(spare, || listener.accept())?;
        stream.set_nonblocking(true).ok()?;
        // Send the response without delay.
        stream.set_nodelay(true).ok()?;
        Some(Stream::Tcp(stream, address))
    }

    /// Reads from one connection; answers and closes it if its request is complete.
    fn serve(&mut self, number: usize, now: Nanos) {
        let slots = if number < SLOTS {
            &mut self.local
        } else {
            &mut self.remote
        };
        let Some(slot) = slots.get_mut(number % SLOTS) else {
            return;
        };
        let Some(stream) = &mut slot.stream else {
            return;
        };
        let room = slot.bytes.get_mut(slot.length..).unwrap_or_default();
        let more = match stream.read(room) {
            Ok(0) => false,
            Ok(count) => {
                slot.length += count;
                true
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                if now - slot.since <= REQUEST_TIMEOUT {
                    return;
                }
                false
            }
            Err(_) => false,
        };
        if !more {
            slot.stream = None;
            return;
        }
        let answer = match read(slot.bytes.get(..slot.length).unwrap_or_default()) {
            Read::Partial => return,
            Read::Bad(status, why) => refusal(status, why),
            Read::Whole(request) => {
                let gate = Gate {
                    keys: &self.keys,
                    own: self.own,
                };
                match gate.admit(stream, &request) {
                    Ok(origin) => carry_out(&self.switch, &request, origin),
                    Err((status, why)) => {
                        self.switch.count_refused();
                        refusal(status, why)
                    }
                }
            }
        };
        stream.finish(&answer);
        slot.stream = None;
    }
}

/// Accepts a connection; if the process has no descriptor left, the spare one is closed first.
fn accept<T>(spare: &mut Option<OwnedFd>, mut accept: impl FnMut() -> io::Result<T>) -> Option<T> {
    match accept() {
        Ok(taken) => Some(taken),
        // EMFILE, ENFILE.
        Err(error) if matches!(error.raw_os_error(), Some(23 | 24)) => {
            drop(spare.take());
            accept().ok()
        }
        Err(_) => None,
    }
}

/// Assigns a connection to an empty slot, or to that of the oldest.
fn place(slots: &mut [Slot; SLOTS], stream: Stream, now: Nanos) {
    let free = slots.iter().position(|slot| slot.stream.is_none());
    let oldest = || {
        let ages = slots.iter().enumerate();
        ages.min_by_key(|(_, slot)| slot.since).map(|(i, _)| i)
    };
    let number = free.or_else(oldest).unwrap_or(0);
    if let Some(slot) = slots.get_mut(number) {
        slot.begin(stream, now);
    }
}

/// Who may stop.
struct Gate<'a> {
    keys: &'a [Option<String>; 2],
    own: (u32, u32),
}

impl Gate<'_> {
    fn admit(
        &self,
        stream: &Stream,
        request: &Request<'_>,
    ) -> Result<Origin, (&'static str, &'static str)> {
        match stream {
            Stream::Unix(stream) => {
                let unknown = (
                    "403 Forbidden",
                    "the kernel did not report the peer's credentials",
                );
                let peer = getsockopt(stream, PeerCredentials).map_err(|_| unknown)?;
                let (uid, gid) = self.own;
                if peer.uid() != 0 && peer.uid() != uid && peer.gid() != gid {
                    return Err((
                        "403 Forbidden",
                        "only root, the controller's own user and its group may stop it here",
                    ));
                }
                Ok(Origin::Process {
                    pid: u32::try_from(peer.pid()).unwrap_or(0),
                    uid: peer.uid(),
                })
            }
            Stream::Tcp(_, address) => {
                if !request.is_of_own_page() {
                    return Err(("403 Forbidden", "web pages of other hosts may not stop it"));
                }
                let Some(given) = request.key else {
                    return Err((
                        "401 Unauthorized",
                        "a token is needed: Authorization: Bearer ...",
                    ));
                };
                let same = |key: &String| constant_time_eq(key.as_bytes(), given.as_bytes());
                // Each is compared, whichever it is.
                let right = self
                    .keys
                    .iter()
                    .flatten()
                    .map(same)
                    .fold(false, |a, b| a | b);
                if right {
                    Ok(Origin::Network(*address))
                } else {
                    Err(("401 Unauthorized", "the token is wrong"))
                }
            }
        }
    }
}

/// Operates the switch and waits for the answers of all net threads, up to a timeout.
fn carry_out(switch: &StopSwitch, request: &Request<'_>, origin: Origin) -> Answer {
    let received = takt_rt::monotonic();
    let changed = match request.order {
        Order::Stop => switch.stop(origin),
        Order::Release => switch.release(),
        Order::Show => false,
    };
    let periods = switch.longest_period();
    let until = received + periods + periods + periods + GRACE;
    let mut now = received;
    while request.order != Order::Show
        && now < until
        && !switch.answers().all(|answer| answer.is_applied)
    {
        if takt_rt::sleep_until(now + POLL_INTERVAL).is_err() {
            break;
        }
        now = takt_rt::monotonic();
    }
    let done = Done {
        changed,
        received,
        waited: now - received,
    };
    of_state(switch, done, request.origin)
}

#[cfg(test)]
mod tests;
