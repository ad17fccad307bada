//! Plans outside nets agree with the primitives, and find where an arm cannot follow.

use std::time::Duration;

use takt_net::JointLimits;

use super::*;
use crate::kinematics::Srs;
use crate::plan::{
    Cause, FrameBounds, FrameState, JointSample, Plan, PlanError, Route, State, plan, plan_frame,
};

const PERIOD: Duration = Duration::from_millis(1);
const START: [f64; 7] = [0.2, 0.6, -0.3, -1.2, 0.4, 0.9, -0.2];

fn rest(positions: &[f64]) -> Vec<State> {
    positions
        .iter()
        .map(|position| State::at_rest(*position))
        .collect()
}

fn frame_bounds() -> FrameBounds {
    let [translation, rotation] = cartesian_bounds();
    FrameBounds {
        translation,
        rotation,
    }
}

fn limits() -> [JointLimits; 7] {
    let limits = |range: &crate::kinematics::Range| JointLimits {
        position_min: range.min,
        position_max: range.max,
        velocity_max: 20.0,
        acceleration_max: 10.0,
    };
    Srs::kuka_lwr4().ranges().each_ref().map(limits)
}

fn assert_same(plan: &Plan<JointSample>, run: &Run, skip: usize) {
    let planned = plan.cycles().skip(skip);
    let mut compared = 0;
    for ((at, sample), joints) in planned.zip(&run.joints) {
        for (state, joint) in sample.joints.iter().zip(joints) {
            assert!(
                (state.position - joint).abs() < 1e-12,
                "{at:?}: {state:?} {joint}"
            );
        }
        compared += 1;
    }
    assert!(
        compared + 6 > run.joints.len(),
        "{compared} of {}",
        run.joints.len()
    );
}

#[test]
fn plan_agrees_with_ptp_in_every_cycle() {
    let mut random = Random::new(31);
    for _ in 0..4 {
        let ptp = random_ptp(&mut random, 3);
        let planned = plan(&rest(&ptp.from), &ptp.to, &ptp.bounds, PERIOD).expect("a plan");
        assert_same(&planned, &Run::new(&ptp.net).finish(), 0);
        let velocity = some(&mut random, 3, -0.4, 0.4);
        let moving: Vec<State> = ptp
            .from
            .iter()
            .zip(&velocity)
            .map(|(position, velocity)| State {
                position: *position,
                velocity: *velocity,
                acceleration: 0.0,
            })
            .collect();
        let planned = plan(&moving, &ptp.to, &ptp.bounds, PERIOD).expect("a plan");
        assert_same(
            &planned,
            &Run::new(&departures::departing(&ptp, &moving)).finish(),
            1,
        );
    }
}

#[test]
fn plan_agrees_with_lin_in_every_cycle() {
    let mut random = Random::new(32);
    let (from, to) = (
        random_frame(&mut random, 0.5),
        random_frame(&mut random, 0.5),
    );
    let net = cartesian("Lin", &[("From", from), ("To", to)]);
    let run = Run::new(&net).finish();
    let route = Route::Line { to };
    let planned =
        plan_frame(&FrameState::at_rest(from), &route, frame_bounds(), PERIOD).expect("a plan");
    for ((_, sample), frame) in planned.cycles().zip(&run.frames) {
        assert!((sample.frame.translation.vector - frame.translation.vector).norm() < 1e-9);
    }
    let halfway = planned
        .first(|sample| sample.progress >= 0.5)
        .expect("half of it");
    let progress = planned.at(halfway).progress;
    assert!((0.5..0.51).contains(&progress), "{progress}");
    let early = planned.at(halfway.saturating_sub(PERIOD / 2)).progress;
    assert!(early < progress, "{early}");
    assert!(planned.first(|sample| sample.progress > 2.0).is_none());
    assert!((planned.at(planned.duration() * 2).progress - 1.0).abs() < 1e-12);
}

#[test]
fn check_names_place_out_of_reach_range_and_velocity() {
    let arm = Srs::kuka_lwr4();
    let start = FrameState::at_rest(
        crate::kinematics::named("kuka_lwr4")
            .expect("an arm")
            .forward(&START),
    );
    let to = |x: f64, y: f64| Route::Line {
        to: Frame::translation(x, y, 0.0) * start.frame,
    };
    let check = |route: &Route, limits: &[JointLimits]| {
        let planned = plan_frame(&start, route, frame_bounds(), PERIOD).expect("a plan");
        planned.check(&arm, limits, &START, &Frame::identity())
    };
    let joints = check(&to(0.0, 0.2), &limits()).expect("within reach");
    let end = crate::kinematics::named("kuka_lwr4")
        .expect("an arm")
        .forward(&joints);
    assert!((end.translation.y - start.frame.translation.y - 0.2).abs() < 1e-9);

    let found = check(&to(1.0, 0.0), &limits()).expect_err("too far");
    assert!(
        matches!(found.cause, Cause::Unreachable(_)) && (0.05..0.95).contains(&found.progress),
        "{found}"
    );
    // There, and not before.
    let planned = plan_frame(&start, &to(1.0, 0.0), frame_bounds(), PERIOD).expect("a plan");
    let at = |time: Duration| {
        let mut joints = [0.0; 7];
        let frame = planned.at(time).frame;
        takt_net::device::Kinematics::inverse(&arm, &frame, &START, &mut joints).is_ok()
    };
    assert!(!at(found.at) && at(found.at - PERIOD * 2), "{found}");

    let mut slow = limits();
    slow.iter_mut().for_each(|limits| limits.velocity_max = 0.1);
    let found = check(&to(0.0, 0.2), &slow).expect_err("too fast");
    assert!(
        matches!(found.cause, Cause::Velocity { limit: 0.1, .. }),
        "{found}"
    );
    let mut narrow = limits();
    narrow[3].position_min = START[3] - 0.05;
    let found = check(&to(0.2, 0.0), &narrow).expect_err("beyond a range");
    assert!(
        matches!(found.cause, Cause::Position { joint: 3, .. }),
        "{found}"
    );
    assert!(found.to_string().contains("joint 3 is at"), "{found}");
    let found = check(&to(0.0, 0.1), &limits()[1..]).expect_err("six limits");
    assert_eq!(
        found.cause,
        Cause::Joints {
            found: 6,
            joints: 7
        }
    );
}

#[test]
fn joint_plan_check_names_first_violation() {
    let bounds = [Bounds {
        velocity: 1.0,
        acceleration: 5.0,
        jerk: 50.0,
    }];
    let planned = plan(&rest(&[0.0]), &[1.0], &bounds, PERIOD).expect("a plan");
    let limits = |max, velocity_max| JointLimits {
        position_min: -1.0,
        position_max: max,
        velocity_max,
        acceleration_max: 5.0,
    };
    assert_eq!(planned.check(&[limits(1.0, 1.0)]), Ok(()));
    let found = planned
        .check(&[limits(0.5, 1.0)])
        .expect_err("out of range");
    assert!((0.5..0.51).contains(&found.progress), "{found}");
    assert!(matches!(found.cause, Cause::Position { joint: 0, .. }));
    let found = planned.check(&[limits(1.0, 0.5)]).expect_err("too fast");
    assert!(
        found.progress < 0.2 && matches!(found.cause, Cause::Velocity { .. }),
        "{found}"
    );
}

#[test]
fn plan_of_invalid_motion_is_error() {
    let bounds = [Bounds {
        velocity: 1.0,
        acceleration: 5.0,
        jerk: 50.0,
    }];
    let refused = |from: &[f64], to: &[f64], bounds: &[Bounds], period| {
        plan(&rest(from), to, bounds, period).expect_err("no plan")
    };
    assert_eq!(
        refused(&[f64::NAN], &[0.0], &bounds, PERIOD),
        PlanError::Number
    );
    assert_eq!(refused(&[0.0], &[1e9], &bounds, PERIOD), PlanError::Number);
    assert_eq!(
        refused(&[0.0], &[1.0], &bounds, Duration::ZERO),
        PlanError::Period
    );
    assert_eq!(
        refused(&[0.0], &[], &bounds, PERIOD),
        PlanError::Joints {
            from: 1,
            to: 0,
            bounds: 1
        }
    );
    assert_eq!(
        refused(&[], &[], &[], PERIOD),
        PlanError::Joints {
            from: 0,
            to: 0,
            bounds: 0
        }
    );
    let none = [Bounds {
        jerk: 0.0,
        ..bounds[0]
    }];
    assert_eq!(
        refused(&[0.0], &[1.0], &none, PERIOD),
        PlanError::Limit(0.0)
    );
    let start = FrameState::at_rest(Frame::identity());
    let at = |x: f64| Frame::translation(x, 0.0, 0.0);
    let collinear = Route::Arc {
        from: at(0.0),
        via: at(0.1),
        to: at(0.2),
    };
    assert_eq!(
        plan_frame(&start, &collinear, frame_bounds(), PERIOD).expect_err("no arc"),
        PlanError::Path
    );
    let single = Route::Spline {
        points: vec![at(0.0)],
        tangents: Vec::new(),
    };
    assert_eq!(
        plan_frame(&start, &single, frame_bounds(), PERIOD).expect_err("no curve"),
        PlanError::Path
    );
    let slow = [Bounds {
        velocity: 1e-6,
        ..bounds[0]
    }];
    assert_eq!(
        refused(&[0.0], &[1000.0], &slow, PERIOD),
        PlanError::Endless
    );
}

#[test]
fn plan_after_its_end_is_at_rest() {
    let bounds = Bounds {
        velocity: 1.0,
        acceleration: 1.0,
        jerk: 10.0,
    };
    let from = [State::at_rest(0.0)];
    let planned = plan(&from, &[0.3], &[bounds], Duration::from_millis(4)).expect("a plan");
    for time in [planned.duration(), Duration::from_secs(3600), Duration::MAX] {
        let end = planned.at(time);
        assert!((end.joints[0].position - 0.3).abs() < 1e-12, "{time:?}");
        assert!(end.joints[0].velocity.abs() < 1e-12, "{time:?}");
    }
}

/// Two kinds of profile meet there; 20 mm at 1 m/s² and 10 m/s³ are such a distance.
#[test]
fn plans_that_just_reach_a_limit_exist() {
    for (velocity, acceleration, jerk) in [(0.25, 1.0, 10.0), (0.25, 1.0, 4.0), (1.0, 1.0, 1.0)] {
        let bounds = Bounds {
            velocity,
            acceleration,
            jerk,
        };
        let to_acceleration: f64 = 2.0 * acceleration.powi(3) / jerk.powi(2);
        let to_velocity = velocity * (velocity / acceleration + acceleration / jerk);
        for distance in [to_acceleration, to_velocity] {
            let mut distance = (0..20).fold(distance, |distance, _| distance.next_down());
            for _ in 0..40 {
                let plan = plan(&[State::at_rest(0.0)], &[distance], &[bounds], PERIOD);
                assert!(plan.is_ok(), "{distance:e} with {bounds:?}: {plan:?}");
                distance = distance.next_up();
            }
        }
    }
}
