//! Goals that are refused, each with its code and cause.

use super::*;

const NOW: Nanos = 1_700_000_000_000_000_000;

fn joints() -> Vec<String> {
    ["a", "b"].map(str::to_owned).into()
}

fn point(time_s: f64, positions: [f64; 2]) -> Point {
    #[expect(clippy::cast_possible_truncation, reason = "small")]
    let time = (time_s * 1e9) as i64;
    Point {
        positions: positions.into(),
        velocities: vec![0.0; 2],
        time,
        ..Point::default()
    }
}

fn goal() -> FollowGoal {
    FollowGoal {
        trajectory: Trajectory {
            stamp: 0,
            joints: joints(),
            points: vec![point(0.0, [0.0, 1.0]), point(1.0, [0.5, 1.5])],
        },
        ..FollowGoal::default()
    }
}

fn refused(change: impl FnOnce(&mut FollowGoal)) -> (i32, String) {
    let mut goal = goal();
    change(&mut goal);
    let error = check(&goal, &joints(), NOW).unwrap_err();
    (error.code, error.text)
}

#[test]
fn goal_with_names_in_any_order_is_sorted() {
    let mut other = goal();
    other.trajectory.joints.reverse();
    for point in &mut other.trajectory.points {
        point.positions.reverse();
    }
    other.path = vec![Tolerance {
        joint: "b".to_owned(),
        position: 0.1,
        ..Tolerance::default()
    }];
    let checked = check(&other, &joints(), NOW).unwrap();
    assert_eq!(checked.points, goal().trajectory.points);
    assert_eq!(checked.path, [Allowed::Default, Allowed::Most(0.1)]);
    assert_eq!((checked.delay, checked.goal_time), (0, None));
}

#[test]
fn goal_with_other_joints_is_refused() {
    let names = |names: &'static [&str]| {
        refused(|goal| goal.trajectory.joints = names.iter().map(|it| (*it).to_owned()).collect())
    };
    let (code, text) = names(&["a", "x"]);
    assert_eq!(code, code::INVALID_JOINTS);
    assert_eq!(text, "joint `x` is none of this arm, which has a, b");
    assert_eq!(names(&["a"]), (-2, "joint `b` is missing".to_owned()));
    let twice = names(&["a", "b", "b"]);
    assert_eq!(twice, (-2, "joint `b` is named more than once".to_owned()));
    let (code, _) = refused(|goal| {
        goal.goal = vec![Tolerance {
            joint: "x".to_owned(),
            ..Tolerance::default()
        }];
    });
    assert_eq!(code, code::INVALID_JOINTS);
}

#[test]
fn goal_with_times_out_of_order_is_refused() {
    for time in [0, -5] {
        let (code, text) = refused(|goal| goal.trajectory.points[1].time = time);
        assert_eq!(code, code::INVALID_GOAL);
        assert!(text.contains("point 1"), "{text}");
    }
    let (_, text) = refused(|goal| goal.trajectory.points[0].time = -1);
    assert!(text.contains("point 0"), "{text}");
    let (_, text) = refused(|goal| goal.trajectory.points[1].time = DURATION_MAX + 1);
    assert!(text.contains("3600 s"), "{text}");
}

#[test]
fn goal_in_past_is_refused_as_old() {
    let at = |stamp| {
        let mut goal = goal();
        goal.trajectory.stamp = stamp;
        check(&goal, &joints(), NOW).map(|it| it.delay)
    };
    assert_eq!(at(NOW + 5), Ok(5));
    assert_eq!(at(NOW - LATE_MAX), Ok(0));
    let old = at(NOW - LATE_MAX - 1).unwrap_err();
    assert_eq!(old.code, code::OLD_HEADER_TIMESTAMP);
    assert_eq!(at(1).unwrap_err().code, code::OLD_HEADER_TIMESTAMP);
    assert_eq!(at(NOW + AHEAD_MAX + 1).unwrap_err().code, -1);
    assert_eq!(at(i64::MIN).unwrap_err().code, code::OLD_HEADER_TIMESTAMP);
}

#[test]
fn goal_with_wrong_lists_or_numbers_is_refused() {
    let wrong: [fn(&mut FollowGoal); 9] = [
        |it| it.trajectory.points.clear(),
        |it| it.trajectory.points[1].positions.truncate(1),
        |it| it.trajectory.points[1].velocities.clear(),
        |it| it.trajectory.points[1].accelerations = vec![0.0; 2],
        |it| it.trajectory.points[1].positions[0] = f64::NAN,
        |it| it.trajectory.points[0].velocities[1] = f64::INFINITY,
        |it| it.trajectory.points[0].effort = vec![1.0],
        |it| it.trajectory.points[1].velocities[0] = 0.1,
        |it| it.multi_dof = 1,
    ];
    for (number, change) in wrong.into_iter().enumerate() {
        assert_eq!(refused(change).0, code::INVALID_GOAL, "case {number}");
    }
}

#[test]
fn tolerances_of_0_are_default_and_below_are_none() {
    let of = |position, velocity| {
        let mut goal = goal();
        goal.goal = vec![Tolerance {
            joint: "a".to_owned(),
            position,
            velocity,
            acceleration: 0.0,
        }];
        check(&goal, &joints(), NOW).map(|it| it.goal[0])
    };
    assert_eq!(of(0.0, 0.0), Ok(Allowed::Default));
    assert_eq!(of(-1.0, -1.0), Ok(Allowed::Any));
    assert_eq!(of(0.2, 0.0), Ok(Allowed::Most(0.2)));
    assert!(of(f64::NAN, 0.0).is_err());
    assert!(of(0.2, 0.1).is_err());
}
