//! The primitives of devices in nets, on simulated devices and on one driven by the test, in
//! virtual time: what they command and report, null, ranges, concurrent access and failures.

mod fixtures;

use fixtures::{Driven, Fixture, arm_parameters, endless, parameters, watch};
use takt_core::device::{
    ArmDescription, DeviceDescription, DeviceState, DeviceStatus, Part, parts,
};
use takt_core::executor::{End, StartError};
use takt_net::device::{Answer, Interfaces, Layout};
use takt_net::{Frame, JointLimits, Twist, Vector};

/// A device with these parts and joints, with its endpoint, interfaces and state.
fn driven(fixture: &mut Fixture, joints: usize, of: &[Part]) -> (Driven, Interfaces, DeviceState) {
    let limits = JointLimits {
        position_min: -1.0,
        position_max: 1.0,
        velocity_max: 1.0,
        acceleration_max: 1.0,
    };
    let device = ArmDescription {
        name: "dev".to_owned(),
        kind: "test",
        limits: vec![limits; joints],
        model: "".into(),
    };
    let driven = fixture.add_driven(device.with(of));
    let mut layout = Layout::default();
    let interfaces = parts::lay(of, joints, &mut layout);
    let mut state = DeviceState::new(layout.signals);
    state.status = DeviceStatus::Operational;
    (driven, interfaces, state)
}

fn publish(driven: &mut Driven, state: &DeviceState) {
    driven.state.write_with(|slot| slot.copy_from(state));
}

const BASE: Part = Part::Base {
    wheels: 4,
    velocity_max: 1.0,
    rotation_max: 1.0,
    acceleration_max: 1.6,
    rotation_acceleration_max: 1.6,
};

/// Children that command the velocity written to them, null while `n` is true.
fn base_velocity(robot: &str, velocity: &str) -> String {
    format!(
        "v=World::TwistValue(Value='{velocity}'),
        move=RobotBase::BaseVelocity(inVel=v.outValue,Robot='{robot}'),{},{},{},{}",
        watch("Core::Int", "error", "move.outError"),
        watch(
            "Core::Boolean",
            "concurrent",
            "move.outErrorConcurrentAccess"
        ),
        watch("Core::Boolean", "failed", "move.outErrorBaseFailed"),
        watch("Core::Boolean", "illegal", "move.outErrorIllegalVelocity"),
    )
}

fn base_monitor(robot: &str) -> String {
    format!(
        "base=RobotBase::BaseMonitor(Robot='{robot}'),
        xyz=World::FrameToXYZ(inValue=base.outPos),vel=World::TwistToXYZ(inValue=base.outVel),
        {},{},{},{}",
        watch("Core::Double", "x", "xyz.outX"),
        watch("Core::Double", "y", "xyz.outY"),
        watch("Core::Double", "vx", "vel.outX"),
        watch("Core::Int", "base", "base.outError"),
    )
}

// ---------------------------------------------------------------------------------- RobotBase

#[test]
fn base_moves_and_brakes_without_commands() {
    let mut fixture = Fixture::default();
    fixture.add(
        "base",
        "kuka_youbot_base_sim",
        &parameters(&[("max_acc", "2")]),
    );
    fixture.start(1, &base_monitor("base"));
    fixture.start(2, &base_velocity("base", "{vel:{x:0.4}}"));
    fixture.steps(201);
    assert!((fixture.number(1, "vx") - 0.4).abs() < 1e-12);
    assert_eq!(fixture.out(2, "error"), "0");
    // Half of it while it accelerated for 0.2 s.
    let x = fixture.number(1, "x");
    assert!((x - 0.04).abs() < 0.001, "{x}");
    fixture.steps(1000);
    assert!((fixture.number(1, "x") - x - 0.4).abs() < 1e-9);
    fixture.end(2);
    fixture.steps(100);
    let vx = fixture.number(1, "vx");
    assert!((vx - 0.2).abs() < 0.01, "it brakes at its limit: {vx}");
    fixture.steps(110);
    assert_eq!(fixture.out(1, "vx"), "0");
    let rested = fixture.out(1, "x");
    fixture.steps(100);
    assert_eq!(fixture.out(1, "x"), rested);
}

#[test]
fn base_velocity_holds_for_slow_nets() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(1, &base_monitor("base"));
    let text = endless(&base_velocity("base", "{vel:{x:0.1}}"));
    fixture.try_start(2, &text, 4).unwrap();
    fixture.steps(300);
    for _ in 0..20 {
        fixture.step();
        assert!((fixture.number(1, "vx") - 0.1).abs() < 1e-12);
    }
}

#[test]
fn base_velocity_out_of_range_is_rejected() {
    for (velocity, error, illegal) in [
        ("{vel:{x:0.9}}", "1", "true"),
        ("{vel:{x:0.7,y:0.7}}", "1", "true"),
        ("{rot:{z:-1.1}}", "1", "true"),
        ("{vel:{x:nan}}", "2", "true"),
        // Directions in which a base cannot move do not matter.
        ("{vel:{z:9}}", "0", "false"),
    ] {
        let mut fixture = Fixture::default();
        fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
        fixture.start(1, &base_monitor("base"));
        fixture.start(2, &base_velocity("base", velocity));
        fixture.steps(50);
        assert_eq!(fixture.out(2, "error"), error, "{velocity}");
        assert_eq!(fixture.out(2, "illegal"), illegal, "{velocity}");
        assert_eq!(fixture.out(1, "vx"), "0", "{velocity}");
    }
}

#[test]
fn base_null_velocity_is_no_error() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(1, &base_monitor("base"));
    let children = base_velocity("base", "{vel:{x:0.4}}").replace(
        "inVel=v.outValue",
        "inVel=World::TwistSetNull(inValue=v.outValue,
            inNull=Core::BooleanValue(Value='true').outValue).outValue",
    );
    fixture.start(2, &children);
    fixture.steps(20);
    assert_eq!(
        (fixture.out(2, "error"), fixture.out(1, "vx")),
        ("0".to_owned(), "0".to_owned())
    );
}

#[test]
fn second_primitive_gets_concurrent_access_error() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(1, &base_monitor("base"));
    // The second depends on the first: this fixes their order.
    let both = format!(
        "{},no=Core::BooleanNot(inValue=move.outErrorIllegalVelocity),
        w2=World::TwistValue(Value='{{vel:{{x:-0.2}}}}'),
        late=World::TwistConditional(inCondition=no.outValue,inTrue=w2.outValue,inFalse=w2.outValue),
        again=RobotBase::BaseVelocity(inVel=late.outValue,Robot='base'),{},{}",
        base_velocity("base", "{vel:{x:0.2}}"),
        watch("Core::Int", "error2", "again.outError"),
        watch("Core::Boolean", "concurrent2", "again.outErrorConcurrentAccess"),
    );
    fixture.start(2, &both);
    fixture.steps(300);
    assert_eq!(fixture.out(2, "error"), "0");
    assert_eq!(fixture.out(2, "error2"), "-1");
    assert_eq!(fixture.out(2, "concurrent2"), "true");
    assert!((fixture.number(1, "vx") - 0.2).abs() < 1e-12);
}

#[test]
fn two_nets_cannot_command_one_base() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(1, &base_velocity("base", "{}"));
    let second = endless(&base_velocity("base", "{}"));
    let refused = fixture.try_start(2, &second, 1);
    assert!(
        matches!(refused, Err(StartError::ResourceInUse(_))),
        "{refused:?}"
    );
    let pose = endless(
        "p=World::FrameValue(),to=CartesianPosition::CartesianPosition(inPosition=p.outValue,Robot='base')",
    );
    let refused = fixture.try_start(3, &pose, 1);
    assert!(
        matches!(refused, Err(StartError::ResourceInUse(_))),
        "{refused:?}"
    );
}

#[test]
fn base_fault_ends_commanding_net_only() {
    let mut fixture = Fixture::default();
    let (mut dev, has, mut state) = driven(&mut fixture, 0, &[BASE]);
    let base = has.base.unwrap();
    base.error.report(&mut state.signals, Some(0));
    publish(&mut dev, &state);
    fixture.step();
    fixture.start(1, &base_monitor("dev"));
    fixture.start(2, &base_velocity("dev", "{vel:{x:0.4}}"));
    fixture.steps(5);
    let given = dev
        .command
        .read_with(|c| base.command.read(&c.words))
        .unwrap();
    assert_eq!(given.value.vel, Vector::new(0.4, 0.0, 0.0));
    assert!(given.is_in_force(fixture.cycle));
    assert_eq!(
        (fixture.out(1, "base"), fixture.out(1, "x")),
        ("0".into(), "null".into())
    );
    // Its driver reports that it does not follow, but stays operational.
    base.error.report(&mut state.signals, Some(2));
    publish(&mut dev, &state);
    fixture.steps(2);
    assert_eq!(
        (fixture.out(2, "error"), fixture.out(2, "failed")),
        ("2".into(), "true".into())
    );
    let given = dev
        .command
        .read_with(|c| base.command.read(&c.words))
        .unwrap();
    assert!(
        !given.is_in_force(fixture.cycle),
        "nothing is commanded any more"
    );
    (state.status, state.faults) = (DeviceStatus::SafeOperational, 1);
    publish(&mut dev, &state);
    fixture.step();
    assert_eq!(fixture.ended.get(&2), Some(&End::DeviceFault(0)));
    assert!(!fixture.ended.contains_key(&1));
    let again = fixture.try_start(3, &endless(&base_velocity("dev", "{}")), 1);
    assert_eq!(again, Err(StartError::DeviceNotReady(0)));
}

#[test]
fn base_controller_reaches_pose() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(
        1,
        &format!(
            "{},to=World::FrameValue(Value='{{pos:{{x:0.5,y:-0.25}},rot:{{a:1.2}}}}'),
            go=RobotBase::OmnidirectionalBaseController(inDest=to.outValue,inPos=base.outPos,
                inVel=base.outVel),
            move=RobotBase::BaseVelocity(inVel=go.outVel,Robot='base'),{},{}",
            base_monitor("base"),
            watch("Core::Int", "error", "move.outError"),
            watch("Core::Boolean", "done", "go.outCompleted"),
        ),
    );
    let mut sideways: f64 = 0.0;
    fixture.step();
    while fixture.out(1, "done") != "true" {
        assert!(fixture.cycle < 10_000, "it does not arrive");
        fixture.step();
        assert_eq!(fixture.out(1, "error"), "0");
        if fixture.cycle > 2 {
            sideways = sideways.max((fixture.number(1, "y") + fixture.number(1, "x") / 2.0).abs());
        }
    }
    assert!((fixture.number(1, "x") - 0.5).abs() < 0.011);
    assert!((fixture.number(1, "y") + 0.25).abs() < 0.011);
    assert!(sideways < 0.02, "the path is straight: {sideways}");
    // 0.5 m at 0.25 m/s, and the end of an exponential.
    assert!((2_000..5_000).contains(&fixture.cycle), "{}", fixture.cycle);
}

/// A driver with longer cycles than its nets reports what it commands only now and then: a base gains speed from one command
/// of its net to the next all the same.
#[test]
fn base_gains_speed_between_reports_of_driver() {
    let mut fixture = Fixture::default();
    let (mut dev, has, mut state) = driven(&mut fixture, 0, &[BASE]);
    let base = has.base.unwrap();
    base.error.report(&mut state.signals, Some(0));
    base.pose
        .report(&mut state.signals, Some(Frame::identity()));
    base.commanded
        .report(&mut state.signals, Some(Twist::default()));
    publish(&mut dev, &state);
    fixture.step();
    let net = format!(
            "to=World::FrameValue(Value='{{pos:{{x:9}}}}'),base=RobotBase::BaseMonitor(Robot='dev'),
            go=RobotBase::OmnidirectionalBaseController(inDest=to.outValue,inPos=base.outPos,inVel=base.outCmdVel,
                velX='0.5'),
            move=RobotBase::BaseVelocity(inVel=go.outVel,Robot='dev'),xyz=World::TwistToXYZ(inValue=go.outVel),{}",
            watch("Core::Double", "vx", "xyz.outX")
    );
    fixture.start(1, &net);
    fixture.steps(100);
    let speed = fixture.number(1, "vx");
    assert!((speed - 0.05).abs() < 0.002, "0.5 m/s² for 0.1 s: {speed}");
    // A driver that still smooths a step is what counts.
    let still = Twist {
        vel: Vector::new(-0.9, 0.0, 0.0),
        ..Twist::default()
    };
    base.commanded.report(&mut state.signals, Some(still));
    publish(&mut dev, &state);
    fixture.steps(2);
    let vx = fixture.number(1, "vx");
    assert!(vx < -0.4, "{vx}");
}

#[test]
fn base_controller_checks_pose_and_gains() {
    let mut fixture = Fixture::default();
    let text = format!(
        "to=World::FrameValue(),go=RobotBase::OmnidirectionalBaseController(inDest=to.outValue),{}",
        watch("Core::Boolean", "done", "go.outCompleted")
    );
    fixture.start(1, &text);
    fixture.steps(3);
    assert_eq!(fixture.out(1, "done"), "null");
    let fault = fixture.fault(&endless(&text.replace("(inDest", "(pX='0',inDest")));
    assert!(fault.contains("`pX`: 0 is not above zero"), "{fault}");
}

#[test]
fn base_wheels_follow_kinematics() {
    // In the direction of their motors: 0.2 m/s forward, 0.2 m/s to the left, 0.5 rad/s.
    let rates = |v: f64, signs: [f64; 4]| signs.map(|s| s * v / 0.0475);
    for (velocity, wheels) in [
        ("{vel:{x:0.2}}", rates(0.2, [-1.0, 1.0, -1.0, 1.0])),
        ("{vel:{y:0.2}}", rates(0.2, [1.0, 1.0, -1.0, -1.0])),
        ("{rot:{z:0.5}}", rates(0.5 * 0.385, [1.0; 4])),
    ] {
        let mut fixture = Fixture::default();
        fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
        fixture.start(1, &base_velocity("base", velocity));
        let monitors: Vec<_> = (0..4)
            .map(|i| {
                let key = format!("w{i}");
                format!(
                    "m{i}=RobotBase::WheelMonitor(Robot='base',Wheel='{i}'),{}",
                    watch("Core::Double", &key, &format!("m{i}.outVel"))
                )
            })
            .collect();
        fixture.start(2, &monitors.join(","));
        fixture.steps(1000);
        for (i, wheel) in wheels.into_iter().enumerate() {
            let rate = fixture.number(2, &format!("w{i}"));
            assert!((rate - wheel).abs() < 1e-9, "{velocity}, wheel {i}: {rate}");
        }
    }
}

#[test]
fn missing_interface_error_lists_suitable_devices() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.add("arm", "kuka_lwr_sim", &arm_parameters(7, &[]));
    fixture.add("io", "io_sim", &parameters(&[]));
    let fault = fixture.fault(&endless("b=RobotBase::BaseMonitor(Robot='arm')"));
    let wanted = "there is no robot base `arm`; available are `base`";
    assert!(fault.contains(wanted), "{fault}");
    let fault = fixture.fault(&endless("j=RobotArm::JointMonitor(Robot='base')"));
    assert!(
        fault.contains("no robot arm `base`; available are `arm`"),
        "{fault}"
    );
    let fault = fixture.fault(&endless("g=KUKA::youBot::GripperMonitor(Robot='io')"));
    assert!(
        fault.contains("no gripper `io`; available are none"),
        "{fault}"
    );
    let fault = fixture.fault(&endless(
        "w=RobotBase::WheelMonitor(Robot='base',Wheel='4')",
    ));
    assert!(fault.contains("4 is not between 0 and 3"), "{fault}");
    let fault = fixture.fault(&endless("i=IO::InBool(DeviceID='io',Port='-1')"));
    assert!(fault.contains("-1 is not between 0 and 7"), "{fault}");
    let fault = fixture.fault(&endless(
        "v=World::TwistValue(),m=RobotBase::BaseVelocity(Robot='base')",
    ));
    assert!(
        fault.contains("`inVel`") && fault.contains("must be connected"),
        "{fault}"
    );
}

// -------------------------------------------------------------------------- CartesianPosition

/// A pose that moves at a speed in x, and the pose of the device.
fn follow(robot: &str, start: f64, speed: f64) -> String {
    format!(
        "clock=Core::Clock(Increment='{speed}'),
        x=Core::DoubleAdd(inFirst=clock.outValue,Second='{start}'),
        r=World::RotationValue(),p=World::FrameFromXYZ(inX=x.outValue,inRot=r.outValue),
        to=CartesianPosition::CartesianPosition(inPosition=p.outValue,Robot='{robot}'),
        at=CartesianPosition::CartesianMonitor(Robot='{robot}'),
        xyz=World::FrameToXYZ(inValue=at.outMeasuredPosition),
        vel=World::TwistToXYZ(inValue=at.outCommandedVelocity),{},{},{},{},{}",
        watch("Core::Double", "x", "xyz.outX"),
        watch("Core::Double", "vx", "vel.outX"),
        watch("Core::Int", "error", "to.outError"),
        watch("Core::Int", "device", "at.outError"),
        watch("Core::Boolean", "illegal", "to.outErrorIllegalPosition"),
    )
}

#[test]
fn base_follows_poses_and_brakes_afterwards() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(1, &follow("base", 0.0, 0.3));
    fixture.steps(1001);
    // The state of a cycle is the result of the set-point of the previous cycle.
    assert!(
        (fixture.number(1, "x") - 0.3).abs() < 1e-9,
        "{}",
        fixture.out(1, "x")
    );
    assert_eq!(fixture.out(1, "error"), "0");
    fixture.start(2, &base_monitor("base"));
    fixture.end(1);
    fixture.steps(2);
    let vx = fixture.number(2, "vx");
    assert!((0.29..0.3).contains(&vx), "it brakes, not jumps: {vx}");
    fixture.steps(400);
    assert_eq!(fixture.out(2, "vx"), "0");
}

#[test]
fn base_rejects_distant_pose_until_stream_ends() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(1, &follow("base", 0.5, 0.0));
    fixture.steps(20);
    assert_eq!(
        (fixture.out(1, "error"), fixture.out(1, "device")),
        ("3".into(), "3".into())
    );
    assert_eq!(fixture.out(1, "x"), "0");
    fixture.end(1);
    fixture.steps(2);
    fixture.start(2, &follow("base", 0.0, 0.1));
    fixture.steps(20);
    assert_eq!(fixture.out(2, "error"), "0");
}

#[test]
fn base_slow_net_reaches_same_distance() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(1, &base_monitor("base"));
    let text = endless(&follow("base", 0.0, 0.075));
    fixture.try_start(2, &text, 4).unwrap();
    // Its clock counts its own cycles, which the fixture configures as 1 ms each.
    fixture.steps(400);
    for _ in 0..8 {
        fixture.step();
        let vx = fixture.number(1, "vx");
        assert!(
            (vx - 0.075 / 4.0).abs() < 1e-6,
            "the speed does not pulse: {vx}"
        );
    }
}

#[test]
fn base_nan_pose_is_reported() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.start(1, &follow("base", f64::NAN, 0.0).replace("NaN", "nan"));
    fixture.steps(3);
    assert_eq!(
        (fixture.out(1, "error"), fixture.out(1, "illegal")),
        ("2".into(), "true".into())
    );
}

// ----------------------------------------------------------------------------------------- IO

fn io_net(device: &str) -> String {
    format!(
        "b=Core::BooleanNetcommIn(Key='b',Value='true'),r=Core::DoubleValue(Value='2.5'),
        ob=IO::OutBool(inIO=b.outValue,DeviceID='{device}',Port='1'),
        oc=IO::OutBool(DeviceID='{device}',Port='2',IO='true'),
        or=IO::OutReal(inIO=r.outValue,DeviceID='{device}',Port='1'),
        ib=IO::InBool(DeviceID='{device}',Port='1'),ic=IO::InBool(DeviceID='{device}',Port='2'),
        i0=IO::InBool(DeviceID='{device}'),ir=IO::InReal(DeviceID='{device}',Port='1'),
        sb=IO::OutBoolSensor(DeviceID='{device}',Port='1'),
        sr=IO::OutRealSensor(DeviceID='{device}',Port='1'),{},{},{},{},{},{}",
        watch("Core::Boolean", "in1", "ib.outIO"),
        watch("Core::Boolean", "in2", "ic.outIO"),
        watch("Core::Boolean", "in0", "i0.outIO"),
        watch("Core::Double", "real", "ir.outIO"),
        watch("Core::Boolean", "sensor", "sb.outIO"),
        watch("Core::Double", "sensor_real", "sr.outIO"),
    )
}

#[test]
fn outputs_keep_values_after_net_end() {
    let mut fixture = Fixture::default();
    fixture.add(
        "io",
        "io_sim",
        &parameters(&[("bools", "3"), ("reals", "2")]),
    );
    fixture.start(1, &io_net("io"));
    fixture.steps(2);
    for (key, value) in [
        ("in1", "true"),
        ("in2", "true"),
        ("in0", "false"),
        ("real", "2.5"),
        ("sensor", "true"),
        ("sensor_real", "2.5"),
    ] {
        assert_eq!(fixture.out(1, key), value, "{key}");
    }
    let second = fixture.try_start(2, &endless("o=IO::OutBool(DeviceID='io',Port='1')"), 1);
    assert!(
        matches!(second, Err(StartError::ResourceInUse(_))),
        "{second:?}"
    );
    fixture.end(1);
    let text = format!(
        "i=IO::InBool(DeviceID='io',Port='1'),{}",
        watch("Core::Boolean", "in1", "i.outIO")
    );
    fixture.start(3, &text);
    fixture.steps(10);
    assert_eq!(fixture.out(3, "in1"), "true");
}

#[test]
fn sim_lwr_has_outputs_besides_joints() {
    let mut fixture = Fixture::default();
    fixture.add("lwr", "kuka_lwr_sim", &arm_parameters(7, &[]));
    let text = format!(
        "on=IO::OutBool(DeviceID='lwr',Port='7',IO='true'),in=IO::InBool(DeviceID='lwr',Port='7'),
        set=IO::OutReal(DeviceID='lwr',Port='7',IO='2.5'),
        set_to=IO::OutRealSensor(DeviceID='lwr',Port='7'),{},{}",
        watch("Core::Boolean", "in", "in.outIO"),
        watch("Core::Double", "set_to", "set_to.outIO"),
    );
    fixture.start(1, &text);
    fixture.steps(2);
    let values = ["in", "set_to"].map(|key| fixture.out(1, key));
    assert_eq!(values, ["true", "2.5"]);
}

#[test]
fn null_keeps_output_unknown_input_is_null() {
    let mut fixture = Fixture::default();
    let part = Part::Io {
        bool_in: 1,
        bool_out: 1,
        real_in: 1,
        real_out: 0,
    };
    let (mut dev, has, state) = driven(&mut fixture, 0, &[part]);
    let io = has.io.unwrap();
    publish(&mut dev, &state);
    fixture.step();
    let text = format!(
        "n=Core::BooleanValue(Value='true'),v=Core::BooleanSetNull(inValue=n.outValue,inNull=n.outValue),
        o=IO::OutBool(inIO=v.outValue,DeviceID='dev',IO='true'),i=IO::InReal(DeviceID='dev'),{}",
        watch("Core::Double", "real", "i.outIO")
    );
    fixture.start(1, &text);
    fixture.steps(5);
    assert_eq!(fixture.out(1, "real"), "null");
    let given = dev
        .command
        .read_with(|c| io.bool_out[0].command.read(&c.words));
    assert_eq!(given, None);
}

// ----------------------------------------------------------------- RobotArm, KUKA::LWR, youBot

fn strategy(robot: &str, number: i32) -> String {
    format!(
        "s=Core::IntValue(Value='{number}'),
        c=KUKA::LWR::ControlStrategy(inStrategy=s.outValue,Robot='{robot}'),{},{}",
        watch("Core::Boolean", "done", "c.outCompleted"),
        watch("Core::Int", "error", "c.outError"),
    )
}

fn joint_monitor(robot: &str) -> String {
    format!(
        "m=RobotArm::JointMonitor(Robot='{robot}',Axis='1'),{},{}",
        watch("Core::Double", "commanded", "m.outCommandedPosition"),
        watch("Core::Double", "measured", "m.outMeasuredPosition"),
    )
}

/// Switches the strategy of an arm and ends that net.
fn switch(fixture: &mut Fixture, robot: &str, number: i32) {
    fixture.start(90, &strategy(robot, number));
    fixture.until(90, "done", "true");
    assert_eq!(fixture.out(90, "error"), "0");
    fixture.end(90);
}

const LOAD: (&str, &str) = ("external_torque", "[0,20,0,0,0,0,0]");

#[test]
fn compliant_joint_yields_stiff_joint_holds() {
    let mut fixture = Fixture::default();
    fixture.add("arm", "kuka_lwr_sim", &arm_parameters(7, &[LOAD]));
    fixture.start(1, &joint_monitor("arm"));
    fixture.steps(100);
    assert_eq!(fixture.out(1, "measured"), "0");
    switch(&mut fixture, "arm", 3);
    fixture.steps(2000);
    // 20 Nm at the 1000 Nm/rad it has at first.
    assert!((fixture.number(1, "measured") - 0.02).abs() < 1e-9);
    assert_eq!(fixture.out(1, "commanded"), "0");
    let impedance = "k=Core::DoubleValue(Value='200'),d=Core::DoubleValue(Value='0.5'),
        i=KUKA::LWR::JointImpParameters(inStiffness=k.outValue,inDamping=d.outValue,Robot='arm',Axis='1')";
    fixture.start(2, impedance);
    fixture.step();
    fixture.steps(3000);
    assert!((fixture.number(1, "measured") - 0.1).abs() < 1e-6);
    // The stiffness remains after the end of the net that set it.
    fixture.end(2);
    fixture.steps(100);
    assert!((fixture.number(1, "measured") - 0.1).abs() < 1e-6);
}

#[test]
fn added_torque_ends_with_its_net() {
    let mut fixture = Fixture::default();
    fixture.add("arm", "kuka_iiwa_sim", &arm_parameters(7, &[]));
    fixture.start(1, &joint_monitor("arm"));
    switch(&mut fixture, "arm", 3);
    fixture.start(
        2,
        "t=Core::DoubleValue(Value='10'),
        i=KUKA::LWR::JointImpParameters(inAddTorque=t.outValue,Robot='arm',Axis='1')",
    );
    fixture.steps(2000);
    assert!((fixture.number(1, "measured") - 0.01).abs() < 1e-9);
    fixture.end(2);
    fixture.steps(2000);
    assert!(fixture.number(1, "measured").abs() < 1e-9);
}

#[test]
fn strategy_rejected_if_unknown_or_moving() {
    let mut fixture = Fixture::default();
    fixture.add("arm", "kuka_lwr_sim", &arm_parameters(7, &[LOAD]));
    fixture.start(1, &strategy("arm", 7));
    fixture.until(1, "error", "1");
    assert_eq!(fixture.out(1, "done"), "false");
    fixture.end(1);
    switch(&mut fixture, "arm", 3);
    fixture.steps(2000);
    // 0.02 rad from its set-point.
    fixture.start(1, &strategy("arm", 1));
    fixture.until(1, "error", "3");
    assert_eq!(fixture.out(1, "done"), "false");
    fixture.end(1);
    // The answer to an earlier order does not answer a new one.
    fixture.start(1, &strategy("arm", 3));
    fixture.step();
    assert_eq!(
        (fixture.out(1, "error"), fixture.out(1, "done")),
        ("0".into(), "false".into())
    );
    fixture.until(1, "done", "true");
}

#[test]
fn null_strategy_changes_nothing() {
    let mut fixture = Fixture::default();
    fixture.add("arm", "kuka_lwr_sim", &arm_parameters(7, &[]));
    fixture.start(1, &strategy("arm", 3).replace("inStrategy=s.outValue,", ""));
    fixture.steps(5);
    assert_eq!(
        (fixture.out(1, "error"), fixture.out(1, "done")),
        ("null".into(), "null".into())
    );
}

#[test]
fn second_order_gets_error_every_cycle() {
    let mut fixture = Fixture::default();
    fixture.add("arm", "kuka_lwr_sim", &arm_parameters(7, &[]));
    let both = format!(
        "{},late=Core::IntConditional(inCondition=c.outCompleted,True='1',False='1'),
        again=KUKA::LWR::ControlStrategy(inStrategy=late.outValue,Robot='arm'),{}",
        strategy("arm", 3),
        watch("Core::Int", "error2", "again.outError"),
    );
    fixture.start(1, &both);
    for _ in 0..20 {
        fixture.step();
        assert_eq!(fixture.out(1, "error2"), "-1");
    }
    assert_eq!(
        (fixture.out(1, "error"), fixture.out(1, "done")),
        ("0".into(), "true".into())
    );
}

#[test]
fn tool_force_acts_on_joints_and_is_reported() {
    let mut fixture = Fixture::default();
    // Stretched upwards: a force along x at 1.178 m above the base bends the second joint.
    let wrench = ("external_wrench", "[10,0,0,0,0,0]");
    fixture.add("arm", "kuka_lwr_sim", &arm_parameters(7, &[wrench]));
    let text = format!(
        "f=KUKA::LWR::FMonitor(Robot='arm'),t=KUKA::LWR::TMonitor(Robot='arm',Axis='1'),
        all=KUKA::LWR::FTMonitor(Robot='arm'),z=RobotArm::JointMonitor(Robot='arm',Axis='1'),
        j0=Core::DoubleArray(Size='7'),kin=ArmKinematics::Kin(inJoints=j0.outArray,Robot='arm'),
        at=World::FrameToXYZ(inValue=kin.outFrame),{},{},{},{},{},{}",
        watch("Core::Double", "fx", "f.outTcpFx"),
        watch("Core::Double", "est", "t.outEst"),
        watch("Core::Double", "est2", "all.outEstJ2"),
        watch("Core::Double", "msr2", "all.outMsrJ2"),
        watch("Core::Double", "all_fx", "all.outTcpFx"),
        watch("Core::Double", "height", "at.outZ"),
    );
    fixture.start(1, &text);
    fixture.steps(5);
    assert_eq!(
        (fixture.out(1, "fx"), fixture.out(1, "all_fx")),
        ("10".into(), "10".into())
    );
    let lever = fixture.number(1, "height") - 0.3105;
    let torque = fixture.number(1, "est");
    assert!(
        (torque.abs() - 10.0 * lever).abs() < 1e-3,
        "{torque} Nm at {lever} m"
    );
    assert_eq!(fixture.out(1, "est"), fixture.out(1, "est2"));
    assert_eq!(fixture.out(1, "est"), fixture.out(1, "msr2"));
}

#[test]
fn unknown_forces_are_null() {
    let mut fixture = Fixture::default();
    let (mut dev, has, mut state) = driven(&mut fixture, 7, &[Part::Torques, Part::Wrench]);
    has.torques.unwrap()[6]
        .measured
        .report(&mut state.signals, Some(1.5));
    publish(&mut dev, &state);
    fixture.step();
    let text = format!(
        "all=KUKA::LWR::FTMonitor(Robot='dev'),{},{},{}",
        watch("Core::Double", "msr7", "all.outMsrJ7"),
        watch("Core::Double", "est7", "all.outEstJ7"),
        watch("Core::Double", "fx", "all.outTcpFx"),
    );
    fixture.start(1, &text);
    fixture.step();
    assert_eq!(
        [
            fixture.out(1, "msr7"),
            fixture.out(1, "est7"),
            fixture.out(1, "fx")
        ],
        ["1.5", "null", "null"]
    );
}

/// A tool of this mass, configured in either way.
fn tools(mass: &str) -> [String; 2] {
    let done = [
        watch("Core::Boolean", "done", "t.outCompleted"),
        watch("Core::Int", "error", "t.outError"),
    ]
    .join(",");
    [
        format!("t=RobotArm::ToolParameters(Robot='dev',Axis='6',Mass='{mass}'),{done}"),
        format!(
            "m=Core::DoubleValue(Value='{mass}'),f=World::FrameValue(Value='{{pos:{{z:0.1}}}}'),
            i=World::VectorValue(Value='{{x:1,y:1,z:1}}'),
            t=KUKA:LWR::ToolParameters(inMass=m.outValue,inCOM=f.outValue,inMOI=i.outValue,
                inTCP=f.outValue,robot='dev'),{done}"
        ),
    ]
}

#[test]
fn tool_is_set_once_and_confirmed() {
    for (number, text) in tools("1.5").into_iter().enumerate() {
        let mut fixture = Fixture::default();
        let (mut dev, has, mut state) = driven(&mut fixture, 7, &[Part::Tool]);
        let tool = has.tool.unwrap();
        publish(&mut dev, &state);
        fixture.step();
        fixture.start(1, &text);
        fixture.steps(10);
        let given = dev
            .command
            .read_with(|c| tool.command.read(&c.words))
            .unwrap();
        assert_eq!((given.cycle, given.value.mass), (2, 1.5));
        let height = given.value.tcp.translation.vector.z;
        assert_eq!(height > 0.0, number == 1, "{height}");
        assert_eq!(
            (fixture.out(1, "done"), fixture.out(1, "error")),
            ("false".into(), "0".into())
        );
        for (error, done) in [(5, "false"), (0, "true")] {
            let order = given.cycle;
            tool.answer
                .report(&mut state.signals, Some(Answer { order, error }));
            publish(&mut dev, &state);
            fixture.step();
            assert_eq!(fixture.out(1, "done"), done);
            assert_eq!(fixture.out(1, "error"), error.to_string());
        }
    }
}

#[test]
fn invalid_tools_are_not_set() {
    for (mass, error) in [("-1", "1"), ("nan", "2")] {
        for text in tools(mass) {
            let mut fixture = Fixture::default();
            let (mut dev, has, state) = driven(&mut fixture, 7, &[Part::Tool]);
            publish(&mut dev, &state);
            fixture.step();
            fixture.start(1, &text);
            fixture.steps(3);
            assert_eq!(fixture.out(1, "error"), error);
            let tool = has.tool.unwrap();
            assert_eq!(dev.command.read_with(|c| tool.command.read(&c.words)), None);
        }
    }
    let mut fixture = Fixture::default();
    driven(&mut fixture, 7, &[Part::Tool]);
    let fault = fixture.fault(&endless("t=RobotArm::ToolParameters(Robot='dev',Axis='2')"));
    assert!(fault.contains("a tool is set for axis 6"), "{fault}");
}

#[test]
fn tool_cannot_change_while_joint_moves() {
    let mut fixture = Fixture::default();
    fixture.add("dev", "kuka_lwr_sim", &arm_parameters(7, &[]));
    fixture.start(
        1,
        "p=Core::DoubleValue(),j=RobotArm::JointPosition(inPosition=p.outValue,Robot='dev',Axis='6')",
    );
    for text in tools("1") {
        let refused = fixture.try_start(2, &endless(&text), 1);
        assert!(
            matches!(refused, Err(StartError::ResourceInUse(_))),
            "{refused:?}"
        );
    }
}

#[test]
fn cartesian_impedance_omits_null_values() {
    let mut fixture = Fixture::default();
    let (mut dev, has, state) = driven(&mut fixture, 7, &[Part::CartesianImpedance]);
    publish(&mut dev, &state);
    fixture.step();
    fixture.start(
        1,
        "k=World::WrenchValue(Value='{force:{x:500},torque:{z:30}}'),
        c=KUKA::LWR::CartImpParameters(inStiffness=k.outValue,Robot='dev')",
    );
    fixture.steps(3);
    let order = has.cartesian_impedance.unwrap();
    let given = dev
        .command
        .read_with(|c| order.command.read(&c.words))
        .unwrap();
    assert_eq!(
        given.value.stiffness.unwrap().force,
        Vector::new(500.0, 0.0, 0.0)
    );
    assert_eq!((given.value.damping, given.value.wrench), (None, None));
    assert!(given.is_in_force(fixture.cycle));
}

#[test]
fn youbot_arm_switches_controller_and_yields() {
    let mut fixture = Fixture::default();
    let load = ("external_torque", "[0,2,0,0,0]");
    fixture.add("arm", "kuka_youbot_arm_sim", &arm_parameters(5, &[load]));
    fixture.start(1, &joint_monitor("arm"));
    let text = format!(
        "c=KUKA::youBot::ArmControlStrategy(Robot='arm',Controller='1'),
        i=KUKA::youBot::JointImpParameters(Robot='arm',JointIndex='1',Stiffness='20',Damping='0.7'),
        bad=KUKA::youBot::JointImpParameters(Robot='arm',JointIndex='2',Damping='7'),
        e=KUKA::youBot::SlaveError(Robot='arm',Port='1'),{},{},{},{},{}",
        watch("Core::Boolean", "switched", "c.outSuccess"),
        watch("Core::Boolean", "set", "i.outSuccess"),
        watch("Core::Boolean", "bad", "bad.outSuccess"),
        watch("Core::Boolean", "position_mode", "e.bit10"),
        watch("Core::Boolean", "overcurrent", "e.bit0"),
    );
    fixture.start(2, &text);
    fixture.steps(5000);
    for (key, value) in [
        ("switched", "true"),
        ("set", "true"),
        ("bad", "false"),
        ("position_mode", "true"),
        ("overcurrent", "false"),
    ] {
        assert_eq!(fixture.out(2, key), value, "{key}");
    }
    let measured = fixture.number(1, "measured");
    assert!((measured - 0.1).abs() < 1e-6, "{measured}");
}

#[test]
fn maximum_torque_lets_joint_slip() {
    let mut fixture = Fixture::default();
    let load = ("external_torque", "[0,2,0,0,0]");
    fixture.add("arm", "kuka_youbot_arm_sim", &arm_parameters(5, &[load]));
    fixture.start(1, &joint_monitor("arm"));
    fixture.start(
        2,
        "c=KUKA::youBot::ArmControlStrategy(Robot='arm',Controller='1'),
        i=KUKA::youBot::JointImpParameters(Robot='arm',JointIndex='1',Stiffness='20',
            Damping='0.7',MaxTorque='1')",
    );
    fixture.steps(20_000);
    // Up to its stop.
    assert!(
        (fixture.number(1, "measured") - 2.0).abs() < 1e-9,
        "{}",
        fixture.out(1, "measured")
    );
}

#[test]
fn gripper_opens_at_speed_and_reports_completion() {
    let mut fixture = Fixture::default();
    fixture.add(
        "hand",
        "kuka_youbot_gripper_sim",
        &parameters(&[("max_vel", "0.02")]),
    );
    let text = format!(
        "g=KUKA::youBot::Gripper(Robot='hand',Distance='0.02'),
        m=KUKA::youBot::GripperMonitor(Robot='hand'),{},{}",
        watch("Core::Boolean", "done", "g.outCompleted"),
        watch("Core::Double", "at", "m.outDistance"),
    );
    fixture.start(1, &text);
    fixture.steps(501);
    // A hundredth in half a second, less what it takes to get up to speed at 1 m/s².
    let at = fixture.number(1, "at");
    assert!((at - 0.0098).abs() < 3e-5, "{at}");
    assert_eq!(fixture.out(1, "done"), "false");
    fixture.until(1, "done", "true");
    assert_eq!(fixture.out(1, "at"), "0.02");
    assert!((1010..1050).contains(&fixture.cycle), "{}", fixture.cycle);
    let second = fixture.try_start(2, &endless("g=KUKA::youBot::Gripper(Robot='hand')"), 1);
    assert!(
        matches!(second, Err(StartError::ResourceInUse(_))),
        "{second:?}"
    );
    let wide = endless("g=KUKA::youBot::Gripper(Robot='hand',Distance='0.03')");
    assert!(
        fixture
            .fault(&wide)
            .contains("0.03 m is not between 0 and 0.023 m")
    );
}

// ------------------------------------------------------------------------------ more than one

#[test]
fn orders_do_not_reach_later_devices() {
    let mut fixture = Fixture::default();
    let (mut dev, has, mut state) = driven(&mut fixture, 0, &[BASE]);
    let base = has.base.unwrap();
    base.error.report(&mut state.signals, Some(0));
    publish(&mut dev, &state);
    fixture.step();
    fixture.start(1, &base_velocity("dev", "{vel:{x:0.4}}"));
    fixture.steps(3);
    fixture.end(1);
    let number = fixture.table.remove("dev").unwrap();
    assert!(
        fixture
            .served
            .remove(number, &mut fixture.executor)
            .is_some()
    );
    let (mut dev, ..) = driven(&mut fixture, 0, &[BASE]);
    fixture.steps(2);
    assert_eq!(dev.command.read_with(|c| base.command.read(&c.words)), None);
}

#[test]
fn device_is_visible_to_second_thread() {
    use takt_core::executor::serve::{DeviceEnd, Driver};
    let (mut one, mut other) = (Fixture::default(), Fixture::default());
    one.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    let device = one.table.find("base").unwrap();
    let driver = Driver::Seen {
        state: device.reader().unwrap(),
    };
    let end = DeviceEnd::new(0, device.place.clone(), driver);
    other.table = one.table.clone();
    other.served.add(Box::new(end), &mut other.executor);
    one.start(1, &base_velocity("base", "{vel:{x:0.1}}"));
    other.start(1, &base_monitor("base"));
    one.steps(1000);
    other.step();
    assert!((other.number(1, "vx") - 0.1).abs() < 1e-12);
}

#[test]
fn arm_moves_on_moving_base() {
    let mut fixture = Fixture::default();
    fixture.add("base", "kuka_youbot_base_sim", &parameters(&[]));
    fixture.add("arm", "kuka_youbot_arm_sim", &arm_parameters(5, &[]));
    let text = format!(
        "{},{},clock=Core::Clock(),part=Core::Interval(inValue=clock.outValue,Max='1'),
        smooth=Core::DoubleBezier(inValue=part.outValue,To='0.5'),
        joint=RobotArm::JointPosition(inPosition=smooth.outValue,Robot='arm',Axis='1'),{}",
        base_velocity("base", "{vel:{y:0.2}}"),
        base_monitor("base"),
        watch("Core::Int", "joint", "joint.outError"),
    );
    fixture.start(1, &text);
    fixture.start(2, &joint_monitor("arm"));
    fixture.steps(1100);
    assert_eq!(
        (fixture.out(1, "error"), fixture.out(1, "joint")),
        ("0".into(), "0".into())
    );
    assert!((fixture.number(2, "measured") - 0.5).abs() < 1e-9);
    assert!(
        (fixture.number(1, "y") - 0.2).abs() < 0.03,
        "{}",
        fixture.out(1, "y")
    );
}

#[test]
fn wrong_device_parameters_are_reported() {
    let made = |kind: &str, pair: (&str, &str)| {
        let parameters = arm_parameters(7, &[pair]);
        match takt_core::device::sim::make("dev", kind, &parameters) {
            Ok((DeviceDescription { kind, .. }, _)) => kind.to_owned(),
            Err(error) => error.to_string(),
        }
    };
    let base = "kuka_youbot_base_sim";
    assert!(made(base, ("max_vel", "0")).contains("max_vel: `0` is no number from 1e-6 to 1e9"));
    assert!(
        made("io_sim", ("bools", "65")).contains("bools: `65` is no whole number from 0 to 64")
    );
    assert!(
        made("kuka_lwr_sim", ("external_wrench", "[1]"))
            .contains("6 numbers from -1e9 to 1e9 are wanted")
    );
    assert_eq!(made("io_sim", ("anything", "else")), "io_sim");
}
