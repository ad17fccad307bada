//! Energy and momentum as references that share nothing with the recursion, and identified payloads.

use nalgebra::{Matrix3, Vector3};
use takt_net::device::Kinematics;
use takt_net::{Frame, Twist};
use takt_tests::Random;

use super::*;
use crate::kinematics::{Joint, Range};

const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -GRAVITY);

/// An arm of seven joints, one of them prismatic, with bodies of any shape.
fn arm(random: &mut Random) -> Dynamics {
    let mut vector = |size: f64| {
        let [x, y, z] = [0; 3].map(|_| random.between(-size, size));
        Vector3::new(x, y, z)
    };
    let mut joints = Vec::new();
    let mut bodies = Vec::new();
    for number in 0..7 {
        let turn = nalgebra::UnitQuaternion::from_scaled_axis(vector(2.0));
        joints.push(Joint {
            origin: Frame::from_parts(vector(0.4).into(), turn),
            axis: vector(1.0),
            kind: if number == 2 {
                JointKind::Prismatic
            } else {
                JointKind::Revolute
            },
            range: Range::degrees(-170.0, 170.0),
        });
        // Four point masses are a possible body.
        let points: [Vector3<f64>; 4] = std::array::from_fn(|_| vector(0.2));
        let body = points.iter().fold(Body::default(), |body, at| {
            body.with(&Body::new(1.0, *at, Matrix3::zeros()))
        });
        assert!(body.is_possible());
        bodies.push(body);
    }
    let serial = Serial::new(&joints, &Frame::translation(0.1, 0.0, 0.2)).unwrap();
    Dynamics::new(serial, &bodies).unwrap()
}

fn random_motion(random: &mut Random, joints: usize) -> Vec<JointMotion> {
    (0..joints)
        .map(|_| [0; 3].map(|_| random.between(-1.5, 1.5)))
        .collect()
}

fn torques(arm: &Dynamics, motions: &[JointMotion], gravity: &Vector3<f64>) -> Vec<f64> {
    let mut torques = vec![0.0; motions.len()];
    arm.torques(motions, gravity, &mut torques);
    torques
}

/// The mass matrix, column by column, by unit accelerations at rest.
fn mass_matrix(arm: &Dynamics, at: &[f64]) -> nalgebra::DMatrix<f64> {
    let count = at.len();
    let mut matrix = nalgebra::DMatrix::zeros(count, count);
    for joint in 0..count {
        let motion = |n: usize| [at[n], 0.0, if n == joint { 1.0 } else { 0.0 }];
        let motions: Vec<_> = (0..count).map(motion).collect();
        let column = torques(arm, &motions, &Vector3::zeros());
        matrix.column_mut(joint).copy_from_slice(&column);
    }
    matrix
}

#[test]
fn dynamics_mass_matrix_is_symmetric_and_positive() {
    let mut random = Random::new(1);
    for _ in 0..20 {
        let arm = arm(&mut random);
        let at: Vec<_> = (0..7).map(|_| random.between(-1.0, 1.0)).collect();
        let matrix = mass_matrix(&arm, &at);
        assert!((&matrix - matrix.transpose()).amax() < 1e-10);
        assert!(matrix.symmetric_eigenvalues().min() > 0.0);
    }
}

/// Lagrange's equations with numeric derivatives: d/dt(M v) - 1/2 d(v M v)/dq, which the recursion does not use.
#[test]
fn dynamics_velocity_torques_match_lagrange() {
    let mut random = Random::new(2);
    for _ in 0..5 {
        let arm = arm(&mut random);
        let motions = random_motion(&mut random, 7);
        let at: Vec<_> = motions.iter().map(|it| it[0]).collect();
        let speed = nalgebra::DVector::from_iterator(7, motions.iter().map(|it| it[1]));
        let rate = nalgebra::DVector::from_iterator(7, motions.iter().map(|it| it[2]));
        let step = 1e-5;
        let moved = |joint: usize, by: f64| {
            let mut at = at.clone();
            at[joint] += by;
            mass_matrix(&arm, &at)
        };
        let slopes: Vec<_> = (0..7)
            .map(|joint| (moved(joint, step) - moved(joint, -step)) / (2.0 * step))
            .collect();
        let mut wanted = mass_matrix(&arm, &at) * rate;
        for joint in 0..7 {
            wanted += &slopes[joint] * &speed * speed[joint];
            wanted[joint] -= 0.5 * (speed.transpose() * &slopes[joint] * &speed)[0];
        }
        let found = torques(&arm, &motions, &Vector3::zeros());
        for (found, wanted) in found.iter().zip(wanted.iter()) {
            assert!(
                (found - wanted).abs() < 1e-4 * (1.0 + wanted.abs()),
                "{found} {wanted}"
            );
        }
    }
}

#[test]
fn dynamics_of_payload_at_rest_is_its_weight() {
    let mut random = Random::new(3);
    let arm = arm(&mut random);
    let payload = Body::new(
        2.5,
        Vector3::new(0.02, -0.05, 0.1),
        Matrix3::identity() * 0.01,
    );
    let at: Vec<_> = (0..7).map(|_| random.between(-1.0, 1.0)).collect();
    let rest: Vec<_> = at.iter().map(|at| [*at, 0.0, 0.0]).collect();
    let without = torques(&arm, &rest, &DOWN);
    let with = torques(&arm.clone().with_payload(&payload), &rest, &DOWN);
    // The weight at the centre of mass, through the Jacobian.
    let flange = arm.arm().forward(&at);
    let mut columns = [Twist::default(); 7];
    arm.arm().jacobian(&at, &mut columns);
    let lever = flange.rotation * payload.centre();
    for (joint, column) in columns.iter().enumerate() {
        let rise = column.vel.z + column.rot.cross(&lever).z;
        let wanted = 2.5 * GRAVITY * rise;
        assert!((with[joint] - without[joint] - wanted).abs() < 1e-10);
    }
}

#[test]
fn payload_is_identified_from_motion() {
    let mut random = Random::new(4);
    let arm = arm(&mut random);
    let inertia = Matrix3::new(0.02, 0.001, 0.0, 0.001, 0.03, 0.002, 0.0, 0.002, 0.025);
    let payload = Body::new(1.7, Vector3::new(0.03, -0.04, 0.09), inertia);
    let loaded = arm.clone().with_payload(&payload);
    let sample = |motions: Vec<JointMotion>| Sample {
        torques: torques(&loaded, &motions, &DOWN),
        motions,
    };
    let moving: Vec<_> = (0..40)
        .map(|_| sample(random_motion(&mut random, 7)))
        .collect();
    let found = identify(&arm, &moving, &DOWN).unwrap();
    assert!(found.has_inertia && found.residual < 1e-9);
    assert!((found.body.mass - 1.7).abs() < 1e-9);
    assert!((found.body.centre() - payload.centre()).norm() < 1e-9);
    assert!((found.body.central_inertia() - inertia).amax() < 1e-8);
    // At rest only mass and centre show.
    let resting = |it: &Sample| sample(it.motions.iter().map(|it| [it[0], 0.0, 0.0]).collect());
    let resting: Vec<_> = moving.iter().map(resting).collect();
    let found = identify(&arm, &resting, &DOWN).unwrap();
    assert!(!found.has_inertia && (found.body.mass - 1.7).abs() < 1e-9);
    assert!((found.body.centre() - payload.centre()).norm() < 1e-9);
}

#[test]
fn payload_without_motion_is_not_identified() {
    let mut random = Random::new(5);
    let arm = arm(&mut random);
    let motions = vec![[0.1, 0.0, 0.0]; 7];
    let sample = Sample {
        torques: vec![0.0; 7],
        motions,
    };
    let same = vec![sample.clone(); 10];
    // One pose shows at most a part of mass and centre: a force of three numbers has no fourth.
    let one = Vector3::zeros();
    assert_eq!(
        identify(&arm, &same, &one).unwrap_err(),
        IdentifyError::Motion
    );
    assert_eq!(
        identify(&arm, &[], &DOWN).unwrap_err(),
        IdentifyError::Motion
    );
    let short = Sample {
        torques: vec![0.0; 6],
        ..sample.clone()
    };
    assert_eq!(
        identify(&arm, &[sample, short], &DOWN).unwrap_err(),
        IdentifyError::Sample(1)
    );
}

#[test]
fn body_that_cannot_be_is_detected() {
    let moments = |x, y, z| {
        Body::new(
            1.0,
            Vector3::x(),
            Matrix3::from_diagonal(&Vector3::new(x, y, z)),
        )
    };
    assert!(moments(1.0, 1.0, 1.5).is_possible());
    assert!(
        !moments(1.0, 1.0, 2.5).is_possible(),
        "one exceeds the others"
    );
    assert!(!moments(1.0, 1.0, -0.1).is_possible());
    assert!(!Body::default().is_possible(), "no mass");
}

/// A point mass at the flange.
fn point(mass: f64, centre: [f64; 3]) -> Body {
    Payload {
        mass,
        centre_of_mass: centre,
    }
    .body()
}

#[test]
fn weight_of_load_is_what_arm_holds_more() {
    let mut random = Random::new(7);
    for _ in 0..20 {
        let arm = arm(&mut random);
        let load = point(2.5, [0.03, -0.05, 0.12]);
        let loaded = arm.clone().with_payload(&load);
        let at: Vec<_> = (0..7).map(|_| random.between(-1.5, 1.5)).collect();
        let rest: Vec<_> = at.iter().map(|at| [*at, 0.0, 0.0]).collect();
        let gravity = Vector3::new(1.0, -3.0, -9.0);
        let mut own = vec![0.0; 7];
        weight(arm.arm(), &at, &load, &gravity, &mut own);
        let with = torques(&loaded, &rest, &gravity);
        let without = torques(&arm, &rest, &gravity);
        for ((own, with), without) in own.iter().zip(with).zip(without) {
            assert!((own - (with - without)).abs() < 1e-10, "{own}");
        }
        weight(arm.arm(), &at[1..], &load, &gravity, &mut own);
        assert!(own.iter().all(|it| it.is_nan()));
    }
}

/// External torques of an LWR that swings slowly about a bent pose, with a load, dry friction and noise.
fn swung(load: &Body, moves: usize, friction: f64, noise: f64) -> Vec<Sample> {
    let arm = crate::kinematics::named("kuka_lwr4").unwrap();
    let mut random = Random::new(8);
    let bent = [0.2, 0.6, -0.3, -1.2, 0.4, 0.9, -0.2];
    let swing = |joint: usize, t: f64| {
        let rate = 0.3 + 0.13 * joint as f64;
        let moves = if joint >= 7 - moves { 0.3 } else { 0.0 };
        (moves * (rate * t).sin(), moves * rate * (rate * t).cos())
    };
    (0..400)
        .map(|number| {
            let t = 0.05 * f64::from(number);
            let motions: Vec<_> = bent
                .iter()
                .enumerate()
                .map(|(joint, at)| {
                    let (by, speed) = swing(joint, t);
                    [at + by, speed, 0.0]
                })
                .collect();
            let at: Vec<_> = motions.iter().map(|it| it[0]).collect();
            let mut torques = vec![0.0; 7];
            weight(&*arm, &at, load, &DOWN, &mut torques);
            for (torque, [_, speed, _]) in torques.iter_mut().zip(&motions) {
                *torque += friction * speed.signum() * speed.abs().min(1.0).ceil();
                *torque += random.between(-noise, noise);
            }
            Sample { motions, torques }
        })
        .collect()
}

#[test]
fn load_is_weighed_beside_friction_and_noise() {
    let arm = crate::kinematics::named("kuka_lwr4").unwrap();
    let load = point(3.2, [0.02, -0.01, 0.11]);
    let found = weigh(&*arm, None, &swung(&load, 7, 1.5, 0.5), &DOWN).unwrap();
    assert!(
        (found.mass - 3.2).abs() < found.uncertainty.max(0.02),
        "{found:?}"
    );
    assert!(
        (found.centre - Vector3::new(0.02, -0.01, 0.11)).norm() < 0.01,
        "{found:?}"
    );
    assert!(
        found.residual < 0.4 && found.uncertainty < 0.15,
        "{found:?}"
    );
    let none = weigh(&*arm, None, &swung(&Body::default(), 7, 0.0, 0.2), &DOWN).unwrap();
    assert!(none.mass.abs() <= none.uncertainty, "{none:?}");
    assert_eq!(none.centre, Vector3::zeros());
}

#[test]
fn weighing_of_poor_motion_is_refused_with_cause() {
    let arm = crate::kinematics::named("kuka_lwr4").unwrap();
    let load = point(3.2, [0.02, -0.01, 0.11]);
    let refused = |samples: &[Sample], gravity: &Vector3<f64>| weigh(&*arm, None, samples, gravity);
    // The axes of the wrist meet in one point: a heavy load near is as a light one far.
    let wrist = refused(&swung(&load, 3, 0.0, 0.0), &DOWN);
    assert!(matches!(wrist, Err(WeighError::Motion(_))), "{wrist:?}");
    let still = refused(&swung(&load, 0, 0.0, 0.0), &DOWN);
    assert_eq!(still, Err(WeighError::Few(0)));
    let noisy = refused(&swung(&load, 7, 0.0, 30.0), &DOWN);
    assert!(
        matches!(noisy, Err(WeighError::Residual { .. })),
        "{noisy:?}"
    );
    let lifted = refused(&swung(&load, 7, 0.0, 0.1), &-DOWN);
    assert!(matches!(lifted, Err(WeighError::Negative(_))), "{lifted:?}");
    let mut broken = swung(&load, 7, 0.0, 0.0);
    broken[3].torques[1] = f64::NAN;
    assert_eq!(refused(&broken, &DOWN), Err(WeighError::Sample(3)));
    broken[3].torques.pop();
    assert_eq!(refused(&broken, &DOWN), Err(WeighError::Sample(3)));
}
