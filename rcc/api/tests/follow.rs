//! Following frames that move, on emulated arms.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;

use takt_api::{Arm, Cell, ErrorKind, MovingFrame, Number, Outcome, Pose};
use takt_tests::steady;

const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
const TIMEOUT: Duration = Duration::from_secs(30);

fn arms() -> (Cell, Arm, Arm) {
    let cell = Cell::emulated("two_lwr").unwrap();
    let [left, right] = ["left", "right"].map(|name| {
        let arm = cell.arm(name).unwrap().with_base(Pose::IDENTITY);
        assert_eq!(arm.ptp(BENT).run(), Ok(Outcome::Completed));
        arm
    });
    (cell, left, right)
}

fn flange(arm: &Arm) -> Pose {
    let commanded = arm.commanded().unwrap();
    let kinematics = arm.description().model.unlimited();
    kinematics.unwrap().forward(&commanded).into()
}

fn distance(a: &Pose, b: &Pose) -> f64 {
    let [dx, dy, dz] = (a.inverse() * *b).position();
    dx.hypot(dy).hypot(dz)
}

#[test]
fn follow_keeps_to_other_arm_and_hands_over() {
    steady(|| {
        let (cell, left, right) = arms();
        let beside = Pose::xyz(0.0, 0.05, 0.0);
        let follow = right.follow(&left.centre().pose(beside)).begin().unwrap();
        assert_eq!(follow.wait(), Ok(Outcome::Maintaining));
        let start = flange(&left);
        let there = left.lin(Pose::xyz(0.0, 0.1, 0.1) * start).speed(0.5);
        let there = there.begin().unwrap();
        let mut most: f64 = 0.0;
        while there.outcome().is_none() {
            let goal = flange(&left) * beside;
            most = most.max(distance(&goal, &flange(&right)));
        }
        assert_eq!(there.wait(), Ok(Outcome::Completed));
        // Both are read one after the other, while they move at up to 0.125 m/s.
        assert!(most < 0.02, "{most} m");
        std::thread::sleep(Duration::from_millis(300));
        let end = distance(&(flange(&left) * beside), &flange(&right));
        assert!(end < 1e-4, "{end} m");
        // A motion takes over.
        assert_eq!(right.ptp(BENT).run(), Ok(Outcome::Completed));
        assert_eq!(follow.wait_to_end(), Ok(Outcome::TakenOver));
        cell.close().unwrap();
    });
}

#[test]
fn follow_expression_ends_by_condition() {
    steady(|| {
        let (cell, left, right) = arms();
        let start = flange(&right);
        let [x, y, z] = start.position();
        let turned = MovingFrame::of(
            [x.into(), left.joint(0) * 0.2 + y, z.into()],
            [0.0.into(), 0.0.into(), 0.0.into()],
        );
        let offset = Pose::quaternion([0.0; 3], start.orientation());
        let far = left.joint(0).over(0.5);
        let follow = right.follow(&turned.pose(offset)).until("far", far);
        let follow = follow.begin().unwrap();
        let mut goal = BENT;
        goal[0] = 0.8;
        assert_eq!(left.ptp(goal).speed(0.3).run(), Ok(Outcome::Completed));
        let ended = follow.wait_to_end_for(TIMEOUT).unwrap();
        assert_eq!(ended, Ok(Outcome::Stopped("far".to_owned())));
        let [at_x, at_y, _] = flange(&right).position();
        assert!((at_x - x).abs() < 1e-3, "{at_x}");
        assert!((at_y - y - 0.1).abs() < 0.01, "{at_y} {y}");
        cell.close().unwrap();
    });
}

#[test]
fn follow_out_of_reach_fails_at_rest() {
    steady(|| {
        let (cell, left, right) = arms();
        let far = left.centre().pose(Pose::xyz(2.0, 0.0, 0.0));
        let error = right.follow(&far).run().unwrap_err().kind;
        assert!(matches!(error, ErrorKind::Unreachable { .. }), "{error}");
        let rest = right.commanded().unwrap();
        std::thread::sleep(Duration::from_millis(100));
        let after = right.commanded().unwrap();
        let moved = after.iter().zip(&rest).map(|(a, b)| (a - b).abs());
        assert!(moved.fold(0.0, f64::max) < 1e-6, "{rest:?} {after:?}");
        let joints = &right.description().joints;
        let in_range = rest.iter().zip(joints);
        for (q, limits) in in_range {
            assert!((limits.position_min..=limits.position_max).contains(q));
        }
        assert_eq!(right.ptp(BENT).run(), Ok(Outcome::Completed));
        cell.close().unwrap();
    });
}

#[test]
fn follow_unknown_or_own_frame_is_refused() {
    steady(|| {
        let (cell, left, right) = arms();
        let own = left.follow(&left.centre()).run().unwrap_err().kind;
        assert!(matches!(own, ErrorKind::Invalid(_)), "{own}");
        let never = Number::from(-1.0).sqrt();
        let zero = || Number::from(0.0);
        let never = MovingFrame::of([never, zero(), zero()], [zero(), zero(), zero()]);
        let error = right.follow(&never).run().unwrap_err().kind;
        assert!(matches!(error, ErrorKind::DeviceFailed { .. }), "{error}");
        assert!(error.to_string().contains("not known"), "{error}");
        cell.close().unwrap();
    });
}

#[test]
fn follow_and_stream_stand_still_at_zero_override() {
    steady(|| {
        let (cell, left, right) = arms();
        cell.set_override(0.0).unwrap();
        let follow = right
            .follow(&left.centre().pose(Pose::xyz(0.0, 0.1, 0.0)))
            .begin()
            .unwrap();
        let stream = left.stream().begin().unwrap();
        let mut goal = BENT;
        goal[0] = 0.2;
        stream.send(goal).unwrap();
        std::thread::sleep(Duration::from_millis(300));
        let near = |arm: &Arm| {
            let at = arm.commanded().unwrap();
            at.iter()
                .zip(BENT)
                .all(|(at, bent)| (at - bent).abs() < 1e-6)
        };
        assert!(near(&left) && near(&right), "the override is 0");
        cell.set_override(0.5).unwrap();
        assert_eq!(follow.wait_for(TIMEOUT).unwrap(), Ok(Outcome::Maintaining));
        stream.cancel();
        assert_eq!(stream.wait(), Ok(Outcome::Cancelled));
        cell.close().unwrap();
    });
}
