//! Messages that were written are read again, cut or changed ones are refused; published ones have the bytes
//! that rosbags writes. Nothing is sent here.

use super::*;
use crate::ros::types;

fn point(time: Nanos) -> Point {
    Point {
        positions: vec![0.1, -0.2],
        velocities: vec![0.3, 0.0],
        accelerations: vec![],
        effort: vec![1.0],
        time,
    }
}

fn goal() -> FollowGoal {
    FollowGoal {
        id: [7; 16],
        trajectory: Trajectory {
            stamp: 1_700_000_000_000_000_005,
            joints: vec!["a".to_owned(), "joint_b".to_owned()],
            points: vec![point(1), point(2_500_000_000)],
        },
        multi_dof: 0,
        path: vec![Tolerance {
            joint: "a".to_owned(),
            position: 0.1,
            velocity: -1.0,
            acceleration: 0.0,
        }],
        goal: vec![],
        goal_time: -1,
    }
}

#[test]
fn goal_is_read_as_written() {
    let bytes = goal().encode();
    assert_eq!(FollowGoal::decode(&bytes), Ok(goal()));
    for end in 0..bytes.len() {
        assert!(FollowGoal::decode(&bytes[..end]).is_err(), "{end} bytes");
    }
}

#[test]
fn goal_with_million_points_is_refused() {
    let mut cdr = Cdr::default();
    cdr.begin().octets(&[0; 16]);
    write_header(&mut cdr, 0, "").count(0).count(1_000_000);
    let mut bytes = cdr.bytes().to_vec();
    bytes.resize(4 << 20, 0);
    let error = FollowGoal::decode(&bytes).unwrap_err();
    assert_eq!(
        error.to_string(),
        "points: 1000000, and at most 10000 are read"
    );
}

#[test]
fn times_keep_their_sign_and_range() {
    for value in [0, 1, -1, SECOND, -SECOND - 1, 1_700_000_000_123_456_789] {
        let mut cdr = Cdr::default();
        write_time(cdr.begin(), value);
        let mut reader = Reader::new(cdr.bytes()).unwrap();
        assert_eq!(time(&mut reader), Ok(value));
    }
    let mut cdr = Cdr::default();
    cdr.begin().i32(0).u32(1_000_000_000);
    let mut reader = Reader::new(cdr.bytes()).unwrap();
    assert!(time(&mut reader).is_err());
}

#[test]
fn short_requests_are_read() {
    let mut cdr = Cdr::default();
    write_time(cdr.begin().octets(&[3; 16]), 5);
    assert_eq!(decode_cancel(cdr.bytes()), Ok(([3; 16], 5)));
    assert_eq!(decode_get_result(&cdr.bytes()[..20]), Ok([3; 16]));
    assert!(decode_get_result(cdr.bytes()).is_err());
    cdr.begin().bool(true);
    assert_eq!(decode_set_bool(cdr.bytes()), Ok(true));
    cdr.begin().u8(2);
    assert!(decode_set_bool(cdr.bytes()).is_err());
    cdr.begin().octets(&[1; 16]).f64(0.04).f64(20.0);
    let gripper = GripperGoal::decode(cdr.bytes()).unwrap();
    assert_eq!(gripper.position.to_bits(), 0.04_f64.to_bits());
}

#[test]
fn parallel_gripper_goal_has_one_position() {
    for positions in [0, 1, 2] {
        let mut cdr = Cdr::default();
        cdr.begin().octets(&[1; 16]);
        write_header(&mut cdr, 0, "").texts(&["finger".to_owned()]);
        cdr.numbers((0..positions).map(f64::from))
            .numbers([].into_iter())
            .numbers([3.0].into_iter());
        let goal = GripperGoal::decode_parallel(cdr.bytes());
        assert_eq!(goal.is_ok(), positions == 1, "{goal:?}");
    }
}

/// Types, hashes and bytes of messages as rosbags writes them; the Python tests compare them with rosbags.
const ROSBAGS: &str = include_str!("../../../tests/ros2/rosbags.txt");

#[test]
fn messages_have_bytes_and_hashes_of_rosbags() {
    let stamp = 1_700_000_000_123_456_789;
    let names = ["a1".to_owned(), "joint_2".to_owned()];
    let place = Transform {
        parent: "world".to_owned(),
        child: "left/base".to_owned(),
        position: [0.1, 0.2, 0.3],
        rotation: [0.0, 0.6, 0.0, 0.8],
    };
    let status = Status {
        level: Level::Error,
        name: "left".to_owned(),
        message: "offline".to_owned(),
        hardware: "KUKA LWR".to_owned(),
        values: vec![("lost".to_owned(), "7".to_owned())],
    };
    let states = [&[0.5, -1.25][..], &[0.0, 1e-3], &[10.0, 20.0]];
    let own = [
        (types::STRING, string("<robot/>")),
        (types::JOINT_STATE, joint_state(stamp, &names, states)),
        (
            types::WRENCH_STAMPED,
            wrench(stamp, "left/flange", [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        ),
        (types::TF_MESSAGE, transforms(stamp, &[place])),
        (types::DIAGNOSTIC_ARRAY, diagnostics(stamp, &[status])),
        (
            types::GOAL_STATUS_ARRAY,
            goal_statuses(&[([9; 16], stamp, 4)]),
        ),
    ];
    let own = own.map(|(ty, bytes)| {
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        format!("{} {} {hex}", ty.name, ty.hash)
    });
    let golden: Vec<_> = ROSBAGS.lines().collect();
    assert_eq!(own.to_vec(), golden);
}
