//! A chain survives its text bit for bit; what others wrote is checked.

use takt_net::JointLimits;
use takt_tests::Random;

use super::*;
use crate::urdf::Urdf;

const TX90: &str = include_str!("../../tests/arms/tx90.urdf");

/// Its joints are turned against each other: no number of its frames is short.
const UR5E: &str = include_str!("../../../../examples/cells/ur5e.urdf");

fn model(urdf: &str) -> Model {
    Model::of_arm(Urdf::parse(urdf).unwrap().arm(None, None).unwrap())
}

fn tx90() -> Model {
    model(TX90)
}

fn limits(count: usize) -> Vec<JointLimits> {
    let limits = JointLimits {
        position_min: -2.0,
        position_max: 2.0,
        velocity_max: 1.0,
        acceleration_max: 1.0,
    };
    vec![limits; count]
}

#[test]
fn chain_text_gives_same_arm_bit_for_bit() {
    for arm in [tx90(), model(UR5E)] {
        survives(&arm);
    }
}

fn survives(arm: &Model) {
    let text = arm.text().into_owned();
    let copy: Model = text.parse().unwrap();
    assert_eq!(copy.text(), text);
    assert_eq!(copy.name(), arm.name());
    let full: Model = arm.full_text().parse().unwrap();
    assert_eq!(&full, arm);
    assert!(copy.arm().unwrap().visuals.is_empty() && copy != *arm);
    let [own, other] = [arm, &copy].map(|it| it.limited(&limits(6)).unwrap());
    let mut random = Random::new(3);
    for _ in 0..1000 {
        let joints: Vec<_> = (0..6).map(|_| random.between(-2.0, 2.0)).collect();
        let flange = own.forward(&joints);
        assert_eq!(flange, other.forward(&joints));
        let hint: Vec<_> = joints.iter().map(|it| it + 0.1).collect();
        let (mut a, mut b) = ([0.0; 6], [0.0; 6]);
        let found = own.inverse(&flange, &hint, &mut a);
        assert_eq!(found, other.inverse(&flange, &hint, &mut b));
        assert_eq!(a.map(f64::to_bits), b.map(f64::to_bits));
    }
    let masses = [arm, &copy].map(|it| it.arm().unwrap().dynamics.as_ref().unwrap().mass());
    assert_eq!(masses[0].to_bits(), masses[1].to_bits());
}

#[test]
fn chain_text_with_odd_names_survives() {
    let odd = "a b;%25 ü\n";
    let escaped = "a b;%25 ü&#10;";
    let text = TX90.replace("name=\"joint_4\"", &format!("name=\"{escaped}\""));
    let arm = Model::of_arm(Urdf::parse(&text).unwrap().arm(None, None).unwrap());
    let copy: Model = arm.full_text().parse().unwrap();
    assert_eq!(copy.arm().unwrap().joints[3].name, odd);
}

#[test]
fn model_with_limits_of_other_count_has_no_kinematics() {
    assert!(tx90().limited(&limits(5)).is_none());
    assert!(Model::from("kuka_lwr4").limited(&limits(6)).is_none());
    assert!(Model::from("kuka_lwr4").limited(&limits(7)).is_some());
    assert!(Model::from("other").unlimited().is_none());
    assert!(Model::default().is_empty() && Model::default().unlimited().is_none());
}

#[test]
fn chain_text_damaged_is_refused_or_an_arm() {
    let text = tx90().full_text().into_owned();
    let refused = |text: &str| text.parse::<Model>().unwrap_err();
    let version = refused(&text.replace("serial 1", "serial 2"));
    assert_eq!(version, TextError::Version("2".to_owned()));
    assert_eq!(refused("serial 1"), TextError::Record(0));
    assert_eq!(refused(&text.replacen(";R", ";X", 1)), TextError::Record(1));
    let more = text.replacen(
        ";F",
        &format!(
            "{};F",
            &text[text.find(";R").unwrap()..text.find(";F").unwrap()]
        ),
        1,
    );
    assert_eq!(refused(&more), TextError::Record(9));
    let long = format!("{text};{}", " ".repeat(1 << 18));
    assert_eq!(refused(&long), TextError::Long);
    let none = text.split(";R").next().unwrap().to_owned();
    assert!(matches!(refused(&none), TextError::Arm(_)));
    // No damage is a panic.
    let mut random = Random::new(9);
    for _ in 0..3000 {
        let mut bytes = text.clone().into_bytes();
        for _ in 0..3 {
            let at = random.below(bytes.len());
            bytes[at] = b" 09.-;%RPFVx"[random.below(12)];
        }
        let _ = String::from_utf8(bytes).unwrap().parse::<Model>();
    }
}
