//! The master's state machine of one slave. It executes one small operation after the other (a register, a state, words
//! of the SII, a mailbox message) with at most one pending datagram. The sequence of operations is in [`steps`]; the
//! master decides in which frame a datagram is sent.

mod clock;
mod datagram;
mod ethernet;
mod file;
mod identity;
mod info;
mod jobs;
mod learn;
mod local_clock;
mod mailbox;
mod objects;
mod op;
mod operation;
mod queue;
mod recovery;
mod start;
mod status;
mod steps;
mod transfer;
mod watch;

use std::time::Duration;

use super::event::{Event, Fault, Outbox};
use super::process::ProcessData;
use crate::config::{MasterConfig, SlaveSpec, Timeouts};
use crate::{AlState, AlStatusCode};
use datagram::{Pending, Turn};
use local_clock::{ClockChange, UnitClock};
use mailbox::Mailbox;
use op::{Op, Operation};
use queue::Jobs;
use recovery::Recovery;
use start::Start;
use status::Status;

pub(super) use datagram::{Answer, Context, Request};
pub use ethernet::EthernetCounters;
pub use info::{Port as PortState, SlaveInfo};
pub(super) use start::{Gate, Step};
pub use watch::PortCounters;

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
    start: Start,
    operation: Operation,
    turn: Turn,
    mailbox: Mailbox,
    jobs: Jobs,
    pub(super) status: Status,
    pub(super) recovery: Recovery,
    pub(super) clock: UnitClock,
    watch: watch::Watch,
}

impl Unit {
    pub(super) fn new(number: usize, station: u16, spec: SlaveSpec, config: &MasterConfig) -> Self {
        let mut mailbox = Mailbox::new(spec.timeouts.unwrap_or(config.timeouts));
        mailbox.set_ethernet(spec.ethernet);
        Self {
            number,
            station,
            position: None,
            info: SlaveInfo::default(),
            process: ProcessData::default(),
            mapped: false,
            gate: Gate::Identity,
            start: Start::default(),
            operation: Operation::default(),
            turn: Turn::default(),
            mailbox,
            jobs: Jobs::new(&spec),
            status: Status::default(),
            recovery: Recovery::default(),
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
        self.jobs.scratch = Jobs::buffer(&spec);
        if let Some(timeouts) = spec.timeouts {
            self.mailbox.set_timeouts(timeouts);
        }
        self.mailbox.set_ethernet(spec.ethernet);
        (self.number, self.spec) = (number, spec);
    }

    pub(super) const fn step(&self) -> Step {
        self.start.step
    }

    pub(super) const fn counters(&self) -> &PortCounters {
        self.watch.counters()
    }

    pub(super) fn is_present(&self) -> bool {
        self.position.is_some()
    }

    /// The state to bring it to.
    pub(super) fn goal(&self, config: &MasterConfig) -> AlState {
        let own = self.spec.goal;
        if self.is_apart() || own.raw() <= config.goal.raw() {
            own
        } else {
            config.goal
        }
    }

    /// Whether it is held in INIT or BOOT, apart from the process data of the segment.
    pub(super) const fn is_apart(&self) -> bool {
        matches!(self.spec.goal, AlState::Init | AlState::Boot)
    }

    /// Whether process data and clocks are set up.
    pub(super) fn goes_on(&self, config: &MasterConfig) -> bool {
        matches!(self.goal(config), AlState::SafeOp | AlState::Op)
    }

    /// Longest datagram of its mailbox, bytes; zero without a mailbox.
    pub(super) fn mailbox_size(&self) -> usize {
        self.mailbox.size()
    }

    /// It failed more than once, so that others do not wait for it.
    pub(super) const fn has_failed(&self) -> bool {
        matches!(self.start.step, Step::Failed) && self.recovery.failures >= 2
    }

    pub(super) const fn is_running(&self) -> bool {
        matches!(self.start.step, Step::Run)
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
        let settled = self.recovery.is_settled(now);
        let is_up =
            self.is_running() && self.status.al.state == AlState::Op && !self.status.al.error;
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
        self.recovery.counted = self.is_running();
    }

    /// A slave is present and starts from INIT.
    pub(super) fn begin(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        self.recovery.fault = None;
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
        self.clock.unlock();
        self.rest();
        self.recovery.fault = Some(Fault::Lost);
        out.event(Event::Fault {
            slave: self.number,
            fault: Fault::Lost,
        });
        self.abandon(out);
    }

    /// Nothing runs, and no datagram is pending.
    fn rest(&mut self) {
        (self.start.step, self.operation.op) = (Step::Absent, Op::Rest);
        self.turn = Turn::default();
    }

    /// Handles AL status as read.
    fn show(&mut self, status: u16, code: AlStatusCode) {
        self.status.show(status, code, self.info.mirrors());
    }

    /// Whether its SII was read.
    pub(super) const fn is_known(&self) -> bool {
        self.start.known
    }

    /// A different slave appeared in its position.
    pub(super) fn release(&mut self) {
        self.position = None;
        self.show(0, AlStatusCode::default());
        self.rest();
    }

    /// It failed to reach its goal.
    pub(super) fn fail(&mut self, fault: Fault, cx: &Context<'_>, out: &mut Outbox) {
        let wait = self.timeouts(cx.config).again;
        // A repeated fault is reported once.
        if self.recovery.fail(fault, self.is_running(), wait, cx.now) {
            out.event(Event::Fault {
                slave: self.number,
                fault,
            });
        }
        (self.start.step, self.operation.op, self.operation.since) =
            (Step::Failed, Op::Rest, cx.now);
        // Its operation is aborted, so that the retry does not wait for it.
        self.jobs.abort_current(out);
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
        let al = self.status.al;
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
        if matches!(self.start.step, Step::Failed)
            && cx.now >= self.recovery.again
            && self.jobs.current.is_none()
        {
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
            self.start.step,
            Step::Run | Step::Failed | Step::Identified | Step::Configured
        ) && self.operation.is_at_rest()
    }

    /// Whether a datagram other than one of the watch is due.
    pub(super) fn is_busy(&self) -> bool {
        self.turn.is_free()
            && self.is_present()
            && (!self.operation.is_at_rest() || !self.mailbox.is_idle())
    }

    /// The next datagram, if none is pending: of an operation, of the mailbox or, in its turn, of the watch.
    pub(super) fn request(&mut self, watch: bool) -> Option<Request<'_>> {
        if !self.turn.is_free() || !self.is_present() {
            return None;
        }
        if !matches!(self.operation.op, Op::Rest | Op::Mailbox) {
            self.turn.offer(Pending::Operation);
            return self.operation_request();
        }
        if self.mailbox.request().is_some() {
            self.turn.offer(Pending::Mailbox);
            return self.mailbox.request();
        }
        if watch && self.is_running() {
            self.turn.offer(Pending::Watch);
            return self.watch.request(
                self.mailbox.exists(),
                self.mailbox.has_ethernet(),
                self.info.has_clock(),
            );
        }
        None
    }

    /// The offered datagram was put into a frame.
    pub(super) const fn sent(&mut self) {
        self.turn.sent();
    }

    /// Handles the result of the pending datagram.
    pub(super) fn handle(&mut self, answer: Answer<'_>, cx: &Context<'_>, out: &mut Outbox) {
        match self.turn.take() {
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

    /// A clock that is lost is reported once. The slave itself leaves OP when it cannot continue.
    fn judge_clock(&mut self, difference_ns: i32, cx: &Context<'_>, out: &mut Outbox) {
        let slave = self.number;
        match self.clock.judge(difference_ns, cx.config.clocks.window_ns) {
            None => {}
            Some(ClockChange::Back) => out.event(Event::ClockBack { slave }),
            Some(ClockChange::Lost) => out.event(Event::ClockLost {
                slave,
                difference_ns,
            }),
        }
    }
}
