//! Commands of a net are withdrawn when it ends: every ending, every kind of command, every period, in virtual time.
//! Commands are checked where drivers receive them; simulated devices also by where they come to rest.

#![expect(
    clippy::float_cmp,
    clippy::unwrap_used,
    reason = "what rests does so to the bit; a test may fail anywhere, its helpers too"
)]

mod fixtures;

use fixtures::{Driven, Fixture, arm_parameters, parameters};
use takt_core::device::{DeviceDescription, DeviceState, DeviceStatus, Part, parts};
use takt_core::executor::End;
use takt_core::executor::rules::{Failure, RuleState};
use takt_net::device::{Devices, Interfaces, JointLimits, Layout, Target, is_in_force};

/// Periods, in cycles of the thread.
const PERIODS: [u64; 3] = [1, 10, 1000];
/// The net that ends.
const NET: u32 = 1;

/// A net that is scheduled to follow it when its client is lost or the controller shuts down.
const WAITS: u32 = 2;

/// How a net ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ending {
    Itself,
    Cancel,
    Abort,
    Rule,
    /// Its client is lost: its scheduled nets are withdrawn, its running nets aborted.
    LostClient,
    /// Aborted, and unloaded at once.
    Unload,
    /// The controller shuts down: no pending net starts any more, all running nets are aborted.
    Shutdown,
    Runaway,
    DeviceFault,
    DeviceLost,
    EmergencyStop,
}

const ENDINGS: [Ending; 11] = [
    Ending::Itself,
    Ending::Cancel,
    Ending::Abort,
    Ending::Rule,
    Ending::LostClient,
    Ending::Unload,
    Ending::Shutdown,
    Ending::Runaway,
    Ending::DeviceFault,
    Ending::DeviceLost,
    Ending::EmergencyStop,
];

/// A kind of command.
#[derive(Clone, Copy)]
struct Kind {
    name: &'static str,
    joints: usize,
    parts: &'static [Part],
    /// Whether its net claims the device, and so ends with it; else it only uses a part of it.
    claims: bool,
    /// Children that command it; `STEP` is the step of a clock per evaluation, times 1000.
    children: &'static str,
}

const BASE: Part = Part::Base {
    wheels: 4,
    velocity_max: 1.0,
    rotation_max: 2.0,
    acceleration_max: 1.6,
    rotation_acceleration_max: 1.6,
};
const IO: Part = Part::Io {
    bool_in: 0,
    bool_out: 1,
    real_in: 0,
    real_out: 1,
};
const ARM: &str = "clock=Core::Clock(Increment='STEP'),
    j=RobotArm::JointPosition(inPosition=clock.outValue,Robot='x',Axis='1')";
const VELOCITY: &str = "v=World::TwistValue(Value='{vel:{x:0.5}}'),
    j=RobotBase::BaseVelocity(inVel=v.outValue,Robot='x')";
const POSE: &str = "v=World::FrameValue(Value='{pos:{x:0.015}}'),
    j=CartesianPosition::CartesianPosition(inPosition=v.outValue,Robot='x')";
const GRIPPER: &str = "j=KUKA::youBot::Gripper(Distance='0.02',Robot='x')";

/// Kinds of commands by the devices that take them. Joints are those of LWR, iiwa, CiA 402 drives and youBot arms, which
/// all follow [`takt_core::device::JointSetPoints`]; velocities those of a Segway RMP and a youBot's base.
const KINDS: [Kind; 9] = [
    kind("joints", 7, &[], true, ARM),
    kind("velocity", 0, &[BASE], true, VELOCITY),
    kind(
        "pose of a base",
        0,
        &[BASE, Part::CartesianPosition],
        true,
        POSE,
    ),
    kind("tool position", 0, &[Part::CartesianPosition], true, POSE),
    kind(
        "gripper",
        0,
        &[Part::Gripper {
            distance_max: 0.023,
        }],
        true,
        GRIPPER,
    ),
    kind(
        "outputs",
        0,
        &[IO],
        true,
        "b=IO::OutBool(IO='true',DeviceID='x'),r=IO::OutReal(IO='2',DeviceID='x')",
    ),
    kind(
        "joint torque",
        7,
        &[Part::JointImpedance],
        false,
        "t=Core::DoubleValue(Value='3'),
         j=KUKA::LWR::JointImpParameters(inAddTorque=t.outValue,Robot='x',Axis='1')",
    ),
    kind(
        "wrench",
        7,
        &[Part::CartesianImpedance],
        false,
        "t=World::WrenchValue(Value='{force:{x:3}}'),
         j=KUKA::LWR::CartImpParameters(inAddTorque=t.outValue,Robot='x')",
    ),
    kind(
        "strategy and tool",
        7,
        &[Part::Strategy, Part::Tool],
        false,
        "v=Core::IntValue(Value='3'),s=KUKA::LWR::ControlStrategy(inStrategy=v.outValue,Robot='x'),
         t=RobotArm::ToolParameters(Mass='1',Robot='x',Axis='6')",
    ),
];

const fn kind(
    name: &'static str,
    joints: usize,
    parts: &'static [Part],
    claims: bool,
    children: &'static str,
) -> Kind {
    Kind {
        name,
        joints,
        parts,
        claims,
        children,
    }
}

/// A net of these children that ends when cancelled, or after so many evaluations.
fn net(children: &str, every: u64, ends_after: Option<u32>) -> String {
    let children = children.replace(
        "STEP",
        &format!("{}", 0.015 * f64::from(u32::try_from(every).unwrap())),
    );
    let last = ends_after.map_or(1e9, |count| f64::from(count) / 1000.0 - 0.0005);
    format!(
        "{{{children},age=Core::Clock(Increment='1'),
        over=Core::DoubleGreater(inFirst=age.outValue,Second='{last}'),
        cancel=Cancel(),end=Core::BooleanOr(inFirst=cancel.outCancel,inSecond=over.outValue),
        outTerminate=end.outValue}}"
    )
}

/// Runs a net for a few evaluations and a part of a period, then ends it. Returns after the cycle of its end.
/// `fail` changes the state of its device.
fn end(
    fixture: &mut Fixture,
    ending: Ending,
    every: u64,
    fail: impl FnOnce(&mut Fixture),
) -> Option<End> {
    let period = usize::try_from(every).unwrap();
    fixture.steps(period + period / 3 + 2);
    if ending != Ending::Itself {
        assert_eq!(fixture.ended.get(&NET), None);
    }
    match ending {
        Ending::Itself => {}
        Ending::Cancel => assert!(fixture.executor.cancel(NET)),
        Ending::Abort => assert!(fixture.executor.abort(NET)),
        Ending::Rule => fixture.stop_by_rule(9, NET, &[]),
        Ending::Unload => fixture.unload(NET),
        Ending::LostClient | Ending::Shutdown => {
            let idle = "{no=Core::BooleanValue(),c=Cancel(),outTerminate=c.outCancel}";
            fixture.start_after(Some(NET), WAITS, idle, 1);
            fixture.lose_client(&[NET, WAITS]);
        }
        Ending::Runaway => fixture.executor.end_runaway(NET),
        Ending::DeviceFault | Ending::DeviceLost => fail(fixture),
        Ending::EmergencyStop => fixture.set_stop(true),
    }
    // Done or cancelled, it ends at its next evaluation; else in this cycle.
    let most = match ending {
        Ending::Itself | Ending::Cancel => 5 * period,
        Ending::Abort
        | Ending::Rule
        | Ending::LostClient
        | Ending::Unload
        | Ending::Shutdown
        | Ending::Runaway
        | Ending::DeviceFault
        | Ending::DeviceLost
        | Ending::EmergencyStop => 1,
    };
    for _ in 0..most {
        fixture.step();
        if fixture.ended.contains_key(&NET) {
            break;
        }
    }
    assert!(!fixture.ended.contains_key(&WAITS), "what waited never ran");
    fixture.ended.get(&NET).copied()
}

/// Positions of the commands of a device among its words.
fn targets(has: &Interfaces) -> Vec<usize> {
    let base = has.base.iter().map(|base| base.command.target());
    let io = has.io.iter().flat_map(|io| {
        let bools = io.bool_out.iter().map(|output| output.command.target());
        let reals = io.real_out.iter().map(|output| output.command.target());
        bools.chain(reals).collect::<Vec<_>>()
    });
    let cartesian = has.cartesian.iter().map(|it| it.command.target());
    let gripper = has.gripper.iter().map(|it| it.order.command.target());
    let tool = has.tool.iter().map(|it| it.command.target());
    let strategy = has.strategy.iter().map(|it| it.command.target());
    let joints = has.joint_impedance.iter().flat_map(|joints| joints.iter());
    let joints = joints.map(|it| it.command.target());
    let wrench = has.cartesian_impedance.iter().map(|it| it.command.target());
    let all = base.chain(io).chain(cartesian).chain(gripper).chain(tool);
    let all = all.chain(strategy).chain(joints).chain(wrench);
    all.filter_map(|target| match target {
        Target::Words(at) => Some(at),
        Target::Joint(_) => None,
    })
    .collect()
}

/// A device of a kind, driven by the test.
struct Bench {
    fixture: Fixture,
    driven: Driven,
    state: DeviceState,
    commands: Vec<usize>,
}

impl Bench {
    fn new(kind: &Kind) -> Self {
        let limits = JointLimits {
            position_min: -2.0,
            position_max: 2.0,
            velocity_max: 2.0,
            acceleration_max: 4.0,
        };
        let mut fixture = Fixture::default();
        let driven = fixture.add_driven(DeviceDescription {
            name: "x".to_owned(),
            kind: "test",
            limits: vec![limits; kind.joints],
            model: "".into(),
            parts: kind.parts.to_vec(),
        });
        let mut layout = Layout::default();
        let has = parts::lay(kind.parts, kind.joints, &mut layout);
        let mut state = DeviceState::new(layout.signals);
        state.status = DeviceStatus::Operational;
        if let Some(base) = &has.base {
            base.error.report(&mut state.signals, Some(0));
        }
        if let Some(cartesian) = &has.cartesian {
            cartesian.error.report(&mut state.signals, Some(0));
        }
        let mut bench = Self {
            fixture,
            driven,
            state,
            commands: targets(&has),
        };
        bench.publish();
        bench.fixture.step();
        bench
    }

    fn publish(&mut self) {
        let state = &self.state;
        self.driven.state.write_with(|slot| slot.copy_from(state));
    }

    /// The device ceases to follow commands.
    fn fail(&mut self, status: DeviceStatus) {
        self.state.enter(status, takt_rt::Nanos(0));
        self.publish();
    }

    /// Number of commands in force for its driver: set-points, and orders that were not withdrawn.
    fn commanded(&mut self) -> usize {
        let commands = &self.commands;
        self.driven.command.read_with(|command| {
            let joints = command.joints.iter().filter(|joint| joint.active).count();
            let of = |at: &&usize| command.words[**at + 1] != 0 && command.words[**at + 2] != 0;
            let words = commands.iter().filter(of).count();
            let late = commands.iter().any(|at| {
                is_in_force(&command.words, *at, command.cycle) && command.words[*at + 2] == 0
            });
            assert!(!late, "what is withdrawn is not in force");
            joints + words
        })
    }
}

/// All combinations, up to the driver.
#[test]
fn commands_are_withdrawn_when_their_net_ends() {
    for kind in &KINDS {
        for every in PERIODS {
            for ending in ENDINGS {
                let what = format!("{}, {ending:?}, every {every}", kind.name);
                let fails = matches!(ending, Ending::DeviceFault | Ending::DeviceLost);
                if fails && !kind.claims {
                    continue;
                }
                let mut bench = Bench::new(kind);
                let text = net(
                    kind.children,
                    every,
                    (ending == Ending::Itself).then_some(5),
                );
                bench.fixture.try_start(NET, &text, every).unwrap();
                let period = usize::try_from(every).unwrap();
                bench.fixture.steps(period + 1);
                assert!(bench.commanded() > 0, "{what}: nothing is commanded");
                let Bench {
                    fixture,
                    driven,
                    state,
                    ..
                } = &mut bench;
                let fail = |_: &mut Fixture| {
                    let status = if ending == Ending::DeviceLost {
                        DeviceStatus::Offline
                    } else {
                        DeviceStatus::SafeOperational
                    };
                    state.enter(status, takt_rt::Nanos(0));
                    driven.state.write_with(|slot| slot.copy_from(state));
                };
                let ended = end(fixture, ending, every, fail);
                let outlives = ending == Ending::EmergencyStop && !kind.claims;
                assert_eq!(ended.is_some(), !outlives, "{what}: {ended:?}");
                assert_eq!(bench.commanded(), 0, "{what}");
                for _ in 0..period + 3 {
                    bench.fixture.step();
                    assert_eq!(bench.commanded(), 0, "{what}");
                }
            }
        }
    }
}

/// Additions of a stopped net do not return when the stop is released: only after a pause, or from another net.
#[test]
fn emergency_stop_additions_do_not_return() {
    for kind in KINDS
        .iter()
        .filter(|kind| kind.name == "joint torque" || kind.name == "wrench")
    {
        for every in PERIODS {
            let mut bench = Bench::new(kind);
            let text = net(kind.children, every, None);
            bench.fixture.try_start(NET, &text, every).unwrap();
            let period = usize::try_from(every).unwrap();
            bench.fixture.steps(2 * period);
            assert!(bench.commanded() > 0, "{}", kind.name);
            bench.fixture.set_stop(true);
            bench.fixture.steps(period + 2);
            assert_eq!(bench.commanded(), 0, "{}", kind.name);
            bench.fixture.set_stop(false);
            bench.fixture.steps(2 * period + 2);
            assert_eq!(bench.commanded(), 0, "{}", kind.name);
            bench.fixture.end(NET);
            bench.fixture.steps(2);
            bench.fixture.try_start(2, &text, every).unwrap();
            bench.fixture.steps(period + 1);
            assert!(bench.commanded() > 0, "{}: a new net may", kind.name);
        }
    }
}

/// A simulated device, the net that moves it, and its position.
struct Sim {
    kind: &'static str,
    children: &'static str,
    place: fn(&Fixture) -> f64,
    /// Speed and acceleration, in the unit of `place`.
    speed: f64,
    acceleration: f64,
}

fn joint(fixture: &Fixture) -> f64 {
    fixture.executor.joints()[1]
        .state
        .get()
        .measured_position
        .unwrap()
}

fn along_x(fixture: &Fixture) -> f64 {
    let base = fixture.table.interfaces("x").unwrap().base.unwrap();
    base.pose
        .get(&fixture.executor.image)
        .unwrap()
        .translation
        .vector
        .x
}

fn distance(fixture: &Fixture) -> f64 {
    let gripper = fixture.table.interfaces("x").unwrap().gripper.unwrap();
    gripper.distance.get(&fixture.executor.image).unwrap()
}

fn width(fixture: &Fixture) -> f64 {
    let gripper = fixture
        .table
        .interfaces("x")
        .unwrap()
        .servo_gripper
        .unwrap();
    gripper.width.get(&fixture.executor.image).unwrap()
}

const SERVO_GRIPPER: &str =
    "j=schunkwsg::Prepositioning(Device='x',Width='0.01',Speed='0.1',RelativeMotion='false')";

const SIMULATED: [Sim; 7] = [
    sim("kuka_lwr_sim", ARM, joint, 2.0, 4.0),
    sim("kuka_iiwa_sim", ARM, joint, 2.0, 4.0),
    sim("kuka_youbot_arm_sim", ARM, joint, 2.0, 4.0),
    sim("kuka_youbot_base_sim", VELOCITY, along_x, 0.5, 1.0),
    sim("kuka_youbot_base_sim", POSE, along_x, 1.0, 1.0),
    sim("kuka_youbot_gripper_sim", GRIPPER, distance, 0.01, 1.0),
    sim("schunk_wsg_sim", SERVO_GRIPPER, width, 0.1, 5.0),
];

const fn sim(
    kind: &'static str,
    children: &'static str,
    place: fn(&Fixture) -> f64,
    speed: f64,
    acceleration: f64,
) -> Sim {
    Sim {
        kind,
        children,
        place,
        speed,
        acceleration,
    }
}

#[test]
fn simulated_devices_rest_within_their_stopping_distance() {
    for device in &SIMULATED {
        for every in PERIODS {
            for ending in ENDINGS {
                if matches!(ending, Ending::DeviceFault | Ending::DeviceLost) {
                    // They have none.
                    continue;
                }
                let what = format!("{}, {ending:?}, every {every}", device.kind);
                let joints = if device.kind == "kuka_youbot_arm_sim" {
                    5
                } else {
                    7
                };
                let of_base = [
                    ("max_acc", "1"),
                    ("max_rot_acc", "1"),
                    ("max_vel", "1"),
                    ("max_rot_vel", "1"),
                ];
                let parameters = match device.kind {
                    "kuka_youbot_base_sim" => parameters(&of_base),
                    "kuka_youbot_gripper_sim" | "schunk_wsg_sim" => parameters(&[]),
                    _ => arm_parameters(joints, &[]),
                };
                let mut fixture = Fixture::default();
                fixture.add("x", device.kind, &parameters);
                let text = net(
                    device.children,
                    every,
                    (ending == Ending::Itself).then_some(5),
                );
                fixture.try_start(NET, &text, every).unwrap();
                let began = (device.place)(&fixture);
                assert!(end(&mut fixture, ending, every, |_| ()).is_some(), "{what}");
                let ended = (device.place)(&fixture);
                assert!(ended != began, "{what}: it never moved");
                let mut last = ended;
                // One cycle of latency, and one at the previous speed.
                let way = device.speed * (device.speed / device.acceleration / 2.0 + 0.002);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "some hundred cycles"
                )]
                let stopping = (device.speed / device.acceleration * 1000.0) as usize + 3;
                for cycle in 0..stopping + usize::try_from(every).unwrap() {
                    fixture.step();
                    let now = (device.place)(&fixture);
                    assert!((now - ended).abs() <= way, "{what}: {now} after {ended}");
                    assert!(cycle < stopping || now == last, "{what}: moves on at {now}");
                    last = now;
                }
            }
        }
    }
}

/// When their net ends, outputs hold their values, even if set only in its last cycle, or take the configured value in
/// the same cycle.
#[test]
fn outputs_follow_their_policy_after_their_net() {
    let value = [("on_end_bool", "[false]"), ("on_end_real", "[0.5,hold]")];
    let holds = [("on_end_bool", "hold"), ("on_end_real", "hold")];
    for (more, expected) in [
        (&[][..], (true, 2.0)),
        (&holds, (true, 2.0)),
        (&value, (false, 0.5)),
    ] {
        for (kind, arm) in [("io_sim", false), ("kuka_lwr_sim", true)] {
            for ending in ENDINGS {
                if matches!(ending, Ending::DeviceFault | Ending::DeviceLost) {
                    continue;
                }
                let mut fixture = Fixture::default();
                let given = if arm {
                    arm_parameters(7, more)
                } else {
                    parameters(more)
                };
                fixture.add("x", kind, &given);
                let outputs = KINDS.iter().find(|kind| kind.name == "outputs").unwrap();
                let text = net(
                    outputs.children,
                    10,
                    (ending == Ending::Itself).then_some(5),
                );
                fixture.try_start(NET, &text, 10).unwrap();
                let what = format!("{kind}, {more:?}, {ending:?}");
                assert!(end(&mut fixture, ending, 10, |_| ()).is_some(), "{what}");
                // The image shows what the cycle of the end left.
                fixture.step();
                for _ in 0..100 {
                    let io = fixture.table.interfaces("x").unwrap().io.unwrap();
                    let image = &fixture.executor.image;
                    let (truth, number) = expected;
                    assert_eq!(io.bool_out[0].state.get(image), Some(truth), "{what}");
                    assert_eq!(io.real_out[0].state.get(image), Some(number), "{what}");
                    fixture.step();
                }
            }
        }
    }
}

/// An invalid value for an output is rejected with its port.
#[test]
fn output_policies_of_wrong_type_are_rejected() {
    for (key, value, expected) in [
        (
            "on_end_bool",
            "[hold,1]",
            "`1` of output 1 is neither hold nor true or false",
        ),
        (
            "on_end_real",
            "[nan]",
            "`nan` of output 0 is neither hold nor a finite number",
        ),
        (
            "on_end_real",
            "[0,0,0]",
            "`on_end.real` states 3 outputs, there are 2",
        ),
    ] {
        let given = parameters(&[(key, value)]);
        let error = takt_core::device::sim::make("x", "io_sim", &given).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    }
}

/// A successor that commands the same takes over without a gap, whatever the period; others do not.
#[test]
fn successor_by_rule_keeps_commands_until_its_first_cycle() {
    let other = "j=RobotArm::JointPosition(Robot='x',Axis='2')";
    for every in PERIODS {
        for (children, keeps) in [(ARM, true), (other, false)] {
            for stops in [false, true] {
                let mut bench = Bench::new(&KINDS[0]);
                let fixture = &mut bench.fixture;
                let first = net(ARM, every, (!stops).then_some(5));
                fixture.try_start(NET, &first, every).unwrap();
                let second = net(children, every, None);
                let period = usize::try_from(every).unwrap();
                if stops {
                    fixture.steps(3 * period + period / 3);
                    fixture.schedule(2, &second, every);
                    fixture.stop_by_rule(2, NET, &[2]);
                } else {
                    fixture.start_after(Some(NET), 2, &second, every);
                }
                let what = format!("every {every}, stopped {stops}, keeps {keeps}");
                for _ in 0..6 * period {
                    bench.fixture.step();
                    if bench.fixture.ended.contains_key(&NET) {
                        break;
                    }
                }
                assert!(bench.fixture.ended.contains_key(&NET), "{what}");
                for _ in 0..3 * period {
                    assert_eq!(bench.commanded() > 0, keeps, "{what}");
                    bench.fixture.step();
                }
            }
        }
    }
}

/// A successor that commands the same, but not in its first cycle, does not prolong it.
#[test]
fn successor_that_commands_nothing_lets_commands_end() {
    // A position out of range is no set-point.
    let silent = "far=Core::DoubleValue(Value='99'),
        j=RobotArm::JointPosition(inPosition=far.outValue,Robot='x',Axis='1')";
    let mut bench = Bench::new(&KINDS[0]);
    bench
        .fixture
        .try_start(NET, &net(ARM, 1000, None), 1000)
        .unwrap();
    bench.fixture.steps(3400);
    bench.fixture.schedule(2, &net(silent, 10, None), 10);
    bench.fixture.stop_by_rule(2, NET, &[2]);
    bench.fixture.steps(12);
    assert!(bench.fixture.ended.contains_key(&NET));
    assert_eq!(bench.commanded(), 0);
}

/// Event of a device after a net is scheduled and before its rule fires.
#[derive(Clone, Copy, Debug)]
enum Between {
    Nothing,
    Fault,
    Lost,
    Stop,
    /// Its position jumps, and it goes on following.
    Jump,
    /// It did not follow commands when the net was scheduled.
    Comes,
}

#[test]
fn scheduled_nets_of_failed_device_are_returned() {
    use Between::{Comes, Fault, Jump, Lost, Nothing, Stop};
    for kind in KINDS.iter().filter(|kind| kind.claims) {
        for between in [Nothing, Fault, Lost, Stop, Jump, Comes] {
            let what = format!("{}, {between:?}", kind.name);
            let mut bench = Bench::new(kind);
            if matches!(between, Comes) {
                bench.fail(DeviceStatus::SafeOperational);
                bench.fixture.step();
            }
            // It waits for a net that has nothing to do with the device.
            bench
                .fixture
                .try_start(
                    NET,
                    "{no=Core::BooleanValue(),c=Cancel(),outTerminate=c.outCancel}",
                    1,
                )
                .unwrap();
            bench
                .fixture
                .start_after(Some(NET), 2, &net(kind.children, 1, None), 1);
            bench.fixture.steps(3);
            match between {
                Nothing | Comes => {}
                Fault => bench.fail(DeviceStatus::SafeOperational),
                Lost => bench.fail(DeviceStatus::Offline),
                Stop => bench.fixture.set_stop(true),
                Jump => {
                    bench.state.jumped.count += 1;
                    bench.publish();
                }
            }
            bench.fixture.steps(3);
            bench.fail(DeviceStatus::Operational);
            bench.fixture.set_stop(false);
            bench.fixture.steps(3);
            let rule = bench.fixture.rules.get(&2).copied();
            let fails = Some((RuleState::FireFailed, Some(Failure::DeviceChanged(0))));
            let expected = if matches!(between, Nothing) {
                None
            } else {
                fails
            };
            assert_eq!(rule, expected, "{what}: before its condition holds");
            assert!(bench.fixture.executor.cancel(NET));
            bench.fixture.steps(5);
            let fires = matches!(between, Nothing);
            assert_eq!(bench.commanded() > 0, fires, "{what}");
            if fires {
                continue;
            }
            // Requested again, it runs.
            assert!(
                bench.fixture.executor.take_unscheduled(2, false).is_some(),
                "{what}"
            );
            bench.fixture.rules.clear();
            bench
                .fixture
                .start_after(None, 3, &net(kind.children, 1, None), 1);
            bench.fixture.steps(3);
            assert_eq!(bench.fixture.rules[&3].0, RuleState::Fired, "{what}");
            assert!(bench.commanded() > 0, "{what}");
        }
    }
}
