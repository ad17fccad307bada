//! Nets and plans of motions, without controller.

use std::sync::Arc;
use std::time::Duration;

use super::*;
use crate::order::{Operation, Order, Speed};
use crate::preparation::{Begin, Begins};

const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];

fn arm(name: &str) -> ArmDescription {
    let joint = JointLimits {
        position_min: -2.9,
        position_max: 2.9,
        velocity: 2.0,
        acceleration: 8.0,
        jerk: 80.0,
    };
    ArmDescription {
        name: name.to_owned(),
        kind: "kuka_lwr_sim".to_owned(),
        model: "kuka_lwr4".into(),
        joints: vec![joint; 7],
        home: vec![0.0; 7],
        period: Duration::from_millis(2),
        interfaces: ["wrench", "strategy", "cartesianimpedance"]
            .map(str::to_owned)
            .to_vec(),
    }
}

fn begins(names: &[&str]) -> Begins {
    let begin = Begin::at_rest(BENT.to_vec());
    let pairs = names.iter().map(|name| ((*name).to_owned(), begin.clone()));
    pairs.collect()
}

fn along(route: Route) -> ArmMotion {
    ArmMotion {
        arm: arm("left"),
        path: Ok(Path::Frame(route)),
        limits: CartesianLimits::default(),
        tool: Pose::IDENTITY,
    }
}

fn flange() -> Pose {
    arm("left").pose(&BENT).unwrap()
}

fn net(operation: impl Operation + 'static, begins: &Begins) -> Result<String, ErrorKind> {
    let order = Order {
        operation: Arc::new(operation),
        speed: Speed::FULL.times(0.5),
        blend: Some(0.5),
        until: Vec::new(),
        marks: Vec::new(),
        is_checked: true,
    };
    order.check()?;
    Ok(order.compile(begins)?.net)
}

#[test]
fn arc_begins_where_the_arm_is() {
    let (via, to) = (Pose::xyz(0.1, 0.1, 0.0), Pose::xyz(0.0, 0.2, 0.0));
    let route = Route::Arc {
        via: via * flange(),
        to: to * flange(),
    };
    let text = net(along(route.clone()), &begins(&["left"])).unwrap();
    assert!(
        text.contains(&format!("From='{}'", flange().text())),
        "{text}"
    );
    let unknown = net(along(route), &Begins::new()).unwrap_err();
    assert!(matches!(unknown, ErrorKind::Unplanned { .. }), "{unknown}");
}

#[test]
fn line_needs_no_known_start() {
    let text = net(along(Route::Line(flange())), &Begins::new()).unwrap();
    assert!(
        text.contains("Join='0'") && text.contains("Velocity='0.25'"),
        "{text}"
    );
}

#[test]
fn motion_of_unknown_model_cannot_be_planned() {
    let mut motion = along(Route::Line(flange()));
    motion.arm.model = "other".into();
    let error = motion
        .plan(&begins(&["left"]), 1.0)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("the model `other` of its kinematics is not known"),
        "{error}"
    );
    assert_eq!(motion.follow(&begins(&["left"]), 1.0), Ok([].into()));
}

#[test]
fn limits_that_are_not_positive_are_refused() {
    let mut motion = along(Route::Line(flange()));
    motion.limits.jerk = f64::NAN;
    let error = motion.check().unwrap_err().to_string();
    assert_eq!(
        error,
        "left: the limit `jerk` is NaN; it is above 0\nhint: limits are in m, rad and s"
    );
    let error = along(Route::Spline(Vec::new())).check().unwrap_err();
    assert_eq!(error.to_string(), "left: 0 points; a curve has 1 to 63");
}

fn coupled() -> CoupledMotion {
    let holder = |name: &str| Holder {
        arm: arm(name),
        base: Pose::xyz(0.0, 0.3, 0.0),
        grasp: Pose::xyz(0.0, 0.1, 0.0),
    };
    CoupledMotion {
        holders: vec![holder("left"), holder("right")],
        route: Route::Line(Pose::xyz(0.0, 0.3, 0.1) * flange() * Pose::xyz(0.0, -0.1, 0.0)),
        limits: CartesianLimits::default(),
    }
}

#[test]
fn coupled_arms_have_one_motion_and_one_stop() {
    let text = net(coupled(), &begins(&["left", "right"])).unwrap();
    assert_eq!(text.matches("Motion::Lin(").count(), 1, "{text}");
    assert_eq!(
        text.matches("ArmKinematics::InvKin(").count(),
        4,
        "now and at rest: {text}"
    );
    assert_eq!(
        text.matches("RobotArm::JointPosition(").count(),
        14,
        "{text}"
    );
    assert_eq!(
        text.matches("Core::BooleanPre(inValue=p").count(),
        1,
        "{text}"
    );
    // The speed of a joint is that of the net's own positions.
    assert_eq!(
        text.matches("Core::DoublePre(inValue=p").count(),
        14,
        "{text}"
    );
    for key in [
        "unreachable_left",
        "fast_right",
        "failed_left",
        "concurrent_right",
        "lost_left",
    ] {
        assert!(
            text.contains(&format!("Key='{key}'")),
            "{key} is missing in {text}"
        );
    }
}

#[test]
fn lines_beyond_reach_fail_at_rest() {
    let begins = begins(&["left"]);
    let text = net(along(Route::Line(Pose::xyz(0.5, 0.0, 0.5))), &begins).unwrap();
    assert_eq!(
        text.matches("ArmKinematics::InvKin(").count(),
        2,
        "now and at rest: {text}"
    );
    let result = text
        .lines()
        .find(|line| line.contains("Key='unreachable_left'"))
        .unwrap();
    let (_, port) = result.split_once("inValue=").unwrap();
    let (name, _) = port.split_once('.').unwrap();
    let ended = text
        .lines()
        .find(|line| line.trim().starts_with(&format!("{name}=")))
        .unwrap();
    assert!(
        ended.contains("Core::BooleanAnd(inFirst=") && ended.contains(".outDone"),
        "{ended}"
    );
}

#[test]
fn coupled_net_outlives_a_failure_until_rest() {
    let begins = begins(&["left", "right"]);
    let text = net(coupled(), &begins).unwrap();
    let lost = text
        .lines()
        .find(|line| line.contains("=DeviceFailure("))
        .unwrap();
    let (name, _) = lost.trim().split_once('=').unwrap();
    assert!(
        text.contains(&format!(
            "Core::BooleanOr(inFirst=p0.outCancel, inSecond={name}.outFailed)"
        )),
        "{text}"
    );
    // From half the speed, braking takes up to 0.225 s.
    assert!(lost.contains("Time='1'"), "{lost}");
    for (acceleration, jerk, time) in [(0.2, 10.0, "1.29"), (1.0, 0.5, "2"), (1.0, 0.01, "10")] {
        let mut slow = coupled();
        slow.limits.acceleration = acceleration;
        slow.limits.jerk = jerk;
        let text = net(slow, &begins).unwrap();
        let lost = format!("DeviceFailure(Time='{time}')");
        assert!(text.contains(&lost), "{text}");
    }
}

#[test]
fn coupled_arms_have_plans_of_one_duration() {
    let begins = begins(&["left", "right"]);
    let plan = coupled().plan(&begins, 1.0).unwrap();
    let [partner] = plan.partners() else {
        panic!("{plan:?}");
    };
    assert_eq!((plan.device(), partner.device()), ("left", "right"));
    assert_eq!(plan.duration(), partner.duration());
    assert_eq!(plan.end(), partner.end());
}

fn live_net(operation: impl Operation + 'static) -> String {
    let order = Order {
        operation: Arc::new(operation),
        speed: Speed::FULL.times(0.5),
        blend: None,
        until: Vec::new(),
        marks: Vec::new(),
        is_checked: true,
    };
    order.check().unwrap();
    order.compile(&Begins::new()).unwrap().net
}

#[test]
fn jog_nets_have_a_dead_man() {
    let centre = live_net(Jog::Centre(Centre {
        arm: arm("left"),
        limits: CartesianLimits::default(),
        tool: Pose::xyz(0.0, 0.0, 0.1),
    }));
    let joints = live_net(Jog::Joints { arm: arm("left") });
    for (text, sent) in [
        (&centre, "World::TwistNetcommIn"),
        (&joints, "Core::DoubleArrayNetcommIn"),
    ] {
        assert_eq!(text.matches(sent).count(), 1, "{text}");
        assert!(text.contains("Second='0.1'"), "{text}");
        assert!(
            text.contains("Core::BooleanConditional(inCondition="),
            "{text}"
        );
        assert_eq!(text.matches("RobotArm::JointPosition(").count(), 7);
    }
    // Half the velocity, the whole acceleration.
    assert!(
        centre.contains("Max='0.125'") && centre.contains("Second='1'"),
        "{centre}"
    );
    assert!(
        joints.contains("Min='-1', Max='1'") && joints.contains("Second='8'"),
        "{joints}"
    );
    assert!(centre.contains("Key='unreachable_left'") && centre.contains("Key='fast_left'"));
}

#[test]
fn stream_nets_track_goals_once_written() {
    let streams = [Goals::Joints, Goals::Poses(Pose::IDENTITY)];
    let [joints, poses] = streams.map(|goals| {
        live_net(Stream {
            arm: arm("left"),
            goals,
        })
    });
    for text in [&joints, &poses] {
        assert_eq!(text.matches("Motion::Track(").count(), 1, "{text}");
        assert_eq!(text.matches("SetNull(").count(), 1, "{text}");
    }
    assert!(poses.contains("ArmKinematics::InvKin(") && poses.contains("Key='unreachable_left'"));
}

#[test]
fn full_speed_leaves_room_for_device_clock() {
    let [text, ..] = arm("left").limit_texts();
    assert_eq!(text, array(&[2.0 * 0.999; 7]));
}

/// What brakes a motion at a part of the speed has its whole limits: the primitive takes both.
#[test]
fn motions_at_part_of_speed_have_whole_limits() {
    let begins = begins(&["left", "right"]);
    let line = along(Route::Line(flange() * Pose::xyz(0.0, 0.0, 0.1)));
    let joints = ArmMotion {
        path: Ok(Path::Ptp(vec![0.5; 7])),
        ..line.clone()
    };
    let [_, acceleration, jerk] = arm("left").limit_texts();
    let of_joints = format!("Acceleration='{acceleration}', Jerk='{jerk}', Speed='0.5'");
    let of_frame = "Velocity='0.25', Acceleration='1', Jerk='10', RotVelocity='0.5', RotAcceleration='2.5', RotJerk='25', Speed='0.5'";
    for (text, limits) in [
        (net(joints, &begins).unwrap(), of_joints.as_str()),
        (net(line, &begins).unwrap(), of_frame),
        (net(coupled(), &begins).unwrap(), of_frame),
        (live_net(Hold { arm: arm("left") }), &of_joints),
    ] {
        assert!(text.contains(limits), "{limits}: {text}");
    }
}

/// Towards stretched arms joints become faster while the object already brakes: such a line is refused, with the speed at which it
/// fits, so that no line that is accepted brakes on its way.
#[test]
fn coupled_line_that_would_brake_names_fitting_speed() {
    let begins = begins(&["left", "right"]);
    let mut by_braking = 0;
    for step in (4..60).step_by(5) {
        let mut motion = coupled();
        let start = Pose::xyz(0.0, 0.3, 0.0) * flange() * Pose::xyz(0.0, -0.1, 0.0);
        let outward = start.position().map(|at| at * 0.005 * f64::from(step));
        let [x, y, z] = outward;
        motion.route = Route::Line(Pose::xyz(x, y, z) * start);
        for speed in [0.5, 0.95, 1.0] {
            let Err(error) = motion.follow(&begins, speed) else {
                continue;
            };
            let ErrorKind::TooFast {
                speed: fits, limit, ..
            } = error
            else {
                continue;
            };
            assert!(fits < speed, "{fits} at {speed}");
            by_braking += usize::from(limit < 0.5 * 2.0);
            let slower = motion.follow(&begins, fits);
            assert!(slower.is_ok(), "step {step}, {speed} to {fits}: {slower:?}");
        }
    }
    assert!(by_braking > 0, "no line is refused for its braking");
}

fn centre() -> Centre {
    Centre {
        arm: arm("left"),
        limits: CartesianLimits::default(),
        tool: Pose::IDENTITY,
    }
}

fn press(force: f64, limits: ForceLimits) -> Press {
    Press {
        centre: centre(),
        along: Ok(Along::Base([0.0, 0.0, -2.0])),
        force,
        limits,
        to: None,
    }
}

#[test]
fn press_net_reports_each_way_to_fail() {
    let text = live_net(press(20.0, ForceLimits::default()));
    for key in [
        "maintaining",
        "forceless_left",
        "exceeded_left",
        "contactless_left",
        "forceful_left",
        "unreachable_left",
        "fast_left",
    ] {
        assert!(text.contains(&format!("Key='{key}'")), "{key}: {text}");
    }
    // Half of the speeds, and the unit vector.
    assert!(text.contains("False='0.01'") && text.contains("Max='0.005'"));
    assert!(text.contains("{x:0,y:0,z:-1}"), "{text}");
}

#[test]
fn press_arguments_out_of_bounds_are_refused() {
    let limits = ForceLimits::default();
    for force in [0.0, -1.0, f64::NAN, f64::INFINITY, 98.1] {
        let error = press(force, limits).check().unwrap_err();
        assert!(error.to_string().contains("at most 98 N"), "{error}");
    }
    let wrong = ForceLimits {
        damping: 0.0,
        ..limits
    };
    let error = press(20.0, wrong).check().unwrap_err();
    assert!(error.to_string().contains("`damping` is 0"), "{error}");
    for direction in [[0.0; 3], [f64::NAN, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]] {
        let press = Press {
            along: Ok(Along::Centre(direction)),
            ..press(20.0, limits)
        };
        let error = press.check().unwrap_err();
        assert!(error.to_string().contains("finite and not 0"), "{error}");
    }
    let mut blind = press(20.0, limits);
    blind.centre.arm.interfaces.clear();
    let error = blind.check().unwrap_err();
    assert!(matches!(error, ErrorKind::Unsupported { .. }), "{error}");
}
