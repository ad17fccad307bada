//! The thread that evaluates nets: a real-time cycle around an [`Executor`], with the cells of
//! devices on one side and the rings to the controller on the other. It makes no decisions.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_net::{JointState, Moment, Nanos};
use takt_rt::latest::{LatestReader, LatestWriter};
use takt_rt::ring::{Consumer, Producer};
use takt_rt::stats::{Recorder, RecorderReader, StatsReader, StatsWriter};
use takt_rt::thread::{Thread, ThreadConfig};

use crate::device::sim::Simulation;
use crate::device::{ARM_JOINTS_MAX, ArmCommand, ArmState, JointSetPoints, SetPoint};
use crate::error::Error;
use crate::executor::rules::{Rule, RuleRefusal};
use crate::executor::{DEVICES_MAX, DeviceView, Effect, End, Executor, Refusal, Running};
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
    /// Serve an arm.
    AddArm(Box<ArmEnd>),
    /// Serve the device of that number no longer.
    RemoveArm(usize),
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
    /// An arm is no longer served.
    ArmRemoved(Box<ArmEnd>),
    /// A net that no rule starts any more is back.
    Unscheduled(Box<Running>),
}

/// An arm as the thread serves it.
#[derive(Debug)]
pub struct ArmEnd {
    /// Its device number.
    pub number: usize,
    /// Number of its first joint in the image.
    pub first_joint: usize,
    /// How many joints it has.
    pub joints: usize,
    /// What moves it.
    pub driver: ArmDriver,
    /// What nets command to it.
    pub set_points: [JointSetPoints; ARM_JOINTS_MAX],
}

/// What moves an arm.
#[derive(Debug)]
pub enum ArmDriver {
    /// A driver in a thread of its own.
    Cells {
        /// What it tells.
        state: LatestReader<ArmState>,
        /// What it is told.
        command: LatestWriter<ArmCommand>,
    },
    /// Nothing: the arm is simulated.
    Simulated(Box<Simulation>),
}

/// How the thread is to run.
#[derive(Debug)]
pub struct NetThreadConfig {
    /// Time from one cycle to the next.
    pub period: Duration,
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
    thread: Thread<()>,
    stop: Arc<AtomicBool>,
}

/// Commands under way; more are refused.
const COMMANDS: usize = 1024;
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
            executor: Executor::default(),
            arms: (0..DEVICES_MAX).map(|_| None).collect(),
            period: config.period.into(),
            commands: command_end,
            events: event_end,
            hand_over,
            tap,
        });
        let stopping = Arc::clone(&stop);
        let name = config.thread.name.clone();
        let period = config.period;
        let thread = takt_rt::thread::spawn(config.thread, move || {
            run(&mut cycle, period, &mut stats_writer, &stopping);
        })
        .map_err(|source| Error::Thread { name, source })?;
        Ok(Self {
            commands,
            events,
            stats,
            hand_over: hand_over_reader,
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

    /// Ends the thread after its present cycle and waits for that.
    pub fn stop(self) {
        self.stop.store(true, Ordering::Relaxed);
        if self.thread.join().is_err() {
            tracing::error!("the net thread had ended by a panic");
        }
    }
}

fn run(cycle: &mut Cycle, period: Duration, stats: &mut StatsWriter, stop: &AtomicBool) {
    let scope = takt_rt::alloc::enter_real_time();
    takt_rt::cycle::run_cycles(period, None, stats, |tick| {
        let moment = Moment {
            cycle: tick.index + 1,
            time: Nanos(tick.scheduled.0),
            wall: Nanos(tick.woken.0),
            every: 1,
            cancel: false,
            takeover: false,
        };
        cycle.run(moment);
        if stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    drop(scope);
}

/// Most commands taken in one cycle; the rest waits for the next.
const COMMANDS_A_CYCLE: usize = 16;

struct Cycle {
    executor: Executor,
    /// By device number.
    arms: Vec<Option<Box<ArmEnd>>>,
    period: takt_rt::Nanos,
    commands: Consumer<Command>,
    events: Producer<Event>,
    hand_over: Recorder,
    tap: Option<Tap>,
}

impl Cycle {
    fn run(&mut self, moment: Moment) {
        self.read_devices();
        for _ in 0..COMMANDS_A_CYCLE {
            let Some(command) = self.commands.pop() else {
                break;
            };
            self.obey(command);
        }
        for net in self.executor.running() {
            let received = net.receive();
            if let (true, Some(tap)) = (received, &mut self.tap) {
                tap.inbox(net);
            }
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
        self.executor.cycle(moment);
        self.write_devices(moment);
        let tap = &mut self.tap;
        self.executor.publish(|net| {
            if let Some(tap) = tap {
                tap.outbox(net);
            }
        });
        self.executor.fire_rules();
        self.tell_effects();
        self.hand_back();
        if let Some(tap) = &mut self.tap {
            tap.outputs(moment, &self.executor);
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
            | Command::Unschedule { .. }
            | Command::Forget(_)) => self.obey_rule(rule),
            Command::AddArm(end) => self.add_arm(end),
            Command::RemoveArm(number) => self.remove_arm(number),
        }
    }

    fn add_arm(&mut self, end: Box<ArmEnd>) {
        if let Some(slot) = self.arms.get_mut(end.number) {
            self.executor.use_joints(end.first_joint + end.joints);
            *slot = Some(end);
            // A net may start in this very cycle.
            self.read_devices();
        }
    }

    fn remove_arm(&mut self, number: usize) {
        if let Some(end) = self.arms.get_mut(number).and_then(Option::take) {
            self.executor.set_device(number, DeviceView::default());
            self.tell(Event::ArmRemoved(end));
        }
    }

    fn start(&mut self, net: Box<Running>) {
        let id = net.id;
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
                match self.executor.add_rule(rule) {
                    Ok(()) => self.tell(Event::RuleAdded(id)),
                    Err((rule, why)) => self.tell(Event::RuleRefused(rule, why)),
                }
            }
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
            | Command::AddArm(_)
            | Command::RemoveArm(_) => {}
        }
    }

    /// Tells what rules did in this cycle.
    fn tell_effects(&mut self) {
        let Self {
            executor,
            events,
            tap,
            ..
        } = self;
        executor.rule_effects(|id, effect| {
            if let Some(tap) = tap {
                match effect {
                    Effect::Stopped => tap.stopped(id),
                    Effect::Cancelled => tap.cancelled(id),
                    Effect::Started => tap.started(id),
                }
            }
            let event = match effect {
                Effect::Stopped => return,
                Effect::Cancelled => Event::Cancelling(id),
                Effect::Started => Event::Started(id),
            };
            let told = events.push(event);
            debug_assert!(told.is_ok(), "more events than requests");
        });
        while executor.take_rule(|rule| match events.push(Event::RuleDone(rule)) {
            Err(Event::RuleDone(rule)) => Err(rule),
            _ => Ok(()),
        }) {}
    }

    /// There is room: see [`EVENTS`].
    fn tell(&mut self, event: Event) {
        let told = self.events.push(event);
        debug_assert!(told.is_ok(), "more events than requests");
    }

    fn read_devices(&mut self) {
        let executor = &mut self.executor;
        for arm in self.arms.iter_mut().flatten() {
            let (number, first, joints) = (arm.number, arm.first_joint, arm.joints);
            let mut take = |state: &ArmState| {
                let view = DeviceView {
                    status: state.status,
                    faults: state.faults,
                };
                executor.set_device(number, view);
                let joints = &executor.image.joints[first..first + joints];
                for (joint, told) in joints.iter().zip(&state.joints) {
                    joint.state.set(*told);
                }
            };
            match &mut arm.driver {
                ArmDriver::Cells { state, .. } => state.read_with(take),
                ArmDriver::Simulated(simulation) => take(simulation.state()),
            }
        }
    }

    /// Hands set-points to all drivers, one right after the other.
    fn write_devices(&mut self, moment: Moment) {
        let time = takt_rt::Nanos(moment.time.0);
        let period_ns = self.period.0;
        let (mut first, mut last) = (None, takt_rt::Nanos::ZERO);
        for arm in self.arms.iter_mut().flatten() {
            let joints = &self.executor.image.joints[arm.first_joint..][..arm.joints];
            let mut commanded = false;
            for (joint, set_points) in joints.iter().zip(&mut arm.set_points) {
                let command = joint.command.get();
                let given = command.cycle == moment.cycle;
                commanded |= given;
                // A set-point of a slower net stands until that net gives the next.
                if given || moment.cycle - command.cycle >= command.every {
                    let position = command.position;
                    set_points.advance(given.then_some(SetPoint { time, position }));
                    set_points.period =
                        takt_rt::Nanos(period_ns * command.every.max(1).cast_signed());
                }
            }
            let set_points = &arm.set_points;
            match &mut arm.driver {
                ArmDriver::Cells { command, .. } => command.write_with(|command| {
                    command.time = time;
                    command.joints = *set_points;
                }),
                ArmDriver::Simulated(simulation) => {
                    simulation.step(set_points, time, self.period);
                }
            }
            if commanded {
                last = takt_rt::monotonic();
                first.get_or_insert(last);
            }
        }
        if let Some(first) = first {
            self.hand_over.record(last - first);
        }
    }

    fn hand_back(&mut self) {
        let Self {
            executor,
            events,
            tap,
            ..
        } = self;
        while executor.take_ended(|net, end| {
            let id = net.id;
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

/// How a joint's state is laid out in a recording: error, then six values with a word before each
/// that is 1 if it is known.
pub(crate) const JOINT_WORDS: usize = 13;

/// Writes a joint's state as words.
pub(crate) fn joint_words(state: &JointState) -> [u64; JOINT_WORDS] {
    let values = [
        state.commanded_position,
        state.commanded_velocity,
        state.commanded_acceleration,
        state.measured_position,
        state.measured_velocity,
        state.measured_acceleration,
    ];
    let mut words = [0; JOINT_WORDS];
    words[0] = u64::from(state.error.cast_unsigned());
    for (pair, value) in words[1..].chunks_exact_mut(2).zip(values) {
        pair[0] = u64::from(value.is_some());
        pair[1] = value.unwrap_or(0.0).to_bits();
    }
    words
}

/// Reads a joint's state back.
pub(crate) fn joint_state(words: &[u64]) -> Option<JointState> {
    let value = |i: usize| {
        let pair = words.get(1 + 2 * i..3 + 2 * i)?;
        Some((pair[0] != 0).then(|| f64::from_bits(pair[1])))
    };
    Some(JointState {
        error: u32::try_from(*words.first()?).ok()?.cast_signed(),
        commanded_position: value(0)?,
        commanded_velocity: value(1)?,
        commanded_acceleration: value(2)?,
        measured_position: value(3)?,
        measured_velocity: value(4)?,
        measured_acceleration: value(5)?,
    })
}
