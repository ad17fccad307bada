//! A segment whose master is a tool: it sends and receives the frames of the master once a cycle, until a state is reached.
//! It meets no deadlines: for real time there is the controller.

use std::io;
use std::time::Duration;

use anyhow::{bail, ensure};
use takt_ethercat::config::{Location, MasterConfig, SlaveSpec, Timeouts};
use takt_ethercat::dc::{self, Sample};
use takt_ethercat::link::{Link, Port};
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_ethercat::master::{Event, Job, JobError, JobKind, Master, Phase};
use takt_ethercat::{Address, AlState, AlStatus, Command, FrameWriter, register};
use takt_rt::interface::Medium;

use crate::link::failed;

/// A wire and the clock by which it stamps what it receives.
pub(super) trait Wire: Link {
    /// The time now.
    fn now(&mut self) -> io::Result<Duration>;

    /// Returns at a time; at once if that is past.
    fn wait_until(&mut self, at: Duration) -> io::Result<()>;
}

impl Wire for PacketLink {
    fn now(&mut self) -> io::Result<Duration> {
        monotonic()
    }

    fn wait_until(&mut self, at: Duration) -> io::Result<()> {
        std::thread::sleep(at.saturating_sub(monotonic()?));
        Ok(())
    }
}

/// Time to receive frames of another master before the first frame: longer than any usual cycle.
const LISTEN: Duration = Duration::from_millis(60);
/// Wait at each end of a ring, in turn.
const TURN: Duration = Duration::from_micros(20);
/// Timeout of the first answer.
const SILENT_AFTER: Duration = Duration::from_secs(1);
/// Time after which slaves with a fault are no longer waited for: the master has retried them.
const TRIED: Duration = Duration::from_secs(3);
/// Most events that are stored; later ones repeat them.
const EVENTS_MAX: usize = 1000;
/// Longest wait for progress of a job, in addition to the master's own time-outs.
const JOB: Duration = Duration::from_secs(60);

/// How far behind the middle between two SYNC0 a frame was sent, ns; SYNC0 lies on whole cycles of the system time.
pub(super) fn phase_error(sample: &Sample, cycle: Duration) -> i64 {
    let signed = |ns: u64| i64::try_from(ns).unwrap_or(i64::MAX);
    let half = signed(nanos(cycle) / 2);
    signed(dc::phase_ns(sample.system_ns, cycle, 0)) - half
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// An eighth of the error, at most a two hundredth of the cycle: faster than any clocks drift apart.
fn nudged(next: Duration, error_ns: i64, cycle: Duration) -> Duration {
    let most = i64::try_from(nanos(cycle) / 200).unwrap_or(i64::MAX);
    let by = (error_ns / 8).clamp(-most, most);
    let size = Duration::from_nanos(by.unsigned_abs());
    if by > 0 {
        next.saturating_sub(size)
    } else {
        next + size
    }
}

/// The answer to a job, and its data.
type Answered = (Result<(), JobError>, Vec<u8>);

/// A segment that a tool is master of.
#[derive(Debug)]
pub(super) struct Session<W> {
    interface: String,
    port: Port<W>,
    /// The other end of a ring.
    second: Option<Port<W>>,
    master: Master,
    frame: Box<[u8; FrameWriter::LEN_MAX]>,
    /// When the next cycle begins.
    next: Duration,
    /// When the newest frame was sent.
    sent_at: Duration,
    events: Vec<(Duration, Event)>,
    round_trips: Vec<Duration>,
    /// Frames keep a phase to SYNC0.
    follows: bool,
    /// The newest sample of the reference clock, until it is read.
    clock: Option<Sample>,
    /// The first end received frames of the second.
    closed: bool,
}

impl<W: Wire> Session<W> {
    /// A session that has not sent anything yet.
    pub(super) fn new(
        interface: &str,
        wire: W,
        mac: [u8; 6],
        config: MasterConfig,
    ) -> anyhow::Result<Self> {
        let mut port = Port::new(wire, mac);
        let next = port.link().now()?;
        Ok(Self {
            interface: interface.to_owned(),
            port,
            second: None,
            master: Master::new(config)?,
            frame: Box::new([0; FrameWriter::LEN_MAX]),
            next,
            sent_at: next,
            events: Vec::new(),
            round_trips: Vec::new(),
            follows: false,
            clock: None,
            closed: false,
        })
    }

    /// With the other end of a ring, of a configuration that is redundant.
    pub(super) fn with_second(mut self, wire: W, mac: [u8; 6]) -> Self {
        self.second = Some(Port::new(wire, mac));
        self
    }

    /// The name of the interface.
    pub(super) fn interface(&self) -> &str {
        &self.interface
    }

    /// The master.
    pub(super) const fn master(&self) -> &Master {
        &self.master
    }

    /// The master, to read and write process data between cycles.
    pub(super) const fn master_mut(&mut self) -> &mut Master {
        &mut self.master
    }

    /// Restarts with another configuration, on the same wire.
    pub(super) fn restart(&mut self, config: MasterConfig) -> anyhow::Result<()> {
        let redundant = self.second.is_some();
        self.master = Master::new(MasterConfig {
            redundant,
            ..config
        })?;
        self.forget();
        Ok(())
    }

    /// Keeps frames in the middle between two SYNC0 from now on.
    pub(super) const fn follow_sync0(&mut self) {
        self.follows = true;
    }

    /// The time on the wire's clock.
    pub(super) fn now(&mut self) -> io::Result<Duration> {
        self.port.link().now()
    }

    /// The newest sample of the reference clock, once.
    pub(super) const fn sample(&mut self) -> Option<Sample> {
        self.clock.take()
    }

    /// The wire.
    #[cfg(test)]
    pub(super) const fn wire(&mut self) -> &mut W {
        self.port.link()
    }

    /// Events so far, with their times.
    pub(super) fn events(&self) -> &[(Duration, Event)] {
        &self.events
    }

    /// From sending to receiving, frame by frame since [`Self::forget`].
    pub(super) fn round_trips(&self) -> &[Duration] {
        &self.round_trips
    }

    /// Deletes events and round trips: a measurement begins here.
    pub(super) fn forget(&mut self) {
        self.events.clear();
        self.round_trips.clear();
    }

    /// Checks that there is no other master. Two on one segment receive each other's frames, and outputs of the other one
    /// would be overwritten.
    pub(super) fn listen(&mut self) -> anyhow::Result<()> {
        let mut another = false;
        for port in std::iter::once(&mut self.port).chain(&mut self.second) {
            let received = port.receive(LISTEN);
            another |= received
                .map_err(|error| failed(&self.interface, Medium::Ethernet, error))?
                .is_some();
        }
        ensure!(
            !another,
            "{}: frames of another master are received; nothing was sent\n\
             hint: stop it first (`systemctl stop takt`, or the program that sends there)",
            self.interface
        );
        Ok(())
    }

    /// One frame out and back, then the end of the cycle. At start there is no cycle: the next frame goes at once.
    pub(super) fn cycle(&mut self) -> anyhow::Result<()> {
        self.exchange()
            .map_err(|error| failed(&self.interface, Medium::Ethernet, error))?;
        while let Some(event) = self.master.poll_event() {
            if self.events.len() < EVENTS_MAX {
                self.events.push((self.next, event));
            }
        }
        Ok(())
    }

    fn exchange(&mut self) -> io::Result<()> {
        let paced = self.master.phase() == Phase::Running;
        let now = self.port.link().now()?;
        // Missed cycles are skipped, never sent in a burst; frames without a cycle do not move the grid.
        let cycle = self.master.config().cycle;
        self.next = (self.next + cycle).clamp(now, now + cycle);
        let sent = self.master.poll_transmit(now, &mut self.frame[..]);
        if let Some(len) = sent {
            self.sent_at = now;
            self.send(len)?;
        }
        while !self.next.saturating_sub(self.port.link().now()?).is_zero() {
            if self.receive()? {
                break;
            }
        }
        if paced {
            self.keep_phase();
        }
        if paced || sent.is_none() {
            self.port.link().wait_until(self.next)?;
        }
        Ok(())
    }

    /// Sends what is in the buffer, in a ring from both ends. One end that fails is a cable that is cut.
    fn send(&mut self, len: usize) -> io::Result<()> {
        let frame = self.frame.get(..len).unwrap_or_default();
        let first = self.port.send(frame);
        match &mut self.second {
            None => first,
            Some(second) => second.send(frame).or(first),
        }
    }

    /// Waits for a frame until the cycle ends, in a ring briefly at each end; whether it was the whole answer.
    fn receive(&mut self) -> io::Result<bool> {
        let left = self.next.saturating_sub(self.port.link().now()?);
        let wait = if self.second.is_some() {
            left.min(TURN)
        } else {
            left
        };
        let second = self.second.as_ref().map(Port::source);
        let ends = std::iter::once(&mut self.port).chain(&mut self.second);
        let (mut alive, mut failed) = (false, None);
        for (number, port) in ends.enumerate() {
            match port.receive(wait) {
                Ok(Some((bytes, at))) => {
                    let whole = self.master.handle_frame(number, bytes, at);
                    self.closed |= number == 0 && second.is_some_and(|mac| port.received_from(mac));
                    if whole {
                        self.round_trips.push(at.saturating_sub(self.sent_at));
                        return Ok(true);
                    }
                    alive = true;
                }
                Ok(None) => alive = true,
                Err(error) => failed = Some(error),
            }
        }
        failed.filter(|_| !alive).map_or(Ok(false), Err)
    }

    /// Moves the end of the cycle a little towards the middle between two SYNC0.
    fn keep_phase(&mut self) {
        if let Some(sample) = self.master.poll_sample() {
            self.clock = Some(sample);
            if self.follows {
                let cycle = self.master.config().cycle;
                self.next = nudged(self.next, phase_error(&sample, cycle), cycle);
            }
        }
    }

    /// Brings the segment to its configured state. Returns also if some slaves do not reach it, with their faults in the
    /// master.
    pub(super) fn bring_up(&mut self, timeout: Duration) -> anyhow::Result<()> {
        let begin = self.port.link().now()?;
        loop {
            self.cycle()?;
            let passed = self.port.link().now()?.saturating_sub(begin);
            if self.master.is_empty() {
                if passed >= SILENT_AFTER {
                    self.silence()?;
                }
                continue;
            }
            if self.master.is_operational() || self.master.phase() == Phase::Refused {
                return Ok(());
            }
            if passed >= timeout || (passed >= TRIED && self.all_settled()) {
                return Ok(());
            }
        }
    }

    /// Whether the second end of a closed ring was named first: frames then pass the slaves on their way from there, which
    /// alone looks like a ring that is open behind its last slave.
    pub(super) fn is_reversed(&self) -> bool {
        let gap = self.master.ring_gap();
        self.closed && gap.is_some_and(|cable| cable.to.is_none())
    }

    /// Whether each slave is in its state or has a fault.
    fn all_settled(&self) -> bool {
        let mut slaves = (0..self.master.len()).filter_map(|number| self.master.slave(number));
        self.master.phase() == Phase::Running
            && slaves.all(|slave| slave.is_running() || slave.fault().is_some())
    }

    /// Why there is no slave after a while.
    pub(super) fn silence(&self) -> anyhow::Result<()> {
        let interface = &self.interface;
        let frames = self.master.frames();
        if let Some(position) = self.master.ring_split() {
            bail!(
                "{interface}: the ring is open before the slave at position {position}, and a start from both ends \
                 cannot identify the slaves\nhint: check plugs, cable and supply there; without --second, each end \
                 reaches its own side"
            );
        }
        if frames.answered > 0 {
            bail!(
                "{interface}: frames return and no slave has processed them\n\
                 hint: connect the cable to the IN port of the first slave, not to a loop or a switch"
            );
        }
        bail!(
            "{interface}: {} frames sent, none returned\nhint: check the link (`ip link show {interface}`), the supply of \
             the first slave, and that the cable is in its IN port",
            frames.sent
        );
    }

    /// Continues for a time.
    pub(super) fn run_for(&mut self, duration: Duration) -> anyhow::Result<()> {
        let end = self.port.link().now()? + duration;
        while self.port.link().now()? < end {
            self.cycle()?;
        }
        Ok(())
    }

    /// Submits a job and continues until it is answered.
    pub(super) fn request(
        &mut self,
        slave: usize,
        kind: JobKind,
        data: Vec<u8>,
    ) -> anyhow::Result<Result<Vec<u8>, JobError>> {
        let ended = self.transfer(slave, kind, data, |_| true)?;
        let (result, data) = ended.unwrap_or((Err(JobError::Absent), Vec::new()));
        Ok(result.map(|()| data))
    }

    /// The same, with the data of an error. After each cycle `goes_on` gets the number of bytes transferred; if it returns
    /// false, the session ends within the job, and so does this with `None`.
    pub(super) fn transfer(
        &mut self,
        slave: usize,
        kind: JobKind,
        data: Vec<u8>,
        mut goes_on: impl FnMut(usize) -> bool,
    ) -> anyhow::Result<Option<Answered>> {
        let job = Job {
            slave,
            kind,
            data,
            token: 0,
        };
        if let Err(refused) = self.master.submit(job) {
            return Ok(Some((refused.result, refused.job.data)));
        }
        let (mut begin, mut before) = (self.port.link().now()?, 0);
        loop {
            self.cycle()?;
            // Late uploads of a proof have another token.
            if let Some(reply) = self.master.poll_reply()
                && reply.job.token == 0
            {
                return Ok(Some((reply.result, reply.job.data)));
            }
            let now = self.port.link().now()?;
            let slave = self.master.slave(slave);
            let done = slave.and_then(|slave| slave.transferred()).unwrap_or(0);
            if done != before {
                (begin, before) = (now, done);
            }
            if !goes_on(done) {
                return Ok(None);
            }
            let passed = now.saturating_sub(begin);
            if passed >= JOB {
                return Ok(Some((Err(JobError::Timeout(passed)), Vec::new())));
            }
        }
    }

    /// Restarts with one slave in a state and all others in PRE-OP, and waits for that.
    pub(super) fn hold(
        &mut self,
        slave: usize,
        goal: AlState,
        timeouts: Option<Timeouts>,
        timeout: Duration,
    ) -> anyhow::Result<()> {
        self.hold_as(slave, timeout, |spec| {
            (spec.goal, spec.timeouts) = (goal, timeouts);
        })
    }

    /// Restarts with all slaves in PRE-OP, one of which exchanges Ethernet frames (EoE), and waits for that.
    pub(super) fn hold_ethernet(&mut self, slave: usize, timeout: Duration) -> anyhow::Result<()> {
        self.hold_as(slave, timeout, |spec| spec.ethernet = true)
    }

    fn hold_as(
        &mut self,
        slave: usize,
        timeout: Duration,
        change: impl Fn(&mut SlaveSpec),
    ) -> anyhow::Result<()> {
        let at = |number: usize| {
            let position = u16::try_from(number).unwrap_or(u16::MAX);
            let mut spec = SlaveSpec::new(format!("{number}"), Location::Position(position));
            spec.goal = AlState::PreOp;
            if number == slave {
                change(&mut spec);
            }
            spec
        };
        let slaves: Vec<SlaveSpec> = (0..self.master.len()).map(at).collect();
        let goal = slaves.get(slave).map_or(AlState::PreOp, |spec| spec.goal);
        let is_up = matches!(goal, AlState::SafeOp | AlState::Op);
        self.restart(MasterConfig {
            slaves,
            goal: if is_up { goal } else { AlState::PreOp },
            cycle: self.master.config().cycle,
            ..MasterConfig::default()
        })?;
        self.bring_up(timeout)
    }

    /// Leaves all slaves in INIT, so that no watchdog has to detect the end of this master.
    pub(super) fn leave(&mut self) -> anyhow::Result<()> {
        let init = AlStatus {
            state: AlState::Init,
            error: true,
        };
        let address = Address::Device {
            adp: 0,
            ado: register::AL_CONTROL,
        };
        let mut writer = FrameWriter::new(&mut self.frame[..])?;
        writer.push(Command::Bwr, 0, address, &init.raw().to_le_bytes())?;
        let len = writer.finish();
        self.send(len)
            .map_err(|error| failed(&self.interface, Medium::Ethernet, error))
    }

    /// The number of a slave by its number, or by a unique name or order code.
    pub(super) fn find(&self, text: &str) -> anyhow::Result<usize> {
        let master = &self.master;
        if let Ok(number) = text.parse::<usize>() {
            let count = master.len();
            ensure!(
                number < count,
                "there is no slave {number}: {} has {count}, counted from 0",
                self.interface
            );
            return Ok(number);
        }
        let is_meant = |number: &usize| {
            let info = master.slave(*number).map(|slave| slave.info());
            info.is_some_and(|info| info.name == text || info.order == text)
        };
        let found: Vec<usize> = (0..master.len()).filter(is_meant).collect();
        match found[..] {
            [number] => Ok(number),
            [] => bail!(
                "no slave is named `{text}`\nhint: `takt ecat scan {}` lists them",
                self.interface
            ),
            [first, ..] => bail!(
                "{} slaves are named `{text}`, the first at {first}\nhint: use the number",
                found.len()
            ),
        }
    }
}
