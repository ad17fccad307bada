//! The master's state machine of one slave. It executes one small operation after the other (a register, a state, words
//! of the SII, a mailbox message) with at most one pending datagram. The sequence of operations is in [`steps`]; the
//! master decides in which frame a datagram is sent.

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
use crate::config::{MasterConfig, SlaveSpec, Timeouts};
use crate::{AlState, AlStatus, AlStatusCode};

pub use info::{Port as PortState, SlaveInfo};
use jobs::{JOBS_MAX, OWN};
use mailbox::Mailbox;
use operation::Op;
pub(super) use steps::Step;
pub use watch::PortCounters;

/// A datagram that a slave's state machine requests.
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

/// The result of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer<'a> {
    /// Its frame was lost.
    Lost,
    /// It returned.
    Data { counter: u16, data: &'a [u8] },
}

/// What a slave's state machine knows of the segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Context<'a> {
    pub(super) now: Duration,
    /// When the frame of this answer was sent.
    pub(super) sent_at: Duration,
    /// System time of the reference clock as the frame of this answer passed it, ns.
    pub(super) reference_ns: Option<u64>,
    /// The slave whose clock is the reference.
    pub(super) reference: Option<usize>,
    pub(super) config: &'a MasterConfig,
    pub(super) image: &'a Image,
}

impl Context<'_> {
    /// Capacity of a mailbox datagram, beside the image if that is exchanged, bytes.
    fn mailbox_capacity(&self) -> usize {
        if self.config.goal == AlState::PreOp {
            Image::default().mailbox_capacity()
        } else {
            self.image.mailbox_capacity()
        }
    }
}

/// The purpose of a pending datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Pending {
    /// No pending datagram.
    #[default]
    Nothing,
    Operation,
    Mailbox,
    Watch,
    /// For an operation that was aborted.
    Past,
}

/// The step up to which a slave may proceed by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Gate {
    /// Until it is identified.
    #[default]
    Identity,
    /// Until its process data is known.
    Process,
    /// Up to its goal.
    Goal,
}

/// The clock of a slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct UnitClock {
    /// Receive times of its ports, as latched at start, ns of local time.
    pub(super) times: [u32; 4],
    /// The receive times were read.
    pub(super) latched: bool,
    /// Propagation delay from the reference, ns.
    pub(super) delay_ns: u32,
    /// Offset added to its local time, ns.
    offset: u64,
    /// System time difference as last read, ns; positive is ahead.
    pub(super) difference_ns: Option<i32>,
    /// Differences beyond the window since it was locked.
    pub(super) violations: u64,
    /// Consecutive differences beyond the window.
    outside: u8,
    /// It follows the reference.
    pub(super) locked: bool,
    /// First SYNC0, system time, ns.
    pub(super) start_ns: Option<u64>,
}

impl UnitClock {
    /// A locked clock is outside of the window for longer than noise explains.
    pub(super) const fn is_lost(&self) -> bool {
        self.outside >= OUTSIDE
    }
}

/// Consecutive differences beyond the window after which a clock is reported as lost.
const OUTSIDE: u8 = 3;
/// Firmware that shows OP may still be enabling its SyncManagers; after this time its working counter must be complete.
const COUNT_GRACE: Duration = Duration::from_millis(100);
/// Longest write to registers, bytes.
const WRITE_MAX: usize = 256;

/// A slave.
#[derive(Debug)]
pub(super) struct Unit {
    pub(super) number: usize,
    pub(super) station: u16,
    /// Position in the ring; `None` while it is offline.
    pub(super) position: Option<u16>,
    pub(super) spec: SlaveSpec,
    pub(super) info: SlaveInfo,
    pub(super) process: ProcessData,
    /// The process data is known and has a region in the image.
    pub(super) mapped: bool,
    pub(super) gate: Gate,
    step: Step,
    op: Op,
    since: Duration,
    misses: u8,
    /// The purpose of the pending datagram.
    waiting: Pending,
    /// The purpose of the datagram that was last offered.
    offered: Pending,
    write: [u8; WRITE_MAX],
    write_len: usize,
    sii: Vec<u8>,
    assignments: Vec<Assignment>,
    /// The first assignment that was refused; whether it matters shows when the PDOs are read back.
    refused: Option<Fault>,
    learn: learn::Learn,
    /// Buffer for the transfers of the steps.
    scratch: Vec<u8>,
    mailbox: Mailbox,
    jobs: VecDeque<Job>,
    /// A register job, while its operation runs.
    job: Option<Job>,
    /// Interpreted AL status, and its code.
    pub(super) al: AlStatus,
    pub(super) code: AlStatusCode,
    /// The lower five bits of AL status as read, for the census.
    pub(super) shown: u8,
    /// SII status as last read.
    sii_status: u16,
    pub(super) fault: Option<Fault>,
    failures: u8,
    again: Duration,
    /// Time at which it last reached its goal.
    reached_at: Duration,
    /// The working counter was complete since then.
    counted: bool,
    /// It has reached its goal and holds its set-up.
    set_up: bool,
    /// Its SII was read.
    pub(super) known: bool,
    /// Consecutive good answers.
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
            waiting: Pending::Nothing,
            offered: Pending::Nothing,
            write: [0; WRITE_MAX],
            write_len: 0,
            sii: Vec::new(),
            assignments: Vec::new(),
            refused: None,
            learn: learn::Learn::default(),
            scratch: Vec::with_capacity(longest.max(16)),
            mailbox: Mailbox::new(spec.timeouts.unwrap_or(config.timeouts)),
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

    /// Its timeouts.
    fn timeouts(&self, config: &MasterConfig) -> Timeouts {
        self.spec.timeouts.unwrap_or(config.timeouts)
    }

    /// Assigns a detected slave to its entry in the configuration.
    pub(super) fn assign(&mut self, number: usize, spec: SlaveSpec) {
        let longest = spec
            .startup
            .iter()
            .map(|sdo| sdo.data.len())
            .max()
            .unwrap_or(0);
        self.scratch = Vec::with_capacity(longest.max(16));
        if let Some(timeouts) = spec.timeouts {
            self.mailbox.set_timeouts(timeouts);
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

    /// The state to bring it to.
    pub(super) fn goal(&self, config: &MasterConfig) -> AlState {
        if config.goal.raw() < self.spec.goal.raw() {
            config.goal
        } else {
            self.spec.goal
        }
    }

    /// Longest datagram of its mailbox, bytes; zero without a mailbox.
    pub(super) fn mailbox_size(&self) -> usize {
        self.mailbox.size()
    }

    /// It failed more than once, so that others do not wait for it.
    pub(super) const fn has_failed(&self) -> bool {
        matches!(self.step, Step::Failed) && self.failures >= 2
    }

    pub(super) const fn is_running(&self) -> bool {
        matches!(self.step, Step::Run)
    }

    /// What its process data adds to the working counter of LRW, by its state: minimum and maximum.
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
            // During a state change a slave switches its SyncManagers at any time, and an unreachable one may still
            // take part with its old FMMUs. Other slaves must not suffer from that.
            (0, most)
        }
    }

    /// The working counter of its group was complete: from now on its share is required.
    pub(super) const fn take_part(&mut self) {
        self.counted = self.is_running();
    }

    /// A slave is present and starts from INIT.
    pub(super) fn begin(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        self.fault = None;
        self.enter(Step::Init, cx, out);
    }

    /// It answers again; the next step depends on its state.
    pub(super) fn returned(&mut self, position: u16, cx: &Context<'_>, out: &mut Outbox) {
        self.position = Some(position);
        out.event(Event::Returned { slave: self.number });
        self.enter(Step::Check, cx, out);
    }

    /// It is lost.
    pub(super) fn lose(&mut self, out: &mut Outbox) {
        self.position = None;
        self.show(0, AlStatusCode::default());
        (self.clock.locked, self.clock.outside) = (false, 0);
        (self.step, self.op, self.waiting) = (Step::Absent, Op::Rest, Pending::Nothing);
        self.fault = Some(Fault::Lost);
        out.event(Event::Fault {
            slave: self.number,
            fault: Fault::Lost,
        });
        self.abandon(out);
    }

    /// A different slave appeared in its position.
    pub(super) fn release(&mut self) {
        self.position = None;
        self.show(0, AlStatusCode::default());
        (self.step, self.op, self.waiting) = (Step::Absent, Op::Rest, Pending::Nothing);
    }

    /// It failed to reach its goal.
    pub(super) fn fail(&mut self, fault: Fault, cx: &Context<'_>, out: &mut Outbox) {
        if matches!(self.step, Step::Run)
            && cx.now.saturating_sub(self.reached_at) > Duration::from_secs(1)
        {
            self.failures = 0;
        }
        let wait = self.timeouts(cx.config).again * (1 << self.failures.min(5));
        self.failures = self.failures.saturating_add(1);
        self.again = cx.now + wait;
        // A repeated fault is reported once.
        if self.fault != Some(fault) {
            out.event(Event::Fault {
                slave: self.number,
                fault,
            });
        }
        self.fault = Some(fault);
        (self.step, self.op, self.since) = (Step::Failed, Op::Rest, cx.now);
        // Its operation is aborted, so that the retry does not wait for it.
        if let Some(job) = self.job.take() {
            self.give_back(job, Err(JobError::Absent), out);
        }
    }

    /// Handles its state as the census or an inspection read it.
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

    /// Handles timeouts; called before each frame.
    pub(super) fn poll(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        if !self.is_present() {
            return;
        }
        if matches!(self.step, Step::Failed) && cx.now >= self.again && self.job.is_none() {
            self.enter(Step::Check, cx, out);
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

    /// Whether no operation of the steps runs.
    fn is_at_rest(&self) -> bool {
        matches!(
            self.step,
            Step::Run | Step::Failed | Step::Identified | Step::Configured
        ) && self.op == Op::Rest
    }

    /// Whether a datagram other than one of the watch is due.
    pub(super) fn is_busy(&self) -> bool {
        self.waiting == Pending::Nothing
            && self.is_present()
            && (self.op != Op::Rest || !self.mailbox.is_idle())
    }

    /// The next datagram, if none is pending: of an operation, of the mailbox or, in its turn, of the watch.
    pub(super) fn request(&mut self, watch: bool) -> Option<Request<'_>> {
        if self.waiting != Pending::Nothing || !self.is_present() {
            return None;
        }
        if !matches!(self.op, Op::Rest | Op::Mailbox) {
            self.offered = Pending::Operation;
            return self.operation_request();
        }
        if self.mailbox.request().is_some() {
            self.offered = Pending::Mailbox;
            return self.mailbox.request();
        }
        if watch && self.is_running() {
            self.offered = Pending::Watch;
            return self
                .watch
                .request(self.mailbox.exists(), self.info.has_clock());
        }
        None
    }

    /// The offered datagram was put into a frame.
    pub(super) const fn sent(&mut self) {
        self.waiting = self.offered;
    }

    /// Handles the result of the pending datagram.
    pub(super) fn handle(&mut self, answer: Answer<'_>, cx: &Context<'_>, out: &mut Outbox) {
        match std::mem::take(&mut self.waiting) {
            Pending::Nothing | Pending::Past => {}
            Pending::Operation => self.operation_answer(answer, cx, out),
            Pending::Watch => self.watched(answer, cx, out),
            Pending::Mailbox => {
                if let Some(output) = self.mailbox.answer(answer, cx.now) {
                    self.handle_mailbox(output, cx, out);
                }
            }
        }
    }

    fn watched(&mut self, answer: Answer<'_>, cx: &Context<'_>, out: &mut Outbox) {
        let found = self.watch.answer(answer);
        if found.mailbox_full {
            self.mailbox.check_full(true, cx.now);
        }
        if let Some(difference) = found.difference_ns {
            let is_reference = cx.reference == Some(self.number);
            let difference = if is_reference { 0 } else { difference };
            self.judge_clock(difference, cx, out);
        }
    }

    /// A locked clock that is outside of the window three times in a row is reported once. The slave itself leaves OP
    /// when it cannot continue.
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
