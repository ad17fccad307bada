//! The thread that evaluates nets: a real-time cycle around an [`Executor`], with the cells of
//! devices on one side and the rings to the controller on the other. It makes no decisions.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_net::{Moment, Nanos};
use takt_rt::cycle::{Cycles, Follow, Tick};
use takt_rt::ring::{Consumer, Producer};
use takt_rt::stats::{Recorder, RecorderReader, StatsReader, StatsWriter};
use takt_rt::thread::{Thread, ThreadConfig};

use crate::error::Error;
use crate::executor::figures::budget;
use crate::executor::rules::{Literal, Rule, RuleRefusal, WORK_MAX};
use crate::executor::serve::{DeviceEnd, Served};
use crate::executor::stop::StopPart;
use crate::executor::{Effect, End, Executor, Refusal, Running};
use crate::record::Tap;

/// What the controller asks of the thread.
#[derive(Debug)]
pub enum Command {
    /// Evaluate this net from now on.
    Start(Box<Running>),
    /// Ask a net to cancel.
    Cancel(u32),
    /// End a net.
    Abort(u32),
    /// Keep this net for rules to start.
    Schedule(Box<Running>),
    /// Watch this rule.
    AddRule(Box<Rule>),
    /// Answer for good what rules ask of a net that has ended.
    Answer(Literal),
    /// Give back a net that was scheduled: always, or only if no rule waits to start it.
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
}

impl Command {
    /// Whether all waiting rules are looked at for it.
    const fn looks_at_rules(&self) -> bool {
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
            | Self::RemoveDevice(_) => false,
        }
    }
}

/// What the thread tells the controller.
#[derive(Debug)]
pub enum Event {
    /// A net runs.
    Started(u32),
    /// A net could not be started and is back.
    Refused(Box<Running>, Refusal),
    /// A net was asked to cancel and runs on until it ends itself.
    Cancelling(u32),
    /// A net ended and is back.
    Ended(Box<Running>, End),
    /// A rule waits.
    RuleAdded(u32),
    /// A rule could not be kept.
    RuleRefused(Box<Rule>, RuleRefusal),
    /// A rule no longer waits.
    RuleDone(Box<Rule>),
    /// A device is no longer served.
    DeviceRemoved(Box<DeviceEnd>),
    /// A net that no rule starts any more is back.
    Unscheduled(Box<Running>),
}

/// How the thread is to run.
#[derive(Debug)]
pub struct NetThreadConfig {
    /// Time from one cycle to the next.
    pub period: Duration,
    /// Cycle n begins at `base` plus n periods. In the past, and the same for all threads whose
    /// multiples are to coincide.
    pub base: takt_rt::Nanos,
    /// The device's clock that its cycles keep phase with; `None` for the host's. Logical time is
    /// `base` plus n periods either way.
    pub follow: Option<Follow>,
    /// Its part of the controller's emergency stop.
    pub stop: StopPart,
    /// Name, priority and processors.
    pub thread: ThreadConfig,
}

/// The controller's end of the thread.
#[derive(Debug)]
pub struct NetThread {
    /// Where it is told what to do.
    pub commands: Producer<Command>,
    /// What it has to tell.
    pub events: Consumer<Event>,
    /// How well it keeps its time.
    pub stats: StatsReader,
    /// Time between handing over set-points to the first and to the last arm in one cycle.
    pub hand_over: RecorderReader,
    /// Time from one cycle to the next.
    pub period: Duration,
    thread: Thread<()>,
    stop: Arc<AtomicBool>,
}

/// Commands under way; more are refused.
pub(crate) const COMMANDS: usize = 1024;
/// Events under way. The controller takes all of them before each command, so there are never more
/// than what so many commands, all waiting rules and all nets of the thread can cause.
const EVENTS: usize = 8 * COMMANDS;

impl NetThread {
    /// Starts the thread, which from then on does nothing but cycles.
    ///
    /// # Errors
    /// If the system has no thread to give.
    pub fn start(config: NetThreadConfig, tap: Option<Tap>) -> Result<Self, Error> {
        let (commands, command_end) = takt_rt::ring::ring(COMMANDS);
        let (event_end, events) = takt_rt::ring::ring(EVENTS);
        let (mut stats_writer, stats) = takt_rt::stats::pair();
        let hand_over = Recorder::new();
        let hand_over_reader = hand_over.reader();
        let stop = Arc::new(AtomicBool::new(false));
        let mut cycle = Box::new(Cycle {
            executor: Executor::within(budget(config.period).into()),
            served: Served::new(config.period.into(), hand_over).under(config.stop),
            commands: command_end,
            events: event_end,
            tap,
            clock: takt_rt::monotonic,
        });
        let stopping = Arc::clone(&stop);
        let name = config.thread.name.clone();
        let (period, base, follow) = (config.period, config.base, config.follow);
        let thread = takt_rt::thread::spawn(config.thread, move || {
            let cycles = Cycles {
                start: Some(base),
                follow,
                ..Cycles::every(period)
            };
            run(&mut cycle, cycles, &mut stats_writer, &stopping);
        })
        .map_err(|source| Error::Thread { name, source })?;
        Ok(Self {
            commands,
            events,
            stats,
            hand_over: hand_over_reader,
            period,
            thread,
            stop,
        })
    }

    /// How the host granted what the thread asked for.
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
    pub fn ask_to_stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Ends the thread after its next cycle and waits for that.
    pub fn stop(self) {
        self.ask_to_stop();
        if self.thread.join().is_err() {
            tracing::error!("the net thread had ended by a panic");
        }
    }
}

fn run(cycle: &mut Cycle, cycles: Cycles<'_>, stats: &mut StatsWriter, stop: &AtomicBool) {
    let scope = takt_rt::alloc::enter_real_time();
    let period = cycles.period.into();
    cycles.run(stats, |tick| {
        cycle.run(&Slot::of(tick, period));
        if stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    drop(scope);
}

/// When a cycle is, to nets and to drivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Slot {
    /// What nets see: time is logical, so that the same inputs give the same outputs.
    moment: Moment,
    /// When it began on the clock of this host, by which drivers place set-points. The same as logical
    /// time, unless the thread follows a device's clock.
    begin: takt_rt::Nanos,
    /// When it is to be over.
    end: takt_rt::Nanos,
}

impl Slot {
    fn of(tick: &Tick, period: takt_rt::Nanos) -> Self {
        let moment = Moment {
            // 0 is "never".
            cycle: tick.index.max(1),
            time: Nanos(tick.time.0),
            wall: Nanos(tick.woken.0),
            ..Moment::default()
        };
        Self {
            moment,
            begin: tick.scheduled,
            end: tick.scheduled + period,
        }
    }
}

/// Most commands taken in one cycle; the rest waits for the next.
const COMMANDS_A_CYCLE: usize = 16;
/// So much work of waiting rules makes a command that looks at them count once more.
const WORK_A_COMMAND: usize = WORK_MAX / COMMANDS_A_CYCLE;

struct Cycle {
    executor: Executor,
    served: Served,
    commands: Consumer<Command>,
    events: Producer<Event>,
    tap: Option<Tap>,
    clock: fn() -> takt_rt::Nanos,
}

impl Cycle {
    fn run(&mut self, slot: &Slot) {
        let moment = slot.moment;
        self.served.look(slot.begin);
        self.served.read(&mut self.executor);
        let halted = self.halt();
        self.obey_commands();
        for net in self.executor.running() {
            let received = net.receive();
            if let (true, Some(tap)) = (received, &mut self.tap) {
                tap.inbox(net);
            }
        }
        if self.executor.fire_decided() {
            self.tell_effects();
        }
        let tap = &mut self.tap;
        self.executor.announce_takeovers(|id, waits| {
            if let Some(tap) = tap {
                tap.takeover(id, waits);
            }
        });
        if let Some(tap) = &mut self.tap {
            tap.inputs(moment, &self.executor);
        }
        self.executor.cycle_timed(moment, self.clock);
        self.served.write(&mut self.executor, moment, slot.begin);
        self.served.stop().answer(halted, self.clock);
        let tap = &mut self.tap;
        self.executor.publish(|net| {
            if let Some(tap) = tap {
                tap.outbox(net);
            }
        });
        self.executor.fire_rules();
        self.tell_effects();
        if !self.executor.running().is_empty() && (self.clock)() >= slot.end {
            self.executor.overran();
        }
        if let Some(tap) = &mut self.tap {
            tap.outputs(moment, &self.executor);
        }
        // Before anyone learns that a net has ended, and after it was seen who follows it.
        if self.executor.withdraw() {
            self.served.retract(&self.executor);
        }
        self.hand_back();
        self.tell_rules();
        if let Some(tap) = &mut self.tap {
            tap.finish();
        }
    }

    /// Ends all nets if the controller is stopped; returns how many.
    fn halt(&mut self) -> u32 {
        let mut count = 0;
        if self.served.stop().ends_nets() {
            let tap = &mut self.tap;
            self.executor.halt(|id| {
                count += 1;
                if let Some(tap) = tap {
                    tap.aborted(id);
                }
            });
        }
        count
    }

    /// Obeys the commands of this cycle: fewer where rules that wait make each of them dearer.
    fn obey_commands(&mut self) {
        let mut left = COMMANDS_A_CYCLE;
        while left > 0 {
            let Some(command) = self.commands.pop() else {
                break;
            };
            let looks_at_rules = command.looks_at_rules();
            self.obey(command);
            let rules = self.executor.rule_work() / WORK_A_COMMAND;
            left = left.saturating_sub(1 + if looks_at_rules { rules } else { 0 });
        }
    }

    fn obey(&mut self, command: Command) {
        match command {
            Command::Start(net) => self.start(net),
            Command::StartScheduled(id) => {
                if let Some(net) = self.executor.take_unscheduled(id, true) {
                    self.start(net);
                }
            }
            Command::Cancel(id) => {
                if self.executor.cancel(id) {
                    if let Some(tap) = &mut self.tap {
                        tap.cancelled(id);
                    }
                    self.tell(Event::Cancelling(id));
                }
            }
            Command::Abort(id) => {
                if self.executor.abort(id)
                    && let Some(tap) = &mut self.tap
                {
                    tap.aborted(id);
                }
            }
            rule @ (Command::Schedule(_)
            | Command::AddRule(_)
            | Command::Answer(_)
            | Command::Unschedule { .. }
            | Command::Forget(_)) => self.obey_rule(rule),
            Command::AddDevice(end) => self.served.add(end, &mut self.executor),
            Command::RemoveDevice(number) => {
                if let Some(end) = self.served.remove(number, &mut self.executor) {
                    self.tell(Event::DeviceRemoved(end));
                }
            }
        }
    }

    fn start(&mut self, net: Box<Running>) {
        let id = net.id;
        if !self.served.stop().permits(net.requested) {
            return self.tell(Event::Refused(net, Refusal::Halted));
        }
        match self.executor.start(net) {
            Ok(()) => {
                if let Some(tap) = &mut self.tap {
                    tap.started(id);
                }
                self.tell(Event::Started(id));
            }
            Err((net, refusal)) => self.tell(Event::Refused(net, refusal)),
        }
    }

    fn obey_rule(&mut self, command: Command) {
        match command {
            Command::Schedule(net) => {
                if let Err(net) = self.executor.schedule(net) {
                    self.tell(Event::Unscheduled(net));
                }
            }
            Command::AddRule(rule) => {
                let id = rule.id;
                if !self.served.stop().permits(rule.requested) {
                    let rule = crate::executor::rules::refused(rule);
                    return self.tell(Event::RuleRefused(rule, RuleRefusal::Halted));
                }
                match self.executor.add_rule(rule) {
                    Ok(()) => self.tell(Event::RuleAdded(id)),
                    Err((rule, why)) => self.tell(Event::RuleRefused(rule, why)),
                }
            }
            Command::Answer(literal) => self.executor.answer_for_good(literal),
            Command::Unschedule { net, always } => {
                if let Some(net) = self.executor.take_unscheduled(net, always) {
                    self.tell(Event::Unscheduled(net));
                }
            }
            Command::Forget(id) => self.executor.forget(id),
            Command::Start(_)
            | Command::StartScheduled(_)
            | Command::Cancel(_)
            | Command::Abort(_)
            | Command::AddDevice(_)
            | Command::RemoveDevice(_) => {}
        }
    }

    /// Notes what happened to nets that they did not do themselves. Starts are told later, when the
    /// predecessors' ends are.
    fn tell_effects(&mut self) {
        let Self {
            executor,
            events,
            tap,
            ..
        } = self;
        executor.effects(|id, effect| {
            if let Some(tap) = tap {
                match effect {
                    Effect::RanAway => tap.ran_away(id),
                    Effect::Stopped => tap.stopped(id),
                    Effect::Cancelled => tap.cancelled(id),
                    Effect::Started => tap.succeeded(id),
                }
            }
            if effect == Effect::Cancelled {
                let told = events.push(Event::Cancelling(id));
                debug_assert!(told.is_ok(), "more events than requests");
            }
        });
    }

    /// Tells what rules started, and which rules no longer wait.
    fn tell_rules(&mut self) {
        let Self {
            executor, events, ..
        } = self;
        executor.started(|id| {
            let told = events.push(Event::Started(id));
            debug_assert!(told.is_ok(), "more events than requests");
        });
        executor.take_rules(|rule| match events.push(Event::RuleDone(rule)) {
            Err(Event::RuleDone(rule)) => Err(rule),
            _ => Ok(()),
        });
    }

    /// There is room: see [`EVENTS`].
    fn tell(&mut self, event: Event) {
        let told = self.events.push(event);
        debug_assert!(told.is_ok(), "more events than requests");
    }

    /// Hands ended nets back, in the order in which they came: a predecessor's end is told before its
    /// successor's start, and that before the successor's own end.
    fn hand_back(&mut self) {
        let Self {
            executor,
            events,
            tap,
            ..
        } = self;
        while executor.take_ended(|mut net, end| {
            let id = net.id;
            if net.take_untold() {
                let told = events.push(Event::Started(id));
                debug_assert!(told.is_ok(), "more events than requests");
            }
            match events.push(Event::Ended(net, end)) {
                Ok(()) => {
                    if let Some(tap) = tap {
                        tap.ended(id, end);
                    }
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
