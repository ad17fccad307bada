//! A robot's partner while it lasts: a real-time thread that takes the controller's datagrams and answers each at once.
//! What the robot is told is its [`Task`]'s affair; what is shown and judged, that of the commands.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use takt_fri::client::{AXES, Client, ClientConfig, Phase, Status, Withheld};
use takt_fri::diagnosis::Observed;
use takt_fri::generation::Kind;
use takt_fri::link::Link as _;
use takt_fri::linux::{UdpLink, monotonic};
use takt_fri::sunrise::wire::MESSAGE_MAX;
use takt_rt::Nanos;
use takt_rt::host::{Host, HostConfig, prepare};
use takt_rt::latest::{LatestReader, LatestWriter, latest};
use takt_rt::stats::{Recorder, RecorderReader};
use takt_rt::thread::{Thread, ThreadConfig, spawn};

use super::port;
use crate::output::complain;

/// That of the drivers: what is measured here is to be true for them.
const PRIORITY: u8 = 85;
/// Longest wait for a datagram, so that a stop is seen soon.
const WAIT: Duration = Duration::from_millis(20);
/// Waiting datagrams taken at most before one of them is answered.
const BACKLOG: usize = 64;
/// Room for any datagram, and one byte more so that a longer one shows.
const ROOM: usize = MESSAGE_MAX + 1;

/// What the robot is told.
pub(super) trait Task: Send + 'static {
    /// Positions for the answer that is due, rad, `cycles` of the controller after the last; `None` asks for nothing.
    fn joints(&mut self, partner: &mut Client, cycles: u32) -> Option<[f64; AXES]>;

    /// The answer did not carry them.
    fn handle_withheld(&mut self, withheld: Withheld);

    /// The robot follows from now on: entered, or entered anew without a measurement in between that said otherwise.
    fn handle_entered(&mut self);
}

/// Answers, and asks for nothing: the robot stays where its controller has it.
pub(super) struct Watch;

impl Task for Watch {
    fn joints(&mut self, _partner: &mut Client, _cycles: u32) -> Option<[f64; AXES]> {
        None
    }

    fn handle_withheld(&mut self, _withheld: Withheld) {}

    fn handle_entered(&mut self) {}
}

/// A connection at one moment.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seen {
    pub(super) status: Status,
    pub(super) observed: Observed,
    /// The controller.
    pub(super) peer: Option<SocketAddr>,
    /// Another one that sends to the same port.
    pub(super) second: Option<SocketAddr>,
    /// The system's word why the last answer did not leave.
    pub(super) unsent: Option<i32>,
}

/// The thread, from outside.
pub(super) struct Live {
    thread: Thread<()>,
    stop: Arc<AtomicBool>,
    seen: LatestReader<Seen>,
    /// From a measurement's arrival to its answer's departure.
    pub(super) answer_time: RecorderReader,
    /// How far measurements come from where the one before and the period put them.
    pub(super) deviation: RecorderReader,
    pub(super) local: SocketAddr,
    /// Memory and processors as `takt run` has them, as long as this lives.
    _host: Host,
}

impl Live {
    /// Opens the port and starts.
    pub(super) fn start(
        listen: SocketAddr,
        mut config: ClientConfig,
        task: impl Task,
    ) -> anyhow::Result<Self> {
        let link = port::open(listen)?;
        let local = link
            .local_addr()
            .context("the socket tells no address of its own")?;
        config.lwr.first_sequence = first_sequence()?;
        let (writer, seen) = latest(1, Seen::default);
        let (answer_time, deviation) = (Recorder::new(), Recorder::new());
        let readers = (answer_time.reader(), deviation.reader());
        let host = prepare(&HostConfig::default());
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        // Boxed, so that the thread's small stack does not hold it as it is moved there.
        let mut worker = Box::new(Worker {
            link,
            partner: Client::new(config),
            task,
            seen: Seen::default(),
            cycles: 0,
            last: None,
            writer,
            answer_time,
            deviation,
        });
        let config = ThreadConfig {
            priority: Some(PRIORITY),
            ..ThreadConfig::new("fri")
        };
        let thread = spawn(config, move || {
            let scope = takt_rt::alloc::enter_real_time();
            while !stopping.load(Ordering::Relaxed) {
                worker.serve();
            }
            drop(scope);
        })
        .context("cannot start a thread")?;
        let grants = host.grants().iter().chain(thread.grants());
        for grant in grants.filter(|grant| grant.is_refused()) {
            complain(&format!("warning: {grant}"));
        }
        Ok(Self {
            thread,
            stop,
            seen,
            answer_time: readers.0,
            deviation: readers.1,
            local,
            _host: host,
        })
    }

    /// How it is now.
    pub(super) fn seen(&mut self) -> Seen {
        self.seen.read()
    }

    /// Ends it.
    pub(super) fn stop(self) -> anyhow::Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        let joined = self.thread.join();
        anyhow::ensure!(joined.is_ok(), "the thread ended by a panic");
        Ok(())
    }
}

/// Any number, so that two clients do not count alike by chance.
fn first_sequence() -> anyhow::Result<u16> {
    let [low, high, ..] = monotonic()
        .context("no clock")?
        .subsec_micros()
        .to_le_bytes();
    Ok(u16::from_le_bytes([low, high]))
}

struct Worker<T> {
    link: UdpLink,
    partner: Client,
    task: T,
    seen: Seen,
    /// The controller's cycles since the last answer.
    cycles: u32,
    /// When the newest measurement came.
    last: Option<Duration>,
    writer: LatestWriter<Seen>,
    answer_time: Recorder,
    deviation: Recorder,
}

impl<T: Task> Worker<T> {
    /// Waits for datagrams, takes all that are there, and answers once.
    fn serve(&mut self) {
        let mut wait = WAIT;
        for _ in 0..BACKLOG {
            let mut buffer = [0; ROOM];
            let Ok(Some((len, at))) = self.link.receive(&mut buffer, wait) else {
                break;
            };
            self.take(&buffer[..len], at);
            wait = Duration::ZERO;
        }
        if self.partner.is_pending() {
            self.answer();
        } else if let Ok(now) = monotonic()
            && self.partner.handle_timeout(now)
        {
            self.last = None;
        }
        self.seen.status = self.partner.status();
        self.seen.observed = self.partner.observed();
        self.writer.write(self.seen);
    }

    fn take(&mut self, datagram: &[u8], at: Duration) {
        let from = self.link.peer();
        let is_connected = self.partner.phase() != Phase::Offline;
        if is_connected && from != self.seen.peer && Kind::of(datagram).is_from_controller() {
            self.seen.second = from;
            return;
        }
        let Ok(heard) = self.partner.handle_datagram(datagram, at) else {
            return;
        };
        self.seen.peer = from;
        if heard.has_entered {
            self.task.handle_entered();
        }
        if !heard.is_new {
            return;
        }
        let cycles = 1 + u32::from(heard.lost);
        self.cycles = self.cycles.saturating_add(cycles);
        if let (Some(last), Some(period)) = (self.last.replace(at), self.partner.period()) {
            let deviation = at.saturating_sub(last).abs_diff(period * cycles);
            self.deviation.record(Nanos::from(deviation));
        }
    }

    fn answer(&mut self) {
        let joints = self.task.joints(&mut self.partner, self.cycles);
        self.cycles = 0;
        let mut buffer = [0; ROOM];
        let Ok(answer) = self.partner.answer(joints.as_ref(), &mut buffer) else {
            return;
        };
        if let Some(peer) = self.seen.peer {
            self.link.answer_to(peer);
        }
        let sent = self.link.send(&buffer[..answer.len]);
        self.seen.unsent = sent.as_ref().err().and_then(std::io::Error::raw_os_error);
        if let (Ok(1..), Ok(now)) = (sent, monotonic()) {
            self.partner.handle_sent(now);
            let came = self.last.unwrap_or(now);
            self.answer_time
                .record(Nanos::from(now.saturating_sub(came)));
        }
        if let Some(withheld) = answer.withheld {
            self.task.handle_withheld(withheld);
        }
    }
}
