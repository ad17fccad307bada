//! One drive, commanded over SDO by the master of `takt-cia402`, brought to rest and switched off, however the session
//! ends. It decides by the drive's answers alone and prints nothing itself.
//!
//! ```text
//! identify (1000h, axis) -> guard (1016h, heartbeat) -> enable -> hold or jog -> stop -> off
//!                                                          \---- diagnosis, Ctrl-C: quick stop ----/
//! ```

mod jog;
mod lead;

use std::time::Duration;

use takt_can::Frame;
use takt_can::canopen::{HEARTBEAT, NmtCommand, NmtState, NodeId, heartbeat};
use takt_cia402::dictionary::Address;
use takt_cia402::{
    ControlWord, DriveFault, Goal, Master, MasterOptions, Monitor, RunawayLimits, State, StatusWord,
};

use super::diagnosis::{Cause, Diagnosis};
use super::facts::facts;
use super::facts::{CSP, PP, PV};
use super::observer::Observer;
use crate::can::sdo_client::{SdoClient, SdoError, number};
use crate::can::wire::Wire;
use crate::jog::{Limits, Speed};

/// Period in which the drive is read and commanded.
const CYCLE: Duration = Duration::from_millis(10);
/// Time between heartbeats of this program, and its timeout in the drive.
const BEAT: Duration = Duration::from_millis(100);
const BEAT_LOST_MS: u32 = 500;
/// Timeouts from a new velocity to turning, and from the stop to rest: the ramp is the drive's own.
const TURN: Duration = Duration::from_secs(1);
const REST: Duration = Duration::from_secs(5);
/// Timeout of a node's answer when its number is probed.
const FREE: Duration = Duration::from_millis(50);
/// Serial number.
const SERIAL: Address = Address::new(0x1018, 4);
/// Note of a jog of a drive whose quick stop does not brake.
const COASTS: &str = "605Ah is 0: a quick stop of this drive lets its motor coast; this program brakes it by its ramp";
/// Consumer heartbeat time.
const CONSUMER: Address = Address::new(0x1016, 1);
/// Consecutive cycles at rest after which it is at standstill.
const AT_REST: u8 = 3;

/// What to do.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    pub(super) node: NodeId,
    pub(super) axis: u8,
    /// 6060h
    pub(super) mode: i8,
    pub(super) reset: bool,
    /// Time in Operation enabled.
    pub(super) hold: Duration,
    pub(super) jog: Option<Jog>,
    /// Timeout of an SDO answer.
    pub(super) timeout: Duration,
    /// Tolerated deviations of the drive from its profile.
    pub(super) profile: MasterOptions,
}

/// How to turn it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Jog {
    /// Velocity units: 60FFh or 6081h, or the largest speed of cyclic set-points.
    pub(super) velocity: i32,
    pub(super) time: Duration,
    /// Even if it would not stop without this program.
    pub(super) unguarded: bool,
}

/// Words of the drive at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Step {
    /// Since the start of the session.
    pub(super) at: Duration,
    pub(super) status: StatusWord,
    pub(super) control: ControlWord,
    /// 6061h, if it has that.
    pub(super) mode: Option<i8>,
    /// 6064h
    pub(super) position: i32,
    /// 606Ch
    pub(super) velocity: i32,
}

/// The result.
#[derive(Clone, Debug)]
pub(super) struct Report {
    pub(super) node: NodeId,
    pub(super) axis: u8,
    /// Whenever a word changed.
    pub(super) steps: Vec<Step>,
    pub(super) diagnosis: Option<Diagnosis>,
    /// It was stopped on request.
    pub(super) stopped: bool,
    pub(super) commanded: bool,
    /// What does not fail it: limits that the speed of a jog was not compared with and why, emergencies.
    pub(super) notes: Vec<String>,
}

/// Why a session does not go on as planned.
#[derive(Debug)]
enum End {
    /// The tool itself failed.
    Failed(anyhow::Error),
    Because(Cause),
    Stopped,
}

impl From<anyhow::Error> for End {
    fn from(error: anyhow::Error) -> Self {
        Self::Failed(error)
    }
}

type Go<T> = Result<T, End>;

/// Shows a step to the user.
type Show<'s> = &'s mut dyn FnMut(&Step) -> anyhow::Result<()>;

/// A session with one drive.
pub(super) struct Session<'s, W> {
    wire: Observer<'s, W>,
    asker: SdoClient,
    plan: Plan,
    show: Show<'s>,
    master: Master,
    begun: Duration,
    steps: Vec<Step>,
    /// The last written word, so that only changes are sent.
    control: Option<ControlWord>,
    mode: Option<i8>,
    /// Node number of this program while it sends heartbeats, and when the next one is due.
    own: Option<(NodeId, Duration)>,
    /// Parameters as they were before this session changed them.
    saved: Vec<(Address, Vec<u8>)>,
    /// Mode-specific bits of 6040h in Operation enabled.
    bits: u16,
    /// Set-point that applies at SYNC.
    cyclic: Option<i32>,
    /// Time between two cycles.
    period: Duration,
    /// Longest time in which its words were read.
    slowest: Duration,
    /// 605Ah is 0: a quick stop lets the motor coast.
    coasts: bool,
    /// A reset was requested.
    resetting: bool,
    /// It has been in Operation enabled, and must not leave it.
    enabled: bool,
    /// It was commanded to turn, and not at rest since.
    moving: bool,
    /// Its jog is over, and it comes to rest.
    stopping: bool,
    /// It is being switched off.
    leaving: bool,
    /// 607Ah as it was written.
    aligned: Option<i32>,
    /// The limits of the drive.
    limits: Limits,
    /// Whether the motor is where its velocity can have moved it.
    monitor: Monitor,
    /// Where the monitored motion began, 6064h, and when; `None` while it is not monitored.
    origin: Option<(i32, Duration)>,
}

impl<'s, W: Wire> Session<'s, W> {
    pub(super) fn new(wire: &'s mut W, plan: Plan, show: Show<'s>) -> Self {
        let begun = wire.now();
        Self {
            wire: Observer::new(wire, plan.node),
            asker: SdoClient::new(plan.node, plan.timeout),
            master: Master::new(plan.profile),
            plan,
            show,
            begun,
            steps: Vec::new(),
            control: None,
            mode: None,
            own: None,
            saved: Vec::new(),
            bits: 0,
            cyclic: None,
            period: CYCLE,
            slowest: Duration::ZERO,
            coasts: false,
            resetting: false,
            enabled: false,
            moving: false,
            stopping: false,
            leaving: false,
            aligned: None,
            limits: Limits::default(),
            monitor: Monitor::new(RunawayLimits {
                following: f64::INFINITY,
                speed: f64::INFINITY,
            }),
            origin: None,
        }
    }

    /// Reads only, until it is stopped or the time is over.
    pub(super) fn watch(mut self, time: Option<Duration>) -> anyhow::Result<Report> {
        let end = time.map(|time| self.begun + time);
        let done = self.identify().and_then(|()| self.read_until(end));
        let last = self.steps.last().and_then(|step| step.status.state().ok());
        let is_fault = matches!(last, Some(State::Fault | State::FaultReactionActive));
        let done = done.and_then(|()| lead::judge_end(last.filter(|_| is_fault)));
        let diagnosis = self.diagnose(&done)?;
        self.report(done, diagnosis, false)
    }

    fn read_until(&mut self, end: Option<Duration>) -> Go<()> {
        while !self.wire.is_stopped() && end.is_none_or(|end| self.wire.now() < end) {
            let begun = self.wire.now();
            let control = self.read(0x6040)?;
            self.control = control.map(|raw| ControlWord::new(low_word(raw)));
            self.observe()?;
            self.rest_of_cycle(begun)?;
        }
        Ok(())
    }

    /// The whole session.
    pub(super) fn run(mut self) -> anyhow::Result<Report> {
        let done = self.identify().and_then(|()| self.command());
        if matches!(done, Err(End::Because(Cause::Runaway(_)))) {
            // It does not follow its commands: only removing its power stops it.
            self.moving = false;
            self.enabled = false;
            let _ = self.order(ControlWord::DISABLE_VOLTAGE);
        } else if done.is_err() && self.moving {
            // First of all. If that fails too, the drive stops by 6007h.
            let _ = self.brake();
        }
        let diagnosis = self.diagnose(&done)?;
        // Whatever happened: at rest, without power, as it was.
        let down = self.go_down();
        let later = self.diagnose(&down)?;
        self.restore()?;
        let done = done.and(down);
        self.report(done, diagnosis.or(later), true)
    }

    fn report(
        self,
        end: Go<()>,
        diagnosis: Option<Diagnosis>,
        commanded: bool,
    ) -> anyhow::Result<Report> {
        let stopped = match end {
            Err(End::Failed(error)) => return Err(error),
            Err(End::Stopped) => true,
            Ok(()) | Err(End::Because(_)) => false,
        };
        let is_jog = self.plan.jog.is_some();
        let mut notes = if is_jog {
            self.limits.notes().to_vec()
        } else {
            Vec::new()
        };
        if is_jog && self.coasts {
            notes.push(COASTS.to_owned());
        }
        let emergency = self.wire.observed.emergency.filter(|_| diagnosis.is_none());
        notes.extend(emergency.map(|emergency| super::facts::emergency(&emergency)));
        Ok(Report {
            node: self.plan.node,
            axis: self.plan.axis,
            steps: self.steps,
            diagnosis,
            stopped,
            commanded,
            notes,
        })
    }

    /// The diagnosis, while the drive still shows it.
    fn diagnose(&mut self, end: &Go<()>) -> anyhow::Result<Option<Diagnosis>> {
        let Err(End::Because(cause)) = end else {
            return Ok(None);
        };
        let fault = Some(DriveFault::Fault);
        let about = match *cause {
            Cause::Drive(drive_fault) => Some(Some(drive_fault)),
            Cause::DoesNotTurn { .. }
            | Cause::DoesNotStop { .. }
            | Cause::DoesNotArrive { .. }
            | Cause::SetPoint(_) => Some(None),
            Cause::Refused(refusal) if refusal.address() == self.address(0x6060) => {
                let (wanted, shown) = (self.plan.mode, 0);
                Some(Some(DriveFault::Mode { wanted, shown }))
            }
            Cause::StaysPowered(state) => {
                let sent = self.control.unwrap_or_default();
                let waited = Duration::ZERO;
                Some(Some(DriveFault::Stuck {
                    state,
                    sent,
                    waited,
                }))
            }
            Cause::Dropped(_) | Cause::Left(_) | Cause::Rebooted => Some(fault),
            Cause::Silent(_)
            | Cause::NotADrive(_)
            | Cause::NoAxis(..)
            | Cause::Refused(_)
            | Cause::Overwritten { .. }
            | Cause::Unguarded(_)
            | Cause::TooFast(_)
            | Cause::Runaway(_)
            | Cause::Duplicate
            | Cause::Coasts
            | Cause::UnknownUnit
            | Cause::NoReaction => None,
        };
        let axis = self.plan.axis;
        let mut evidence = match about {
            Some(about) => facts(&mut self.wire, &mut self.asker, axis, about)?,
            None => Vec::new(),
        };
        let emergency = self.wire.observed.emergency;
        evidence.extend(emergency.map(|emergency| super::facts::emergency(&emergency)));
        Ok(Some(Diagnosis {
            node: self.plan.node,
            cause: *cause,
            facts: evidence,
            other_master: self.wire.observed.other_master,
        }))
    }

    fn address(&self, index: u16) -> Address {
        let address = Address::new(index, 0);
        address.on_axis(self.plan.axis).unwrap_or(address)
    }

    /// Reads a number; `None` if the drive does not have the object.
    fn read(&mut self, index: u16) -> Go<Option<u32>> {
        let bytes = self.read_bytes(self.address(index))?;
        Ok(bytes.and_then(|bytes| number(&bytes)))
    }

    /// Reads an entry; `None` if the drive does not have it.
    fn read_bytes(&mut self, address: Address) -> Go<Option<Vec<u8>>> {
        match self.asker.read(&mut self.wire, address, false)? {
            Ok(bytes) => Ok(Some(bytes)),
            Err(refusal) if refusal.is_timeout() => Err(End::Because(Cause::Silent(refusal))),
            Err(_) => Ok(None),
        }
    }

    fn write(&mut self, index: u16, value: &[u8]) -> Go<Result<(), SdoError>> {
        let address = self.address(index);
        match self.asker.write(&mut self.wire, address, value, false)? {
            Err(refusal) if refusal.is_timeout() => Err(End::Because(Cause::Silent(refusal))),
            answer => Ok(answer),
        }
    }

    /// Checks that it is a drive and has the axis.
    fn identify(&mut self) -> Go<()> {
        let kind = self.read(0x1000)?.unwrap_or(0);
        if low_word(kind) != 402 {
            return Err(End::Because(Cause::NotADrive(kind)));
        }
        self.find_duplicate()?;
        let status = self.address(0x6041);
        match self.asker.read(&mut self.wire, status, false)? {
            Ok(_) => Ok(()),
            Err(refusal) if refusal.is_timeout() => Err(End::Because(Cause::Silent(refusal))),
            Err(refusal) => Err(End::Because(Cause::NoAxis(self.plan.axis, refusal))),
        }
    }

    /// Checks that one device alone has the number: two answer twice, and their serial numbers differ.
    fn find_duplicate(&mut self) -> Go<()> {
        let serial = self.read_bytes(SERIAL);
        let until = self.wire.now() + FREE;
        while self.wire.receive_until(until)?.is_some() {}
        // Answers that differ and begin at once destroy each other: none is received.
        let collide = matches!(serial, Err(End::Because(Cause::Silent(_))));
        let surplus = std::mem::take(&mut self.wire.observed.surplus);
        match (surplus, collide) {
            (0, false) => serial.map(drop),
            _ => Err(End::Because(Cause::Duplicate)),
        }
    }

    fn command(&mut self) -> Go<()> {
        self.check_limits()?;
        self.guard()?;
        self.start()?;
        self.master.set_mode(self.plan.mode);
        self.master.set_goal(Goal::OperationEnabled);
        self.enable()?;
        match self.plan.jog {
            None => self.hold(self.plan.hold),
            Some(jog) => self.jog(jog),
        }
    }

    /// Checks that the drive allows the speed of the jog, before it gets power.
    fn check_limits(&mut self) -> Go<()> {
        let (wire, asker) = (&mut self.wire, &mut self.asker);
        self.limits = Limits::read(self.plan.axis, |address| -> Go<Option<u32>> {
            match asker.read(wire, address, false)? {
                Ok(bytes) => Ok(number(&bytes)),
                Err(refusal) if refusal.is_timeout() => Err(End::Because(Cause::Silent(refusal))),
                Err(_) => Ok(None),
            }
        })?;
        if let Some(jog) = self.plan.jog {
            self.coasts = self.read(0x605A)?.map(low_word) == Some(0);
            // By profile velocity it brakes by its ramp instead.
            if self.coasts && !jog.unguarded && self.plan.mode != PV {
                return Err(End::Because(Cause::Coasts));
            }
        }
        let speed = Speed::Units(self.plan.jog.map_or(0.0, |jog| jog.velocity.into()));
        self.monitor = Monitor::new(self.limits.monitor(speed, CYCLE));
        match self.limits.check(speed) {
            Ok(()) => Ok(()),
            Err(error) => Err(End::Because(Cause::TooFast(error))),
        }
    }

    /// Makes the drive monitor the heartbeat of this program, so that it stops if that ends.
    fn guard(&mut self) -> Go<()> {
        let must = self.plan.jog.is_some_and(|jog| !jog.unguarded);
        if must && self.read(0x6007)?.map(low_word) == Some(0) {
            return Err(End::Because(Cause::NoReaction));
        }
        let own = self.free_number()?;
        let before = self.asker.read(&mut self.wire, CONSUMER, false)?;
        self.own = Some((own, self.wire.now()));
        self.beat()?;
        let entry = u32::from(own.raw()) << 16 | BEAT_LOST_MS;
        let answer = self
            .asker
            .write(&mut self.wire, CONSUMER, &entry.to_le_bytes(), false)?;
        match answer {
            Ok(()) => {
                self.saved
                    .extend(before.ok().map(|before| (CONSUMER, before)));
                Ok(())
            }
            Err(refusal) if refusal.is_timeout() => Err(End::Because(Cause::Silent(refusal))),
            Err(refusal) if must => Err(End::Because(Cause::Unguarded(refusal))),
            Err(_) => Ok(()),
        }
    }

    /// The highest number at which no node answers.
    fn free_number(&mut self) -> Go<NodeId> {
        let mut own = self.plan.node;
        for raw in (1..=NodeId::LAST.raw()).rev() {
            let Ok(node) = NodeId::new(raw) else {
                continue;
            };
            if node == self.plan.node {
                continue;
            }
            let mut asker = SdoClient::new(node, FREE);
            let answer = asker.read(&mut self.wire, Address::new(0x1000, 0), false)?;
            own = node;
            if answer.is_err_and(SdoError::is_timeout) {
                break;
            }
        }
        Ok(own)
    }

    /// To Operational, unless it is.
    fn start(&mut self) -> Go<()> {
        let node = self.plan.node;
        if let Ok(question) = Frame::remote(node.cob(HEARTBEAT), 1) {
            self.wire.send(&question)?;
        }
        let until = self.wire.now() + FREE;
        while self.wire.receive_until(until)?.is_some() {}
        if self.wire.observed.state != Some(NmtState::Operational) {
            self.wire.send(&NmtCommand::Start.frame(Some(node)))?;
        }
        (self.wire.observed.state, self.wire.observed.boots) = (None, 0);
        Ok(())
    }

    /// Sends a heartbeat, if one is due.
    fn beat(&mut self) -> Go<()> {
        if let Some((own, due)) = self.own
            && self.wire.now() >= due
        {
            self.wire.send(&heartbeat(own, NmtState::Operational))?;
            self.own = Some((own, due.max(self.wire.now()) + BEAT));
        }
        Ok(())
    }

    /// Reads the words; a change of one is a step.
    fn observe(&mut self) -> Go<Step> {
        let begun = self.wire.now();
        let status = self.read(0x6041)?.unwrap_or(0);
        let signed = |raw: Option<u32>| raw.unwrap_or(0).cast_signed();
        let step = Step {
            at: self.wire.now().saturating_sub(self.begun),
            status: StatusWord::new(low_word(status)),
            control: self.control.unwrap_or_default(),
            mode: self
                .read(0x6061)?
                .map(|raw| raw.to_le_bytes()[0].cast_signed()),
            position: signed(self.read(0x6064)?),
            velocity: signed(self.read(0x606C)?),
        };
        self.slowest = self.slowest.max(self.wire.now().saturating_sub(begun));
        let words = |step: &Step| (step.status, step.control, step.mode);
        if self.steps.last().map(words) != Some(words(&step)) {
            (self.show)(&step)?;
            self.steps.push(step);
        }
        Ok(step)
    }

    fn rest_of_cycle(&mut self, begun: Duration) -> Go<()> {
        while self.wire.now() < begun + self.period {
            self.wire.receive_until(begun + self.period)?;
        }
        Ok(())
    }

    /// Restores its heartbeat consumer and its parameters, if it accepts that. It stays in Operational: to a drive, leaving that is a lost
    /// master, to which it reacts by 6007h.
    fn restore(&mut self) -> anyhow::Result<()> {
        for (address, before) in std::mem::take(&mut self.saved) {
            let _ = self.asker.write(&mut self.wire, address, &before, false)?;
        }
        Ok(())
    }
}

const fn low_word(raw: u32) -> u16 {
    let [a, b, ..] = raw.to_le_bytes();
    u16::from_le_bytes([a, b])
}
