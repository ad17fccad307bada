//! The time of an inverse of a seven-axis arm on a smooth path, compared with the same formulas written as one straight
//! line for one known branch; of the numeric inverse of an arm without closed form, and how many poses it finds; of a net that moves
//! two arms on a line; and of the cycle in which a motion begins in motion. Judges no figure; ratios count.
//! `cargo bench -p takt-motion --bench motion [-- [--json]]`.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]

use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde_json::json;
use takt_motion::kinematics::{Joint, JointKind, Range, Serial, Srs, SrsGeometry};
use takt_net::device::Kinematics;
use takt_net::{
    ArmBinding, Devices, Frame, Image, JointLimits, Limits, LoadContext, Moment, Nanos, Registry,
    load,
};

const POSES: u32 = 4_000;
const ROUNDS: usize = 25;
/// Poses of the numeric inverse.
const RANDOM_POSES: u32 = 10_000;
/// Joint positions at the start of the paths, rad.
const START: [f64; 7] = [0.2, 0.6, -0.3, -1.2, 0.4, 0.9, -0.2];

fn as_f64(count: u32) -> f64 {
    f64::from(count)
}

/// The value that a fraction of the values does not exceed.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a fraction of a small number"
    )]
    let at = (values.len() as f64 * share) as usize;
    values[at.min(values.len() - 1)]
}

/// Flange frames of a closed smooth path through that of the start.
fn path(arm: &dyn Kinematics) -> Vec<Frame> {
    let start = arm.forward(&START);
    let at = |number: u32| {
        let angle = std::f64::consts::TAU * as_f64(number) / as_f64(POSES);
        let (sin, cos) = angle.sin_cos();
        let offset = Vector3::new(0.1 * sin, 0.05 * (1.0 - cos), 0.08 * sin * cos);
        let turn =
            UnitQuaternion::from_scaled_axis(Vector3::new(0.3 * sin, 0.0, 0.2 * (1.0 - cos)));
        Frame::from_parts(
            (start.translation.vector + offset).into(),
            turn * start.rotation,
        )
    };
    (0..POSES).map(at).collect()
}

/// Nanoseconds of each call, less those that reading the clock takes.
fn timed(poses: &[Frame], mut solve: impl FnMut(&Frame)) -> Vec<f64> {
    let clock = {
        let mut bare: Vec<f64> = (0..1000)
            .map(|_| Instant::now().elapsed().as_secs_f64() * 1e9)
            .collect();
        quantile(&mut bare, 0.5)
    };
    let one = |pose: &Frame| {
        let begin = Instant::now();
        solve(black_box(pose));
        begin.elapsed().as_secs_f64() * 1e9 - clock
    };
    poses.iter().map(one).collect()
}

fn rot(about_z: bool, angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    if about_z {
        Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
    } else {
        Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
    }
}

/// The straight line: one branch at a known arm angle (the elbow bent forwards, as at [`START`]), no limits, no hint, no
/// check, after the usual formulas.
#[inline(never)]
fn straight_line(g: &SrsGeometry, flange: &Frame, alpha: f64) -> [f64; 7] {
    let rotation = flange.rotation.to_rotation_matrix().into_inner();
    let wrist = flange.translation.vector - Vector3::z() * g.base - rotation.column(2) * g.hand;
    let length = wrist.norm();
    let u = wrist / length;
    let cos4 =
        (length * length - g.upper * g.upper - g.lower * g.lower) / (2.0 * g.upper * g.lower);
    let q4 = cos4.acos();
    let lean = (g.lower * q4.sin()).atan2(g.upper + g.lower * cos4);
    let upright = rot(true, u.y.atan2(u.x)) * rot(false, u.x.hypot(u.y).atan2(u.z) - lean);
    let (sin, cos) = alpha.sin_cos();
    let cross = u.cross_matrix();
    let lateral = cross * upright;
    let radial = cross * lateral;
    let shoulder = lateral * sin - radial * cos + upright + radial;
    let hand = (shoulder * rot(false, q4)).transpose() * rotation;
    let zyz = |m: &Matrix3<f64>| {
        [
            m[(1, 2)].atan2(m[(0, 2)]),
            m[(2, 2)].acos(),
            m[(2, 1)].atan2(-m[(2, 0)]),
        ]
    };
    let ([a, b, c], [d, e, f]) = (zyz(&shoulder), zyz(&hand));
    [a, b, c, q4, d, e, f]
}

fn lwr() -> SrsGeometry {
    SrsGeometry {
        base: 0.3105,
        upper: 0.400,
        lower: 0.390,
        hand: 0.078,
        signs: [1.0; 7],
    }
}

/// Times an arm on its path; returns p50, p99 and ratio to the straight line.
fn inverse(name: &str, arm: &Srs) -> serde_json::Value {
    let poses = path(arm);
    let (mut ours, mut floor, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
    let mut hint = START;
    for _ in 0..ROUNDS {
        let mut round = timed(&poses, |pose| {
            let mut joints = [0.0; 7];
            let solved = arm.inverse(pose, &hint, &mut joints);
            solved.expect("the path is within reach");
            hint = joints;
        });
        let mut straight = timed(&poses, |pose| {
            black_box(straight_line(&lwr(), pose, black_box(0.3)));
        });
        ratios.push(quantile(&mut round, 0.5) / quantile(&mut straight, 0.5));
        ours.append(&mut round);
        floor.append(&mut straight);
    }
    let [p50, p99] = [0.5, 0.99].map(|share| quantile(&mut ours, share));
    let [floor50, floor99] = [0.5, 0.99].map(|share| quantile(&mut floor, share));
    let ratio = quantile(&mut ratios, 0.5);
    println!(
        "{name:<12} inverse p50 {p50:5.0} ns, p99 {p99:5.0} ns; straight line p50 {floor50:5.0} ns, \
         p99 {floor99:5.0} ns; ratio {ratio:.2}"
    );
    json!({ "p50_ns": p50, "p99_ns": p99, "straight_line_p50_ns": floor50, "ratio": ratio })
}

/// Franka's arm by its published dimensions, after Craig: a (m), alpha (rad), d (m), and range (rad) of each joint.
fn panda() -> Serial {
    let quarter = std::f64::consts::FRAC_PI_2;
    let rows = [
        [0.0, 0.0, 0.333, -2.8973, 2.8973],
        [0.0, -quarter, 0.0, -1.7628, 1.7628],
        [0.0, quarter, 0.316, -2.8973, 2.8973],
        [0.0825, quarter, 0.0, -3.0718, -0.0698],
        [-0.0825, -quarter, 0.384, -2.8973, 2.8973],
        [0.0, quarter, 0.0, -0.0175, 3.7525],
        [0.088, quarter, 0.0, -2.8973, 2.8973],
    ];
    let joints = rows.map(|[a, alpha, d, min, max]| {
        let twist = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), alpha);
        let link = Frame::from_parts(Vector3::new(a, 0.0, 0.0).into(), twist);
        Joint {
            origin: link * Frame::translation(0.0, 0.0, d),
            axis: Vector3::z(),
            kind: JointKind::Revolute,
            range: Range { min, max },
        }
    });
    Serial::new(&joints, &Frame::translation(0.0, 0.0, 0.107)).expect("an arm")
}

/// Times the numeric inverse on random reachable poses, each from hints so far away, rad.
fn numeric(away: f64) -> serde_json::Value {
    let arm = panda();
    let mut random = takt_tests::Random::new(11);
    let (mut times, mut found) = (Vec::new(), 0);
    for _ in 0..RANDOM_POSES {
        let each = arm.ranges().iter();
        let joints: Vec<_> = each
            .map(|range| random.between(range.min, range.max))
            .collect();
        let each = joints.iter().zip(arm.ranges());
        let hint: Vec<_> = each
            .map(|(joint, range)| (joint + random.between(-away, away)).clamp(range.min, range.max))
            .collect();
        let target = arm.forward(&joints);
        let mut solution = [0.0; 7];
        let mut is_found = false;
        // The fastest of three, so that the largest is none of the host.
        let each = timed(&[target; 3], |pose| {
            is_found = arm.inverse(pose, &hint, &mut solution).is_ok();
        });
        times.push(each.into_iter().fold(f64::INFINITY, f64::min));
        found += u32::from(is_found);
    }
    let [p50, p99, most] = [0.5, 0.99, 1.0].map(|share| quantile(&mut times, share) / 1e3);
    let share = 100.0 * as_f64(found) / as_f64(RANDOM_POSES);
    println!(
        "panda        numeric inverse from {away} rad beside: p50 {p50:.1} us, p99 {p99:.1} us, largest {most:.1} us; \
         {share:.2} % of {RANDOM_POSES} poses found"
    );
    json!({ "p50_us": p50, "p99_us": p99, "max_us": most, "found_percent": share })
}

/// Two arms, `left` and `right`.
struct Two;

impl Devices for Two {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        let anything = JointLimits {
            position_min: -3.0,
            position_max: 3.0,
            velocity_max: 2.0,
            acceleration_max: 4.0,
        };
        let first_joint = if name == "left" { 0 } else { 7 };
        Some(ArmBinding {
            first_joint,
            limits: [anything; 7].into(),
            kinematics: Some(Arc::new(Srs::kuka_lwr4())),
        })
    }

    fn names(&self) -> Vec<String> {
        vec!["left".to_owned(), "right".to_owned()]
    }
}

/// The joints of an arm in the previous cycle, at first those of the start, as the array `h7`.
fn hint() -> String {
    let start = [0.0, -0.5, 0.0, 1.5, 0.0, -1.0, 0.0];
    let mut text = String::from("h0=Core::DoubleArray(Size='7'),");
    for (i, start) in start.iter().enumerate() {
        let next = i + 1;
        text += &format!(
            "g{i}=Core::DoubleArrayGet(inArray=ik.outJoints,Size='7',Index='{i}'),\
             p{i}=Core::DoublePre(inValue=g{i}.outValue),n{i}=Core::DoubleIsNull(inValue=p{i}.outValue),\
             c{i}=Core::DoubleConditional(inCondition=n{i}.outValue,True='{start}',inFalse=p{i}.outValue),\
             h{next}=Core::DoubleArraySet(inArray=h{i}.outArray,inValue=c{i}.outValue,Size='7',Index='{i}'),"
        );
    }
    text
}

/// A frame on a line, and for each arm base, grasp and joints.
fn two_arms() -> String {
    let arm = |name: &str| {
        format!(
            "{name}={{base=World::FrameValue(Value='{{}}'),grip=World::FrameValue(Value='{{rot:{{c:3.14159}}}}'),\
             object=World::FrameTransform(inFirst=base.outValue,inSecond=parent.inObject),\
             flange=World::FrameTransform(inFirst=object.outValue,inSecond=grip.outValue),{}\
             ik=ArmKinematics::InvKin(inFrame=flange.outValue,inHintJoints=h7.outArray,Robot='{name}'),\
             none=Core::DoubleArrayIsNull(inValue=ik.outJoints),outFailed=none.outValue}}(inObject=m.outPosition),",
            hint()
        )
    };
    format!(
        "{{m=Motion::Lin(From='{{pos:{{x:0.45,z:0.35}}}}',To='{{pos:{{x:0.45,y:0.2,z:0.5}}}}',Velocity='0.05'),{}{}\
         failed=Core::BooleanOr(inFirst=left.outFailed,inSecond=right.outFailed),\
         w=Core::BooleanNetcommOut(inValue=failed.outValue,Key='failed'),outTerminate=failed.outValue}}",
        arm("left"),
        arm("right")
    )
}

/// Times the cycles of a net; `name` is the subject of the line that it prints.
fn net(name: &str, text: &str) -> serde_json::Value {
    let mut registry = Registry::core();
    registry.add(takt_motion::all());
    let context = LoadContext {
        registry: &registry,
        devices: &Two,
        period: Duration::from_millis(1),
        limits: Limits::default(),
    };
    let image = Image::default();
    let poses = [Frame::identity(); 1000];
    let mut times = Vec::new();
    for _ in 0..ROUNDS {
        let mut plan = load(text, &context)
            .map_err(|rejection| rejection.render(name, text))
            .expect("the net has no faults");
        let mut cycle = 0_i32;
        times.append(&mut timed(&poses, |_| {
            cycle += 1;
            let time = Nanos(i64::from(cycle) * 1_000_000);
            let moment = Moment {
                cycle: u64::from(cycle.unsigned_abs()),
                time,
                wall: time,
                ..Moment::default()
            };
            assert!(!plan.evaluate(&image, moment), "a frame is out of reach");
        }));
    }
    let [p50, p99] = [0.5, 0.99].map(|share| quantile(&mut times, share));
    println!("{name}, one cycle: p50 {p50:6.0} ns, p99 {p99:6.0} ns");
    json!({ "p50_ns": p50, "p99_ns": p99 })
}

/// Seven joints that begin in motion in every cycle, across their way.
fn ptp_begins() -> String {
    "{p=Core::DoubleArrayNetcommIn(Key='p',Value='[0,0,0,0,0,0,0]'),\
     v=Core::DoubleArrayNetcommIn(Key='v',Value='[0.5,-0.4,0.3,0.2,-0.3,0.1,0.4]'),on=Core::BooleanValue(Value='true'),\
     m=Motion::Ptp(inReset=on.outValue,inFrom=p.outValue,inFromVelocity=v.outValue,To='[1,1,-1,0.5,0.2,-0.4,1]',\
     Velocity='[0.6]',Acceleration='[2]',Jerk='[20]'),never=Core::BooleanValue(),outTerminate=never.outValue}"
        .to_owned()
}

/// A frame that begins in motion in every cycle, across its line.
fn lin_begins() -> String {
    "{p=World::FrameValue(Value='{pos:{y:-0.1}}'),v=World::TwistValue(Value='{vel:{y:0.1},rot:{x:0.2}}'),\
     on=Core::BooleanValue(Value='true'),\
     m=Motion::Lin(inReset=on.outValue,inFrom=p.outValue,inFromVelocity=v.outValue,To='{pos:{x:0.5},rot:{a:1}}',\
     Join='0.4'),never=Core::BooleanValue(),outTerminate=never.outValue}"
        .to_owned()
}

fn main() {
    let mut members = serde_json::Map::new();
    for (name, arm) in [
        ("kuka_lwr4", Srs::kuka_lwr4()),
        ("kuka_iiwa7", Srs::kuka_iiwa7()),
        ("kuka_iiwa14", Srs::kuka_iiwa14()),
    ] {
        members.insert(name.to_owned(), inverse(name, &arm));
    }
    for (name, away) in [("numeric_near", 0.1), ("numeric_anywhere", 6.0)] {
        members.insert(name.to_owned(), numeric(away));
    }
    let subjects = [
        ("two_arm_lin_net", "two arms on a line", two_arms()),
        (
            "ptp_begins",
            "a Ptp of seven joints begins in motion",
            ptp_begins(),
        ),
        ("lin_begins", "a Lin begins in motion", lin_begins()),
    ];
    for (key, name, text) in subjects {
        members.insert(key.to_owned(), net(name, &text));
    }
    if std::env::args().any(|argument| argument == "--json") {
        println!("{}", json!({ "motion": members }));
    }
}
