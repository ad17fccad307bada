//! Jogging and streamed goals on emulated arms.

use std::time::Duration;

use takt_api::{Cell, ErrorKind, Outcome, Pose, Twist};
use takt_tests::steady;

const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
const PAUSE: Duration = Duration::from_millis(20);

fn near(a: &[f64], b: &[f64], tolerance: f64) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance)
}

#[test]
fn jog_moves_while_sent_and_rests_after() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let arm = cell.arm("left").unwrap();
        assert_eq!(arm.ptp(BENT).run(), Ok(Outcome::Completed));
        let start = arm.pose().unwrap().position();
        let jog = arm.jog().begin().unwrap();
        for _ in 0..25 {
            jog.send(Twist::xyz(0.0, 0.0, 0.1)).unwrap();
            std::thread::sleep(PAUSE);
        }
        let refused = jog.send(Twist::xyz(f64::NAN, 0.0, 0.0)).unwrap_err();
        assert!(matches!(refused.kind, ErrorKind::Invalid(_)), "{refused}");
        std::thread::sleep(Duration::from_millis(800));
        let rest = arm.commanded().unwrap();
        std::thread::sleep(Duration::from_millis(100));
        assert!(near(&arm.commanded().unwrap(), &rest, 1e-9), "it rests");
        let at = arm.pose().unwrap().position();
        assert!(at[2] > start[2] + 0.02, "{start:?} {at:?}");
        assert!(near(&at[..2], &start[..2], 1e-3), "{start:?} {at:?}");
        jog.cancel();
        assert_eq!(jog.wait(), Ok(Outcome::Cancelled));
        let ended = jog.send(Twist::default()).unwrap_err();
        assert!(matches!(ended.kind, ErrorKind::Ended { .. }), "{ended}");
    });
}

#[test]
fn jogged_joint_rests_within_its_range() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let arm = cell.arm("left").unwrap();
        let limits = arm.description().joints[6];
        let mut near_end = BENT;
        near_end[6] = limits.position_max - 0.1;
        assert_eq!(arm.ptp(near_end).run(), Ok(Outcome::Completed));
        let jog = arm.jog_joints().begin().unwrap();
        let mut velocities = [0.0; 7];
        velocities[6] = limits.velocity;
        for _ in 0..50 {
            jog.send(velocities).unwrap();
            std::thread::sleep(PAUSE);
        }
        let at = arm.commanded().unwrap()[6];
        assert!(
            at <= limits.position_max && at > limits.position_max - 0.05,
            "{at}"
        );
        jog.cancel();
        assert_eq!(jog.wait(), Ok(Outcome::Cancelled));
    });
}

#[test]
fn streamed_goals_are_followed_by_one_net() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let arm = cell.arm("left").unwrap();
        assert_eq!(arm.ptp(BENT).run(), Ok(Outcome::Completed));
        let stream = arm.stream().begin().unwrap();
        assert!(near(&arm.commanded().unwrap(), &BENT, 1e-5), "no goal yet");
        let mut goal = BENT;
        for _ in 0..20 {
            goal[0] += 0.01;
            stream.send(goal).unwrap();
            std::thread::sleep(PAUSE);
        }
        while !near(&arm.commanded().unwrap(), &goal, 1e-5) && stream.outcome().is_none() {
            std::thread::sleep(PAUSE);
        }
        goal[0] = 9.0;
        let refused = stream.send(goal).unwrap_err();
        assert!(matches!(refused.kind, ErrorKind::Limit { .. }), "{refused}");
        // Another activity takes over in the next cycle.
        let poses = arm.stream_poses().now().begin().unwrap();
        assert_eq!(stream.wait(), Ok(Outcome::TakenOver));
        let start = arm.pose().unwrap();
        let to = Pose::xyz(0.0, 0.0, 0.05) * start;
        poses.send(to).unwrap();
        let height = |pose: &Pose| pose.position()[2];
        while (height(&arm.pose().unwrap()) - height(&to)).abs() > 1e-3 && poses.outcome().is_none()
        {
            std::thread::sleep(PAUSE);
        }
        let far = poses.send(Pose::xyz(5.0, 0.0, 0.0)).unwrap_err();
        assert!(matches!(far.kind, ErrorKind::Unreachable { .. }), "{far}");
        poses.cancel();
        assert_eq!(poses.wait(), Ok(Outcome::Cancelled));
    });
}
