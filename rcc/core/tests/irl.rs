//! Programs in L-IRL on simulated arms and inputs and outputs: nets as `takt irl run` loads them, in cycles of 1 ms in virtual time.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod fixtures;

use fixtures::{Fixture, arm_parameters, parameters, watch};
use takt_core::executor::End;
use takt_irl::net::{Binding, Channel, net};
use takt_irl::{Program, System, compile};
use takt_tests::{Allocations, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const SPEC: &str = "
    [[robot]]
    name = 'arm'
    joints = [
      { min = -170, max = 170, speed = 400, acceleration = 400, jerk = 4000 },
      { min = -120, max = 120, speed = 400, acceleration = 400, jerk = 4000 },
      { min = -170, max = 170, speed = 400, acceleration = 400, jerk = 4000 },
      { min = -120, max = 120, speed = 400, acceleration = 400, jerk = 4000 },
      { min = -170, max = 170, speed = 400, acceleration = 400, jerk = 4000 },
      { min = -120, max = 120, speed = 400, acceleration = 400, jerk = 4000 },
      { min = -170, max = 170, speed = 400, acceleration = 400, jerk = 4000 },
    ]
    signal = [
      { name = 'ready', direction = 'in', kind = 'digital', channel = 0 },
      { name = 'grip', direction = 'out', kind = 'digital', channel = 0 },
      { name = 'count', direction = 'out', kind = 'binary', channel = 2 },
      { name = 'level', direction = 'in', kind = 'analog', channel = 0 },
    ]";

fn program(text: &str) -> Program {
    let system = SPEC.replace("    signal = [", "    \n    [none]\n    signal = [");
    let (robot, signals) = system.split_once("[none]").unwrap();
    let system = System::parse(&format!("{}\n{robot}", signals.trim())).unwrap();
    let compiled = compile(text, &system, SPEC);
    compiled
        .map_err(|rejection| rejection.render("test", text))
        .unwrap()
        .program
}

fn binding() -> Binding {
    let channel = |port| {
        Some(Channel {
            device: "io".to_owned(),
            port,
        })
    };
    Binding {
        arms: vec!["left".to_owned()],
        // The simulated inputs are connected to the outputs.
        channels: vec![channel(1), channel(1), None, None],
        values: vec![None, None, None, Some("2.5".to_owned())],
        watch: vec!["n".to_owned()],
        steps: 1_000,
        breakpoints: Vec::new(),
        speed: 1.0,
        is_held: false,
    }
}

fn cell() -> Fixture {
    let mut cell = Fixture::default();
    cell.add("left", "kuka_lwr_sim", &arm_parameters(7, &[]));
    cell.add("small", "kuka_youbot_arm_sim", &arm_parameters(5, &[]));
    cell.add("io", "io_sim", &parameters(&[]));
    cell.steps(20);
    cell
}

/// A net that shows where the first joint is commanded.
fn monitor() -> String {
    let joint = watch("Core::Double", "joint", "m.outCommandedPosition");
    format!("m=RobotArm::JointMonitor(Robot='left',Axis='0'),{joint}")
}

const MOVES: &str = "program moves;
var n: int; x: real;
signal in ready = \"ready\"; in level = \"level\";
signal out grip = \"grip\"; out count = \"count\";
begin
  n := 1;
  move ptp mainjoint(20, 30, 0, -40, 0, 10, 0) speed_ptp:=1 acc_ptp:=1;
  grip := true;
  wait for ready;
  n := 2;
  x := level;
  if x = 2.5 then count := 7; endif;
  move ptp mainjoint(0, 0, 0, 0, 0, 0, 0) speed_ptp:=1 acc_ptp:=1;
endprogram;
";

#[test]
fn program_moves_arm_and_signals_without_allocations() {
    let mut cell = cell();
    let text = net(&program(MOVES), &binding()).unwrap();
    cell.start(2, &monitor());
    cell.try_start(1, &text, 1).unwrap();
    let (mut farthest, mut speed, mut last) = (0.0_f64, 0.0_f64, 0.0_f64);
    let mut allocations = 0;
    loop {
        let counted = Allocations::count();
        cell.step();
        let counted = counted.end();
        if cell.ended.contains_key(&1) {
            // In this cycle the test drops the net.
            break;
        }
        allocations += counted;
        let joint = cell.number(2, "joint");
        farthest = farthest.max(joint);
        speed = speed.max((joint - last).abs() / 1e-3);
        last = joint;
        assert!(cell.cycle < 20_000, "line {}", cell.out(1, "line"));
    }
    assert_eq!(cell.ended[&1], End::Terminated);
    assert!((farthest.to_degrees() - 20.0).abs() < 1e-9, "{farthest}");
    assert!(last.abs() < 1e-6, "{last}");
    // The limits of the device are lower than those of the program.
    assert!(speed <= 2.0 + 1e-6, "{speed}");
    assert_eq!(cell.out(1, "watch"), "[2]");
    assert_eq!(cell.out(1, "signal_count"), "7");
    assert_eq!(cell.out(1, "signal_grip"), "true");
    assert_eq!(allocations, 0);
}

#[test]
fn program_output_before_its_end_reaches_device() {
    let mut cell = cell();
    let last = "program last;\nsignal out grip = \"grip\";\nbegin\n  grip := true;\nendprogram;\n";
    let binding = Binding {
        watch: Vec::new(),
        ..binding()
    };
    let text = net(&program(last), &binding).unwrap();
    cell.try_start(1, &text, 1).unwrap();
    cell.steps(50);
    assert_eq!(cell.ended[&1], End::Terminated);
    let state = watch("Core::Boolean", "grip", "m.outIO");
    cell.start(
        2,
        &format!("m=IO::OutBoolSensor(DeviceID='io',Port='1'),{state}"),
    );
    cell.steps(20);
    assert_eq!(cell.out(2, "grip"), "true");
}

#[test]
fn program_pauses_at_breakpoint_with_line_visible() {
    let mut cell = cell();
    let binding = Binding {
        breakpoints: vec![8],
        ..binding()
    };
    cell.try_start(1, &net(&program(MOVES), &binding).unwrap(), 1)
        .unwrap();
    cell.until(1, "state", "2");
    assert_eq!(cell.out(1, "line"), "8");
    cell.steps(1_000);
    assert_eq!(
        (cell.out(1, "watch"), cell.out(1, "line")),
        ("[1]".into(), "8".into())
    );
    let held = Binding {
        is_held: true,
        ..self::binding()
    };
    let mut cell = self::cell();
    cell.try_start(1, &net(&program(MOVES), &held).unwrap(), 1)
        .unwrap();
    cell.until(1, "state", "2");
    assert_eq!(cell.out(1, "line"), "6");
}

#[test]
fn program_for_other_arm_is_refused() {
    let cell = cell();
    let refused = |arm: &str, spec: &str| {
        let mut program = program(MOVES);
        if !spec.is_empty() {
            program.system.robots[0].model = spec.to_owned().into();
        }
        let binding = Binding {
            arms: vec![arm.to_owned()],
            ..binding()
        };
        cell.fault(&net(&program, &binding).unwrap())
    };
    let joints = refused("small", "");
    assert!(
        joints.contains("robot `arm` of the program has 7 joints, device `small` has 5"),
        "{joints}"
    );
    let unknown = refused("lift", "");
    assert!(
        unknown.contains("`lift`") && unknown.contains("left"),
        "{unknown}"
    );
    let count = binding_error(Vec::new());
    assert_eq!(count, "0 arms, but the program has 1");
    let name = binding_error(vec!["a', Code='".to_owned()]);
    assert!(name.contains("is not the name of a device"), "{name}");
}

fn binding_error(arms: Vec<String>) -> String {
    let binding = Binding { arms, ..binding() };
    net(&program(MOVES), &binding).unwrap_err().to_string()
}

#[test]
fn program_changed_byte_or_version_is_refused() {
    let cell = cell();
    let text = net(&program(MOVES), &binding()).unwrap();
    let at = text.find("Code='").unwrap() + 6;
    let changed = |at: usize, digits: &str| {
        let mut text = text.clone();
        text.replace_range(at..at + digits.len(), digits);
        cell.fault(&text)
    };
    let damaged = changed(at + 200, "fe");
    assert!(damaged.contains("the object code is damaged"), "{damaged}");
    let version = changed(at + 8, "ff");
    assert!(version.contains("version"), "{version}");
    let text = changed(at, "zz");
    assert!(text.contains("hexadecimal"), "{text}");
}

#[test]
fn program_fault_ends_its_net_with_location() {
    let mut config = takt_core::CellConfig::default();
    config.controller.priority = None;
    let controller = takt_core::Controller::start(&config).unwrap();
    let limits = arm_parameters(7, &[]);
    controller
        .add_device("left", "kuka_lwr_sim", &limits)
        .unwrap();
    controller
        .add_device("io", "io_sim", &parameters(&[]))
        .unwrap();
    let text = "program breaks;\nvar n, z: int;\nbegin\n  n := 1;\n  n := n div z;\nendprogram;";
    let net = controller
        .load(takt_core::controller::LoadRequest {
            text: net(&program(text), &binding()).unwrap(),
            session: takt_core::SessionId::NONE,
            description: String::new(),
            period: None,
        })
        .unwrap();
    let info = controller.net(net).unwrap();
    assert!(info.rejection.is_none(), "{:?}", info.rejection);
    controller.start_net(net).unwrap();
    let until = std::time::Instant::now() + std::time::Duration::from_secs(60);
    let end = loop {
        if let Some(end) = controller.net(net).unwrap().end {
            break end;
        }
        assert!(std::time::Instant::now() < until);
        std::thread::sleep(std::time::Duration::from_millis(2));
    };
    assert_eq!(
        end,
        "`program`: program breaks failed at 5:8: division by zero\nhint: compare the divisor with 0 before"
    );
}
