//! Machines in a controller, and in virtual time: the paper's machine with its six components, requests and refusals, ends in
//! every state, recordings.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod fixtures;

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use fixtures::{Fixture, arm_parameters};
use takt_core::cell::OnLoss;
use takt_core::controller::{MachineInfo, MachineRequest, NetState};
use takt_core::executor::machines::{Hosted, InputError, MachineInput, MachineView, Seat};
use takt_core::record::{Recorder, replay};
use takt_core::stop_channel::Origin;
use takt_core::{CellConfig, Controller};
use takt_machine::machine::Status;
use takt_machine::{Control, Phase, Program, Request};
use takt_rt::alloc::real_time_allocations;
use takt_rt::latest::LatestReader;
use takt_tests::CountingAllocator;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Tests that count allocations, or need the processor, run one after the other.
static ALONE: Mutex<()> = Mutex::new(());

const STATES: [&str; 5] = [
    "StartRobot",
    "CalibrateOffsets",
    "InitializationSequence",
    "MoveRobot",
    "StopRobot",
];

fn alone() -> impl Drop {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn example(name: &str) -> MachineRequest {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/machine");
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let text = read(name);
    let files = text.lines().filter_map(|line| {
        let (_, rest) = line.split_once(" from \"")?;
        Some(rest.split_once('"')?.0.to_owned())
    });
    MachineRequest {
        files: files.map(|file| (file.clone(), read(&file))).collect(),
        text,
        ..MachineRequest::default()
    }
}

fn controller() -> Controller {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    Controller::start(&cell).unwrap()
}

fn until(what: &str, mut done: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(30);
    while !done() {
        assert!(Instant::now() < end, "{what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Runs until a machine is in a state, or beyond it in the order of the text.
fn reach(controller: &Controller, name: &str, state: &str) {
    let wanted = STATES.iter().position(|one| *one == state);
    until(state, || {
        let now = controller.machine(name).unwrap();
        let now = STATES.iter().position(|one| *one == now.state());
        now >= wanted
    });
}

fn no_component_runs(controller: &Controller) -> bool {
    let nets = controller.nets().into_iter();
    let mut states = nets.filter_map(|net| Some(controller.net(net)?.state()));
    states.all(|state| !matches!(state, NetState::Running | NetState::Cancelling))
}

/// A machine of one component, a clock that counts.
fn counter(machine: &str) -> MachineRequest {
    let component = "component Counter {
          property step: int range 0 .. 10 default 1 live;
          property first: int range 0 .. 100 default 0;
          property label: string default 'none';
          in bias: int;
          out count: int; out label_out: bool;
          operation clear(to: int range 0 .. 100) done label_out;
        }
        { step=Core::IntNetcommIn(Key='step', Value='$step'), bias=Core::IntNetcommIn(Key='bias'),
          first=Core::IntValue(Value='$first'), calls=Core::IntNetcommIn(Key='clear'),
          to=Core::IntNetcommIn(Key='clear_to'),
          sum=Core::IntAdd(inFirst=step.outValue, inSecond=bias.outValue),
          more=Core::IntAdd(inFirst=sum.outValue, inSecond=first.outValue),
          all=Core::IntAdd(inFirst=more.outValue, inSecond=to.outValue),
          count=Core::IntNetcommOut(inValue=all.outValue, Key='count'),
          label=Core::StringValue(Value='$label'),
          any=Core::IntGreater(inFirst=calls.outValue, Second='0'),
          label_out=Core::BooleanNetcommOut(inValue=any.outValue, Key='label_out'),
          cancel=Cancel(), outTerminate=cancel.outCancel }";
    let component = component
        .replace("label=Core::StringValue(Value='$label'),", "")
        .replace("property label: string default 'none';", "");
    MachineRequest {
        text: machine.to_owned(),
        files: vec![("c".to_owned(), component)],
        ..MachineRequest::default()
    }
}

const RESTARTS: &str = "machine Restarts {
      component c from \"c\" configured;
      event off;
      initial state A { entry { start c; } transition on off to Z; transition if c.count > 0 to B; }
      state B { entry { stop c; wait 150ms; start c; } transition on off to Z; transition if c.count > 0 to A
        { stop c; } }
      final state Z { entry { stop c; } }
    }";

fn run_whole(controller: &Controller, name: &str) -> MachineInfo {
    controller.start_machine(name).unwrap();
    until("the machine ends", || {
        controller.machine(name).unwrap().status() != Status::Active
    });
    controller.machine(name).unwrap()
}

#[test]
fn lola_runs_in_controller_to_its_final_state() {
    let _alone = alone();
    let controller = controller();
    let name = controller.load_machine(&example("lola.machine")).unwrap();
    let before = real_time_allocations();
    let end = run_whole(&controller, &name);
    assert_eq!(end.failure(0), None);
    assert_eq!((end.status(), end.state()), (Status::Finished, "StopRobot"));
    assert_eq!(end.view.transitions, 4);
    assert!(end.view.phases.iter().all(|phase| *phase != Phase::Running));
    assert_eq!(real_time_allocations() - before, 0);
    controller.end_machine(&name).unwrap();
    until("all nets of the machine are unloaded", || {
        controller.nets().is_empty()
    });
}

#[test]
fn machine_recording_replays_byte_for_byte() {
    let _alone = alone();
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("machine.mcap");
    let record = || -> Result<u64, takt_core::Error> {
        let mut cell = CellConfig::default();
        cell.controller.priority = None;
        let recording = Some(Recorder::start(&path).unwrap());
        let controller = Controller::start_recording(&cell, recording).unwrap();
        let mut lola = example("lola.machine");
        lola.properties = vec![("servo".to_owned(), "gain = 40.0".to_owned())];
        let name = controller.load_machine(&lola).unwrap();
        controller.start_machine(&name).unwrap();
        reach(&controller, &name, "MoveRobot");
        controller
            .command_machine(&name, "servo.gain := 60")
            .unwrap();
        until("the machine ends", || {
            controller.machine(&name).unwrap().status() != Status::Active
        });
        controller.end_machine(&name).unwrap();
        let restarts = controller.load_machine(&counter(RESTARTS)).unwrap();
        controller.start_machine(&restarts).unwrap();
        std::thread::sleep(Duration::from_millis(300));
        controller.command_machine(&restarts, "raise off").unwrap();
        std::thread::sleep(Duration::from_millis(50));
        controller.finish_recording().map(Option::unwrap)
    };
    let mut attempts = (0..3).map(|_| record());
    let cycles = attempts.find_map(Result::ok).unwrap();
    let first = replay(&path).unwrap();
    assert_eq!((first.differs, first.cycles), (None, cycles));
    assert!(cycles > 500, "{cycles}");
    // Viewers see each change of a state.
    let bytes = std::fs::read(&path).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap();
    let mut states = messages
        .map(Result::unwrap)
        .filter(|message| message.channel.topic == "/takt/machine_events");
    let mut has = |text: &str| {
        let holds = |data: &[u8]| data.windows(text.len()).any(|part| part == text.as_bytes());
        states.any(|message| holds(&message.data))
    };
    for text in [
        "added",
        "StartRobot",
        "MoveRobot",
        "StopRobot",
        "removed",
        "Restarts",
    ] {
        assert!(has(text), "{text}, in this order");
    }
    assert_eq!(replay(&path).unwrap(), first);
}

#[test]
fn machine_ended_in_each_state_leaves_nothing() {
    let _alone = alone();
    for state in STATES {
        for client_is_lost in [false, true] {
            let controller = controller();
            let session = controller.open_session_with("client", OnLoss::End).unwrap();
            let request = MachineRequest {
                session: session.0,
                ..example("lola.machine")
            };
            let name = controller.load_machine(&request).unwrap();
            controller.start_machine(&name).unwrap();
            reach(&controller, &name, state);
            if client_is_lost {
                controller.end_session(session).unwrap();
            } else {
                controller.end_machine(&name).unwrap();
            }
            assert!(no_component_runs(&controller), "{state}");
            assert!(controller.machines().is_empty());
            until("all nets are unloaded", || controller.nets().is_empty());
            // The name is free again.
            controller.load_machine(&example("lola.machine")).unwrap();
        }
    }
}

const STOPS: &str = "machine Stops {
      component c from \"c\" started;
      stop on end within TIME;
      initial state A { transition if false to Z; }
      final state Z { entry { wait 100ms; stop c; } }
    }";

#[test]
fn machine_end_by_stop_runs_final_state() {
    let _alone = alone();
    let controller = controller();
    for by_client in [false, true] {
        let session = controller.open_session_with("client", OnLoss::End).unwrap();
        let request = MachineRequest {
            session: session.0,
            ..counter(&STOPS.replace("TIME", "19s"))
        };
        let name = controller.load_machine(&request).unwrap();
        controller.start_machine(&name).unwrap();
        let ending = controller.clone();
        let ended = std::thread::spawn({
            let name = name.clone();
            move || {
                if by_client {
                    ending.end_session(session)
                } else {
                    ending.end_machine(&name)
                }
            }
        });
        until("the final state", || {
            controller.machine(&name).is_ok_and(|it| it.state() == "Z")
        });
        assert_eq!(controller.machines_end_within(), Duration::from_secs(19));
        ended.join().unwrap().unwrap();
        assert!(controller.machines().is_empty() && no_component_runs(&controller));
        until("all nets are unloaded", || controller.nets().is_empty());
    }
}

#[test]
fn machine_end_by_stop_is_limited() {
    let _alone = alone();
    let controller = controller();
    let text = STOPS.replace("TIME", "30ms").replace("100ms", "1000s");
    let name = controller.load_machine(&counter(&text)).unwrap();
    controller.start_machine(&name).unwrap();
    controller.end_machine(&name).unwrap();
    assert!(controller.machines().is_empty() && no_component_runs(&controller));
}

#[test]
fn machine_wound_down_runs_final_state() {
    let _alone = alone();
    let controller = controller();
    let request = counter(&STOPS.replace("TIME", "19s"));
    let name = controller.load_machine(&request).unwrap();
    controller.start_machine(&name).unwrap();
    controller.close();
    let mut was_in_final_state = false;
    until("it ended", || {
        let is_over = controller.wind_down(&controller.nets());
        was_in_final_state |= controller.machine(&name).is_ok_and(|it| it.state() == "Z");
        is_over
    });
    assert!(was_in_final_state);
}

#[test]
fn machine_starts_component_again_and_again() {
    let _alone = alone();
    let controller = controller();
    let name = controller.load_machine(&counter(RESTARTS)).unwrap();
    controller.start_machine(&name).unwrap();
    until("twenty restarts", || {
        let info = controller.machine(&name).unwrap();
        assert_eq!(info.failure(0), None);
        info.view.transitions > 20
    });
    assert!(controller.nets().len() < 20, "{}", controller.nets().len());
    controller.command_machine(&name, "raise off").unwrap();
    until("it finishes", || {
        controller.machine(&name).unwrap().status() == Status::Finished
    });
}

const HOLD: &str = "machine Hold {
      component c from \"c\" started;
      param wanted: int = 1;
      event go; event bad;
      initial state A { transition on go to B; }
      state B { run { c.bias := wanted; yield; } transition on bad to C; }
      state C { entry { c.step := wanted * 20; } transition on go to D; }
      final state D { entry { stop c; } }
    }";

fn count(controller: &Controller, name: &str) -> String {
    let net = controller.machine(name).unwrap().view.nets[0].unwrap();
    let values = controller.out_values(takt_core::NetId(net));
    let found = values.into_iter().find(|(key, _)| key == "outcount");
    found.map_or_else(String::new, |(_, text)| text)
}

#[test]
fn machine_commands_set_call_and_are_refused() {
    let _alone = alone();
    let controller = controller();
    let mut request = counter(HOLD);
    request.parameters = vec![("wanted".to_owned(), "5".to_owned())];
    request.properties = vec![("c".to_owned(), "first = 20".to_owned())];
    let name = controller.load_machine(&request).unwrap();
    until("properties of the file", || {
        count(&controller, &name) == "21"
    });
    controller
        .command_machine(&name, "c.step := 3; c.clear(4)")
        .unwrap();
    until("a live property and a call", || {
        count(&controller, &name) == "27"
    });
    controller.start_machine(&name).unwrap();
    controller.command_machine(&name, "raise go").unwrap();
    until("the machine writes a port", || {
        count(&controller, &name) == "32"
    });
    for (command, cause) in [
        ("c.step := 11", "11 is not in the range 0 to 10"),
        (
            "c.first := 1",
            "it cannot change while the component is running",
        ),
        ("c { step := 4; first := 1 }", "it cannot change while"),
        ("c.clear(101)", "101 is not in the range 0 to 100"),
        (
            "c.start()",
            "`start` is not allowed while the component is running",
        ),
        (
            "Hold.activate()",
            "`activate` is not possible while the machine is",
        ),
        (
            "c.step := 2; c.sted := 2",
            "the component has no such property",
        ),
        ("d.step := 2", "there is no component or machine `d`"),
    ] {
        let refused = controller.command_machine(&name, command).unwrap_err();
        let text = refused.to_string();
        assert!(text.contains(cause), "{command}: {text}");
        assert!(text.contains("hint: "), "{command}: {text}");
    }
    // The first of two commands was executed, the second refused.
    until("a command before a refused one", || {
        count(&controller, &name) == "31"
    });
    let file = controller.machine_properties(&name, "c").unwrap().to_toml();
    assert!(file.contains("step") && file.contains("first"), "{file}");
    assert!(controller.machine_properties(&name, "x").is_err());
    assert!(matches!(
        controller.load_machine(&counter(HOLD)),
        Err(takt_core::Error::MachineTwice(_))
    ));
}

#[test]
fn machine_failure_stops_its_components() {
    let _alone = alone();
    let controller = controller();
    let name = controller.load_machine(&counter(HOLD)).unwrap();
    controller.start_machine(&name).unwrap();
    controller.command_machine(&name, "raise go").unwrap();
    until("B", || controller.machine(&name).unwrap().state() == "B");
    controller.command_machine(&name, "raise bad").unwrap();
    until("it fails", || {
        controller.machine(&name).unwrap().status() == Status::Failed
    });
    let failure = controller.machine(&name).unwrap().failure(0).unwrap();
    assert!(failure.starts_with("in state C (line 7): "), "{failure}");
    until("no component runs", || no_component_runs(&controller));
    assert_eq!(
        controller.machine(&name).unwrap().view.phases[0],
        Phase::Stopped
    );
}

#[test]
fn machine_component_aborted_is_an_error() {
    let _alone = alone();
    let controller = controller();
    let name = controller.load_machine(&counter(HOLD)).unwrap();
    controller.start_machine(&name).unwrap();
    until("it is active", || {
        controller.machine(&name).unwrap().status() == Status::Active
    });
    let waiting = controller.nets().into_iter().find(|net| {
        controller
            .net(*net)
            .is_some_and(|net| net.state() == NetState::Scheduled)
    });
    let refused = controller.start_net(waiting.unwrap()).unwrap_err();
    assert!(
        refused.to_string().contains("waits for its machine"),
        "{refused}"
    );
    let net = controller.machine(&name).unwrap().view.nets[0].unwrap();
    controller.abort(takt_core::NetId(net)).unwrap();
    until("it fails", || {
        controller.machine(&name).unwrap().status() == Status::Failed
    });
    let info = controller.machine(&name).unwrap();
    assert_eq!(info.view.phases[0], Phase::RunTimeError);
    let failure = info.failure(0).unwrap();
    let cause = format!(": {} ended: aborted\nhint: ", takt_core::NetId(net));
    assert!(failure.contains(&cause), "{failure}");
}

#[test]
fn machine_under_stop_fails_and_starts_nothing() {
    let _alone = alone();
    let controller = controller();
    let name = controller.load_machine(&counter(HOLD)).unwrap();
    controller.start_machine(&name).unwrap();
    let switch = controller.stop_switch();
    switch.stop(Origin::Program);
    until("it fails", || {
        controller.machine(&name).unwrap().status() == Status::Failed
    });
    until("no component runs", || no_component_runs(&controller));
    assert!(switch.release());
    let refused = controller.start_machine(&name).unwrap_err().to_string();
    assert!(
        refused.contains("stopped since the machine was loaded"),
        "{refused}"
    );
    controller.end_machine(&name).unwrap();
    controller.load_machine(&counter(HOLD)).unwrap();
}

#[test]
fn machine_with_bad_parts_is_refused_whole() {
    let _alone = alone();
    let controller = controller();
    let mut missing = example("lola.machine");
    missing.files.pop();
    let mut range = example("lola.machine");
    range.properties = vec![("servo".to_owned(), "gain = 900.0".to_owned())];
    let mut parameter = example("lola.machine");
    parameter.parameters = vec![("was_calibrated".to_owned(), "7".to_owned())];
    let mut name = example("lola.machine");
    name.parameters = vec![("was_calibratd".to_owned(), "true".to_owned())];
    let mut cpf = example("lola.machine");
    cpf.properties = vec![(
        "servo".to_owned(),
        "<properties><simp</properties>".to_owned(),
    )];
    let mut net = counter(HOLD);
    net.files[0].1 = net.files[0]
        .1
        .replace("more=Core::IntAdd", "more=Core::IntAd");
    for (request, cause) in [
        (missing, "was not sent with the machine"),
        (range, "900 is not in the range 0 to 200"),
        (parameter, "parameter `was_calibrated`: `7` is not a bool"),
        (name, "the machine has no parameter `was_calibratd`"),
        (cpf, "properties of servo"),
        (net, "Core::IntAd"),
    ] {
        let refused = controller.load_machine(&request).unwrap_err().to_string();
        assert!(refused.contains(cause), "{refused}");
        assert!(refused.contains("hint: "), "{refused}");
        assert!(controller.machines().is_empty());
        assert!(controller.nets().is_empty(), "{:?}", controller.nets());
    }
}

#[test]
fn machine_beyond_cycle_time_is_refused_with_figures() {
    let _alone = alone();
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    cell.controller.period = Duration::from_micros(100);
    let controller = Controller::start(&cell).unwrap();
    let many: Vec<String> = (0..200)
        .map(|n| format!("component c{n} from \"c\"; "))
        .collect();
    let many = format!(
        "machine Many {{ {} initial state A {{ transition to Z; }} final state Z {{ }} }}",
        many.concat()
    );
    let refused = controller.load_machine(&counter(&many)).unwrap_err();
    let text = refused.to_string();
    assert!(
        text.contains("costs up to") && text.contains("its step and all its components"),
        "{text}"
    );
    assert!(controller.nets().is_empty());
}

/// A machine that starts a motion of an arm on an event.
const MOVES: &str = "machine Moves {
      component axis from \"axis\" configured;
      event go;
      initial state Rest { transition on go to Move; }
      state Move { entry { start axis; } transition on go to Rest { stop axis; } transition if false to End; }
      final state End { entry { stop axis; } }
    }";

#[test]
fn machine_state_change_reaches_set_point_next_cycle() {
    let axis = "component Axis { out moved: double unit \"rad\"; }
        { clock=Core::Clock(), way=Core::DoubleMultiply(inFirst=clock.outValue, Second='0.01'),
          j=RobotArm::JointPosition(inPosition=way.outValue, Robot='arm', Axis='0'),
          moved=Core::DoubleNetcommOut(inValue=way.outValue, Key='moved'),
          cancel=Cancel(), outTerminate=cancel.outCancel }";
    let library = |_: &str| Ok(axis.to_owned());
    let compiled = Program::compile(MOVES, &library);
    let program = Arc::new(
        compiled
            .map_err(|found| found.render("m", MOVES))
            .unwrap()
            .0,
    );
    let mut bench = Fixture::default();
    bench.add("arm", "kuka_lwr_sim", &arm_parameters(7, &[]));
    bench.steps(2);
    let (hosted, mut view) = Hosted::new(1, Arc::clone(&program));
    bench
        .executor
        .add_machine(hosted)
        .map_err(|(_, why)| why)
        .unwrap();
    let component = &program.members()[0].component;
    for (number, id) in [10, 11].into_iter().enumerate() {
        let mut net = bench.make(id, &component.net, 1);
        let seat = Seat::of(&program, (1, 0), component, &net.plan);
        net.seat = Some(Box::new(seat));
        assert!(bench.executor.seat(net, number == 0).is_ok());
    }
    let ask = |bench: &mut Fixture, input| bench.executor.machine_input(1, &input);
    ask(&mut bench, MachineInput::Control(0, Control::Activate)).unwrap();
    bench.steps(3);
    let is_commanded = |bench: &Fixture| {
        let command = bench.executor.image.joints[0].command.get();
        command.every > 0 && command.cycle == bench.cycle
    };
    for _ in 0..2 {
        ask(&mut bench, MachineInput::Raise(1)).unwrap();
        bench.step();
        // The state has changed at the end of this cycle.
        assert_eq!(view.read_with(|view| view.machines[0].state), Some(1));
        assert!(!is_commanded(&bench));
        bench.step();
        assert!(is_commanded(&bench), "the set-point of the next cycle");
        bench.steps(5);
        ask(&mut bench, MachineInput::Raise(1)).unwrap();
        bench.step();
        assert_eq!(view.read_with(|view| view.phases[0]), Phase::Stopped);
        bench.step();
        assert!(!is_commanded(&bench), "withdrawn with its net");
    }
    // Both nets are used, and no controller loads others.
    ask(&mut bench, MachineInput::Raise(1)).unwrap();
    bench.steps(2);
    assert_eq!(
        view.read_with(|view| view.machines[0].status),
        Status::Failed
    );
    let refused = ask(&mut bench, MachineInput::Request(0, Request::Start));
    assert!(
        refused
            .unwrap_err()
            .to_string()
            .contains("no net of the component is ready")
    );
}

/// A machine over one component, in its thread; the component in that state.
fn component_in(phase: Phase) -> (Fixture, LatestReader<MachineView>) {
    let net = "component C { out yes: bool; } { y=Core::BooleanValue(Value='true'),
          yes=Core::BooleanNetcommOut(inValue=y.outValue, Key='yes'), cancel=Cancel(), outTerminate=cancel.outCancel }";
    let text = "machine M { component c from \"c\" configured; initial final state A { entry { stop c; } } }";
    let library = |_: &str| Ok(net.to_owned());
    let program = Arc::new(Program::compile(text, &library).unwrap().0);
    let mut bench = Fixture::default();
    let (hosted, view) = Hosted::new(1, Arc::clone(&program));
    let added = bench.executor.add_machine(hosted);
    added.map_err(|(_, why)| why).unwrap();
    if phase == Phase::PreOperational {
        return (bench, view);
    }
    let component = &program.members()[0].component;
    for id in [10, 11] {
        let mut net = bench.make(id, &component.net, 1);
        net.seat = Some(Box::new(Seat::of(&program, (1, 0), component, &net.plan)));
        assert!(bench.executor.seat(net, id == 10).is_ok());
    }
    if phase != Phase::Stopped {
        request(&mut bench, Request::Start).unwrap();
        bench.step();
    }
    if phase == Phase::RunTimeError {
        bench.executor.abort(10);
        bench.step();
    }
    (bench, view)
}

fn request(bench: &mut Fixture, request: Request) -> Result<(), InputError> {
    let input = MachineInput::Request(0, request);
    bench.executor.machine_input(1, &input)
}

#[test]
fn component_every_cell_starts_and_stops_nets() {
    // No net and no device reports a fatal error yet.
    let phases = [
        Phase::PreOperational,
        Phase::Stopped,
        Phase::Running,
        Phase::RunTimeError,
    ];
    for phase in phases {
        for asked in Request::ALL {
            let (mut bench, mut view) = component_in(phase);
            let mut seen = |bench: &mut Fixture| {
                bench.step();
                view.read_with(|view| (view.phases[0], view.nets[0].is_some()))
            };
            let is_running = phase == Phase::Running;
            assert_eq!(seen(&mut bench), (phase, is_running), "{phase}");
            let result = request(&mut bench, asked);
            if matches!(asked, Request::Error | Request::Fatal) {
                assert!(result.is_err(), "only nets report it");
                continue;
            }
            // A `configure` is complete once its net is loaded, which needs a controller.
            let after = phase.after(asked).unwrap_or(phase);
            let after = if asked == Request::Configure {
                phase
            } else {
                after
            };
            assert_eq!(
                result.is_ok(),
                phase.after(asked).is_ok(),
                "{phase} {asked:?}"
            );
            let runs = after == Phase::Running;
            assert_eq!(seen(&mut bench), (after, runs), "{phase} {asked:?}");
            // The net is evaluated from the next cycle on, or no longer.
            let is_evaluated = bench.executor.running().len() == usize::from(runs);
            assert!(is_evaluated, "{phase} {asked:?}");
        }
    }
}

#[test]
fn machine_inputs_as_words_are_lossless() {
    use takt_machine::Value;
    let list =
        std::array::from_fn(|n| (n, Value::Double(f64::from(u32::try_from(n).unwrap()) / 3.0)));
    let values = std::array::from_fn(|n| {
        if n == 1 {
            Value::Int(-7)
        } else {
            Value::Bool(n == 0)
        }
    });
    let mut inputs = vec![
        MachineInput::Raise(3),
        MachineInput::Enter(1, 4),
        MachineInput::Parameter(2, Value::Int(i32::MIN)),
        MachineInput::Set(4, 8, list),
        MachineInput::Write(1, 2, Value::Bool(true)),
        MachineInput::Call(5, 6, 8, values),
    ];
    inputs.extend(Control::ALL.map(|control| MachineInput::Control(1, control)));
    inputs.extend(Request::ALL.map(|request| MachineInput::Request(2, request)));
    for input in inputs {
        assert_eq!(MachineInput::of_words(&input.words()), Some(input));
    }
    assert_eq!(MachineInput::of_words(&[9; 28]), None);
    assert_eq!(MachineInput::of_words(&[1, 0]), None);
}
