//! A KUKA youBot on an EtherCAT segment, moved by nets: the emulated one at the end of a cable inside of this process.
//! Motors and bars of the emulator are the ground truth.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

#[path = "common/bench.rs"]
mod bench;
mod common;

use std::ops::{Deref, DerefMut};
use std::time::Duration;

use takt_core::NetId;
use takt_core::device::DeviceStatus;
use takt_devices::ethercat::Ethercat;
use takt_devices::ethercat::{EthercatConfig, YouBotControl, YouBotZero};
use takt_ethercat::emulator::{Bar, DriveHandle, Firmware, YouBot, YouBotConfig};
use takt_motion::kinematics::YouBot as YouBotArm;
use takt_net::Frame;
use takt_net::device::Kinematics as _;
use takt_net::value::Twist;
use takt_rt::alloc::{CountingAllocator, real_time_allocations};
use takt_tests::{pass, simulate_time};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The segment as a cell file configures it.
fn config() -> EthercatConfig {
    let text = r#"
        [[ethercat]]
        name = "segment"
        interface = "none"
        cycle = "4ms"
        [[ethercat.youbot_base]]
        name = "base"
        [[ethercat.youbot_arm]]
        name = "arm"
        position = 5
        gripper = "hand"
        homing = true
        zero = "folded"
    "#;
    let cell = takt_devices::parse_cell(text).unwrap();
    cell.of_kind::<EthercatConfig>().next().unwrap().clone()
}

/// A youBot, and a controller that leads it.
struct TestBench {
    bench: bench::TestBench,
    bot: YouBot,
}

impl Deref for TestBench {
    type Target = bench::TestBench;

    fn deref(&self) -> &bench::TestBench {
        &self.bench
    }
}

impl DerefMut for TestBench {
    fn deref_mut(&mut self) -> &mut bench::TestBench {
        &mut self.bench
    }
}

impl TestBench {
    fn new(firmware: Firmware, config: &EthercatConfig) -> Self {
        let bench = Self::start(firmware, config);
        bench.cell().wait_for("arm", DeviceStatus::Operational);
        bench.cell().wait_for("base", DeviceStatus::Operational);
        bench
    }

    /// Whose devices are not waited for.
    fn start(firmware: Firmware, config: &EthercatConfig) -> Self {
        simulate_time(2.0);
        let (segment, bot) = YouBot::segment(&YouBotConfig {
            firmware,
            ..YouBotConfig::default()
        });
        let bench = bench::TestBench::start(config, segment);
        Self { bench, bot }
    }

    fn faults(&self, device: &str) -> u64 {
        self.cell().controller.arm_state(device).unwrap().faults
    }

    fn joint(&self, number: usize) -> &DriveHandle {
        &self.bot.arms[0][number]
    }

    /// Where a joint is, rad away from its stop.
    fn angle(&self, joint: usize) -> f64 {
        self.joint(joint).lock().angle()
    }

    /// How far the motors turned their wheels, rad in the motors' sense.
    fn wheels(&self) -> [f64; 4] {
        std::array::from_fn(|n| -self.bot.wheels[n].lock().angle())
    }

    /// How far the fingers are apart, m.
    fn opening(&self) -> f64 {
        let joint = self.joint(4).lock();
        joint.bars().unwrap().iter().map(Bar::opening).sum()
    }

    /// Runs a net to its end. Returns the result of `before`, evaluated before it.
    fn runs<T>(&self, device: &str, text: &str, before: impl Fn(&Self) -> T) -> T {
        self.cell().wait_for(device, DeviceStatus::Operational);
        let (then, faults) = (before(self), self.faults(device));
        let net = self.cell().load(text);
        self.cell().controller.start_net(net).unwrap();
        self.cell().wait_for_end(net);
        pass(Duration::from_millis(600));
        assert_eq!(self.faults(device), faults, "{device} was lost");
        then
    }

    /// Waits for the gripper. Emulated fingers stop while the host stalls; for those that are late, the power of the
    /// arm is switched off and on, as the event text advises.
    fn wait_for_hand(&self) {
        let is_late = || {
            let why = self.cell().controller.with_drivers(Ethercat::waits_for)[0].clone();
            why.is_some_and(|why| why.contains("a finger did not reach its stop"))
        };
        if is_late() {
            self.segment().set_link(3, false);
            self.cell().wait_for("hand", DeviceStatus::Offline);
            self.segment().set_link(3, true);
        }
        self.cell().wait("the hand", |_| {
            self.cell().status("hand") == DeviceStatus::Operational || is_late()
        });
        assert!(!is_late(), "the fingers were late");
    }

    /// Starts a net that goes on.
    fn goes(&self, device: &str, text: &str) -> NetId {
        self.cell().wait_for(device, DeviceStatus::Operational);
        let net = self.cell().load(text);
        self.cell().controller.start_net(net).unwrap();
        net
    }
}

/// Moves the base for a while.
fn drive(velocity: &str, seconds: f64) -> String {
    format!(
        "{{ v=World::TwistValue(Value='{velocity}'),
            move=RobotBase::BaseVelocity(inVel=v.outValue,Robot='base'),
            clock=Core::Clock(),
            done=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
            cancel=Cancel(),
            end=Core::BooleanOr(inFirst=done.outValue,inSecond=cancel.outCancel),
            outTerminate=end.outValue }}"
    )
}

/// Leads the base forth by a distance within a time, half-way turned by a quarter to the left.
fn lead(distance: f64, seconds: f64) -> String {
    format!(
        "{{ true=Core::BooleanValue(Value='true'),past=Core::BooleanPre(inValue=true.outValue),
            first=Core::BooleanIsNull(inValue=past.outValue),
            at=CartesianPosition::CartesianMonitor(Robot='base'),
            start=World::FrameSnapshot(inSnapshot=first.outValue,inValue=at.outCommandedPosition),
            clock=Core::Clock(),part=Core::Interval(inValue=clock.outValue,Max='{seconds}'),
            way=Core::DoubleBezier(inValue=part.outValue,To='{distance}'),
            turn=Core::DoubleBezier(inValue=part.outValue,To='1.5'),
            moved=World::FrameFromXYZ(inX=way.outValue,inRot=turned.outValue),
            turned=World::RotationFromABC(inA=turn.outValue),
            goal=World::FrameTransform(inFirst=start.outValue,inSecond=moved.outValue),
            to=CartesianPosition::CartesianPosition(inPosition=goal.outValue,Robot='base'),
            cancel=Cancel(),
            done=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
            end=Core::BooleanOr(inFirst=done.outValue,inSecond=cancel.outCancel),
            outTerminate=end.outValue }}"
    )
}

/// Moves the fingers and ends when they are there.
fn grip(distance: f64) -> String {
    format!(
        "{{ g=KUKA::youBot::Gripper(Robot='hand',Distance='{distance}'),
            cancel=Cancel(),
            end=Core::BooleanOr(inFirst=g.outCompleted,inSecond=cancel.outCancel),
            outTerminate=end.outValue }}"
    )
}

/// A net moves arm, base and gripper, whatever the firmware.
fn moves(firmware: Firmware, control: YouBotControl) {
    let mut config = config();
    config.youbot_arms[0].control = control;
    let bench = TestBench::new(firmware, &config);
    // Homed at its stops before anything.
    for joint in 0..5 {
        let reported = bench.cell().position("arm", joint);
        let sign = if joint == 2 { -1.0 } else { 1.0 };
        assert!(
            (reported - sign * bench.angle(joint)).abs() < 0.03,
            "{joint}"
        );
    }
    let before = bench.runs("arm", &common::swing_joint("arm", 3, 1.0), |bench| {
        bench.angle(3)
    });
    let moved = bench.angle(3) - before;
    assert!((moved - 0.5).abs() < 0.02, "moved {moved} rad");
    let before = bench.runs("base", &drive("{vel:{x:0.2}}", 1.0), TestBench::wheels);
    let after = bench.wheels();
    for (n, sign) in [-1.0, 1.0, -1.0, 1.0].into_iter().enumerate() {
        // 0.2 m/s for a second on wheels of 0.0475 m; the ramp's lag at the start is made up at the end.
        let turned = sign * (after[n] - before[n]);
        assert!(
            (turned - 0.2 / 0.0475).abs() < 0.3,
            "wheel {n}: {turned} rad"
        );
    }
    bench.wait_for_hand();
    bench.runs("hand", &grip(0.018), |_| ());
    assert!(
        (bench.opening() - 0.018).abs() < 1e-3,
        "{}",
        bench.opening()
    );
    // From homing to the last order, no cycle of driver or nets allocated.
    assert!(bench.figures().cycles > 1000);
    assert_eq!(real_time_allocations(), 0);
}

/// By default nets count from the upright arm, and the frame of its folded pose is that of the Robotics API.
#[test]
fn youbot_arm_counts_from_upright_by_default() {
    let mut config = config();
    config.youbot_arms[0].zero = YouBotZero::default();
    let bench = TestBench::new(Firmware::V200, &config);
    let upright = [169.0, 65.0, -146.0, 102.5, 167.5].map(f64::to_radians);
    for (joint, upright) in upright.into_iter().enumerate() {
        let sign = if joint == 2 { -1.0 } else { 1.0 };
        let from_stop = bench.cell().position("arm", joint) + upright;
        let difference = from_stop - sign * bench.angle(joint);
        assert!(difference.abs() < 0.03, "{joint}: {difference}");
    }
    let before = bench.runs("arm", &common::swing_joint("arm", 3, 1.0), |bench| {
        bench.angle(3)
    });
    let moved = bench.angle(3) - before;
    assert!((moved - 0.5).abs() < 0.02, "moved {moved} rad");
}

#[test]
fn youbot_net_moves_all_with_firmware_2_00() {
    moves(Firmware::V200, YouBotControl::Position);
}

#[test]
fn youbot_net_moves_all_with_firmware_1_48() {
    moves(Firmware::V148, YouBotControl::Velocity);
}

#[test]
fn youbot_arm_without_permission_does_not_home() {
    let mut config = config();
    config.youbot_arms[0].homing = false;
    let bench = TestBench::start(Firmware::V200, &config);
    bench.cell().wait_for("base", DeviceStatus::Operational);
    let before: [f64; 5] = std::array::from_fn(|joint| bench.angle(joint));
    pass(Duration::from_millis(500));
    assert_eq!(bench.cell().status("arm"), DeviceStatus::SafeOperational);
    assert_eq!(bench.cell().status("hand"), DeviceStatus::SafeOperational);
    let why = bench.cell().controller.with_drivers(Ethercat::waits_for);
    let why = why[0].clone().unwrap();
    assert!(
        why.starts_with("arm joint 0: its commutation is unknown"),
        "{why}"
    );
    for (joint, before) in before.into_iter().enumerate() {
        assert!((bench.angle(joint) - before).abs() < 0.05, "{joint}");
    }
}

#[test]
fn youbot_cut_cable_ends_net_repair_recovers_at_rest() {
    let bench = TestBench::new(Firmware::V200, &config());
    let net = bench.goes("base", &drive("{vel:{y:0.2}}", 60.0));
    pass(Duration::from_millis(500));
    // Between the second and the third wheel: the arm is behind it too.
    bench.segment().set_link(3, false);
    bench.cell().wait_for("base", DeviceStatus::Offline);
    bench.cell().wait_for("arm", DeviceStatus::Offline);
    bench.cell().wait_for_end(net);
    pass(Duration::from_millis(300));
    bench.segment().set_link(3, true);
    bench.cell().wait_for("base", DeviceStatus::Operational);
    bench.cell().wait_for("arm", DeviceStatus::Operational);
    assert_eq!(real_time_allocations(), 0);
    // The drives behind the cut saw no frames for longer than they tolerate.
    assert!(
        bench.figures().youbots.timeouts >= 7,
        "{:?}",
        bench.figures()
    );
    let (wheels, angle) = (bench.wheels(), bench.angle(1));
    pass(Duration::from_millis(300));
    for (now, then) in bench.wheels().into_iter().zip(wheels) {
        assert!((now - then).abs() < 0.01, "nothing moves by itself");
    }
    assert!((bench.angle(1) - angle).abs() < 0.01);
}

/// The angles of the arm's joints, rad away from their stops.
fn angles(bench: &TestBench) -> [f64; 5] {
    std::array::from_fn(|joint| bench.angle(joint))
}

/// Waits for the arm and asserts that no joint moved before, nor moves for a while after it.
fn stays(bench: &TestBench, before: [f64; 5]) {
    let near = || {
        for (joint, before) in before.into_iter().enumerate() {
            let away = bench.angle(joint) - before;
            assert!(away.abs() < 0.02, "joint {joint} moved by {away} rad");
        }
    };
    bench.cell().wait("the arm, resting", |_| {
        near();
        bench.cell().status("arm") == DeviceStatus::Operational
    });
    for _ in 0..60 {
        std::thread::sleep(Duration::from_millis(5));
        near();
    }
}

#[test]
fn youbot_homed_arm_rests_under_next_controller() {
    for control in [YouBotControl::Position, YouBotControl::Velocity] {
        let mut config = config();
        config.youbot_arms[0].control = control;
        let mut bench = TestBench::new(Firmware::V200, &config);
        for _ in 0..2 {
            bench.runs("arm", &common::swing_joint("arm", 3, 1.0), |_| ());
            bench.runs("arm", &common::swing_joint("arm", 4, 1.0), |_| ());
        }
        assert!(bench.angle(3) > 0.9 && bench.angle(4) > 0.9);
        let before = angles(&bench);
        bench.leave();
        bench.lead(&config);
        stays(&bench, before);
    }
}

#[test]
fn youbot_arm_behind_cut_cable_rests_in_place() {
    let bench = TestBench::new(Firmware::V200, &config());
    for _ in 0..2 {
        bench.runs("arm", &common::swing_joint("arm", 4, 1.0), |_| ());
    }
    assert!(bench.angle(4) > 0.9);
    let before = angles(&bench);
    bench.segment().set_link(3, false);
    bench.cell().wait_for("arm", DeviceStatus::Offline);
    bench.segment().set_link(3, true);
    stays(&bench, before);
}

#[test]
fn youbot_fingers_missing_stops_are_reported() {
    let bench = TestBench::start(Firmware::V200, &config());
    bench.joint(4).lock().bars_mut().unwrap()[0].jammed = true;
    let why = || bench.cell().controller.with_drivers(Ethercat::waits_for)[0].clone();
    bench.cell().wait("the reason", |_| {
        why().is_some_and(|why| why.starts_with("arm joint 4: its gripper: a finger"))
    });
    assert_eq!(bench.cell().status("arm"), DeviceStatus::Operational);
    assert_eq!(bench.cell().status("hand"), DeviceStatus::SafeOperational);
}

#[test]
fn youbot_i2t_ends_net_and_is_cleared() {
    let bench = TestBench::new(Firmware::V200, &config());
    let net = bench.cell().swinging("arm", 3);
    let before = bench.figures().youbots.i2t;
    bench.joint(0).lock().overheat();
    bench.cell().wait_for_end(net);
    bench.cell().wait_for("arm", DeviceStatus::Operational);
    assert!(bench.figures().youbots.i2t > before);
}

#[test]
fn youbot_emergency_stop_ends_net_arm_stays() {
    let bench = TestBench::new(Firmware::V148, &config());
    let net = bench.cell().swinging("arm", 3);
    let stop = |pressed: bool| {
        for joint in &bench.bot.arms[0] {
            joint.lock().emergency_stop = pressed;
        }
    };
    stop(true);
    bench.cell().wait_for("arm", DeviceStatus::SafeOperational);
    bench.cell().wait_for_end(net);
    pass(Duration::from_millis(200));
    let sunk = bench.angle(3);
    stop(false);
    bench.cell().wait_for("arm", DeviceStatus::Operational);
    pass(Duration::from_millis(300));
    assert!(
        (bench.angle(3) - sunk).abs() < 0.05,
        "{} {sunk}",
        bench.angle(3)
    );
}

/// Makes joint 0 a spring of 40 Nm/rad that adds a torque, for two seconds.
fn spring(torque: f64) -> String {
    format!(
        "{{ c=KUKA::youBot::ArmControlStrategy(Robot='arm',Controller='1'),
            i=KUKA::youBot::JointImpParameters(Robot='arm',JointIndex='0',Stiffness='40',Damping='1',
                AddTorque='{torque}'),
            clock=Core::Clock(),
            done=Core::DoubleGreater(inFirst=clock.outValue,Second='2'),
            outTerminate=done.outValue }}"
    )
}

#[test]
fn youbot_soft_joint_deflects_current_is_clamped() {
    let mut config = config();
    // 4.2 Nm at the joint, at most.
    config.youbot_arms[0].current_max = [0.8; 5];
    config.youbot_arms[0].homing_current = [0.7, 0.5, 0.7, 0.5, 0.5];
    let bench = TestBench::new(Firmware::V200, &config);
    bench.runs("arm", &common::swing_joint("arm", 0, 1.0), |_| ());
    let start = bench.angle(0);
    bench.runs("arm", &spring(3.0), |_| ());
    assert_eq!(bench.figures().youbots.clamped, 0);
    bench.joint(0).lock().pushed = -3.0;
    bench.cell().wait("the joint giving way", |_| {
        (bench.angle(0) - start).abs() > 0.03
    });
    bench.joint(0).lock().pushed = 0.0;
    bench.runs("arm", &spring(20.0), |_| ());
    assert!(bench.figures().youbots.clamped > 0);
}

/// Makes the tool a spring, for some seconds, and returns the result.
fn tool_spring(stiffness: f64, seconds: f64) -> String {
    let turn = stiffness / 10.0;
    format!(
        "{{ c=KUKA::youBot::ArmControlStrategy(Robot='arm',Controller='2'),
            k=World::WrenchValue(Value='{{force:{{x:{stiffness},y:{stiffness},z:{stiffness}}},
                torque:{{x:{turn},y:{turn},z:{turn}}}}}'),
            i=KUKA::LWR::CartImpParameters(inStiffness=k.outValue,Robot='arm'),
            switched=Core::BooleanNetcommOut(inValue=c.outSuccess,Key='switched'),
            taken=Core::BooleanNetcommOut(inValue=i.outCompleted,Key='taken'),
            clock=Core::Clock(),
            done=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
            outTerminate=done.outValue }}"
    )
}

/// Where the motors have brought the flange.
fn flange(bench: &TestBench) -> Frame {
    let mut joints = angles(bench);
    joints[2] = -joints[2];
    YouBotArm::default().forward(&joints)
}

/// Stiffness of a soft tool, N/m.
const SOFT: f64 = 1000.0;
/// Dry friction of the emulated gears at the joints, Nm.
const FRICTION: [f64; 5] = [0.94, 0.94, 0.6, 0.43, 0.43];

/// What the springs of a tool that belongs to `at` do at the joints, Nm.
fn springs(bench: &TestBench, at: &Frame) -> [f64; 5] {
    let mut joints = angles(bench);
    joints[2] = -joints[2];
    let here = flange(bench);
    let force = (at.translation.vector - here.translation.vector) * SOFT;
    let torque = (at.rotation * here.rotation.inverse()).scaled_axis() * SOFT / 10.0;
    let mut columns = [Twist::default(); 5];
    YouBotArm::default().jacobian(&joints, &mut columns);
    columns.map(|Twist { vel, rot }| vel.dot(&force) + rot.dot(&torque))
}

#[test]
fn youbot_soft_tool_carries_itself_deflects_returns() {
    let mut config = config();
    // Longer ones admit no such springs.
    config.cycle = Duration::from_millis(2);
    let bench = TestBench::new(Firmware::V200, &config);
    // Off the ends of their ranges, where nothing is pushed on.
    for joint in [0, 1, 1, 2, 2, 3, 3, 4] {
        let (off, other) = ("To='0.5'", "To='-0.5'");
        let swing = common::swing_joint("arm", joint, 1.0);
        let swing = if joint == 2 {
            swing.replace(off, other)
        } else {
            swing
        };
        bench.runs("arm", &swing, |_| ());
    }
    bench.cell().wait_for("arm", DeviceStatus::Operational);
    let (at, faults) = (flange(&bench), bench.faults("arm"));
    let net = bench.goes("arm", &tool_spring(SOFT, 8.0));
    let is = |key: &str| {
        let values = bench.cell().controller.out_values(net);
        let key = format!("out{key}");
        values
            .iter()
            .any(|(name, value)| *name == key && value == "true")
    };
    bench
        .cell()
        .wait("the strategy", |_| is("switched") && is("taken"));
    pass(Duration::from_millis(800));
    let away = || (flange(&bench).translation.vector - at.translation.vector).norm();
    let sagged = away();
    assert!(sagged < 0.01, "it does not carry itself: {sagged} m");
    // More than friction holds.
    bench.joint(1).lock().pushed = 12.0;
    bench.cell().wait("the arm giving way", |_| away() > 0.015);
    bench.joint(1).lock().pushed = 0.0;
    pass(Duration::from_secs(3));
    // Joints need not be where they were: what is left is held by the gears' friction.
    assert!(away() < 0.01, "{} m", away());
    let left = springs(&bench, &at);
    for (joint, (left, friction)) in left.into_iter().zip(FRICTION).enumerate() {
        assert!(
            left.abs() < friction * 1.1,
            "joint {joint} rests at {left} Nm"
        );
    }
    bench.cell().wait_for_end(net);
    assert_eq!(bench.faults("arm"), faults, "the arm was lost");
    assert_eq!(real_time_allocations(), 0);
}

#[test]
fn youbot_base_drives_to_poses() {
    let bench = TestBench::new(Firmware::V200, &config());
    let before = bench.runs("base", &lead(0.3, 4.0), TestBench::wheels);
    let ways: Vec<f64> = bench
        .wheels()
        .into_iter()
        .zip(before)
        .map(|(now, then)| now - then)
        .collect();
    // All four turn the base, by 1.5 rad with a lever of 0.385 m; what is left of each after that is the way.
    let turned = ways.iter().sum::<f64>() / 4.0 * 0.0475 / 0.385;
    assert!((turned - 1.5).abs() < 0.05, "turned {turned} rad");
    // The way was straight in the frame in which it began, so that x and y in its own frame took turns.
    let x = (-ways[0] + ways[1] - ways[2] + ways[3]) / 4.0 * 0.0475;
    let y = (ways[0] + ways[1] - ways[2] - ways[3]) / 4.0 * 0.0475;
    assert!(x > 0.1 && y < -0.1 && x.hypot(y) < 0.31, "{x} {y}");
}

#[test]
fn youbot_invalid_configurations_are_rejected_by_name() {
    for (text, said) in [
        (
            "[[ethercat.youbot_base]]\nname = \"a\"\n[[ethercat.youbot_arm]]\nname = \"b\"\nposition = 4",
            "share position 4",
        ),
        (
            "[[ethercat.youbot_arm]]\nname = \"b\"\nposition = 5\ncurrent_max = [0.1,1,1,1,1]",
            "joint 0: homing_current is 2 A; it must be above 0 and below current_max, 0.1 A",
        ),
        (
            "[[ethercat.youbot_base]]\nname = \"a\"\ncurrent_max = 40",
            "youbot_base a: current_max is 40 A; it must be above 0, to 20 A",
        ),
        (
            "[[ethercat.youbot_arm]]\nname = \"b\"\nposition = 5\ngripper = \"b\"",
            "device name `b` is given twice",
        ),
        (
            "[[ethercat.youbot_base]]\nname = \"a\"\nvelocity_max = 0",
            "must be above 0",
        ),
        (
            "[[ethercat.youbot_base]]\nname = \"a\"\nacceleration_max = inf",
            "must be above 0 and finite",
        ),
        (
            "[[ethercat.youbot_arm]]\nname = \"b\"\nposition = 5\nacceleration_max = [90,90,inf,90,90]",
            "joint 2: range must go up, velocity_max and acceleration_max must be above 0, all of them finite",
        ),
        (
            "[[ethercat.youbot_arm]]\nname = \"b\"\nposition = 5\nvelocity_max = [nan,90,90,90,90]",
            "joint 0: range must go up",
        ),
    ] {
        let text = format!("[[ethercat]]\nname = \"s\"\ninterface = \"none\"\n{text}");
        let error = takt_devices::parse_cell(&text).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
    }
}
