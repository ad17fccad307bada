//! Round trips of all arms over random joint positions, and rejected inputs.

use std::f64::consts::{PI, TAU};

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use takt_net::device::Unreachable;
use takt_net::{Frame, Twist};
use takt_tests::Random;

use super::*;

fn random_joints<const N: usize>(random: &mut Random, ranges: &[Range; N]) -> [f64; N] {
    std::array::from_fn(|i| random.between(ranges[i].min, ranges[i].max))
}

fn error(a: &Frame, b: &Frame) -> f64 {
    let position = (a.translation.vector - b.translation.vector).norm();
    position.max(a.rotation.angle_to(&b.rotation))
}

fn difference<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// The properties of every arm: 10,000 random joint positions, with hints near and far.
fn round_trips<const N: usize>(arm: &dyn Kinematics, ranges: &[Range; N], is_redundant: bool) {
    assert_eq!(arm.joints(), N);
    let mut random = Random::new(0x9e37_79b9_7f4a_7c15);
    for number in 0..10_000 {
        let joints = random_joints(&mut random, ranges);
        let flange = arm.forward(&joints);
        let hint = match number % 3 {
            0 => joints,
            1 => joints.map(|j| j + random.between(-0.01, 0.01)),
            _ => random_joints(&mut random, ranges),
        };
        let mut solved = [f64::NAN; N];
        let result = arm.inverse(&flange, &hint, &mut solved);
        assert_eq!(result, Ok(()), "{number}: {joints:?} from {hint:?}");
        let error = error(&arm.forward(&solved), &flange);
        assert!(error < 1e-9, "{number}: {error} {joints:?} from {hint:?}");
        let within = solved.iter().zip(ranges);
        let is_within = within.fold(true, |all, (q, r)| all && (r.min..=r.max).contains(q));
        assert!(is_within, "{number}: {solved:?}");
        if number % 3 == 0 {
            let off = difference(&solved, &joints);
            assert!(
                off < 1e-6,
                "{number}: {off} from the hint, which is a solution"
            );
        }
        // `joints` is a solution, too: the result is not farther from the hint.
        let farther = difference(&solved, &hint) - difference(&joints, &hint);
        assert!(is_redundant || farther < 1e-6, "{number}: {farther}");
    }
}

#[test]
fn tx90_round_trips() {
    let arm = Opw::staubli_tx90();
    round_trips(&arm, &arm.ranges(), false);
}

#[test]
fn opw_with_all_offsets_round_trips() {
    let geometry = OpwGeometry {
        a1: 0.35,
        a2: -0.054,
        b: -0.02,
        c1: 0.75,
        c2: 1.25,
        c3: 1.5,
        c4: 0.23,
        offsets: [0.0, -PI / 2.0, 0.3, 0.0, 0.1, PI],
        signs: [-1.0, 1.0, 1.0, -1.0, 1.0, -1.0],
    };
    let ranges = [
        Range::degrees(-185.0, 185.0),
        Range::degrees(-140.0, 5.0),
        Range::degrees(-120.0, 155.0),
        Range::degrees(-350.0, 350.0),
        Range::degrees(-122.5, 122.5),
        Range::degrees(-350.0, 350.0),
    ];
    round_trips(&Opw::new(geometry, ranges), &ranges, false);
}

#[test]
fn lwr4_round_trips() {
    let arm = Srs::kuka_lwr4();
    round_trips(&arm, &arm.ranges(), true);
}

#[test]
fn iiwa7_round_trips() {
    let arm = Srs::kuka_iiwa7();
    round_trips(&arm, &arm.ranges(), true);
}

#[test]
fn iiwa14_round_trips() {
    let arm = Srs::kuka_iiwa14();
    round_trips(&arm, &arm.ranges(), true);
}

#[test]
fn youbot_round_trips() {
    let arm = YouBot::default();
    round_trips(&arm, &arm.ranges(), false);
}

#[test]
fn upright_youbot_round_trips_from_its_zero() {
    let arm = YouBot::upright(YouBot::UPRIGHT_RANGES);
    round_trips(&arm, &arm.ranges(), false);
    let flange = arm.forward(&[0.0; 5]);
    let at = Frame::translation(0.033, 0.0, 0.608);
    assert!(error(&flange, &at) < 1e-12, "{flange}");
}

/// Both count the same joints: the folded arm in the vendor's numbers is the upright one after an offset, except that
/// the vendor's axis 1 is off by a degree.
#[test]
fn upright_youbot_bends_as_the_folded_one() {
    let (folded, upright) = (YouBot::default(), YouBot::upright(YouBot::UPRIGHT_RANGES));
    let joints = [0.3, 0.4, -1.2, 0.9, 2.0];
    let zero = [170.0, 65.0, -146.0, 102.5, 167.5].map(f64::to_radians);
    let moved: [f64; 5] = std::array::from_fn(|i| joints[i] - zero[i]);
    let [one, other] = [folded.forward(&joints), upright.forward(&moved)];
    assert!(one.rotation.angle_to(&other.rotation) < 1e-9);
}

/// The chain of links of a robot description: position of each joint in the previous one, rotation
/// about y or z in rad, and its axis (y or z, with its sign).
fn chain(links: &[([f64; 3], Vector3<f64>, Vector3<f64>)], joints: &[f64]) -> Frame {
    let joined = links.iter().zip(joints);
    joined.fold(Frame::identity(), |frame, ((at, turned, axis), q)| {
        let turn =
            UnitQuaternion::from_scaled_axis(*turned) * UnitQuaternion::from_scaled_axis(axis * *q);
        frame * Frame::from_parts(Translation3::from(Vector3::from(*at)), turn)
    })
}

#[test]
fn forward_matches_robot_description_chain() {
    let (y, z, none) = (Vector3::y(), Vector3::z(), Vector3::zeros());
    let tx90 = [
        ([0.0, 0.0, 0.478], none, z),
        ([0.050, 0.0, 0.0], none, y),
        ([0.0, 0.050, 0.425], none, y),
        ([0.0, 0.0, 0.0], none, z),
        ([0.0, 0.0, 0.425], none, y),
        ([0.0, 0.0, 0.100], none, z),
    ];
    let lwr = [
        ([0.0, 0.0, 0.11], none, z),
        ([0.0, 0.0, 0.2005], none, -y),
        ([0.0, 0.0, 0.20], none, z),
        ([0.0, 0.0, 0.20], none, y),
        ([0.0, 0.0, 0.20], none, z),
        ([0.0, 0.0, 0.19], none, -y),
        ([0.0, 0.0, 0.078], none, z),
    ];
    let mut iiwa = lwr.map(|(_, turned, _)| ([0.0; 3], turned, z));
    for (i, (height, axis)) in [
        (0.36, y),
        (0.0, z),
        (0.42, -y),
        (0.0, z),
        (0.40, y),
        (0.126, z),
    ]
    .into_iter()
    .enumerate()
    {
        iiwa[i + 1] = ([0.0, 0.0, height], none, axis);
    }
    let degrees = |axis: Vector3<f64>, angle: f64| axis * angle.to_radians();
    let youbot = [
        ([0.024, 0.0, 0.096], degrees(z, 170.0), -z),
        ([0.033, 0.0, 0.019], degrees(y, -65.0), y),
        ([0.0, 0.0, 0.155], degrees(y, 146.0), y),
        ([0.0, 0.0, 0.135], degrees(y, -102.5), y),
        ([-0.002, 0.0, 0.130], degrees(z, 167.5), -z),
    ];
    let upright = [
        ([0.0, 0.0, 0.147], none, -z),
        ([0.033, 0.0, 0.0], none, y),
        ([0.0, 0.0, 0.155], none, y),
        ([0.0, 0.0, 0.135], none, y),
        ([0.0, 0.0, 0.171], none, -z),
    ];
    let arms: [(&str, &[_]); 5] = [
        ("staubli_tx90", &tx90),
        ("kuka_lwr4", &lwr),
        ("kuka_iiwa14", &iiwa),
        ("kuka_youbot", &youbot),
        ("kuka_youbot_upright", &upright),
    ];
    let mut random = Random::new(42);
    for (name, links) in arms {
        let arm = named(name).expect("a known arm");
        for _ in 0..1000 {
            let joints: Vec<_> = links.iter().map(|_| random.between(-3.0, 3.0)).collect();
            let error = error(&arm.forward(&joints), &chain(links, &joints));
            assert!(error < 1e-7, "{name} {joints:?}: {error}");
        }
    }
}

#[test]
fn arms_in_singularities_round_trip() {
    let stretched: [(&str, &[f64]); 9] = [
        ("staubli_tx90", &[0.3, 0.5, 0.7, 0.2, 0.0, 0.4]),
        ("staubli_tx90", &[0.3, 0.5, 0.0, 0.2, 0.6, 0.4]),
        ("staubli_tx90", &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ("kuka_lwr4", &[0.0; 7]),
        ("kuka_lwr4", &[0.3, 0.4, 0.5, 0.0, 0.7, 0.8, 0.9]),
        ("kuka_lwr4", &[0.3, 0.0, 0.5, 0.6, 0.7, 0.8, 0.9]),
        ("kuka_lwr4", &[0.3, 0.4, 0.5, 0.6, 0.7, 0.0, 0.9]),
        ("kuka_iiwa7", &[0.3, 0.0, 0.5, 1.6, 0.7, 0.0, 0.9]),
        ("kuka_iiwa14", &[0.3, 1e-8, 0.5, 1e-8, 0.7, 1e-8, 0.9]),
    ];
    for (name, joints) in stretched {
        let arm = named(name).expect("a known arm");
        let flange = arm.forward(joints);
        for off in [0.0, 1e-9, 1e-3] {
            let hint: Vec<_> = joints.iter().map(|q| q + off).collect();
            let mut solved = vec![f64::NAN; joints.len()];
            let result = arm.inverse(&flange, &hint, &mut solved);
            assert_eq!(result, Ok(()), "{name} {joints:?}");
            let error = error(&arm.forward(&solved), &flange);
            assert!(error < 1e-9, "{name} {joints:?}: {error}");
        }
    }
}

#[test]
fn opw_wrist_on_axis_1_keeps_hint() {
    let geometry = OpwGeometry {
        b: 0.0,
        ..OpwGeometry::STAUBLI_TX90
    };
    let arm = Opw::new(geometry, Opw::staubli_tx90().ranges());
    let q2 = 0.3_f64;
    let q3 = -((geometry.a1 + geometry.c2 * q2.sin()) / geometry.c3).asin() - q2;
    let joints = [1.1, q2, q3, 0.4, 0.5, 0.6];
    let mut solved = [0.0; 6];
    let flange = arm.forward(&joints);
    assert_eq!(arm.inverse(&flange, &joints, &mut solved), Ok(()));
    assert!(difference(&solved, &joints) < 1e-9, "{solved:?}");
}

#[test]
fn inverse_out_of_reach_fails_without_change() {
    for name in ["staubli_tx90", "kuka_lwr4", "kuka_iiwa7", "kuka_youbot"] {
        let arm = named(name).expect("a known arm");
        let mut joints = vec![7.0; arm.joints()];
        let hint = vec![0.1; arm.joints()];
        let far = Frame::translation(3.0, 0.0, 0.0);
        assert_eq!(
            arm.inverse(&far, &hint, &mut joints),
            Err(Unreachable::Reach)
        );
        let here = arm.forward(&hint);
        let none = vec![f64::NAN; arm.joints()];
        assert_eq!(
            arm.inverse(&here, &none, &mut joints),
            Err(Unreachable::Invalid)
        );
        assert_eq!(
            arm.inverse(&here, &hint[1..], &mut joints),
            Err(Unreachable::Invalid)
        );
        let huge = Frame::translation(1e308, -1e308, 1e308);
        assert_eq!(
            arm.inverse(&huge, &hint, &mut joints),
            Err(Unreachable::Reach)
        );
        let invalid = Frame::translation(f64::NAN, 0.0, 0.0);
        assert_eq!(
            arm.inverse(&invalid, &hint, &mut joints),
            Err(Unreachable::Invalid)
        );
        assert_eq!(joints, vec![7.0; arm.joints()], "{name}");
        assert!(arm.forward(&none).translation.x.is_nan(), "{name}");
        assert!(arm.forward(&[]).translation.x.is_nan(), "{name}");
    }
    // Within reach, but axis 4 of the iiwa bends by 120° at most.
    let arm = Srs::kuka_iiwa7();
    let flange = arm.forward(&[0.1, 0.2, 0.3, 2.3, 0.4, 0.5, 0.6]);
    let mut joints = [0.0; 7];
    let result = arm.inverse(&flange, &[0.1; 7], &mut joints);
    assert_eq!(result, Err(Unreachable::Limits));
}

#[test]
fn youbot_frame_beyond_five_axes_is_rejected() {
    let arm = YouBot::default();
    let hint = [1.0, 1.0, -2.0, 1.0, 2.0];
    let flange = arm.forward(&hint);
    let turned = flange * UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.1, 0.0));
    let mut joints = [0.0; 5];
    assert_eq!(
        arm.inverse(&turned, &hint, &mut joints),
        Err(Unreachable::Reach)
    );
}

#[test]
fn arm_angle_within_limits_is_kept() {
    let arm = Srs::kuka_lwr4();
    let mut random = Random::new(7);
    let mut kept = 0;
    for _ in 0..2000 {
        let joints = random_joints(&mut random, &arm.ranges());
        let (flange, alpha) = arm.forward_alpha(&joints);
        let wanted = alpha + random.between(-0.2, 0.2);
        let solved = arm
            .inverse_alpha(&flange, wanted, &joints)
            .expect("reached");
        let (again, got) = arm.forward_alpha(&solved);
        assert!(error(&again, &flange) < 1e-9);
        let bent_alike = (solved[3] > 0.0) == (joints[3] > 0.0);
        let got = if bent_alike { got } else { got + PI };
        let off = (got - wanted + PI).rem_euclid(2.0 * PI) - PI;
        let on_limit = solved
            .iter()
            .zip(arm.ranges())
            .any(|(q, r)| (q - r.min).abs() < 1e-4 || (q - r.max).abs() < 1e-4);
        assert!(off.abs() < 1e-6 || on_limit, "{off} {solved:?}");
        kept += u32::from(off.abs() < 1e-6);
    }
    assert!(kept > 1500, "{kept}");
}

#[test]
fn elbow_position_matches_arm_angle() {
    let arm = Srs::kuka_lwr4();
    let (_, alpha) = arm.forward_alpha(&[0.4, -0.5, 0.0, 1.0, 0.2, 0.3, 0.1]);
    assert!(
        alpha.abs() < 1e-12 || (alpha.abs() - PI).abs() < 1e-12,
        "{alpha}"
    );
    let (flange, alpha) = arm.forward_alpha(&[0.4, -0.5, 0.3, 1.0, 0.2, 0.3, 0.1]);
    let turned = arm.inverse_alpha(&flange, alpha + 0.1, &[0.4, -0.5, 0.3, 1.0, 0.2, 0.3, 0.1]);
    let (_, after) = arm.forward_alpha(&turned.expect("reached"));
    assert!((after - alpha - 0.1).abs() < 1e-9);
}

#[test]
fn velocities_match_derivatives() {
    let mut random = Random::new(3);
    for arm in [Srs::kuka_lwr4(), Srs::kuka_iiwa14()] {
        for _ in 0..500 {
            let joints = random_joints(&mut random, &arm.ranges());
            let speeds: [f64; 7] = std::array::from_fn(|_| random.between(-1.0, 1.0));
            let h = 1e-5;
            let at =
                |t: f64| arm.forward_alpha(&std::array::from_fn(|i| joints[i] + t * speeds[i]));
            let ((before, first), (after, second)) = (at(-h), at(h));
            let vel = (after.translation.vector - before.translation.vector) / (2.0 * h);
            let rot = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * h);
            let alpha = ((second - first + PI).rem_euclid(2.0 * PI) - PI) / (2.0 * h);
            let (twist, rate) = arm.velocity(&joints, &speeds);
            assert!((twist.vel - vel).norm() < 1e-7, "{joints:?}");
            assert!((twist.rot - rot).norm() < 1e-6, "{joints:?}");
            let rate = rate.expect("no singularity was drawn");
            assert!(
                (rate - alpha).abs() < 1e-4 * (1.0 + rate.powi(4)),
                "{joints:?}: {rate} {alpha}"
            );
        }
        assert_eq!(arm.velocity(&[0.0; 7], &[1.0; 7]).1, None);
    }
}

#[test]
fn arm_with_narrower_limits_keeps_them() {
    let limits = JointLimits {
        position_min: -1.0,
        position_max: 1.0,
        velocity_max: 1.0,
        acceleration_max: 1.0,
    };
    for name in ["staubli_tx90", "kuka_lwr4", "kuka_iiwa7", "kuka_iiwa14"] {
        let model = named(name).expect("a known arm");
        let arm = limited(name, &vec![limits; model.joints()]).expect("as many as joints");
        let inside = vec![0.9; model.joints()];
        let outside = vec![1.1; model.joints()];
        let mut joints = inside.clone();
        let flange = model.forward(&outside);
        assert_eq!(model.inverse(&flange, &outside, &mut joints), Ok(()));
        if arm.inverse(&flange, &outside, &mut joints).is_ok() {
            assert!(joints.iter().all(|q| q.abs() <= 1.0), "{name}: {joints:?}");
        }
        let flange = model.forward(&inside);
        assert_eq!(arm.inverse(&flange, &inside, &mut joints), Ok(()));
        assert!(limited(name, &[limits; 2]).is_none());
    }
    assert!(limited("kuka_youbot", &[limits; 5]).is_some());
    assert!(named("unknown").is_none() && limited("unknown", &[]).is_none());
}

#[test]
fn turns_stay_within_range() {
    let range = Range::degrees(-270.0, 270.0);
    let near = |angle: f64, hint: f64| range.nearest_turn(angle, hint);
    assert_eq!(near(1.0, 0.9), Some(1.0));
    assert!((near(-2.0, 4.0).expect("in range") - (TAU - 2.0)).abs() < 1e-12);
    assert!((near(1.0, 7.0).expect("in range") - 1.0).abs() < 1e-12);
    assert_eq!(Range::degrees(-90.0, 90.0).nearest_turn(3.0, 0.0), None);
    assert_eq!(range.nearest_turn(f64::NAN, 0.0), None);
}

#[test]
fn jacobian_is_derivative_of_forward() {
    let mut random = Random::new(11);
    for name in [
        "staubli_tx90",
        "kuka_lwr4",
        "kuka_iiwa7",
        "kuka_iiwa14",
        "kuka_youbot",
    ] {
        let arm = named(name).expect("a known arm");
        for _ in 0..500 {
            let joints: Vec<_> = (0..arm.joints())
                .map(|_| random.between(-3.0, 3.0))
                .collect();
            let mut columns = vec![Twist::default(); arm.joints()];
            arm.jacobian(&joints, &mut columns);
            for (joint, column) in columns.iter().enumerate() {
                let h = 1e-5;
                let at = |by: f64| {
                    let mut joints = joints.clone();
                    joints[joint] += by;
                    arm.forward(&joints)
                };
                let (before, after) = (at(-h), at(h));
                let vel = (after.translation.vector - before.translation.vector) / (2.0 * h);
                let rot = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * h);
                assert!(
                    (column.vel - vel).norm() < 1e-8,
                    "{name} {joint} {joints:?}"
                );
                assert!(
                    (column.rot - rot).norm() < 1e-6,
                    "{name} {joint} {joints:?}"
                );
            }
        }
        let mut columns = vec![Twist::default(); arm.joints()];
        arm.jacobian(&vec![f64::NAN; arm.joints()], &mut columns);
        assert!(columns.iter().any(|c| c.vel.x.is_nan()), "{name}");
        arm.jacobian(&vec![0.0; arm.joints()], &mut columns[1..]);
        assert!(columns[1].vel.x.is_nan(), "{name}");
    }
}

/// What is found without a search is what a search among all solutions finds.
#[test]
fn srs_solution_near_hint_is_that_of_search() {
    let mut random = Random::new(12);
    for arm in [Srs::kuka_lwr4(), Srs::kuka_iiwa7(), Srs::kuka_iiwa14()] {
        let mut compared = 0;
        for number in 0..2_000 {
            let hint = random_joints(&mut random, &arm.ranges());
            let spread = [0.001, 0.1, 1.0][number % 3];
            let joints = hint.map(|q| q + random.between(-spread, spread));
            let flange = arm.forward(&joints);
            let Some([near, search]) = arm.both(&flange, &hint) else {
                continue;
            };
            let near = near.expect("the solution without a search");
            let search = search.expect("the same");
            let farther = difference(&near, &hint) - difference(&search, &hint);
            // Where several joints are close to their limits, the search may find one a little nearer.
            let on_limit = near
                .iter()
                .zip(arm.ranges())
                .any(|(q, r)| q - r.min < 1e-4 || r.max - q < 1e-4);
            let most = if on_limit { 1e-2 } else { 1e-6 };
            assert!(
                farther < most,
                "{number}: {farther} {near:?} {search:?} {hint:?}"
            );
            assert!(
                error(&arm.forward(&near), &flange) < 1e-9,
                "{number}: {near:?}"
            );
            compared += 1;
        }
        assert!(compared > 1_200, "{compared}");
    }
}

/// Along a smooth path nearly every solution is found without a search, and joints move smoothly.
#[test]
fn srs_smooth_path_seldom_needs_search() {
    let arm = Srs::kuka_lwr4();
    let mut random = Random::new(13);
    let (mut found, mut all) = (0, 0);
    for _ in 0..40 {
        let mut hint = random_joints(&mut random, &arm.ranges());
        let start = arm.forward(&hint);
        let step = Vector3::from_fn(|_, _| random.between(-7e-4, 7e-4));
        let turn = Vector3::from_fn(|_, _| random.between(-1e-3, 1e-3));
        for number in 0..200 {
            let along = f64::from(number);
            let rotation = UnitQuaternion::from_scaled_axis(turn * along) * start.rotation;
            let position = start.translation.vector + step * along;
            let flange = Frame::from_parts(position.into(), rotation);
            let near = arm.both(&flange, &hint).is_some();
            let mut joints = [0.0; 7];
            if arm.inverse(&flange, &hint, &mut joints).is_err() {
                break;
            }
            all += 1;
            found += u32::from(near);
            hint = joints;
        }
    }
    assert!(all > 2_000 && found * 1000 > all * 995, "{found} of {all}");
}
