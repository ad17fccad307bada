//! The primitives in nets: what they give, and what they refuse.

use std::sync::Arc;

use takt_net::value::text::{TextValue, parse_array};

use super::*;
use crate::kinematics::named;
use crate::stand::{Arm, Stand};

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
fn frames_and_joints_round_trip_in_a_net() {
    for (model, joints) in [
        ("staubli_tx90", "[0.1,0.2,0.3,0.4,0.5,0.6]"),
        ("kuka_lwr4", "[0.1,0.2,0.3,0.4,0.5,0.6,0.7]"),
        ("kuka_youbot", "[1,1,-2,1,2]"),
    ] {
        let mut stand = Stand::new(&round_trip(joints), &arm(model));
        stand.step();
        let frame = stand.read("frame");
        stand.write("f", &frame);
        stand.step();
        let given: Vec<f64> = parse_array(joints, 7).expect("joints");
        let solved: Vec<f64> = parse_array(&stand.read("joints"), 7).expect("joints");
        let off = given.iter().zip(&solved).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-9, "{model}: {solved:?}");
        assert_eq!(stand.read("error"), "0");
    }
}

#[test]
fn what_has_no_solution_is_null_and_says_why() {
    let mut stand = Stand::new(
        &round_trip("[0.1,0.2,0.3,0.4,0.5,0.6]"),
        &arm("staubli_tx90"),
    );
    stand.write("f", "{pos:{x:5}}");
    stand.step();
    assert_eq!(
        (stand.read("joints"), stand.read("error")),
        ("null".into(), "1".into())
    );
    stand.write("f", "{pos:{x:nan}}");
    stand.write("j", "[0,nan,0,0,0,0]");
    stand.step();
    assert_eq!(
        (stand.read("joints"), stand.read("error")),
        ("null".into(), "3".into())
    );
    assert_eq!(stand.read("frame"), "null");
}

fn faults(children: &str, arm: &Arm) -> String {
    let Err(faults) = Stand::load(children, arm) else {
        panic!("the net has no faults");
    };
    faults.join("\n")
}

#[test]
fn a_net_is_refused_that_does_not_fit_the_arm() {
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
        found.contains("parameter `Robot`: the kinematics of `arm` is not known"),
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

fn write_all(stand: &mut Stand, set: &str, values: [f64; 7]) {
    for (i, value) in values.iter().enumerate() {
        let mut text = String::new();
        value.format(&mut text);
        stand.write(&format!("{set}{i}"), &text);
    }
}

fn solved(stand: &Stand) -> Option<[f64; 7]> {
    let texts: [_; 7] = std::array::from_fn(|i| stand.read(&format!("q{i}")));
    let values = texts.map(|text| f64::parse(&text).ok());
    values
        .iter()
        .all(Option::is_some)
        .then(|| values.map(Option::unwrap_or_default))
}

const Q: [f64; 7] = [0.2, -0.6, 0.3, 1.1, 0.4, 0.5, 0.1];

#[test]
fn the_lwr_keeps_the_arm_angle_of_the_null_space_joints() {
    let mut stand = Stand::new(&lwr_net(0), &arm("kuka_lwr4"));
    let arm = Srs::kuka_lwr4();
    let (frame, alpha) = arm.forward_alpha(&Q);
    let turned = arm.inverse_alpha(&frame, alpha + 0.3, &Q).expect("reached");
    write_all(&mut stand, "h", Q);
    write_all(&mut stand, "n", turned);
    stand.step();
    assert!((f64::parse(&stand.read("outAlpha")).expect("alpha") - alpha).abs() < 1e-12);
    let told = stand.read("outFrame");
    stand.write("f", &told);
    stand.step();
    let got = solved(&stand).expect("solved");
    let (there, got) = arm.forward_alpha(&got);
    assert!((got - alpha - 0.3).abs() < 1e-9, "{got} {alpha}");
    assert!((there.translation.vector - frame.translation.vector).norm() < 1e-9);
    assert_eq!(stand.read("outError"), "0");
    stand.write("f", "{pos:{x:3}}");
    stand.step();
    assert_eq!((solved(&stand), stand.read("outError")), (None, "1".into()));
}

#[test]
fn strategy_one_goes_from_there_nearer_to_the_hint() {
    let arm_angle = |strategy| {
        let mut stand = Stand::new(&lwr_net(strategy), &arm("kuka_lwr4"));
        let arm = Srs::kuka_lwr4();
        let (frame, alpha) = arm.forward_alpha(&Q);
        let turned = arm
            .inverse_alpha(&frame, alpha + 0.23, &Q)
            .expect("reached");
        write_all(&mut stand, "h", Q);
        write_all(&mut stand, "n", turned);
        let mut text = String::new();
        frame.format(&mut text);
        stand.write("f", &text);
        stand.step();
        distance(&solved(&stand).expect("solved"), &Q).sqrt()
    };
    let (kept, moved) = (arm_angle(0), arm_angle(1));
    assert!(kept > 0.1 && moved < 1e-3, "{kept} {moved}");
}

#[test]
fn velocities_of_the_lwr_come_out_of_the_net() {
    let mut stand = Stand::new(&lwr_net(1), &arm("kuka_lwr4"));
    let speeds = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7];
    write_all(&mut stand, "h", Q);
    write_all(&mut stand, "v", speeds);
    stand.step();
    let (twist, alpha) = Srs::kuka_lwr4().velocity(&Q, &speeds);
    assert_eq!(Twist::parse(&stand.read("outTwist")), Ok(twist));
    assert_eq!(f64::parse(&stand.read("outVAlpha")).ok(), alpha);
    write_all(&mut stand, "h", [0.0; 7]);
    stand.step();
    assert_eq!(stand.read("outVAlpha"), "null");
    assert_ne!(stand.read("outTwist"), "null");
    write_all(&mut stand, "h", [f64::NAN; 7]);
    stand.step();
    assert_eq!(stand.read("outTwist"), "null");
    assert_eq!(stand.read("outAlpha"), "null");
}

#[test]
fn the_limits_of_the_lwr_are_those_of_its_driver() {
    // The stand's arm has ±2 rad at every joint, the LWR of the data sheet more.
    let q = [2.5, -0.6, 0.3, 1.1, 0.4, 0.5, 0.1];
    let mut stand = Stand::new(&lwr_net(0), &arm("kuka_lwr4"));
    let (frame, _) = Srs::kuka_lwr4().forward_alpha(&q);
    let mut text = String::new();
    frame.format(&mut text);
    stand.write("f", &text);
    write_all(&mut stand, "h", q);
    write_all(&mut stand, "n", q);
    stand.step();
    let within = solved(&stand).is_none_or(|q| q.iter().all(|q| q.abs() <= 2.0));
    assert!(within, "{:?}", solved(&stand));
    let free: Arc<dyn Kinematics> = Arc::new(Srs::kuka_lwr4());
    let mut joints = [0.0; 7];
    assert_eq!(free.inverse(&frame, &q, &mut joints), Ok(()));
    assert!(joints[0] > 2.0);
}
