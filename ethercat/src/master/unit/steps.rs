//! The sequence of steps that starts a slave, the first time and whenever it returns. The order is that of ETG.1000.6,
//! clause 6.4.1: the configuration for a state is written in the state before.
//!
//! ```text
//! 1 Init                   INIT acknowledged, registers and SII read        -> Identified (gate 1: identity)
//! 2 Identified             port times, FMMUs and SyncManagers cleared, mailboxes set up, PRE-OP, start-up objects,
//!                          PDOs assigned, mapping read back                 -> Configured (gate 2: process image)
//! 3 Configured             watchdog, SyncManagers, FMMUs, clock, SYNC0, SAFE-OP, OP            -> Run
//! 4 Run, any               fault, working counter 0, timeout (fail)         -> Failed
//! 5 Failed, Absent         retry time, answers again (returned)             -> Check
//! 6 Check                  still set up: OP, or PRE-OP for SYNC0 (Fallback) -> 3; else 1
//! ```

use takt_cia402::dictionary::Address;

use super::super::event::{Event, Fault, JobError, Outbox};
use super::super::job::JobKind;
use super::op::{Op, WRITE_MAX};
use super::start::{Gate, Step};
use super::transfer::Transfer;
use super::{Context, Unit};
use crate::AlState;
use crate::coe::Whole;
use crate::register;

/// How a step starts.
pub(super) enum Prepared {
    Do(Op),
    Transfer(Transfer),
    /// Nothing to do: continue with the next step.
    Skip,
    /// Wait for a condition.
    Wait,
    Fail(Fault),
}

/// Loop gain of a clock (0930h) and its filter depths (0934h), as other masters write them.
const SPEED_START: [u8; 2] = 0x1000_u16.to_le_bytes();
const FILTERS: [u8; 2] = [0x00, 0x0C];
/// Maximum number of FMMUs and SyncManagers cleared at once.
const BLOCKS_MAX: u8 = 16;

impl Unit {
    /// Enters a step, and skips steps with nothing to do.
    pub(super) fn enter(&mut self, step: Step, cx: &Context<'_>, out: &mut Outbox) {
        self.turn.abort();
        let mut step = step;
        loop {
            (self.start.step, self.clock.streak) = (step, 0);
            self.operation.begin(Op::Rest, cx.now);
            match self.prepare(step, cx, out) {
                Prepared::Do(op) => {
                    self.operation.op = op;
                    return;
                }
                Prepared::Transfer(transfer) => {
                    self.operation.op = Op::Mailbox;
                    let kind = JobKind::Upload {
                        address: Address::default(),
                        whole: Whole::Entry,
                    };
                    if let Some(output) =
                        self.mailbox
                            .begin(transfer, kind, cx.mailbox_capacity(), cx.now)
                    {
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

    /// Passes the gate it is waiting at, if it is open now.
    pub(super) fn pass_gate(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        if self.operation.op != Op::Rest || self.jobs.current.is_some() {
            return;
        }
        if self.start.step == Step::Identified && self.gate >= Gate::Process {
            self.enter(Step::ReceiveTimes, cx, out);
        } else if self.start.step == Step::Configured && self.gate >= Gate::Goal {
            self.enter(Step::Watchdog, cx, out);
        } else if matches!(self.start.step, Step::ClockWait | Step::SyncStart) {
            self.pass_clock(cx, out);
        }
    }

    pub(super) fn following(&self, step: Step) -> Step {
        let more = |at: usize, len: usize| at + 1 < len;
        match step {
            Step::Init => Step::Information,
            Step::Information => Step::Configuration,
            Step::Configuration => Step::Links,
            Step::Links => Step::ClockUnit,
            Step::ClockUnit => Step::SiiForce,
            Step::SiiForce => Step::SiiTake,
            Step::SiiTake => Step::SiiRead,
            Step::SiiRead => Step::Identified,
            Step::Identified => Step::ReceiveTimes,
            Step::ReceiveTimes => Step::ClearFmmus,
            Step::ClearFmmus => Step::ClearSyncManagers,
            Step::ClearSyncManagers => Step::ClearSync,
            Step::ClearSync => Step::Mailboxes,
            Step::Mailboxes => Step::PreOp,
            // INIT and BOOT have no PDOs.
            Step::PreOp if self.is_apart() => Step::Configured,
            Step::PreOp => Step::Startup(0),
            Step::Startup(at) if more(at.into(), self.spec.startup.len()) => Step::Startup(at + 1),
            Step::Startup(_) => Step::Assign(0),
            Step::Assign(at) if more(at.into(), self.start.assignments.len()) => {
                Step::Assign(at + 1)
            }
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
            Step::SafeOp => Step::Open(0),
            Step::Open(at) if more(at.into(), self.process.channels.len()) => Step::Open(at + 1),
            Step::Open(_) => Step::Op,
            Step::Op | Step::Run => Step::Run,
            Step::Check => Step::Init,
            Step::Absent => Step::Absent,
            Step::Failed => Step::Failed,
        }
    }

    #[expect(clippy::too_many_lines, reason = "a table, one line per step")]
    fn prepare(&mut self, step: Step, cx: &Context<'_>, out: &mut Outbox) -> Prepared {
        use Prepared::{Do, Skip, Wait};
        let goes_on = self.goes_on(cx.config);
        match step {
            Step::Absent | Step::Failed => Wait,
            Step::Init => {
                if let Some(transfer) = self.mailbox.reset() {
                    self.jobs
                        .give_back(transfer.into_job(), Err(JobError::Absent), out);
                }
                self.start.set_up = false;
                Do(self.status.change(AlState::Init))
            }
            Step::Information => Do(Op::Read {
                at: register::INFORMATION,
                len: 10,
            }),
            Step::Configuration => Do(Op::Read {
                at: register::PDI_CONTROL,
                len: 2,
            }),
            Step::Links => Do(Op::Read {
                at: register::DL_STATUS,
                len: 2,
            }),
            Step::ClockUnit if self.info.announces_clock() => Do(Op::Probe {
                at: register::DC_SYSTEM_TIME,
                len: 8,
            }),
            Step::ClockUnit => Skip,
            Step::SiiForce => Do(self.operation.write(register::SII_ACCESS, &[2])),
            Step::SiiTake => Do(self.operation.write(register::SII_ACCESS, &[0])),
            Step::SiiRead => Do(self.read_sii()),
            Step::Identified if self.gate == Gate::Identity => Wait,
            Step::Identified => Skip,
            Step::ReceiveTimes if self.mapped || !self.info.announces_clock() => Skip,
            Step::ReceiveTimes => Do(Op::Probe {
                at: register::DC_RECEIVE_TIMES,
                len: 16,
            }),
            Step::ClearFmmus => self.clear(register::FMMU, 16, self.info.fmmus),
            Step::ClearSyncManagers => {
                self.clear(register::SYNC_MANAGER, 8, self.info.sync_managers)
            }
            Step::ClearSync if self.info.has_clock() => {
                Do(self.operation.write(register::DC_ACTIVATION, &[0]))
            }
            Step::ClearSync => Skip,
            Step::Mailboxes if self.mailbox.exists() && self.spec.goal != AlState::Init => {
                let bytes = self.mailbox.sync_managers();
                Do(self.operation.write(register::SYNC_MANAGER, &bytes))
            }
            Step::Mailboxes => Skip,
            Step::PreOp if self.spec.goal == AlState::Init => Skip,
            Step::PreOp if self.spec.goal == AlState::Boot => Do(self.status.change(AlState::Boot)),
            Step::PreOp | Step::Fallback => Do(self.status.change(AlState::PreOp)),
            Step::Startup(at) => self.startup(at.into()),
            Step::Assign(at) => self.assignment(at.into()),
            Step::Learn(at) => self.query_pdos(at.into()),
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
            Step::ClockGain => Do(self.operation.write(register::DC_SPEED_START, &SPEED_START)),
            Step::ClockFilter => Do(self.operation.write(register::DC_FILTERS, &FILTERS)),
            Step::ClockLock => self.lock(cx),
            Step::SyncStart => self.sync_start(cx),
            Step::SyncCycle | Step::SyncOn => self.sync(step),
            Step::SafeOp => Do(self.status.change(AlState::SafeOp)),
            Step::Open(at) => self.open(at.into(), cx),
            Step::Op if self.goal(cx.config) == AlState::SafeOp => self.run(cx, out),
            Step::Op => Do(self.status.change(AlState::Op)),
            Step::Run => self.run(cx, out),
            Step::Check => Do(Op::Read {
                at: register::AL_STATUS,
                len: 6,
            }),
        }
    }

    fn run(&mut self, cx: &Context<'_>, out: &mut Outbox) -> Prepared {
        (self.start.step, self.start.set_up) = (Step::Run, true);
        self.recovery.reach(cx.now);
        out.event(Event::Reached {
            slave: self.number,
            state: self.status.al.state,
        });
        Prepared::Wait
    }

    fn clear(&mut self, at: u16, size: u16, count: u8) -> Prepared {
        let len = size * u16::from(count.min(BLOCKS_MAX));
        if len == 0 {
            return Prepared::Skip;
        }
        let zeros = [0; WRITE_MAX];
        Prepared::Do(
            self.operation
                .write(at, zeros.get(..len.into()).unwrap_or_default()),
        )
    }

    fn configured(&mut self, cx: &Context<'_>) -> Prepared {
        if !self.mapped
            && let Err(fault) = self.process.check()
        {
            return Prepared::Fail(fault);
        }
        let lens = (self.process.outputs_len(), self.process.inputs_len());
        if self.gate == Gate::Goal && !cx.image.fits(self.number, lens) {
            return Prepared::Fail(Fault::NotInImage);
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
        // In units of the divider's factory setting, 100 us. Zero would disable it, so it is rounded up.
        let units = u16::try_from(time.as_nanos().div_ceil(100_000)).unwrap_or(u16::MAX);
        Prepared::Do(
            self.operation
                .write(register::WATCHDOG_PROCESS_DATA, &units.to_le_bytes()),
        )
    }

    fn channel(&mut self, at: usize) -> Prepared {
        let Some(channel) = self.process.channels.get(at) else {
            return Prepared::Skip;
        };
        let block = channel.sync_manager().encode();
        let at = register::SYNC_MANAGER + 8 * u16::from(channel.number);
        Prepared::Do(self.operation.write(at, &block))
    }

    /// Outputs that are enabled in OP only are switched on immediately before OP.
    fn open(&mut self, at: usize, cx: &Context<'_>) -> Prepared {
        let opens = self.goal(cx.config) == AlState::Op;
        let channel = self.process.channels.get(at);
        let Some(channel) = channel.filter(|channel| opens && channel.waits_for_op()) else {
            return Prepared::Skip;
        };
        let at = register::SYNC_MANAGER + 8 * u16::from(channel.number) + 6;
        Prepared::Do(self.operation.write(at, &[1]))
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
            return Prepared::Fail(Fault::NotInImage);
        };
        let number = before().filter(|channel| !channel.is_empty()).count();
        let block = channel.fmmu(base + offset).encode();
        let at = register::FMMU + 16 * u16::try_from(number).unwrap_or(0);
        Prepared::Do(self.operation.write(at, &block))
    }

    /// The operation of the step succeeded.
    #[expect(
        clippy::wildcard_enum_match_arm,
        reason = "the answers of most steps carry no data"
    )]
    pub(super) fn advance(&mut self, data: &[u8], cx: &Context<'_>, out: &mut Outbox) {
        let goes_on = match self.start.step {
            Step::Information => self.info.take_registers(data),
            Step::Configuration => self.info.take_configuration(data),
            Step::Links => self.info.take_links(data),
            Step::ClockUnit => {
                self.info.system_time = !data.is_empty();
                true
            }
            Step::SiiRead => return self.sii_read(cx, out),
            Step::ReceiveTimes => self.take_times(data),
            Step::ClockRead => self.take_offset(data, cx),
            Step::ClockLock => self.take_difference(data, cx, out),
            Step::Check => return self.check(data, cx, out),
            // The others have no result to handle.
            _ => true,
        };
        if goes_on {
            self.enter(self.following(self.start.step), cx, out);
        }
    }

    /// The slave is back or is retried: checks how much of its set-up is still valid.
    fn check(&mut self, data: &[u8], cx: &Context<'_>, out: &mut Outbox) {
        self.take_status(data);
        let kept = self.start.set_up && self.recovery.failures < 3;
        let step = match self.status.al.state {
            AlState::SafeOp | AlState::Op if kept && self.goes_on(cx.config) => {
                // Its clock continued, and all others follow it again.
                self.clock.locked |= cx.reference == Some(self.number);
                // SYNC0 is restarted: while the slave was offline its clock ran freely.
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
}
