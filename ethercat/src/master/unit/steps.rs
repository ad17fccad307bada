//! What follows on what in bringing a slave up, the first time and whenever it comes back. The order is that of
//! ETG.1000.6, clause 6.4.1: what a state needs is written in the state before.
//!
//! ```text
//! 1 Init                   INIT acknowledged, registers and SII read        -> Identified (gate 1: who is it?)
//! 2 Identified             port times, FMMUs and SyncManagers cleared, mailboxes set up, PRE-OP, start-up objects,
//!                          PDOs assigned, mapping read back                 -> Configured (gate 2: process image)
//! 3 Configured             watchdog, SyncManagers, FMMUs, clock, SYNC0, SAFE-OP, OP            -> Run
//! 4 Run, any               fault, working counter 0, time-out (fail)        -> Failed
//! 5 Failed, Absent         time to try again, answers again (returned)      -> Look
//! 6 Look                   set up still: OP, or PRE-OP for SYNC0 (Fallback) -> 3; else 1
//! ```

use takt_cia402::dictionary::Address;

use super::super::compare;
use super::super::event::{Event, Fault, JobError, Outbox};
use super::super::job::{Job, JobKind};
use super::transfer::Transfer;
use super::watch::difference;
use super::{Context, Gate, OWN, Op, Unit, info, learn};
use crate::coe::Whole;
use crate::config::Unlocked;
use crate::register;
use crate::sii::{self, Sii};
use crate::{AlState, dc};

/// A step of the way up. What each does is in [`Unit::prepare`], what follows from its answer in [`Unit::advance`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::master) enum Step {
    Absent,
    Init,
    Information,
    Links,
    SiiForce,
    SiiTake,
    SiiRead,
    Identified,
    ReceiveTimes,
    ClearFmmus,
    ClearSyncManagers,
    ClearSync,
    Mailboxes,
    PreOp,
    Startup(u16),
    Assign(u16),
    Learn(u8),
    Configured,
    Watchdog,
    Channel(u8),
    Map(u8),
    ClockWait,
    ClockReset,
    ClockRead,
    ClockOffset,
    ClockGain,
    ClockFilter,
    ClockLock,
    SyncStart,
    SyncCycle,
    SyncOn,
    SafeOp,
    Op,
    Run,
    Failed,
    Look,
    Fallback,
}

/// What a step begins with.
enum Prepared {
    Do(Op),
    Transfer(Transfer),
    /// Nothing to do: the next one.
    Skip,
    /// Something is missing that comes by itself.
    Wait,
    Fail(Fault),
}

/// Differences within the window in a row before a clock counts as locked.
const LOCKED: u8 = 16;
/// Loop gain of a clock (0930h) and its filter depths (0934h), as all masters write them.
const SPEED_START: [u8; 2] = 0x1000_u16.to_le_bytes();
const FILTERS: [u8; 2] = [0x00, 0x0C];
/// FMMUs and SyncManagers that are cleared at once, at most.
const BLOCKS_MAX: u8 = 16;

impl Unit {
    /// Goes to a step, and on from it as long as there is nothing to do.
    pub(super) fn enter(&mut self, step: Step, cx: &Context<'_>, out: &mut Outbox) {
        if self.waiting != super::Asked::Nothing {
            self.waiting = super::Asked::Past;
        }
        let mut step = step;
        loop {
            (self.step, self.op) = (step, Op::Rest);
            (self.since, self.misses, self.streak) = (cx.now, 0, 0);
            match self.prepare(step, cx, out) {
                Prepared::Do(op) => {
                    self.op = op;
                    return;
                }
                Prepared::Transfer(transfer) => {
                    self.op = Op::Mailbox;
                    let kind = JobKind::Upload {
                        address: Address::default(),
                        whole: Whole::Entry,
                    };
                    if let Some(output) = self.mailbox.begin(transfer, kind, cx.now) {
                        self.handle_mailbox(output, cx, out);
                    }
                    return;
                }
                Prepared::Skip => step = self.following(step),
                Prepared::Wait => return,
                Prepared::Fail(fault) => return self.fail(fault, cx, out),
            }
        }
    }

    /// Passes what it was waiting at, if that is open now.
    pub(super) fn pass_gate(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        if self.op != Op::Rest || self.job.is_some() {
            return;
        }
        match self.step {
            Step::Identified if self.gate >= Gate::Process => {
                self.enter(Step::ReceiveTimes, cx, out)
            }
            Step::Configured if self.gate >= Gate::Goal => self.enter(Step::Watchdog, cx, out),
            Step::ClockWait | Step::SyncStart => self.enter(self.step, cx, out),
            _ => {}
        }
    }

    fn following(&self, step: Step) -> Step {
        let more = |at: usize, len: usize| at + 1 < len;
        match step {
            Step::Init => Step::Information,
            Step::Information => Step::Links,
            Step::Links => Step::SiiForce,
            Step::SiiForce => Step::SiiTake,
            Step::SiiTake => Step::SiiRead,
            Step::SiiRead => Step::Identified,
            Step::Identified => Step::ReceiveTimes,
            Step::ReceiveTimes => Step::ClearFmmus,
            Step::ClearFmmus => Step::ClearSyncManagers,
            Step::ClearSyncManagers => Step::ClearSync,
            Step::ClearSync => Step::Mailboxes,
            Step::Mailboxes => Step::PreOp,
            Step::PreOp => Step::Startup(0),
            Step::Startup(at) if more(at.into(), self.spec.startup.len()) => Step::Startup(at + 1),
            Step::Startup(_) => Step::Assign(0),
            Step::Assign(at) if more(at.into(), self.assignments.len()) => Step::Assign(at + 1),
            Step::Assign(_) => Step::Learn(0),
            Step::Learn(at) if more(at.into(), self.process.channels.len()) => Step::Learn(at + 1),
            Step::Learn(_) => Step::Configured,
            Step::Configured | Step::Fallback => Step::Watchdog,
            Step::Watchdog => Step::Channel(0),
            Step::Channel(at) if more(at.into(), self.process.channels.len()) => {
                Step::Channel(at + 1)
            }
            Step::Channel(_) => Step::Map(0),
            Step::Map(at) if more(at.into(), self.process.channels.len()) => Step::Map(at + 1),
            Step::Map(_) => Step::ClockWait,
            Step::ClockWait => Step::ClockReset,
            Step::ClockReset => Step::ClockRead,
            Step::ClockRead => Step::ClockOffset,
            Step::ClockOffset => Step::ClockGain,
            Step::ClockGain => Step::ClockFilter,
            Step::ClockFilter => Step::ClockLock,
            Step::ClockLock => Step::SyncStart,
            Step::SyncStart => Step::SyncCycle,
            Step::SyncCycle => Step::SyncOn,
            Step::SyncOn => Step::SafeOp,
            Step::SafeOp => Step::Op,
            Step::Op | Step::Run => Step::Run,
            Step::Look => Step::Init,
            Step::Absent => Step::Absent,
            Step::Failed => Step::Failed,
        }
    }

    fn prepare(&mut self, step: Step, cx: &Context<'_>, out: &mut Outbox) -> Prepared {
        use Prepared::{Do, Skip, Wait};
        let goes_on = self.goal(cx.config) != AlState::PreOp;
        match step {
            Step::Absent | Step::Failed => Wait,
            Step::Init => {
                if let Some(transfer) = self.mailbox.reset() {
                    self.give_back(transfer.into_job(), Err(JobError::Absent), out);
                }
                self.set_up = false;
                Do(self.change_state(AlState::Init))
            }
            Step::Information => Do(Op::Read {
                at: register::INFORMATION,
                len: 10,
            }),
            Step::Links => Do(Op::Read {
                at: register::DL_STATUS,
                len: 2,
            }),
            Step::SiiForce => Do(self.write(register::SII_ACCESS, &[2])),
            Step::SiiTake => Do(self.write(register::SII_ACCESS, &[0])),
            Step::SiiRead => Do(self.read_sii()),
            Step::Identified if self.gate == Gate::Identity => Wait,
            Step::Identified => Skip,
            Step::ReceiveTimes if self.mapped || !self.info.has_clock() => Skip,
            Step::ReceiveTimes => Do(Op::Read {
                at: register::DC_RECEIVE_TIMES,
                len: 16,
            }),
            Step::ClearFmmus => self.clear(register::FMMU, 16, self.info.fmmus),
            Step::ClearSyncManagers => {
                self.clear(register::SYNC_MANAGER, 8, self.info.sync_managers)
            }
            Step::ClearSync if self.info.has_clock() => {
                Do(self.write(register::DC_ACTIVATION, &[0]))
            }
            Step::ClearSync => Skip,
            Step::Mailboxes if self.mailbox.exists() => {
                let bytes = self.mailbox.sync_managers();
                Do(self.write(register::SYNC_MANAGER, &bytes))
            }
            Step::Mailboxes => Skip,
            Step::PreOp | Step::Fallback => Do(self.change_state(AlState::PreOp)),
            Step::Startup(at) => self.startup(at.into()),
            Step::Assign(at) => self.assignment(at.into()),
            Step::Learn(at) => self.ask(at.into()),
            Step::Configured => self.configured(cx),
            Step::Watchdog if !goes_on => self.run(cx, out),
            Step::Watchdog => self.watchdog(),
            Step::Channel(at) => self.channel(at.into()),
            Step::Map(at) => self.map(at.into(), cx),
            Step::ClockWait => self.clock_wait(cx),
            Step::ClockReset | Step::ClockOffset if !self.follows(cx) => Skip,
            Step::ClockReset => {
                self.clock.offset = 0;
                Do(self.write_clock())
            }
            Step::ClockOffset => Do(self.write_clock()),
            Step::ClockRead | Step::ClockGain | Step::ClockFilter if !self.follows(cx) => Skip,
            Step::ClockRead => Do(Op::Read {
                at: register::DC_SYSTEM_TIME,
                len: 8,
            }),
            Step::ClockGain => Do(self.write(register::DC_SPEED_START, &SPEED_START)),
            Step::ClockFilter => Do(self.write(register::DC_FILTERS, &FILTERS)),
            Step::ClockLock => self.lock(cx),
            Step::SyncStart => self.sync_start(cx),
            Step::SyncCycle | Step::SyncOn => self.sync(step),
            Step::SafeOp => Do(self.change_state(AlState::SafeOp)),
            Step::Op if self.goal(cx.config) == AlState::SafeOp => self.run(cx, out),
            Step::Op => Do(self.change_state(AlState::Op)),
            Step::Run => self.run(cx, out),
            Step::Look => Do(Op::Read {
                at: register::AL_STATUS,
                len: 6,
            }),
        }
    }

    fn run(&mut self, cx: &Context<'_>, out: &mut Outbox) -> Prepared {
        (self.step, self.reached_at, self.set_up) = (Step::Run, cx.now, true);
        self.fault = None;
        out.event(Event::Reached {
            slave: self.number,
            state: self.al.state,
        });
        Prepared::Wait
    }

    /// The whole SII the first time, and who it is whenever it comes back.
    fn read_sii(&mut self) -> Op {
        self.sii.clear();
        let (word, end) = if self.known {
            (sii::word::IDENTITY, sii::word::IDENTITY + 8)
        } else {
            (0, 0x42)
        };
        Op::Sii {
            word,
            end,
            polls: false,
            writes: false,
        }
    }

    fn clear(&mut self, at: u16, size: u16, count: u8) -> Prepared {
        let len = size * u16::from(count.min(BLOCKS_MAX));
        if len == 0 {
            return Prepared::Skip;
        }
        let zeros = [0; super::WRITE_MAX];
        Prepared::Do(self.write(at, zeros.get(..len.into()).unwrap_or_default()))
    }

    /// A transfer of this step, in the memory that is kept for them.
    fn own(&mut self, kind: JobKind) -> Prepared {
        let data = std::mem::take(&mut self.scratch);
        let job = Job {
            slave: OWN,
            kind,
            data,
            token: 0,
        };
        Prepared::Transfer(Transfer::new(job))
    }

    fn startup(&mut self, at: usize) -> Prepared {
        let Some(sdo) = self.spec.startup.get(at) else {
            return Prepared::Skip;
        };
        let (address, whole) = (sdo.address, sdo.whole);
        self.scratch.clear();
        self.scratch.extend_from_slice(&sdo.data);
        self.own(JobKind::Download { address, whole })
    }

    fn assignment(&mut self, at: usize) -> Prepared {
        let Some(assignment) = self.assignments.get(at).filter(|_| self.refused.is_none()) else {
            return Prepared::Skip;
        };
        let address = assignment.address;
        self.scratch.clear();
        assignment.bytes(&mut self.scratch);
        self.own(JobKind::Download {
            address,
            whole: Whole::Entry,
        })
    }

    /// Asks which PDOs a SyncManager has; a slave without CoE has those of its SII, and one that comes back those
    /// that it had.
    fn ask(&mut self, at: usize) -> Prepared {
        let Some(channel) = self.process.channels.get(at) else {
            return Prepared::Skip;
        };
        if self.mapped || !self.mailbox.speaks_coe() {
            return Prepared::Skip;
        }
        self.learn = learn::Learn::new(channel.assignment());
        self.next_question().unwrap_or(Prepared::Skip)
    }

    fn next_question(&mut self) -> Option<Prepared> {
        let address = self.learn.question()?;
        self.scratch.clear();
        Some(self.own(JobKind::Upload {
            address,
            whole: Whole::Entry,
        }))
    }

    fn configured(&mut self, cx: &Context<'_>) -> Prepared {
        if !self.mapped
            && let Err(fault) = self.process.check()
        {
            return Prepared::Fail(fault);
        }
        let lens = (self.process.outputs_len(), self.process.inputs_len());
        if self.gate == Gate::Goal && !cx.image.has_room(self.number, lens) {
            return Prepared::Fail(Fault::NoRoom);
        }
        self.mapped = true;
        if self.gate == Gate::Goal {
            Prepared::Skip
        } else {
            Prepared::Wait
        }
    }

    fn watchdog(&mut self) -> Prepared {
        let Some(time) = self.spec.watchdog else {
            return Prepared::Skip;
        };
        // In units of the divider as the slave has it from the factory: 100 us.
        let units = u16::try_from(time.as_micros() / 100).unwrap_or(u16::MAX);
        Prepared::Do(self.write(register::WATCHDOG_PROCESS_DATA, &units.to_le_bytes()))
    }

    fn channel(&mut self, at: usize) -> Prepared {
        let Some(channel) = self.process.channels.get(at) else {
            return Prepared::Skip;
        };
        let block = channel.sync_manager().encode();
        let at = register::SYNC_MANAGER + 8 * u16::from(channel.number);
        Prepared::Do(self.write(at, &block))
    }

    fn map(&mut self, at: usize, cx: &Context<'_>) -> Prepared {
        let Some(channel) = self
            .process
            .channels
            .get(at)
            .filter(|channel| !channel.is_empty())
        else {
            return Prepared::Skip;
        };
        let before = || self.process.channels.iter().take(at);
        let offset: usize = before()
            .filter(|c| c.outputs == channel.outputs)
            .map(|c| c.len())
            .sum();
        let base = cx.image.logical(self.number, channel.outputs);
        let (Some(base), Ok(offset)) = (base, u32::try_from(offset)) else {
            return Prepared::Fail(Fault::NoRoom);
        };
        let number = before().filter(|channel| !channel.is_empty()).count();
        let block = channel.fmmu(base + offset).encode();
        let at = register::FMMU + 16 * u16::try_from(number).unwrap_or(0);
        Prepared::Do(self.write(at, &block))
    }

    /// Whether its clock is part of the segment's.
    fn follows(&self, cx: &Context<'_>) -> bool {
        self.info.has_clock() && cx.reference.is_some()
    }

    /// All but the reference wait for the reference.
    fn clock_wait(&self, cx: &Context<'_>) -> Prepared {
        if self.spec.sync.is_some() && !self.info.has_sync() {
            return Prepared::Fail(Fault::NoClock);
        }
        let first = cx.reference == Some(self.number) || cx.reference_ns.is_some();
        if first || !self.follows(cx) {
            Prepared::Skip
        } else {
            Prepared::Wait
        }
    }

    fn write_clock(&mut self) -> Op {
        let mut bytes = [0; 12];
        let (offset, delay) = bytes.split_at_mut(8);
        offset.copy_from_slice(&self.clock.offset.to_le_bytes());
        delay.copy_from_slice(&self.clock.delay_ns.to_le_bytes());
        self.write(register::DC_OFFSET, &bytes)
    }

    fn lock(&mut self, cx: &Context<'_>) -> Prepared {
        if cx.reference == Some(self.number) && self.follows(cx) {
            self.clock.locked = true;
            return Prepared::Skip;
        }
        if self.spec.sync.is_none() || !self.follows(cx) {
            return Prepared::Skip;
        }
        Prepared::Do(Op::Read {
            at: register::DC_DIFFERENCE,
            len: 4,
        })
    }

    fn sync_start(&mut self, cx: &Context<'_>) -> Prepared {
        let Some(sync) = self.spec.sync.filter(|_| self.follows(cx)) else {
            return Prepared::Skip;
        };
        let Some(now) = cx.reference_ns else {
            return Prepared::Wait;
        };
        let start = dc::start_time(now, cx.config.clocks.lead, sync.sync0, sync.shift_ns);
        self.clock.start_ns = Some(start);
        Prepared::Do(self.write(register::DC_START_TIME, &start.to_le_bytes()))
    }

    fn sync(&mut self, step: Step) -> Prepared {
        let Some(sync) = self.spec.sync.filter(|_| self.clock.start_ns.is_some()) else {
            return Prepared::Skip;
        };
        if step == Step::SyncOn {
            return Prepared::Do(
                self.write(register::DC_CONTROL, &sync.assign_activate.to_le_bytes()),
            );
        }
        let ns = |time: std::time::Duration| {
            u32::try_from(time.as_nanos())
                .unwrap_or(u32::MAX)
                .to_le_bytes()
        };
        let mut bytes = [0; 8];
        let (sync0, sync1) = bytes.split_at_mut(4);
        sync0.copy_from_slice(&ns(sync.sync0));
        sync1.copy_from_slice(&ns(sync.sync1));
        Prepared::Do(self.write(register::DC_SYNC0_CYCLE, &bytes))
    }

    /// The operation of the step is done.
    pub(super) fn advance(&mut self, data: &[u8], cx: &Context<'_>, out: &mut Outbox) {
        match self.step {
            Step::Information => self.info.take_registers(data),
            Step::Links => {
                self.info.dl_status = data.first_chunk().map_or(0, |two| u16::from_le_bytes(*two))
            }
            Step::SiiRead => return self.sii_read(cx, out),
            Step::ReceiveTimes => self.take_times(data),
            Step::ClockRead => {
                if !self.take_offset(data, cx) {
                    return;
                }
            }
            Step::ClockLock => {
                if !self.take_difference(data, cx, out) {
                    return;
                }
            }
            Step::Look => return self.look(data, cx, out),
            _ => {}
        }
        self.enter(self.following(self.step), cx, out);
    }

    fn sii_read(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        if self.known {
            return self.recognise(cx, out);
        }
        let have = u16::try_from(self.sii.len() / 2).unwrap_or(u16::MAX);
        let need = info::words_needed(&self.sii).min(SII_WORDS_MAX);
        if have < need {
            self.op = Op::Sii {
                word: have,
                end: need,
                polls: false,
                writes: false,
            };
            return;
        }
        let bytes = std::mem::take(&mut self.sii);
        let sii = Sii::new(&bytes);
        self.info.take_sii(&sii);
        self.process = super::ProcessData::from_sii(&sii);
        self.mailbox.place(self.info.mailbox, self.info.protocols);
        self.sii = bytes;
        self.known = true;
        if self.gate == Gate::Identity {
            return self.enter(Step::Identified, cx, out);
        }
        self.came_later(cx, out);
    }

    /// An optional slave is there for the first time, and the segment runs.
    fn came_later(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let expected = (
            self.spec.vendor.unwrap_or(0),
            self.spec.product.unwrap_or(0),
        );
        let found = (self.info.identity.vendor, self.info.identity.product);
        if !compare::is_expected(&self.spec, &self.info) {
            self.known = false;
            return self.fail(Fault::Identity { expected, found }, cx, out);
        }
        self.plan(cx, out);
        self.gate = Gate::Goal;
        if self.step != Step::Failed {
            self.enter(Step::Identified, cx, out);
        }
    }

    /// It must be the one that it was.
    fn recognise(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let number = |at: usize| {
            let four = self.sii.get(at..).and_then(|rest| rest.first_chunk());
            four.map_or(0, |four| u32::from_le_bytes(*four))
        };
        let found = (number(0), number(4));
        let expected = (self.info.identity.vendor, self.info.identity.product);
        if found == expected {
            self.enter(Step::Identified, cx, out);
        } else {
            self.fail(Fault::Identity { expected, found }, cx, out);
        }
    }

    /// Its place in the configuration is known: what it is to exchange.
    pub(in crate::master) fn plan(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let bytes = std::mem::take(&mut self.sii);
        let planned = self.process.want(&self.spec, &Sii::new(&bytes));
        self.sii = bytes;
        self.assignments = if self.mailbox.speaks_coe() {
            self.process.assignments(&self.spec)
        } else {
            Vec::new()
        };
        self.gate = Gate::Process;
        if let Err(fault) = planned {
            self.fail(fault, cx, out);
        }
    }

    fn take_times(&mut self, data: &[u8]) {
        for (time, four) in self.clock.times.iter_mut().zip(data.chunks_exact(4)) {
            *time = four
                .first_chunk()
                .map_or(0, |four| u32::from_le_bytes(*four));
        }
    }

    /// What must be added to its time so that it shows the reference's; `false` if that is not known from this frame.
    fn take_offset(&mut self, data: &[u8], cx: &Context<'_>) -> bool {
        let local = data
            .first_chunk()
            .map_or(0, |eight| u64::from_le_bytes(*eight));
        let wanted = if cx.reference == Some(self.number) {
            let sent = u64::try_from(cx.sent_at.as_nanos()).unwrap_or(u64::MAX);
            cx.config.clocks.epoch_ns.wrapping_add(sent)
        } else if let Some(reference) = cx.reference_ns {
            reference.wrapping_add(self.clock.delay_ns.into())
        } else {
            return false;
        };
        self.clock.offset = wanted.wrapping_sub(local);
        true
    }

    /// Whether the clock is locked, or is not waited for any longer.
    fn take_difference(&mut self, data: &[u8], cx: &Context<'_>, out: &mut Outbox) -> bool {
        let found = data
            .first_chunk()
            .map_or(i32::MAX, |four| difference(*four));
        let window_ns = cx.config.clocks.window_ns;
        self.clock.difference_ns = Some(found);
        self.streak = if found.unsigned_abs() <= window_ns {
            self.streak + 1
        } else {
            0
        };
        if self.streak >= LOCKED {
            self.clock.locked = true;
            return true;
        }
        if cx.now.saturating_sub(self.since) <= cx.config.clocks.lock {
            return false;
        }
        match cx.config.clocks.unlocked {
            Unlocked::Start => true,
            Unlocked::Refuse => {
                self.fail(
                    Fault::Clock {
                        difference_ns: found,
                        window_ns,
                    },
                    cx,
                    out,
                );
                false
            }
        }
    }

    /// It is there again, or is to be tried again: how much of its set-up has it still?
    fn look(&mut self, data: &[u8], cx: &Context<'_>, out: &mut Outbox) {
        self.take_status(data);
        let kept = self.set_up && self.failures < 3;
        let step = match self.al.state {
            AlState::SafeOp | AlState::Op if kept && self.goal(cx.config) != AlState::PreOp => {
                // Its clock ran on, and all others are to follow it again.
                self.clock.locked |= cx.reference == Some(self.number);
                // SYNC0 is begun anew: while it was away its clock ran by itself.
                if self.spec.sync.is_some() {
                    Step::Fallback
                } else {
                    Step::SafeOp
                }
            }
            AlState::SafeOp
            | AlState::Op
            | AlState::Init
            | AlState::PreOp
            | AlState::Boot
            | AlState::Other(_) => Step::Init,
        };
        self.enter(step, cx, out);
    }

    /// A transfer of this step is over.
    pub(super) fn transfer_done(
        &mut self,
        address: Address,
        result: Result<(), JobError>,
        cx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let fault = result.err().map(|error| match error {
            JobError::Abort(code) => Fault::Abort { address, code },
            error => Fault::Mailbox { address, error },
        });
        match (self.step, fault) {
            (Step::Learn(at), None) => self.learnt(at.into(), cx, out),
            // No such list: the slave has what its SII says.
            (Step::Learn(at), Some(Fault::Abort { .. })) if self.learn.is_at_list() => {
                self.verify(at.into(), cx, out);
            }
            (Step::Startup(at), Some(_)) if self.may_fail(at.into()) => {
                self.enter(self.following(self.step), cx, out);
            }
            // It may have what is wanted all the same; that is seen when it is read back.
            (Step::Assign(_), Some(fault @ Fault::Abort { .. })) if self.accepts_refusal() => {
                self.refused = Some(fault);
                self.enter(Step::Learn(0), cx, out);
            }
            (_, Some(fault)) => self.fail(fault, cx, out),
            (_, None) => self.enter(self.following(self.step), cx, out),
        }
    }

    fn may_fail(&self, at: usize) -> bool {
        self.spec.startup.get(at).is_some_and(|sdo| sdo.may_fail)
    }

    const fn accepts_refusal(&self) -> bool {
        !self.mapped || self.refused.is_some()
    }

    fn learnt(&mut self, at: usize, cx: &Context<'_>, out: &mut Outbox) {
        let scratch = std::mem::take(&mut self.scratch);
        self.learn.answer(&scratch);
        self.scratch = scratch;
        if let Some(Prepared::Transfer(transfer)) = self.next_question() {
            let kind = JobKind::Upload {
                address: Address::default(),
                whole: Whole::Entry,
            };
            if let Some(output) = self.mailbox.begin(transfer, kind, cx.now) {
                self.handle_mailbox(output, cx, out);
            }
            return;
        }
        let pdos = std::mem::take(&mut self.learn).into_pdos();
        let Some(channel) = self.process.channels.get_mut(at) else {
            return;
        };
        let wanted = if channel.outputs {
            &self.spec.outputs
        } else {
            &self.spec.inputs
        };
        let (number, before) = (channel.number, channel.bits());
        let same = channel
            .pdos
            .iter()
            .map(|pdo| pdo.index)
            .eq(pdos.iter().map(|pdo| pdo.index));
        let known = channel.pdos.iter().all(|pdo| !pdo.entries.is_empty());
        channel.set_pdos(pdos);
        let found = channel.bits();
        if wanted.is_some() && (!same || (known && before != found)) {
            let differs = Fault::Assignment {
                sync_manager: number,
                wanted: before,
                found,
            };
            return self.fail(self.refused.unwrap_or(differs), cx, out);
        }
        self.enter(self.following(self.step), cx, out);
    }

    /// The list of a SyncManager cannot be read: nobody can have wanted to change it.
    fn verify(&mut self, at: usize, cx: &Context<'_>, out: &mut Outbox) {
        let outputs = self
            .process
            .channels
            .get(at)
            .is_some_and(|channel| channel.outputs);
        let wanted = if outputs {
            &self.spec.outputs
        } else {
            &self.spec.inputs
        };
        let changes = wanted
            .as_ref()
            .is_some_and(|pdos| pdos.iter().any(|pdo| !pdo.entries.is_empty()));
        match self.refused.filter(|_| changes) {
            Some(fault) => self.fail(fault, cx, out),
            None => self.enter(self.following(self.step), cx, out),
        }
    }
}

/// Words of an SII that are read at most: 4 KiB.
const SII_WORDS_MAX: u16 = 2048;
