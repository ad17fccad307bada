//! A live FRI client: a real-time thread that receives the controller's datagrams and answers each at once. Its
//! [`Task`] decides what to command; the subcommands display and judge.

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

use crate::output::complain;

/// The priority of the drivers, so that measurements are valid for them.
const PRIORITY: u8 = 85;
/// Longest wait for a datagram; bounds the delay of a stop.
const WAIT: Duration = Duration::from_millis(20);
/// Datagrams received at most before the newest is answered.
const BACKLOG: usize = 64;
/// Buffer for any datagram, and one byte more to detect longer ones.
const BUFFER: usize = MESSAGE_MAX + 1;

/// Commands for the robot.
pub(super) trait Task: Send + 'static {
    /// Positions of the next answer, rad, `cycles` of the controller after the last; `None` commands no motion.
    fn joints(&mut self, partner: &mut Client, cycles: u32) -> Option<[f64; AXES]>;

    /// The answer did not carry the positions.
    fn handle_withheld(&mut self, withheld: Withheld);

    /// The robot follows from now on: it entered command mode, or re-entered it between two measurements.
    fn handle_entered(&mut self);
}

/// Answers without commands: the robot stays where its controller holds it.
pub(super) struct Watch;

impl Task for Watch {
    fn joints(&mut self, _partner: &mut Client, _cycles: u32) -> Option<[f64; AXES]> {
        None
    }

    fn handle_withheld(&mut self, _withheld: Withheld) {}

    fn handle_entered(&mut self) {}
}

/// Snapshot of a connection.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seen {
    pub(super) status: Status,
    pub(super) observed: Observed,
    /// The controller.
    pub(super) peer: Option<SocketAddr>,
    /// Another one that sends to the same port.
    pub(super) second: Option<SocketAddr>,
    /// The errno with which sending the last answer failed.
    pub(super) unsent: Option<i32>,
}

/// Handle of the thread.
pub(super) struct Live {
    thread: Thread<()>,
    stop: Arc<AtomicBool>,
    seen: LatestReader<Seen>,
    /// From the arrival of a measurement to the departure of its answer.
    pub(super) answer_time: RecorderReader,
    /// Deviation of arrivals from the previous arrival plus the period.
    pub(super) deviation: RecorderReader,
    /// From the arrival of a measurement to the wake-up of the thread: what this host adds.
    pub(super) wake_up: RecorderReader,
    pub(super) local: SocketAddr,
    /// Memory and processor settings of `takt run`, while this lives.
    _host: Host,
}

impl Live {
    /// Opens the port and starts the thread.
    pub(super) fn start(
        listen: SocketAddr,
        mut config: ClientConfig,
        task: impl Task,
    ) -> anyhow::Result<Self> {
        let link = UdpLink::bind(listen).with_context(|| format!("cannot listen at {listen}"))?;
        let local = link
            .local_addr()
            .context("the socket has no local address")?;
        config.lwr.first_sequence = first_sequence()?;
        let (writer, seen) = latest(1, Seen::default);
        let [answer_time, deviation, wake_up] = [(); 3].map(|()| Recorder::new());
        let readers = [&answer_time, &deviation, &wake_up].map(Recorder::reader);
        let host = prepare(&HostConfig::default());
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        // Boxed: the thread's stack is small.
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
            wake_up,
        });
        let config = ThreadConfig {
            priority: Some(PRIORITY),
            ..ThreadConfig::new("fri")
        };
        let thread = spawn(config, move || {
            let scope = takt_rt::alloc::enter_real_time();
            // A controller that was there first filled the socket while this thread was made.
            let _failed = worker.link.discard_queued();
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
        let [answer_time, deviation, wake_up] = readers;
        Ok(Self {
            thread,
            stop,
            seen,
            answer_time,
            deviation,
            wake_up,
            local,
            _host: host,
        })
    }

    /// The latest snapshot.
    pub(super) fn seen(&mut self) -> Seen {
        self.seen.read()
    }

    /// Ends the thread.
    pub(super) fn stop(self) -> anyhow::Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        let joined = self.thread.join();
        anyhow::ensure!(joined.is_ok(), "the thread ended by a panic");
        Ok(())
    }
}

/// An arbitrary number, so that two clients differ in their sequence numbers.
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
    /// Arrival of the newest measurement.
    last: Option<Duration>,
    writer: LatestWriter<Seen>,
    answer_time: Recorder,
    deviation: Recorder,
    wake_up: Recorder,
}

impl<T: Task> Worker<T> {
    /// Waits for datagrams, handles all that are queued, and answers once.
    fn serve(&mut self) {
        let mut wait = WAIT;
        for _ in 0..BACKLOG {
            let mut buffer = [0; BUFFER];
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
        let Ok(received) = self.partner.handle_datagram(datagram, at) else {
            return;
        };
        self.seen.peer = from;
        if received.has_entered {
            self.task.handle_entered();
        }
        if !received.is_new {
            return;
        }
        if let Ok(now) = monotonic() {
            let delay = now.saturating_sub(at);
            self.partner.handle_wake_up(delay);
            self.wake_up.record(delay.into());
        }
        let cycles = 1 + u32::from(received.lost);
        self.cycles = self.cycles.saturating_add(cycles);
        if let (Some(last), Some(period)) = (self.last.replace(at), self.partner.period()) {
            let deviation = at.saturating_sub(last).abs_diff(period * cycles);
            self.deviation.record(Nanos::from(deviation));
        }
    }

    fn answer(&mut self) {
        let joints = self.task.joints(&mut self.partner, self.cycles);
        self.cycles = 0;
        let mut buffer = [0; BUFFER];
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
            let arrived = self.last.unwrap_or(now);
            self.answer_time
                .record(Nanos::from(now.saturating_sub(arrived)));
        }
        if let Some(withheld) = answer.withheld {
            self.task.handle_withheld(withheld);
        }
    }
}
