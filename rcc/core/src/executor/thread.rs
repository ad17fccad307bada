//! The thread that evaluates nets: a real-time cycle around an [`Executor`], with the latest-value cells of
//! devices on one side and the rings to the controller on the other. It makes no decisions.

mod machines;
mod slot;

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_machine::Status;
use takt_rt::cycle::{Cycles, Follow, Tick};
use takt_rt::ring::{Consumer, Producer};
use takt_rt::stats::{Recorder, RecorderReader, StatsReader, StatsWriter};
use takt_rt::thread::{Thread, ThreadConfig};

use crate::error::Error;
use crate::executor::figures::budget;
use crate::executor::flight::{self, FlightReader, FlightWriter};
use crate::executor::machines::{Hosted, InputError, MachineInput};
use crate::executor::report::{Notifier, Reports};
use crate::executor::rules::{Literal, Rule, RuleError, WORK_MAX};
use crate::executor::serve::{DeviceEnd, Served};
use crate::executor::stop::StopPart;
use crate::executor::{Effect, End, Executor, Running, StartError};
use crate::record::flight::ThreadRings;
use crate::record::{Journal, Tap};
use slot::Slot;

/// Commands of the controller to the thread.
#[derive(Debug)]
pub enum Command {
    /// Evaluate this net from now on.
    Start(Box<Running>),
    /// Request a net to cancel.
    Cancel(u32),
    /// End a net.
    Abort(u32),
    /// Hold this net for rules to start.
    Schedule(Box<Running>),
    /// Watch this rule.
    AddRule(Box<Rule>),
    /// Set the final answer of literals about an ended net.
    Answer(Literal),
    /// Return a scheduled net: always, or only if no rule waits to start it.
    Unschedule {
        /// The net.
        net: u32,
        /// Whether rules that wait to start it lose it.
        always: bool,
    },
    /// Evaluate this scheduled net from now on.
    StartScheduled(u32),
    /// This net will never run.
    Forget(u32),
    /// Serve a device.
    AddDevice(Box<DeviceEnd>),
    /// Serve the device of that number no longer.
    RemoveDevice(usize),
    /// Step this machine from now on.
    AddMachine(Box<Hosted>),
    /// Seat this net for the next start of a component; whether it replaces those that wait.
    Seat(Box<Running>, bool),
    /// The net of this component of a machine could not be loaded.
    SeatFailed(u32, usize),
    /// Execute a request to a machine, and answer it with its number.
    MachineInput(u32, u64, MachineInput),
    /// End a machine where it is, with its components.
    RemoveMachine(u32),
}

impl Command {
    /// The net that it is about; `None` for a rule or a device.
    #[must_use]
    pub fn net(&self) -> Option<u32> {
        match self {
            Self::Start(net) | Self::Schedule(net) => Some(net.id),
            Self::Cancel(id)
            | Self::Abort(id)
            | Self::StartScheduled(id)
            | Self::Forget(id)
            | Self::Answer(Literal { net: id, .. })
            | Self::Unschedule { net: id, .. } => Some(*id),
            Self::Seat(net, _) => Some(net.id),
            Self::AddRule(_)
            | Self::AddDevice(_)
            | Self::RemoveDevice(_)
            | Self::AddMachine(_)
            | Self::SeatFailed(..)
            | Self::MachineInput(..)
            | Self::RemoveMachine(_) => None,
        }
    }

    /// Whether it requires a pass over all waiting rules.
    const fn reads_all_rules(&self) -> bool {
        match self {
            Self::Start(_)
            | Self::AddRule(_)
            | Self::Answer(_)
            | Self::Unschedule { .. }
            | Self::StartScheduled(_)
            | Self::Forget(_) => true,
            Self::Cancel(_)
            | Self::Abort(_)
            | Self::Schedule(_)
            | Self::AddDevice(_)
            | Self::RemoveDevice(_)
            | Self::AddMachine(_)
            | Self::Seat(..)
            | Self::SeatFailed(..)
            | Self::MachineInput(..)
            | Self::RemoveMachine(_) => false,
        }
    }
}

/// Events of the thread to the controller.
#[derive(Debug)]
pub enum Event {
    /// A net runs.
    Started(u32),
    /// A net could not be started and is returned.
    StartRejected(Box<Running>, StartError),
    /// A net received a cancel and runs until it ends by itself.
    Cancelling(u32),
    /// A net ended and is returned.
    Ended(Box<Running>, End),
    /// A rule waits.
    RuleAdded(u32),
    /// A rule was rejected.
    RuleRejected(Box<Rule>, RuleError),
    /// A rule no longer waits.
    RuleDone(Box<Rule>),
    /// A device is no longer served.
    DeviceRemoved(Box<DeviceEnd>),
    /// A net that no rule and no machine starts any more is returned.
    Unscheduled(Box<Running>),
    /// A machine is stepped.
    MachineAdded(u32),
    /// A machine was rejected.
    MachineRejected(Box<Hosted>, StartError),
    /// The answer to the request of that number to a machine.
    MachineAnswered(u32, u64, Result<(), InputError>),
    /// A machine requests a `configure` of this component.
    Configure(u32, usize),
    /// The status of a machine has changed.
    MachineStatus(u32, Status),
    /// A machine is no longer stepped, and its components have ended.
    MachineRemoved(Box<Hosted>),
}

/// Settings of the thread.
#[derive(Debug)]
pub struct NetThreadConfig {
    /// Time from one cycle to the next.
    pub period: Duration,
    /// Cycle n begins at `base` plus n periods. It lies in the past and is the same for all threads whose
    /// cycles coincide.
    pub base: takt_rt::Nanos,
    /// The device clock that its cycles follow; `None` for the host's clock. Logical time is
    /// `base` plus n periods either way.
    pub follow: Option<Follow>,
    /// Its part of the controller's emergency stop.
    pub stop: StopPart,
    /// Wakes the thread that takes its events.
    pub notifier: Arc<Notifier>,
    /// Name, priority and processors.
    pub thread: ThreadConfig,
}

/// The controller's handle of the thread.
#[derive(Debug)]
pub struct NetThread {
    /// Queue of commands.
    pub commands: Producer<Command>,
    /// Queue of events.
    pub events: Consumer<Event>,
    /// Its timing.
    pub stats: StatsReader,
    /// Time between handing over set-points to the first and to the last arm in one cycle.
    pub hand_over: RecorderReader,
    /// Time from one cycle to the next.
    pub period: Duration,
    /// The last out values of its nets.
    pub flight: FlightReader,
    /// Timing of its last cycles, and the states of its machines.
    pub timing: FlightReader,
    /// What happened to its nets and machines last.
    pub happened: FlightReader,
    /// Its name at the system, such as `takt-nets`.
    pub name: String,
    /// The instant to which the times of its cycles refer.
    pub base: takt_rt::Nanos,
    thread: Thread<()>,
    stop: Arc<AtomicBool>,
}

/// Capacity of the command queue; further commands are rejected.
pub(crate) const COMMANDS: usize = 1024;
/// Capacity of the event queue. The controller takes all events before each command, so there are never more
/// than what so many commands, all waiting rules and all nets of the thread can cause.
const EVENTS: usize = 8 * COMMANDS;

impl NetThread {
    /// Starts the thread, which from then on only executes cycles.
    ///
    /// # Errors
    /// If the system cannot start a thread.
    pub fn start(config: NetThreadConfig, tap: Option<Tap>) -> Result<Self, Error> {
        let (commands, command_end) = takt_rt::ring::ring(COMMANDS);
        let (event_end, events) = takt_rt::ring::ring(EVENTS);
        let (mut stats_writer, stats) = takt_rt::stats::pair();
        let hand_over = Recorder::new();
        let hand_over_reader = hand_over.reader();
        let stop = Arc::new(AtomicBool::new(false));
        let (flight, flight_reader) = flight::of_nets();
        let (timing, timing_reader) = flight::of_thread(config.period);
        let (journal, event_reader) = Journal::new(tap);
        let mut cycle = Box::new(Cycle {
            executor: Executor::within(budget(config.period).into()),
            served: Served::new(config.period.into(), hand_over).under(config.stop),
            commands: command_end,
            events: Reports::new(event_end, config.notifier),
            journal,
            flight,
            timing,
            clock: takt_rt::monotonic,
        });
        let stopping = Arc::clone(&stop);
        let name = config.thread.name.clone();
        let for_error = name.clone();
        let (period, base, follow) = (config.period, config.base, config.follow);
        let thread = takt_rt::thread::spawn(config.thread, move || {
            let cycles = Cycles {
                start: Some(base),
                follow,
                ..Cycles::every(period)
            };
            run(&mut cycle, cycles, &mut stats_writer, &stopping);
        })
        .map_err(|source| Error::Thread {
            name: for_error,
            source,
        })?;
        Ok(Self {
            commands,
            events,
            stats,
            hand_over: hand_over_reader,
            period,
            flight: flight_reader,
            timing: timing_reader,
            happened: event_reader,
            name,
            base,
            thread,
            stop,
        })
    }

    /// The rings that it writes.
    #[must_use]
    pub(crate) fn rings(&self) -> ThreadRings {
        ThreadRings {
            period: self.period,
            values: self.flight.clone(),
            timing: self.timing.clone(),
            happened: self.happened.clone(),
        }
    }

    /// Settings that the host granted to the thread.
    #[must_use]
    pub fn grants(&self) -> &[takt_rt::Grant] {
        self.thread.grants()
    }

    /// Whether the thread has ended, which it never does by itself.
    #[must_use]
    pub fn is_dead(&self) -> bool {
        self.thread.is_finished()
    }

    /// Ends the thread after its next cycle, without waiting for that.
    pub fn request_stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Ends the thread after its next cycle and waits for that.
    pub fn stop(self) {
        self.request_stop();
        if self.thread.join().is_err() {
            tracing::error!("the net thread panicked");
        }
    }
}

fn run(cycle: &mut Cycle, cycles: Cycles<'_>, stats: &mut StatsWriter, stop: &AtomicBool) {
    let scope = takt_rt::alloc::enter_real_time();
    let period = cycles.period.into();
    cycles.run(stats, |tick| {
        cycle.run(&Slot::of(tick, period));
        cycle.note_timing(tick);
        if stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    drop(scope);
}

/// Maximum number of commands per cycle; the rest waits for the next.
const COMMANDS_A_CYCLE: usize = 16;
/// Rule work that makes a command which reads all rules count once more.
const WORK_A_COMMAND: usize = WORK_MAX / COMMANDS_A_CYCLE;

struct Cycle {
    executor: Executor,
    served: Served,
    commands: Consumer<Command>,
    events: Reports,
    journal: Journal,
    flight: FlightWriter,
    timing: FlightWriter,
    clock: fn() -> takt_rt::Nanos,
}

impl Cycle {
    fn run(&mut self, slot: &Slot) {
        let moment = slot.moment;
        self.journal.begin(moment);
        self.served.poll(slot.begin);
        self.served.read(&mut self.executor);
        let halted = self.halt();
        self.handle_commands();
        for net in self.executor.running() {
            if net.receive() {
                self.journal.inbox(net);
            }
        }
        if self.executor.fire_decided(moment, slot.begin) {
            self.report_effects();
        }
        let journal = &mut self.journal;
        self.executor.announce_takeovers(|id, waits| {
            journal.takeover(id, waits);
        });
        self.journal.inputs(moment, &self.executor);
        self.executor.cycle_timed(moment, self.clock);
        self.served.write(&mut self.executor, moment, slot.begin);
        self.served.stop().answer(halted, self.clock);
        let (journal, flight, events) = (&mut self.journal, &mut self.flight, &mut self.events);
        self.executor.publish(|net| {
            if net.plan.take_results_changed() {
                events.note_results();
            }
            flight.write_net(net, slot.begin, moment.wall);
            journal.outbox(net);
        });
        self.step_machines(moment);
        self.executor.fire_rules();
        self.report_effects();
        if !self.executor.running().is_empty() && (self.clock)() >= slot.end {
            self.executor.overran();
        }
        self.journal.outputs(moment, &self.executor);
        // Before the end of a net is reported, and after its successors are known.
        if self.executor.withdraw() {
            self.served.retract(&self.executor);
        }
        self.hand_back();
        self.report_rules();
        self.report_machines();
        self.journal.finish();
        // Last of all: nothing of the cycle waits for it.
        self.events.flush();
    }

    /// Writes the timing of a cycle, after all else of it.
    fn note_timing(&mut self, tick: &Tick) {
        let machines = self.executor.machine_states();
        self.timing.write_thread(tick, (self.clock)(), machines);
    }

    /// Ends all nets if the controller is stopped; returns how many.
    fn halt(&mut self) -> u32 {
        let mut count = 0;
        if self.served.stop().ends_nets() {
            let journal = &mut self.journal;
            self.executor.halt(|id| {
                count += 1;
                journal.aborted(id);
            });
        }
        count
    }

    /// Handles the commands of this cycle: fewer if waiting rules make each of them more expensive.
    fn handle_commands(&mut self) {
        let mut left = COMMANDS_A_CYCLE;
        while left > 0 {
            let Some(command) = self.commands.pop() else {
                break;
            };
            let reads_all_rules = command.reads_all_rules();
            self.handle(command);
            let rules = self.executor.rule_work() / WORK_A_COMMAND;
            left = left.saturating_sub(1 + if reads_all_rules { rules } else { 0 });
        }
    }

    fn handle(&mut self, command: Command) {
        match command {
            Command::Start(net) => self.start(net),
            Command::StartScheduled(id) => {
                if let Some(net) = self.executor.take_unscheduled(id, true) {
                    self.start(net);
                }
            }
            Command::Cancel(id) => {
                if self.executor.cancel(id) {
                    self.journal.cancelled(id);
                    self.report(Event::Cancelling(id));
                }
            }
            Command::Abort(id) => {
                if self.executor.abort(id) {
                    self.journal.aborted(id);
                }
            }
            rule @ (Command::Schedule(_)
            | Command::AddRule(_)
            | Command::Answer(_)
            | Command::Unschedule { .. }
            | Command::Forget(_)) => self.handle_rule_command(rule),
            machine @ (Command::AddMachine(_)
            | Command::Seat(..)
            | Command::SeatFailed(..)
            | Command::MachineInput(..)
            | Command::RemoveMachine(_)) => self.handle_machine_command(machine),
            Command::AddDevice(end) => self.served.add(end, &mut self.executor),
            Command::RemoveDevice(number) => {
                if let Some(end) = self.served.remove(number, &mut self.executor) {
                    self.report(Event::DeviceRemoved(end));
                }
            }
        }
    }

    fn start(&mut self, net: Box<Running>) {
        let id = net.id;
        if !self.served.stop().permits(net.requested) {
            return self.report(Event::StartRejected(net, StartError::Halted));
        }
        match self.executor.start(net) {
            Ok(()) => {
                self.journal.started(id);
                self.report(Event::Started(id));
            }
            Err((net, error)) => self.report(Event::StartRejected(net, error)),
        }
    }

    fn handle_rule_command(&mut self, command: Command) {
        match command {
            Command::Schedule(net) => {
                if let Err(net) = self.executor.schedule(net) {
                    self.report(Event::Unscheduled(net));
                }
            }
            Command::AddRule(rule) => {
                let id = rule.id;
                if !self.served.stop().permits(rule.requested) {
                    let rule = crate::executor::rules::rejected(rule);
                    return self.report(Event::RuleRejected(rule, RuleError::Halted));
                }
                match self.executor.add_rule(rule) {
                    Ok(()) => self.report(Event::RuleAdded(id)),
                    Err((rule, why)) => self.report(Event::RuleRejected(rule, why)),
                }
            }
            Command::Answer(literal) => self.executor.set_final_answer(literal),
            Command::Unschedule { net, always } => {
                if let Some(net) = self.executor.take_unscheduled(net, always) {
                    self.report(Event::Unscheduled(net));
                }
            }
            Command::Forget(id) => self.executor.forget(id),
            Command::Start(_)
            | Command::StartScheduled(_)
            | Command::Cancel(_)
            | Command::Abort(_)
            | Command::AddDevice(_)
            | Command::RemoveDevice(_)
            | Command::AddMachine(_)
            | Command::Seat(..)
            | Command::SeatFailed(..)
            | Command::MachineInput(..)
            | Command::RemoveMachine(_) => {}
        }
    }

    /// Reports effects on nets that they did not cause. Starts are reported later, after the ends of their
    /// predecessors.
    fn report_effects(&mut self) {
        let Self {
            executor,
            events,
            journal,
            ..
        } = self;
        executor.effects(|id, effect| {
            match effect {
                Effect::RanAway => journal.ran_away(id),
                Effect::Stopped => journal.stopped(id),
                Effect::Cancelled => journal.cancelled(id),
                Effect::Started => journal.succeeded(id),
            }
            if effect == Effect::Cancelled {
                let pushed = events.push(Event::Cancelling(id));
                debug_assert!(pushed.is_ok(), "more events than requests");
            }
        });
    }

    /// Reports nets that rules started, and rules that no longer wait.
    fn report_rules(&mut self) {
        let Self {
            executor, events, ..
        } = self;
        executor.started(|id| {
            let pushed = events.push(Event::Started(id));
            debug_assert!(pushed.is_ok(), "more events than requests");
        });
        executor.take_rules(|rule| match events.push(Event::RuleDone(rule)) {
            Err(Event::RuleDone(rule)) => Err(rule),
            _ => Ok(()),
        });
    }

    /// The queue has space: see [`EVENTS`].
    fn report(&mut self, event: Event) {
        let pushed = self.events.push(event);
        debug_assert!(pushed.is_ok(), "more events than requests");
    }

    /// Returns ended nets in the order of their starts: a predecessor's end is reported before its
    /// successor's start, and this before the successor's end.
    fn hand_back(&mut self) {
        let Self {
            executor,
            events,
            journal,
            ..
        } = self;
        while executor.take_ended(|mut net, end| {
            let id = net.id;
            if net.take_start_report() {
                let pushed = events.push(Event::Started(id));
                debug_assert!(pushed.is_ok(), "more events than requests");
            }
            match events.push(Event::Ended(net, end)) {
                Ok(()) => {
                    journal.ended(id, end);
                    Ok(())
                }
                Err(Event::Ended(net, _)) => Err(net),
                Err(_) => Ok(()),
            }
        }) {}
    }
}

#[cfg(test)]
mod tests;
