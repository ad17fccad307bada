//! The kinematics primitives in nets: their results, and what they reject.

use std::sync::Arc;

use takt_net::value::text::{TextValue, parse_array};

use super::*;
use crate::fixture::{Arm, Fixture};
use crate::kinematics::named;

fn arm(model: &str) -> Arm {
    let kinematics = named(model).expect("a known model");
    Arm {
        joints: kinematics.joints(),
        kinematics: Some(kinematics),
    }
}

/// `ArmKinematics::Kin` of written joints, and `InvKin` of a written frame near written joints.
fn round_trip(joints: &str) -> String {
    format!(
        "j=Core::DoubleArrayNetcommIn(Key='j',Value='{joints}'),\
         f=World::FrameNetcommIn(Key='f'),\
         kin=ArmKinematics::Kin(inJoints=j.outValue,Robot='arm'),\
         inv=ArmKinematics::InvKin(inFrame=f.outValue,inHintJoints=j.outValue,Robot='arm'),\
         w1=World::FrameNetcommOut(inValue=kin.outFrame,Key='frame'),\
         w2=Core::DoubleArrayNetcommOut(inValue=inv.outJoints,Key='joints'),\
         w3=Core::IntNetcommOut(inValue=inv.outError,Key='error')"
    )
}

#[test]
fn kinematics_in_net_round_trip() {
    for (model, joints) in [
        ("staubli_tx90", "[0.1,0.2,0.3,0.4,0.5,0.6]"),
        ("kuka_lwr4", "[0.1,0.2,0.3,0.4,0.5,0.6,0.7]"),
        ("kuka_youbot", "[1,1,-2,1,2]"),
    ] {
        let mut fixture = Fixture::new(&round_trip(joints), &arm(model));
        fixture.step();
        let frame = fixture.read("frame");
        fixture.write("f", &frame);
        fixture.step();
        let given: Vec<f64> = parse_array(joints, 7).expect("joints");
        let solved: Vec<f64> = parse_array(&fixture.read("joints"), 7).expect("joints");
        let off = given.iter().zip(&solved).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-9, "{model}: {solved:?}");
        assert_eq!(fixture.read("error"), "0");
    }
}

#[test]
fn inv_kin_without_solution_is_null_with_error() {
    let mut fixture = Fixture::new(
        &round_trip("[0.1,0.2,0.3,0.4,0.5,0.6]"),
        &arm("staubli_tx90"),
    );
    fixture.write("f", "{pos:{x:5}}");
    fixture.step();
    assert_eq!(
        (fixture.read("joints"), fixture.read("error")),
        ("null".into(), "1".into())
    );
    fixture.write("f", "{pos:{x:nan}}");
    fixture.write("j", "[0,nan,0,0,0,0]");
    fixture.step();
    assert_eq!(
        (fixture.read("joints"), fixture.read("error")),
        ("null".into(), "3".into())
    );
    assert_eq!(fixture.read("frame"), "null");
}

fn faults(children: &str, arm: &Arm) -> String {
    let Err(faults) = Fixture::load(children, arm) else {
        panic!("the net has no faults");
    };
    faults.join("\n")
}

#[test]
fn net_that_mismatches_arm_is_rejected() {
    let found = faults(&round_trip("[1,2,3]"), &arm("staubli_tx90"));
    assert!(
        found.contains("inJoints carries 3 elements, but the arm has 6 joints"),
        "{found}"
    );
    assert!(found.contains("inHintJoints carries 3 elements"), "{found}");
    let unknown = Arm {
        kinematics: None,
        joints: 6,
    };
    let found = faults(&round_trip("[1,2,3]"), &unknown);
    assert!(
        found.contains("parameter `Robot`: the kinematics of `arm` are not known"),
        "{found}"
    );
    let found = faults(&lwr_net(1), &arm("staubli_tx90"));
    assert!(
        found.contains("an LWR has 7 joints, this arm has 6"),
        "{found}"
    );
    let found = faults(&lwr_net(2), &arm("kuka_lwr4"));
    assert!(
        found.contains("parameter `Strategy`: 2 is not between 0 and 1"),
        "{found}"
    );
}

fn links(names: [&str; 7], from: &str) -> String {
    let link = |(i, name)| format!("{name}={from}{i}.outValue,");
    names.iter().enumerate().map(link).collect()
}

/// All `KUKA::LWR` primitives of this file; hint `h`, null-space joints `n`, velocities `v`.
fn lwr_net(strategy: u32) -> String {
    let mut net = String::new();
    for i in 0..7 {
        for set in ["h", "n", "v"] {
            net += &format!("{set}{i}=Core::DoubleNetcommIn(Key='{set}{i}'),");
        }
    }
    let kin = format!("kin=KUKA::LWR::Kin({}Robot='arm'),", links(JOINTS, "h"));
    let inv = format!(
        "f=World::FrameNetcommIn(Key='f'),\
         inv=KUKA::LWR::InvKin(inFrame=f.outValue,{}{}Strategy='{strategy}',Robot='arm'),",
        links(HINT, "h"),
        links(NULLSPACE, "n")
    );
    let vel = format!(
        "vel=KUKA::LWR::VelKin({}{}Robot='arm'),",
        links(JOINTS, "h"),
        links(VELOCITIES, "v")
    );
    let mut watch = String::new();
    for (i, out) in OUT.iter().enumerate() {
        watch += &format!("w{i}=Core::DoubleNetcommOut(inValue=inv.{out},Key='q{i}'),");
    }
    for (ty, port) in [
        ("World::Frame", "kin.outFrame"),
        ("Core::Double", "kin.outAlpha"),
        ("World::Twist", "vel.outTwist"),
        ("Core::Double", "vel.outVAlpha"),
        ("Core::Int", "inv.outError"),
    ] {
        let key = port.split('.').next_back().expect("a name");
        watch += &format!("{key}={ty}NetcommOut(inValue={port},Key='{key}'),");
    }
    net + &kin + &inv + &vel + watch.trim_end_matches(',')
}

fn write_all(fixture: &mut Fixture, set: &str, values: [f64; 7]) {
    for (i, value) in values.iter().enumerate() {
        let mut text = String::new();
        value.format(&mut text);
        fixture.write(&format!("{set}{i}"), &text);
    }
}

fn solved(fixture: &Fixture) -> Option<[f64; 7]> {
    let texts: [_; 7] = std::array::from_fn(|i| fixture.read(&format!("q{i}")));
    let values = texts.map(|text| f64::parse(&text).ok());
    values
        .iter()
        .all(Option::is_some)
        .then(|| values.map(Option::unwrap_or_default))
}

const Q: [f64; 7] = [0.2, -0.6, 0.3, 1.1, 0.4, 0.5, 0.1];

#[test]
fn lwr_inv_kin_keeps_nullspace_arm_angle() {
    let mut fixture = Fixture::new(&lwr_net(0), &arm("kuka_lwr4"));
    let arm = Srs::kuka_lwr4();
    let (frame, alpha) = arm.forward_alpha(&Q);
    let turned = arm.inverse_alpha(&frame, alpha + 0.3, &Q).expect("reached");
    write_all(&mut fixture, "h", Q);
    write_all(&mut fixture, "n", turned);
    fixture.step();
    assert!((f64::parse(&fixture.read("outAlpha")).expect("alpha") - alpha).abs() < 1e-12);
    let frame_text = fixture.read("outFrame");
    fixture.write("f", &frame_text);
    fixture.step();
    let got = solved(&fixture).expect("solved");
    let (there, got) = arm.forward_alpha(&got);
    assert!((got - alpha - 0.3).abs() < 1e-9, "{got} {alpha}");
    assert!((there.translation.vector - frame.translation.vector).norm() < 1e-9);
    assert_eq!(fixture.read("outError"), "0");
    fixture.write("f", "{pos:{x:3}}");
    fixture.step();
    assert_eq!(
        (solved(&fixture), fixture.read("outError")),
        (None, "1".into())
    );
}

#[test]
fn lwr_inv_kin_strategy_1_approaches_hint() {
    let arm_angle = |strategy| {
        let mut fixture = Fixture::new(&lwr_net(strategy), &arm("kuka_lwr4"));
        let arm = Srs::kuka_lwr4();
        let (frame, alpha) = arm.forward_alpha(&Q);
        let turned = arm
            .inverse_alpha(&frame, alpha + 0.23, &Q)
            .expect("reached");
        write_all(&mut fixture, "h", Q);
        write_all(&mut fixture, "n", turned);
        let mut text = String::new();
        frame.format(&mut text);
        fixture.write("f", &text);
        fixture.step();
        distance(&solved(&fixture).expect("solved"), &Q).sqrt()
    };
    let (kept, moved) = (arm_angle(0), arm_angle(1));
    assert!(kept > 0.1 && moved < 1e-3, "{kept} {moved}");
}

#[test]
fn lwr_vel_kin_in_net_matches_model() {
    let mut fixture = Fixture::new(&lwr_net(1), &arm("kuka_lwr4"));
    let speeds = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7];
    write_all(&mut fixture, "h", Q);
    write_all(&mut fixture, "v", speeds);
    fixture.step();
    let (twist, alpha) = Srs::kuka_lwr4().velocity(&Q, &speeds);
    assert_eq!(Twist::parse(&fixture.read("outTwist")), Ok(twist));
    assert_eq!(f64::parse(&fixture.read("outVAlpha")).ok(), alpha);
    write_all(&mut fixture, "h", [0.0; 7]);
    fixture.step();
    assert_eq!(fixture.read("outVAlpha"), "null");
    assert_ne!(fixture.read("outTwist"), "null");
    write_all(&mut fixture, "h", [f64::NAN; 7]);
    fixture.step();
    assert_eq!(fixture.read("outTwist"), "null");
    assert_eq!(fixture.read("outAlpha"), "null");
}

#[test]
fn lwr_inv_kin_keeps_driver_limits() {
    // The fixture's arm has limits of ±2 rad at every joint, the LWR of the data sheet wider ones.
    let q = [2.5, -0.6, 0.3, 1.1, 0.4, 0.5, 0.1];
    let mut fixture = Fixture::new(&lwr_net(0), &arm("kuka_lwr4"));
    let (frame, _) = Srs::kuka_lwr4().forward_alpha(&q);
    let mut text = String::new();
    frame.format(&mut text);
    fixture.write("f", &text);
    write_all(&mut fixture, "h", q);
    write_all(&mut fixture, "n", q);
    fixture.step();
    let within = solved(&fixture).is_none_or(|q| q.iter().all(|q| q.abs() <= 2.0));
    assert!(within, "{:?}", solved(&fixture));
    let free: Arc<dyn Kinematics> = Arc::new(Srs::kuka_lwr4());
    let mut joints = [0.0; 7];
    assert_eq!(free.inverse(&frame, &q, &mut joints), Ok(()));
    assert!(joints[0] > 2.0);
}

#[test]
fn vel_kin_is_the_derivative_of_kin() {
    let net = "j=Core::DoubleArrayNetcommIn(Key='j',Value='[0.1,0.2,0.3,0.4,0.5,0.6,0.7]'),\
         v=Core::DoubleArrayNetcommIn(Key='v',Value='[1,-1,0.5,2,-0.3,0.1,1.5]'),\
         kin=ArmKinematics::Kin(inJoints=j.outValue,Robot='arm'),\
         vel=ArmKinematics::VelKin(inJoints=j.outValue,inVelocities=v.outValue,Robot='arm'),\
         w1=World::FrameNetcommOut(inValue=kin.outFrame,Key='frame'),\
         w2=World::TwistNetcommOut(inValue=vel.outTwist,Key='twist')";
    let mut fixture = Fixture::new(net, &arm("kuka_lwr4"));
    let mut frame_at = |t: f64| {
        let joints = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7];
        let rates = [1.0, -1.0, 0.5, 2.0, -0.3, 0.1, 1.5];
        let joints = std::array::from_fn::<_, 7, _>(|i| joints[i] + rates[i] * t);
        fixture.write("j", &format!("{joints:?}"));
        fixture.step();
        let frame = Frame::parse(&fixture.read("frame")).expect("a frame");
        let twist = Twist::parse(&fixture.read("twist")).expect("a twist");
        (frame, twist)
    };
    let (before, _) = frame_at(-1e-6);
    let (after, _) = frame_at(1e-6);
    let (_, twist) = frame_at(0.0);
    let linear = (after.translation.vector - before.translation.vector) / 2e-6;
    let angular = (after.rotation * before.rotation.inverse()).scaled_axis() / 2e-6;
    assert!((twist.vel - linear).norm() < 1e-6, "{twist:?} {linear}");
    assert!((twist.rot - angular).norm() < 1e-6, "{twist:?} {angular}");
    fixture.write("v", "[1,nan,0,0,0,0,0]");
    fixture.step();
    assert_eq!(fixture.read("twist"), "null");
}

#[test]
fn tool_acceleration_is_rate_of_velocity() {
    let net = "j=Core::DoubleArrayNetcommIn(Key='j',Value='[0,0,0,0,0,0,0]'),\
         v=Core::DoubleArrayNetcommIn(Key='v',Value='[0,0,0,0,0,0,0]'),\
         a=Core::DoubleArrayNetcommIn(Key='a',Value='[0,0,0,0,0,0,0]'),\
         kin=ArmKinematics::Kin(inJoints=j.outValue,Robot='arm'),\
         tool=World::FrameValue(Value='{pos:{x:0.1,y:-0.05,z:0.2}}'),\
         tip=World::FrameTransform(inFirst=kin.outFrame,inSecond=tool.outValue),\
         vel=ArmKinematics::VelKin(inJoints=j.outValue,inVelocities=v.outValue,inAccelerations=a.outValue,Robot='arm',\
         Tool='{pos:{x:0.1,y:-0.05,z:0.2}}'),\
         w1=World::FrameNetcommOut(inValue=tip.outValue,Key='frame'),\
         w2=World::TwistNetcommOut(inValue=vel.outTwist,Key='twist'),\
         w3=World::TwistNetcommOut(inValue=vel.outAcceleration,Key='acceleration')";
    let mut fixture = Fixture::new(net, &arm("kuka_lwr4"));
    let joints = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7];
    let rates = [1.0, -1.0, 0.5, 2.0, -0.3, 0.1, 1.5];
    let changes = [0.5, 2.0, -1.5, 0.7, 3.0, -2.0, 1.0];
    let mut at = |t: f64| {
        let q =
            std::array::from_fn::<_, 7, _>(|i| joints[i] + rates[i] * t + changes[i] * t * t / 2.0);
        let v = std::array::from_fn::<_, 7, _>(|i| rates[i] + changes[i] * t);
        fixture.write("j", &format!("{q:?}"));
        fixture.write("v", &format!("{v:?}"));
        fixture.write("a", &format!("{changes:?}"));
        fixture.step();
        let twist = |key| Twist::parse(&fixture.read(key)).expect("a twist");
        let frame = Frame::parse(&fixture.read("frame")).expect("a frame");
        (frame, twist("twist"), twist("acceleration"))
    };
    let (before, after, (_, velocity, acceleration)) = (at(-1e-5), at(1e-5), at(0.0));
    let moved = (after.0.translation.vector - before.0.translation.vector) / 2e-5;
    assert!((velocity.vel - moved).norm() < 1e-6, "{velocity:?} {moved}");
    let rate = [
        (after.1.vel - before.1.vel) / 2e-5,
        (after.1.rot - before.1.rot) / 2e-5,
    ];
    assert!(
        (acceleration.vel - rate[0]).norm() < 1e-5,
        "{acceleration:?} {rate:?}"
    );
    assert!(
        (acceleration.rot - rate[1]).norm() < 1e-5,
        "{acceleration:?} {rate:?}"
    );
    fixture.write("a", "[nan,0,0,0,0,0,0]");
    fixture.step();
    assert_eq!(fixture.read("acceleration"), "null");
}
