//! Messages, tokens and attachments of ROS 2, fed with bytes from a seeded generator: a short run of what `cargo fuzz` does for
//! hours. The target panics if a property is violated.

use takt_fleet::ros::fuzz;
use takt_fleet::ros::messages::{FollowGoal, Point, Trajectory};
use takt_tests::fuzz::{feed, feed_files};

/// A goal with two points.
fn goal() -> Vec<u8> {
    let point = |time| Point {
        positions: vec![0.5],
        velocities: vec![0.0],
        time,
        ..Point::default()
    };
    let trajectory = Trajectory {
        stamp: 0,
        joints: vec!["a".to_owned()],
        points: vec![point(0), point(1_000_000_000)],
    };
    let goal = FollowGoal {
        trajectory,
        ..FollowGoal::default()
    };
    goal.encode()
}

#[test]
fn ros_messages_stand_random_input() {
    let words: [&[u8]; 7] = [
        &[0, 1, 0, 0],
        &[1, 0, 0, 0],
        &[0; 16],
        &[0, 0, 0, 0, 0, 0, 0xf0, 0x7f],
        &[2, 0, 0, 0, b'a', 0, 0, 0],
        b"@ros2_lv/0/aa/0/1/SC/%/%/n/%t/T/H/::,10:,:,:,,",
        &[0xff; 8],
    ];
    feed("ros", fuzz, &words, 10_000);
}

#[test]
fn ros_goals_stand_damage() {
    let goal = goal();
    feed_files("ros_goals", fuzz, &[&goal], 10_000);
}
