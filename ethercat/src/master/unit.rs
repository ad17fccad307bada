//! One slave as its master sees it: carries out one small operation after the other (a register, a state, words of
//! the SII, a mailbox message) with one datagram under way at most. Which operation follows is in [`steps`]; in which
//! frame its datagram travels is the master's.

mod clock;
mod identity;
mod info;
mod jobs;
mod learn;
mod mailbox;
mod objects;
mod operation;
mod steps;
mod transfer;
mod watch;

use std::collections::VecDeque;
use std::time::Duration;

use super::event::{Event, Fault, JobError, Outbox};
use super::image::Image;
use super::job::{Job, JobKind};
use super::process::{Assignment, ProcessData};
use crate::config::{MasterConfig, Patience, SlaveSpec};
use crate::{AlState, AlStatus, AlStatusCode};

pub use info::{Port as PortState, SlaveInfo};
use jobs::{JOBS_MAX, OWN};
use mailbox::Mailbox;
use operation::Op;
pub(super) use steps::Step;
pub use watch::PortCounters;

/// A datagram that a slave's machine wants sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Request<'a> {
    Read { at: u16, len: u16 },
    Write { at: u16, data: &'a [u8] },
}

impl<'a> Request<'a> {
    const fn read(at: u16, len: u16) -> Self {
        Self::Read { at, len }
    }

    const fn write(at: u16, data: &'a [u8]) -> Self {
        Self::Write { at, data }
    }
}

/// What came of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer<'a> {
    /// Its frame did not come back.
    Lost,
    /// It came back.
    Data { counter: u16, data: &'a [u8] },
}

/// What a slave's machine may know of the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Context<'a> {
    pub(super) now: Duration,
    /// When the frame of this answer was sent.
    pub(super) sent_at: Duration,
    /// System time of the reference clock as the frame of this answer passed it, ns.
    pub(super) reference_ns: Option<u64>,
    /// Whose clock is the reference.
    pub(super) reference: Option<usize>,
    pub(super) config: &'a MasterConfig,
    pub(super) image: &'a Image,
}

impl Context<'_> {
    /// Bytes that one datagram of a mailbox can have, beside the image if that is exchanged.
    fn mailbox_room(&self) -> usize {
        if self.config.goal == AlState::PreOp {
            Image::default().mailbox_room()
        } else {
            self.image.mailbox_room()
        }
    }
}

/// What a datagram under way is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Asked {
    /// There is none.
    #[default]
    Nothing,
    Operation,
    Mailbox,
    Watch,
    /// For something that has been given up.
    Past,
}

/// How far a slave may go by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Gate {
    /// To where it is known who it is.
    #[default]
    Identity,
    /// To where its process data is known.
    Process,
    /// To its goal.
    Goal,
}

/// The clock of a slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct UnitClock {
    /// Receive times of its ports, as latched at start, ns of local time.
    pub(super) times: [u32; 4],
    /// They were read.
    pub(super) latched: bool,
    /// Propagation delay from the reference, ns.
    pub(super) delay_ns: u32,
    /// What is added to its local time, ns.
    offset: u64,
    /// System time difference as last read, ns; positive is ahead.
    pub(super) difference_ns: Option<i32>,
    /// Differences beyond the window since it was locked.
    pub(super) violations: u64,
    /// Differences beyond the window in a row.
    outside: u8,
    /// It follows the reference.
    pub(super) locked: bool,
    /// First SYNC0, system time, ns.
    pub(super) start_ns: Option<u64>,
}

impl UnitClock {
    /// What locked before is outside of the window, for longer than chance has it.
    pub(super) const fn is_lost(&self) -> bool {
        self.outside >= OUTSIDE
    }
}

/// Differences beyond the window in a row after which a clock is told to be lost.
const OUTSIDE: u8 = 3;
/// Firmware that shows OP may still switch its SyncManagers on; after this long it must take part.
const COUNT_GRACE: Duration = Duration::from_millis(100);
/// Longest write to registers, bytes.
const WRITE_MAX: usize = 256;

/// A slave.
#[derive(Debug)]
pub(super) struct Unit {
    pub(super) number: usize,
    pub(super) station: u16,
    /// In the ring; `None` while it is not there.
    pub(super) position: Option<u16>,
    pub(super) spec: SlaveSpec,
    pub(super) info: SlaveInfo,
    pub(super) process: ProcessData,
    /// The process data is known, so that the image has room for it.
    pub(super) mapped: bool,
    pub(super) gate: Gate,
    step: Step,
    op: Op,
    since: Duration,
    misses: u8,
    /// What the datagram under way is for.
    waiting: Asked,
    /// What the datagram that was last offered is for.
    offered: Asked,
    write: [u8; WRITE_MAX],
    write_len: usize,
    sii: Vec<u8>,
    assignments: Vec<Assignment>,
    /// The first assignment that was refused; whether it matters, what the slave has then tells.
    refused: Option<Fault>,
    learn: learn::Learn,
    /// Memory of the transfers that the steps make.
    scratch: Vec<u8>,
    mailbox: Mailbox,
    jobs: VecDeque<Job>,
    /// A job that is about registers, while its operation runs.
    job: Option<Job>,
    /// AL status by its meaning, and its code.
    pub(super) al: AlStatus,
    pub(super) code: AlStatusCode,
    /// The lower five bits of AL status as they were read, for the census.
    pub(super) shown: u8,
    /// SII status as last read.
    sii_status: u16,
    pub(super) fault: Option<Fault>,
    failures: u8,
    again: Duration,
    /// When it last reached its goal.
    reached_at: Duration,
    /// The working counter was complete since then.
    counted: bool,
    /// It was brought to its goal, and its set-up is in it.
    set_up: bool,
    /// Its SII was read.
    pub(super) known: bool,
    /// Good answers in a row.
    streak: u8,
    pub(super) clock: UnitClock,
    watch: watch::Watch,
}

impl Unit {
    pub(super) fn new(number: usize, station: u16, spec: SlaveSpec, config: &MasterConfig) -> Self {
        let longest = spec
            .startup
            .iter()
            .map(|sdo| sdo.data.len())
            .max()
            .unwrap_or(0);
        Self {
            number,
            station,
            position: None,
            info: SlaveInfo::default(),
            process: ProcessData::default(),
            mapped: false,
            gate: Gate::Identity,
            step: Step::Absent,
            op: Op::Rest,
            since: Duration::ZERO,
            misses: 0,
            waiting: Asked::Nothing,
            offered: Asked::Nothing,
            write: [0; WRITE_MAX],
            write_len: 0,
            sii: Vec::new(),
            assignments: Vec::new(),
            refused: None,
            learn: learn::Learn::default(),
            scratch: Vec::with_capacity(longest.max(16)),
            mailbox: Mailbox::new(spec.patience.unwrap_or(config.patience)),
            jobs: VecDeque::with_capacity(JOBS_MAX),
            job: None,
            al: AlStatus::default(),
            code: AlStatusCode::default(),
            shown: 0,
            sii_status: 0,
            fault: None,
            failures: 0,
            again: Duration::ZERO,
            reached_at: Duration::ZERO,
            counted: false,
            set_up: false,
            known: false,
            streak: 0,
            clock: UnitClock::default(),
            watch: watch::Watch::default(),
            spec,
        }
    }

    /// How long it is waited for.
    fn patience(&self, config: &MasterConfig) -> Patience {
        self.spec.patience.unwrap_or(config.patience)
    }

    /// Gives a slave that was found its place in the configuration.
    pub(super) fn assign(&mut self, number: usize, spec: SlaveSpec) {
        let longest = spec
            .startup
            .iter()
            .map(|sdo| sdo.data.len())
            .max()
            .unwrap_or(0);
        self.scratch = Vec::with_capacity(longest.max(16));
        if let Some(patience) = spec.patience {
            self.mailbox.set_patience(patience);
        }
        (self.number, self.spec) = (number, spec);
    }

    pub(super) const fn step(&self) -> Step {
        self.step
    }

    pub(super) const fn counters(&self) -> &PortCounters {
        self.watch.counters()
    }

    pub(super) fn is_present(&self) -> bool {
        self.position.is_some()
    }

    /// How far it is to be brought.
    pub(super) fn goal(&self, config: &MasterConfig) -> AlState {
        if config.goal.raw() < self.spec.goal.raw() {
            config.goal
        } else {
            self.spec.goal
        }
    }

    /// Bytes of the longest datagram that its mailbox needs; zero without one.
    pub(super) fn mailbox_size(&self) -> usize {
        self.mailbox.size()
    }

    /// It failed more than once, so that nobody should wait for it.
    pub(super) const fn has_failed(&self) -> bool {
        matches!(self.step, Step::Failed) && self.failures >= 2
    }

    pub(super) const fn is_running(&self) -> bool {
        matches!(self.step, Step::Run)
    }

    /// What its process data adds to the working counter of LRW, as far as its state tells: least and most.
    pub(super) fn contribution(&self, lrw: bool, now: Duration) -> (u16, u16) {
        let out = if self.process.outputs_len() == 0 {
            0
        } else if lrw {
            2
        } else {
            1
        };
        let most = out + u16::from(self.process.inputs_len() > 0);
        let settled = self.counted || now.saturating_sub(self.reached_at) > COUNT_GRACE;
        let is_up = self.is_running() && self.al.state == AlState::Op && !self.al.error;
        if self.is_present() && is_up && settled {
            (most, most)
        } else {
            // On its way up or down a slave switches its SyncManagers when it likes, and one that is not reached may
            // still take part with the FMMUs that it has. Nobody else is to suffer from that.
            (0, most)
        }
    }

    /// Its whole group counted: from now on it is missed if it does not.
    pub(super) const fn take_part(&mut self) {
        self.counted = self.is_running();
    }

    /// A slave is there and begins from INIT.
    pub(super) fn begin(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        self.fault = None;
        self.enter(Step::Init, cx, out);
    }

    /// It answers again; what is to be done depends on the state that it is in.
    pub(super) fn returned(&mut self, position: u16, cx: &Context<'_>, out: &mut Outbox) {
        self.position = Some(position);
        out.event(Event::Returned { slave: self.number });
        self.enter(Step::Look, cx, out);
    }

    /// It is gone.
    pub(super) fn lose(&mut self, out: &mut Outbox) {
        self.position = None;
        self.show(0, AlStatusCode::default());
        (self.clock.locked, self.clock.outside) = (false, 0);
        (self.step, self.op, self.waiting) = (Step::Absent, Op::Rest, Asked::Nothing);
        self.fault = Some(Fault::Lost);
        out.event(Event::Fault {
            slave: self.number,
            fault: Fault::Lost,
        });
        self.abandon(out);
    }

    /// What came is another one.
    pub(super) fn release(&mut self) {
        self.position = None;
        self.show(0, AlStatusCode::default());
        (self.step, self.op, self.waiting) = (Step::Absent, Op::Rest, Asked::Nothing);
    }

    /// It is not where it is wanted.
    pub(super) fn fail(&mut self, fault: Fault, cx: &Context<'_>, out: &mut Outbox) {
        if matches!(self.step, Step::Run)
            && cx.now.saturating_sub(self.reached_at) > Duration::from_secs(1)
        {
            self.failures = 0;
        }
        let wait = self.patience(cx.config).again * (1 << self.failures.min(5));
        self.failures = self.failures.saturating_add(1);
        self.again = cx.now + wait;
        // What comes back once more is told once.
        if self.fault != Some(fault) {
            out.event(Event::Fault {
                slave: self.number,
                fault,
            });
        }
        self.fault = Some(fault);
        (self.step, self.op, self.since) = (Step::Failed, Op::Rest, cx.now);
        // Its operation ends here, and it must not wait for it before it is tried again.
        if let Some(job) = self.job.take() {
            self.give_back(job, Err(JobError::Absent), out);
        }
    }

    /// What the census or an inspection saw of its state.
    pub(super) fn seen(
        &mut self,
        status: u16,
        code: AlStatusCode,
        cx: &Context<'_>,
        out: &mut Outbox,
    ) {
        self.show(status, code);
        let al = self.al;
        let wanted = self.goal(cx.config);
        if self.is_running() && (al.error || al.state != wanted) {
            self.fail(
                Fault::State {
                    wanted,
                    status: al,
                    code,
                },
                cx,
                out,
            );
        }
    }

    /// Time passes; to be called before each frame.
    pub(super) fn poll(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        if !self.is_present() {
            return;
        }
        if matches!(self.step, Step::Failed) && cx.now >= self.again && self.job.is_none() {
            self.enter(Step::Look, cx, out);
        }
        if let Some(output) = self.mailbox.check(cx.now) {
            self.handle_mailbox(output, cx, out);
        }
        self.check_deadline(cx, out);
        self.pass_gate(cx, out);
        if self.is_at_rest() {
            self.begin_job(cx, out);
        }
    }

    /// No operation of the steps runs.
    fn is_at_rest(&self) -> bool {
        matches!(
            self.step,
            Step::Run | Step::Failed | Step::Identified | Step::Configured
        ) && self.op == Op::Rest
    }

    /// Whether something waits to be sent that is not mere watching.
    pub(super) fn is_busy(&self) -> bool {
        self.waiting == Asked::Nothing
            && self.is_present()
            && (self.op != Op::Rest || !self.mailbox.is_idle())
    }

    /// The datagram that is due, if none is under way: of an operation, of the mailbox, or, if it is its turn, of
    /// the watch.
    pub(super) fn request(&mut self, watch: bool) -> Option<Request<'_>> {
        if self.waiting != Asked::Nothing || !self.is_present() {
            return None;
        }
        if !matches!(self.op, Op::Rest | Op::Mailbox) {
            self.offered = Asked::Operation;
            return self.operation_request();
        }
        if self.mailbox.request().is_some() {
            self.offered = Asked::Mailbox;
            return self.mailbox.request();
        }
        if watch && self.is_running() {
            self.offered = Asked::Watch;
            return self
                .watch
                .request(self.mailbox.exists(), self.info.has_clock());
        }
        None
    }

    /// The datagram that was offered is in a frame.
    pub(super) const fn sent(&mut self) {
        self.waiting = self.offered;
    }

    /// What came of the datagram.
    pub(super) fn handle(&mut self, answer: Answer<'_>, cx: &Context<'_>, out: &mut Outbox) {
        match std::mem::take(&mut self.waiting) {
            Asked::Nothing | Asked::Past => {}
            Asked::Operation => self.operation_answer(answer, cx, out),
            Asked::Watch => self.watched(answer, cx, out),
            Asked::Mailbox => {
                if let Some(output) = self.mailbox.answer(answer, cx.now) {
                    self.handle_mailbox(output, cx, out);
                }
            }
        }
    }

    fn watched(&mut self, answer: Answer<'_>, cx: &Context<'_>, out: &mut Outbox) {
        let found = self.watch.answer(answer);
        if found.mailbox_full {
            self.mailbox.look(true, cx.now);
        }
        if let Some(difference) = found.difference_ns {
            let is_reference = cx.reference == Some(self.number);
            let difference = if is_reference { 0 } else { difference };
            self.judge_clock(difference, cx, out);
        }
    }

    /// A clock that was locked and is outside of the window three times in a row is told, once; what becomes of its
    /// slave is the slave's own business, which leaves OP by itself when it cannot go on.
    fn judge_clock(&mut self, difference_ns: i32, cx: &Context<'_>, out: &mut Outbox) {
        let clock = &mut self.clock;
        clock.difference_ns = Some(difference_ns);
        if difference_ns.unsigned_abs() <= cx.config.clocks.window_ns {
            if clock.is_lost() {
                out.event(Event::ClockBack { slave: self.number });
            }
            (clock.locked, clock.outside) = (true, 0);
        } else if clock.locked {
            clock.violations += 1;
            clock.outside = clock.outside.saturating_add(1);
            if clock.outside == OUTSIDE {
                out.event(Event::ClockLost {
                    slave: self.number,
                    difference_ns,
                });
            }
        }
    }
}
