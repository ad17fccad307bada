//! A net thread's cycle without its thread and clock: which events are reported in which order, what is counted, and
//! what is recorded of that.

use std::cell::Cell;
use std::time::Duration;

use takt_net::Nanos;
use takt_rt::cycle::Grid;
use takt_rt::latest::LatestReader;
use takt_rt::ring::ring;
use takt_rt::servo::{Servo, ServoConfig, State};

use super::*;
use crate::device::{ArmDescription, DeviceCommand, DeviceTable};
use crate::executor::figures::RUNAWAY_AFTER;
use crate::executor::rules::{Literal, NetActions, Question, Step};
use crate::executor::serve::Driver;
use crate::executor::stop::EmergencyStop;
use crate::executor::tests::net;
use crate::ids::NetId;
use crate::record::replay;
use crate::stop_channel::{Origin, StopSwitch};

const PERIOD: takt_rt::Nanos = takt_rt::Nanos::from_millis(1);

/// Never ends by itself.
const ENDLESS: &str = "{never=Core::BooleanValue(),outTerminate=never.outValue}";
/// Ends in its first cycle.
const BRIEF: &str = "{yes=Core::BooleanValue(Value='true'),outTerminate=yes.outValue}";

thread_local! {
    /// The clock of a test, ns.
    static NOW: Cell<i64> = const { Cell::new(0) };
    /// By how much it goes on whenever it is read.
    static STEP: Cell<i64> = const { Cell::new(0) };
}

fn clock() -> takt_rt::Nanos {
    NOW.set(NOW.get() + STEP.get());
    takt_rt::Nanos(NOW.get())
}

struct Bench {
    cycle: Cycle,
    commands: Producer<Command>,
    events: Consumer<Event>,
    number: u64,
}

impl Bench {
    /// A thread whose clock goes on by so much at each reading.
    fn new(step: Duration, tap: Option<Tap>) -> Self {
        STEP.set(takt_rt::Nanos::from(step).0);
        let (commands, command_end) = ring(COMMANDS);
        let (event_end, events) = ring(EVENTS);
        let cycle = Cycle {
            flight: flight::of_nets().0,
            timing: flight::of_thread(Duration::from_millis(1)).0,
            executor: Executor::default(),
            served: Served::new(PERIOD, Recorder::new()),
            commands: command_end,
            events: Reports::new(event_end, Arc::default()),
            journal: Journal::new(tap).0,
            clock,
        };
        Self {
            cycle,
            commands,
            events,
            number: 0,
        }
    }

    /// Puts the thread under a switch, and gives that.
    fn switch(&mut self) -> StopSwitch {
        let switch = StopSwitch::default();
        switch.register(0, PERIOD);
        let stop = Arc::new(EmergencyStop::under(false, switch.clone()));
        self.cycle.served = Served::new(PERIOD, Recorder::new()).under(StopPart::new(stop, 0));
        switch
    }

    fn command(&mut self, command: Command) {
        self.commands.push(command).unwrap();
    }

    /// Starts `next` when net `after` ends by itself.
    fn follow(&mut self, after: u32, next: Box<Running>) {
        let literal = Literal {
            net: after,
            question: Question::Terminated,
            value: None,
            last: false,
        };
        let orders = NetActions {
            start: vec![next.id],
            ..NetActions::default()
        };
        let rule = Box::new(Rule::new(7, vec![literal], vec![Step::Literal(0)], orders));
        self.command(Command::Schedule(next));
        self.command(Command::AddRule(rule));
    }

    /// Runs a cycle that begins on time; returns the events it reported.
    fn run(&mut self) -> Vec<String> {
        self.number += 1;
        let time = takt_rt::Nanos(PERIOD.0 * self.number.cast_signed());
        NOW.set(time.0);
        self.run_slot(&Slot::of(
            &Tick {
                index: self.number,
                missed: 0,
                time,
                scheduled: time,
                woken: time,
                phase_error: None,
            },
            PERIOD,
        ))
    }

    /// Runs a cycle; returns the events it reported.
    fn run_slot(&mut self, slot: &Slot) -> Vec<String> {
        self.cycle.run(slot);
        let reported = std::iter::from_fn(|| self.events.pop());
        reported
            .map(|event| match event {
                Event::Started(id) => format!("started {id}"),
                Event::Ended(net, end) => format!("ended {} {end:?}", net.id),
                Event::RuleAdded(id) => format!("rule {id} added"),
                Event::RuleDone(rule) => format!("rule {} {:?}", rule.id, rule.state),
                Event::Cancelling(id) => format!("cancelling {id}"),
                Event::StartRejected(net, why) => format!("refused {} {why:?}", net.id),
                Event::RuleRejected(rule, why) => format!("rule {} {why:?}", rule.id),
                Event::Unscheduled(net) => format!("unscheduled {}", net.id),
                Event::DeviceRemoved(_) => "device removed".to_owned(),
                Event::MachineAdded(id) => format!("machine {id} added"),
                Event::MachineRejected(hosted, why) => format!("machine {} {why:?}", hosted.id),
                Event::MachineAnswered(id, number, result) => {
                    format!("machine {id} answer {number} {result:?}")
                }
                Event::Configure(id, component) => format!("machine {id} configure {component}"),
                Event::MachineStatus(id, status) => format!("machine {id} {status:?}"),
                Event::MachineRemoved(hosted) => format!("machine {} removed", hosted.id),
            })
            .collect()
    }
}

// The order of events.

#[test]
fn successor_start_is_reported_after_predecessor_end() {
    let mut bench = Bench::new(Duration::ZERO, None);
    bench.follow(0, net(1, ENDLESS));
    bench.command(Command::Start(net(0, BRIEF)));
    assert_eq!(
        bench.run(),
        [
            "rule 7 added",
            "started 0",
            "ended 0 Terminated",
            "started 1",
            "rule 7 Fired"
        ]
    );
}

#[test]
fn successor_ending_at_once_is_reported_started() {
    let mut bench = Bench::new(Duration::ZERO, None);
    bench.follow(0, net(1, BRIEF));
    bench.command(Command::Start(net(0, BRIEF)));
    bench.run();
    assert_eq!(bench.run(), ["ended 1 Terminated"]);
}

/// Cycles until sixteen commands are obeyed.
fn cycles_for(bench: &mut Bench, command: fn(u32) -> Command) -> usize {
    (0..16).for_each(|id| bench.command(command(id)));
    let mut cycles = 0;
    while bench.commands.free_slots() < COMMANDS {
        bench.run();
        cycles += 1;
    }
    cycles
}

#[test]
fn rule_reading_commands_are_spread_over_cycles() {
    let mut bench = Bench::new(Duration::ZERO, None);
    assert_eq!(cycles_for(&mut bench, Command::Forget), 1);
    let waits_for = Literal {
        net: 99,
        question: Question::Terminated,
        value: None,
        last: false,
    };
    let orders = NetActions {
        stop: (100..).take(WORK_MAX - 2).collect(),
        ..NetActions::default()
    };
    let rule = Rule::new(7, vec![waits_for], vec![Step::Literal(0)], orders);
    bench.cycle.executor.add_rule(Box::new(rule)).unwrap();
    assert_eq!(cycles_for(&mut bench, Command::Cancel), 1);
    assert_eq!(cycles_for(&mut bench, Command::Forget), 16);
}

// Figures.

#[test]
fn evaluations_are_measured_and_counted() {
    let mut bench = Bench::new(Duration::from_micros(300), None);
    let net = net(0, ENDLESS);
    let counters = Arc::clone(net.counters());
    assert_eq!(
        counters.read(),
        crate::executor::figures::NetCounts::default()
    );
    bench.command(Command::Start(net));
    for _ in 0..4 {
        bench.run();
    }
    STEP.set(850_000);
    bench.run();
    let counts = counters.read();
    assert_eq!((counts.cycles, counts.over_budget), (5, 1));
    assert_eq!(counts.min, Duration::from_micros(300));
    assert_eq!(counts.max, Duration::from_micros(850));
    assert_eq!(counts.mean, Duration::from_micros((4 * 300 + 850) / 5));
    // Three readings of 850 us take longer than the cycle had; those of 300 us do not.
    assert_eq!(counts.overruns, 1);
}

#[test]
fn overrun_counts_only_evaluated_nets() {
    let mut bench = Bench::new(Duration::from_micros(600), None);
    let (fast, mut slow) = (net(0, ENDLESS), net(1, ENDLESS));
    slow.set_every(4);
    let counters = [&fast, &slow].map(|net| Arc::clone(net.counters()));
    bench.command(Command::Start(fast));
    bench.command(Command::Start(slow));
    for _ in 0..8 {
        bench.run();
    }
    assert_eq!(counters.map(|counters| counters.read().overruns), [8, 2]);
}

// Runaway.

/// The cycles until a net ends whose evaluation takes so long, at most 50.
fn ends_after(took: Duration) -> (u32, Vec<String>) {
    let mut bench = Bench::new(took, None);
    bench.command(Command::Start(net(0, ENDLESS)));
    for cycle in 1..=50 {
        let mut reported = bench.run();
        reported.retain(|event| !event.starts_with("started"));
        if !reported.is_empty() {
            return (cycle, reported);
        }
    }
    (50, Vec::new())
}

#[test]
fn net_exceeding_period_repeatedly_is_ended() {
    let (cycle, reported) = ends_after(Duration::from_nanos(1_000_001));
    assert_eq!(
        (cycle, reported),
        (RUNAWAY_AFTER, vec!["ended 0 Runaway".to_owned()])
    );
    assert_eq!(ends_after(Duration::from_millis(1)), (50, vec![]));
}

#[test]
fn net_exceeding_period_occasionally_continues() {
    let mut bench = Bench::new(Duration::ZERO, None);
    let net = net(0, ENDLESS);
    let counters = Arc::clone(net.counters());
    bench.command(Command::Start(net));
    for cycle in 1..=10 * RUNAWAY_AFTER {
        STEP.set(if cycle % RUNAWAY_AFTER == 0 {
            0
        } else {
            5_000_000
        });
        assert!(bench.run().iter().all(|event| event == "started 0"));
    }
    assert_eq!(counters.read().over_budget, u64::from(9 * RUNAWAY_AFTER));
}

#[test]
fn runaway_net_replays_without_clock() {
    let path = std::env::temp_dir().join(format!("takt-runaway-{}.mcap", std::process::id()));
    let (recorder, tap) = crate::record::Recorder::start(&path).unwrap();
    let mut bench = Bench::new(Duration::from_millis(3), Some(tap));
    for (id, text) in [(0, ENDLESS), (1, BRIEF)] {
        let values = Arc::default();
        recorder.net(
            NetId(id),
            (1, Duration::from_millis(1)),
            &text.into(),
            &values,
        );
    }
    bench.command(Command::Start(net(0, ENDLESS)));
    let mut reported = Vec::new();
    for cycle in 0..2 * RUNAWAY_AFTER {
        if cycle == RUNAWAY_AFTER - 1 {
            bench.follow(0, net(1, BRIEF));
        }
        reported.extend(bench.run());
    }
    assert!(
        reported.contains(&"ended 0 Runaway".to_owned()),
        "{reported:?}"
    );
    assert!(
        reported.contains(&"rule 7 Inactive".to_owned()),
        "{reported:?}"
    );
    assert_eq!(recorder.finish().unwrap(), u64::from(2 * RUNAWAY_AFTER));
    let outcome = replay(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(
        (outcome.cycles, outcome.differs),
        (u64::from(2 * RUNAWAY_AFTER), None)
    );
}

// A device's clock.

/// How long after the robot's instants cycles are to begin.
const PHASE: takt_rt::Nanos = takt_rt::Nanos::from_micros(300);
/// By how much the robot's clock is fast, ppb.
const FAST_PPB: i64 = 80_000;

impl Bench {
    /// Serves an arm; returns where its driver takes commands.
    fn arm(&mut self) -> LatestReader<DeviceCommand> {
        let mut devices = DeviceTable::default();
        let (number, ports) = devices.add_arm(arm("left")).unwrap();
        let place = devices.get(number).unwrap().place.clone();
        let driver = Driver::Cells {
            state: ports.state,
            command: ports.command,
        };
        let end = Box::new(DeviceEnd::new(number, place, driver));
        self.command(Command::AddDevice(end));
        ports.driver_command
    }
}

/// An arm of seven joints.
fn arm(name: &str) -> ArmDescription {
    let limits = takt_net::JointLimits {
        position_min: -2.0,
        position_max: 2.0,
        velocity_max: 2.0,
        acceleration_max: 4.0,
    };
    ArmDescription {
        name: name.to_owned(),
        kind: "test",
        limits: vec![limits; 7],
        model: "".into(),
    }
}

/// The instant of the n-th measurement on this host's clock.
fn instant(n: i64) -> takt_rt::Nanos {
    takt_rt::Nanos(123_456 + n * PERIOD.0 - n * PERIOD.0 / 1_000 * FAST_PPB / 1_000_000)
}

#[test]
fn cycles_keep_phase_with_a_robot_whose_clock_drifts() {
    let mut bench = Bench::new(Duration::ZERO, None);
    let mut commands = bench.arm();
    let mut servo = Servo::new(&ServoConfig::new(PERIOD.try_into().unwrap()));
    let mut grid = Grid::new(takt_rt::Nanos::ZERO, PERIOD.try_into().unwrap());
    let (mut measured, mut locked) = (0, 0);
    for n in 0..20_000_i64 {
        let slot = Slot::of(&grid.next(grid.deadline()), PERIOD);
        while instant(measured) < slot.begin {
            // Datagrams come up to 60 us late.
            let late = takt_rt::Nanos(measured * 7_919 % 60_000);
            servo.handle_sample(
                instant(measured) + late,
                takt_rt::Nanos(measured * PERIOD.0),
            );
            measured += 1;
        }
        bench.run_slot(&slot);
        // To nets it is as late as ever, to the driver as late as it is on this host.
        assert_eq!(slot.moment.time, Nanos(n * PERIOD.0));
        assert_eq!(commands.read_with(|command| command.time), slot.begin);
        assert_eq!(slot.end - slot.begin, PERIOD);
        let clock = servo.estimate();
        if clock.state.is_followed() {
            grid.steer(&clock, PHASE);
        }
        if clock.state == State::Stable {
            locked += 1;
            let error = slot.begin - instant(measured - 1) - PHASE;
            // Half of the delay cannot be distinguished from phase.
            assert!(
                (error - takt_rt::Nanos(30_000)).abs() < takt_rt::Nanos(20_000),
                "{n}: {error}"
            );
        }
    }
    assert!(locked > 10_000, "{locked}");
    let gained = grid.deadline().0 - 20_000 * PERIOD.0;
    assert!(
        gained < -1_000_000,
        "the host's clock was followed: {gained}"
    );
}

// The stop of the whole controller.

#[test]
fn stop_ends_all_nets_in_one_cycle() {
    let mut bench = Bench::new(Duration::ZERO, None);
    let switch = bench.switch();
    bench.command(Command::Start(net(0, ENDLESS)));
    bench.command(Command::Start(net(1, ENDLESS)));
    bench.run();
    switch.stop(Origin::Program);
    assert!(switch.answers().all(|answer| !answer.is_applied));
    assert_eq!(bench.run(), ["ended 0 Halted", "ended 1 Halted"]);
    let answers: Vec<_> = switch.answers().collect();
    assert!(answers[0].is_applied && answers[0].nets == 2, "{answers:?}");
    // Once more changes nothing.
    switch.stop(Origin::Program);
    assert_eq!(bench.run(), [""; 0]);
}

#[test]
fn stopped_rules_never_fire() {
    let mut bench = Bench::new(Duration::ZERO, None);
    let switch = bench.switch();
    bench.follow(0, net(1, ENDLESS));
    bench.run();
    switch.stop(Origin::Program);
    assert_eq!(bench.run(), ["rule 7 FireFailed"]);
    let _ = switch.release();
    let mut first = net(0, BRIEF);
    first.requested = switch.generation();
    bench.run();
    bench.command(Command::Start(first));
    assert_eq!(bench.run(), ["started 0", "ended 0 Terminated"]);
    assert_eq!(bench.run(), [""; 0]);
    // Its net is given back when it is asked for.
    bench.command(Command::Unschedule {
        net: 1,
        always: false,
    });
    assert_eq!(bench.run(), ["unscheduled 1"]);
}

#[test]
fn request_from_before_stop_is_rejected() {
    let mut bench = Bench::new(Duration::ZERO, None);
    let switch = bench.switch();
    bench.run();
    // Both are under way while the stop comes and goes.
    bench.command(Command::Start(net(0, ENDLESS)));
    bench.follow(0, net(1, ENDLESS));
    switch.stop(Origin::Program);
    let _ = switch.release();
    assert_eq!(bench.run(), ["refused 0 Halted", "rule 7 Halted"]);
    bench.command(Command::StartScheduled(1));
    assert_eq!(bench.run(), ["refused 1 Halted"]);
    let mut again = net(2, ENDLESS);
    again.requested = switch.generation();
    bench.command(Command::Start(again));
    assert_eq!(bench.run(), ["started 2"]);
    switch.stop(Origin::Program);
    let mut late = net(3, ENDLESS);
    late.requested = switch.generation();
    bench.command(Command::Start(late));
    assert_eq!(bench.run(), ["refused 3 Halted", "ended 2 Halted"]);
}
