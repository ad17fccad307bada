//! Serial arms against the closed forms of named arms, and arms of other makers by their published dimensions.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use takt_net::device::{Kinematics, Unreachable};
use takt_net::{Frame, Twist};
use takt_tests::Random;

use super::super::{Chain, Range, Structure, named};
use super::*;

const MODELS: [(&str, Structure); 6] = [
    ("staubli_tx90", Structure::Opw),
    ("kuka_lwr4", Structure::Srs),
    ("kuka_iiwa7", Structure::Srs),
    ("kuka_iiwa14", Structure::Srs),
    ("kuka_youbot", Structure::General),
    ("kuka_youbot_upright", Structure::General),
];
const RANGE: Range = Range::degrees(-120.0, 120.0);

/// A serial arm with the axes of a chain, its joint frames turned at random, as in files.
fn of_chain(chain: &Chain, range: Range, random: &mut Random) -> Serial {
    let mut from = Frame::identity();
    let mut joints = Vec::new();
    for axis in &chain.axes {
        let [x, y, z] = [0; 3].map(|_| random.between(-3.0, 3.0));
        let turn = UnitQuaternion::from_euler_angles(x, y, z);
        let along = axis.direction * random.between(-0.2, 0.2);
        let to = Frame::from_parts(Translation3::from(axis.point + along), turn);
        joints.push(Joint {
            origin: from.inv_mul(&to),
            axis: turn.inverse() * axis.direction * random.between(0.5, 2.0),
            kind: JointKind::Revolute,
            range,
        });
        from = to;
    }
    Serial::new(&joints, &from.inv_mul(&chain.home)).unwrap()
}

/// An arm by its Denavit-Hartenberg rows after Craig: a (m), alpha (rad) of the link before, d (m) and offset (rad) of the joint.
fn craig(rows: &[[f64; 4]], tip: f64, ranges: &[Range]) -> Serial {
    let each = rows.iter().zip(ranges);
    let joints: Vec<_> = each
        .map(|([a, alpha, d, offset], range)| {
            let twist = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), *alpha);
            let origin = Frame::from_parts(Translation3::new(*a, 0.0, 0.0), twist)
                * Frame::from_parts(
                    Translation3::new(0.0, 0.0, *d),
                    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *offset),
                );
            Joint {
                origin,
                axis: Vector3::z(),
                kind: JointKind::Revolute,
                range: *range,
            }
        })
        .collect();
    Serial::new(&joints, &Frame::translation(0.0, 0.0, tip)).unwrap()
}

const QUARTER: f64 = std::f64::consts::FRAC_PI_2;

/// The UR5 by its published dimensions.
pub(crate) fn ur5() -> Serial {
    let rows = [
        [0.0, 0.0, 0.089_159, 0.0],
        [0.0, QUARTER, 0.0, 0.0],
        [-0.425, 0.0, 0.0, 0.0],
        [-0.392_25, 0.0, 0.109_15, 0.0],
        [0.0, QUARTER, 0.094_65, 0.0],
        [0.0, -QUARTER, 0.0, 0.0],
    ];
    craig(&rows, 0.0823, &[Range::degrees(-360.0, 360.0); 6])
}

/// Franka's arm by its published dimensions and ranges.
pub(crate) fn panda() -> Serial {
    let rows = [
        [0.0, 0.0, 0.333, 0.0],
        [0.0, -QUARTER, 0.0, 0.0],
        [0.0, QUARTER, 0.316, 0.0],
        [0.0825, QUARTER, 0.0, 0.0],
        [-0.0825, -QUARTER, 0.384, 0.0],
        [0.0, QUARTER, 0.0, 0.0],
        [0.088, QUARTER, 0.0, 0.0],
    ];
    let ranges = [
        [-2.8973, 2.8973],
        [-1.7628, 1.7628],
        [-2.8973, 2.8973],
        [-3.0718, -0.0698],
        [-2.8973, 2.8973],
        [-0.0175, 3.7525],
        [-2.8973, 2.8973],
    ];
    craig(&rows, 0.107, &ranges.map(|[min, max]| Range { min, max }))
}

fn random_joints(arm: &Serial, random: &mut Random) -> Vec<f64> {
    let each = arm.ranges().iter();
    each.map(|range| random.between(range.min, range.max))
        .collect()
}

fn off(a: &Frame, b: &Frame) -> f64 {
    let moved = (a.translation.vector - b.translation.vector).norm();
    // The angle between nearly equal quaternions is exact to the root of the rounding only.
    let turned = (a.rotation.coords - b.rotation.coords)
        .norm()
        .min((a.rotation.coords + b.rotation.coords).norm());
    moved.max(2.0 * turned)
}

#[test]
fn serial_arm_of_known_axes_matches_model() {
    let mut random = Random::new(7);
    for (model, structure) in MODELS {
        let known = named(model).unwrap();
        for _ in 0..20 {
            let arm = of_chain(&Chain::of(&*known), RANGE, &mut random);
            assert_eq!(arm.structure(), structure, "{model}");
            let joints = random_joints(&arm, &mut random);
            assert!(off(&arm.forward(&joints), &known.forward(&joints)) < 1e-12);
            let mut columns = [
                vec![Twist::default(); arm.joints()],
                vec![Twist::default(); arm.joints()],
            ];
            arm.jacobian(&joints, &mut columns[0]);
            known.jacobian(&joints, &mut columns[1]);
            for (own, wanted) in columns[0].iter().zip(&columns[1]) {
                assert!(
                    (own.vel - wanted.vel).norm() < 1e-12 && (own.rot - wanted.rot).norm() < 1e-12
                );
            }
        }
    }
}

/// The share of random poses of an arm, in per mille, that it finds from hints that are as far away, rad; each answer is
/// checked by the forward kinematics.
fn found_per_mille(arm: &Serial, away: f64, poses: u32) -> u32 {
    let mut random = Random::new(11);
    let mut found = 0;
    for _ in 0..poses {
        let joints = random_joints(arm, &mut random);
        let target = arm.forward(&joints);
        let each = joints.iter().zip(arm.ranges());
        let hint: Vec<_> = each
            .map(|(joint, range)| (joint + random.between(-away, away)).clamp(range.min, range.max))
            .collect();
        let mut solution = vec![0.0; joints.len()];
        if arm.inverse(&target, &hint, &mut solution).is_ok() {
            assert!(off(&arm.forward(&solution), &target) < 1e-8);
            assert!(arm.is_within(&solution), "{solution:?}");
            found += 1;
        }
    }
    found * 1000 / poses
}

#[test]
fn serial_arm_with_closed_form_reaches_every_pose() {
    let mut random = Random::new(3);
    for (model, _) in &MODELS[..4] {
        let arm = of_chain(&Chain::of(&*named(model).unwrap()), RANGE, &mut random);
        assert_eq!(found_per_mille(&arm, 3.0, 2_000), 1000, "{model}");
    }
    let arm = ur5();
    assert_eq!(arm.structure(), Structure::ThreeParallel);
    assert_eq!(found_per_mille(&arm, 3.0, 2_000), 1000);
}

#[test]
fn serial_arm_without_closed_form_reaches_nearly_all_poses() {
    let arm = panda();
    assert_eq!(arm.structure(), Structure::General);
    let [near, far] = [0.1, 6.0].map(|away| found_per_mille(&arm, away, 2_000));
    assert!(near >= 999 && far >= 995, "{near} {far}");
    let chain = Chain::of(&*named("kuka_iiwa14").unwrap());
    let srs = of_chain(&chain, RANGE, &mut Random::new(3));
    for arm in [ur5().numeric(), srs.numeric()] {
        let [near, far] = [0.1, 6.0].map(|away| found_per_mille(&arm, away, 1_000));
        assert!(near >= 999 && far >= 995, "{near} {far}");
    }
}

#[test]
fn serial_arm_with_rounded_angles_is_exact() {
    // As in files that write a quarter of a turn as 1.5708.
    let mut random = Random::new(5);
    let mut arm = named("staubli_tx90").map(|arm| Chain::of(&*arm)).unwrap();
    for axis in &mut arm.axes {
        let turn = UnitQuaternion::from_euler_angles(4e-6, -4e-6, 4e-6);
        axis.direction = turn * axis.direction;
    }
    let arm = of_chain(&arm, RANGE, &mut random);
    assert_eq!(arm.structure(), Structure::Opw);
    assert!(found_per_mille(&arm, 3.0, 1_000) >= 998);
}

#[test]
fn serial_arm_out_of_reach_names_cause() {
    let arm = ur5();
    let mut joints = [1.0; 6];
    let far = Frame::translation(2.0, 0.0, 0.0);
    assert_eq!(
        arm.inverse(&far, &[0.0; 6], &mut joints),
        Err(Unreachable::Reach)
    );
    let none = Frame::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(
        arm.inverse(&none, &[0.0; 6], &mut joints),
        Err(Unreachable::Invalid)
    );
    assert_eq!(
        arm.inverse(&far, &[0.0; 5], &mut joints),
        Err(Unreachable::Invalid)
    );
    assert!(
        joints.map(f64::to_bits) == [1.0_f64; 6].map(f64::to_bits),
        "unchanged"
    );
    let low = arm.within(&[Range::degrees(0.0, 10.0); 6]).unwrap();
    let target = ur5().forward(&[0.1, -1.5, 1.0, 0.3, 0.4, 0.5]);
    assert_eq!(
        low.inverse(&target, &[0.1; 6], &mut joints),
        Err(Unreachable::Limits)
    );
}

#[test]
fn serial_arm_rejects_impossible_joints() {
    let joint = Joint {
        origin: Frame::identity(),
        axis: Vector3::z(),
        kind: JointKind::Revolute,
        range: RANGE,
    };
    let arm = |joints: &[Joint]| Serial::new(joints, &Frame::identity()).map(|_| ());
    assert_eq!(arm(&[]), Err(SerialError::Count(0)));
    assert_eq!(arm(&[joint; 9]), Err(SerialError::Count(9)));
    let no_axis = Joint {
        axis: Vector3::zeros(),
        ..joint
    };
    assert_eq!(arm(&[joint, no_axis]), Err(SerialError::Joint(1)));
    let nan = Joint {
        origin: Frame::translation(f64::NAN, 0.0, 0.0),
        ..joint
    };
    assert_eq!(arm(&[nan]), Err(SerialError::Joint(0)));
    let empty = Joint {
        range: Range { min: 1.0, max: 1.0 },
        ..joint
    };
    assert_eq!(arm(&[joint, joint, empty]), Err(SerialError::Range(2)));
    assert_eq!(arm(&[joint; 8]), Ok(()));
}
