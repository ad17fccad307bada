//! Programs of the Robotics API against a controller with two simulated arms, over the real line protocol.

mod robotics;

use std::future::{Future, IntoFuture as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};
use std::time::Duration;

use robotics::{BENT, Bench};
use takt_api::{ErrorKind, JointTrajectory, Outcome, Pose, together};
use takt_tests::steady;

fn near(a: &[f64], b: &[f64], tolerance: f64) {
    let far = a
        .iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max);
    assert!(a.len() == b.len() && far <= tolerance, "{a:?} is not {b:?}");
}

#[test]
fn ptp_reaches_its_goal() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        near(&left.commanded().unwrap(), &BENT, 1e-9);
        let mut goal = BENT;
        goal[6] = 0.4;
        assert_eq!(left.ptp(goal).speed(0.5).run(), Ok(Outcome::Completed));
        near(&left.commanded().unwrap(), &goal, 1e-9);
    });
}

#[test]
fn lin_moves_the_flange_to_its_pose() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let start = left.pose().unwrap();
        let [x, y, z] = start.position();
        let goal = Pose::quaternion([x, y + 0.1, z - 0.05], start.orientation());
        assert_eq!(left.lin(goal).run(), Ok(Outcome::Completed));
        near(&left.pose().unwrap().position(), &goal.position(), 1e-4);
        let via = Pose::xyz(x + 0.03, y + 0.05, z);
        assert_eq!(left.circ(via, start).run(), Ok(Outcome::Completed));
        near(&left.pose().unwrap().position(), &start.position(), 1e-4);
    });
}

/// Bent, turned about its base.
fn turned(first: f64) -> [f64; 7] {
    let mut joints = BENT;
    joints[0] = first;
    joints
}

#[test]
fn trajectory_reaches_its_points_and_takes_over_in_motion() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let there = JointTrajectory::new()
            .point(0.5, turned(0.1))
            .point(1.0, turned(0.2))
            .goal_tolerance([0.01], 1.0);
        assert_eq!(left.trajectory(there).run(), Ok(Outcome::Completed));
        near(&left.commanded().unwrap(), &turned(0.2), 1e-9);
        // At half of the speed it takes twice as long.
        let back = JointTrajectory::new().point(0.5, turned(0.0));
        let begin = std::time::Instant::now();
        let slow = left.trajectory(back).speed(0.5);
        assert_eq!(slow.run(), Ok(Outcome::Completed));
        assert!(begin.elapsed() > Duration::from_millis(900));
        // One that comes in motion begins with what is commanded then.
        let far = JointTrajectory::new().point(2.0, turned(1.0));
        let first = left.trajectory(far).begin().unwrap();
        std::thread::sleep(Duration::from_millis(800));
        let back = JointTrajectory::new().point(1.5, turned(0.0));
        assert_eq!(left.trajectory(back).now().run(), Ok(Outcome::Completed));
        assert_eq!(first.wait(), Ok(Outcome::TakenOver));
        near(&left.commanded().unwrap(), &turned(0.0), 1e-9);
    });
}

#[test]
fn trajectory_beyond_limits_or_elsewhere_is_an_error() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let unplanned = |trajectory: JointTrajectory, text: &str| {
            let error = left.trajectory(trajectory).run().unwrap_err();
            assert!(matches!(error.kind, ErrorKind::Unplanned { .. }), "{error}");
            assert!(error.to_string().contains(text), "{error}");
        };
        let fast = JointTrajectory::new().point(0.01, turned(1.0));
        unplanned(fast, "joint 0 at ");
        let elsewhere = JointTrajectory::new()
            .point(0.0, turned(0.5))
            .point(2.0, turned(0.0));
        unplanned(elsewhere, "joint 0 is 0.500 rad from the first point");
        let outside = left.trajectory(JointTrajectory::new().point(9.0, turned(9.0)));
        let error = outside.run().unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Limit { .. }), "{error}");
        near(&left.commanded().unwrap(), &BENT, 1e-9);
    });
}

#[test]
fn motions_blend_one_ahead() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut handles = Vec::new();
        for round in 0..6 {
            let mut goal = BENT;
            goal[0] = if round % 2 == 0 { 0.3 } else { -0.3 };
            goal[5] += 0.05 * f64::from(round);
            handles.push(left.ptp(goal).blend(0.5).begin().unwrap());
        }
        let last = handles.pop().unwrap();
        assert_eq!(last.wait(), Ok(Outcome::Completed));
        let outcomes: Vec<_> = handles
            .iter()
            .map(|handle| handle.wait().unwrap())
            .collect();
        let blended = outcomes
            .iter()
            .filter(|outcome| **outcome == Outcome::TakenOver)
            .count();
        assert!(blended >= 4, "{outcomes:?}");
        left.finish().unwrap();
    });
}

#[test]
fn motion_without_blend_ends_before_its_successor() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut goal = BENT;
        goal[0] = 0.2;
        let first = left.ptp(goal).queue().unwrap();
        let second = left.ptp(BENT).queue().unwrap();
        assert_eq!(second.wait(), Ok(Outcome::Completed));
        assert_eq!(first.wait(), Ok(Outcome::Completed));
        near(&left.commanded().unwrap(), &BENT, 1e-9);
    });
}

#[test]
fn motion_now_replaces_a_running_one() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut far = BENT;
        far[0] = 2.0;
        let first = left.ptp(far).speed(0.3).begin().unwrap();
        assert_eq!(left.ptp(BENT).now().run(), Ok(Outcome::Completed));
        assert_eq!(first.wait(), Ok(Outcome::TakenOver));
        near(&left.commanded().unwrap(), &BENT, 1e-9);
    });
}

#[test]
fn condition_stops_a_motion_and_names_itself() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut far = BENT;
        far[0] = 2.0;
        let passed = left.joint(0).over(0.5);
        let never = left.joint(0).over(5.0).lasting(Duration::from_millis(20));
        let outcome = left
            .ptp(far)
            .until("never", never)
            .until("half", passed)
            .run()
            .unwrap();
        assert!(outcome.is_stopped_by("half"), "{outcome:?}");
        let reached = left.commanded().unwrap()[0];
        assert!((0.5..1.9).contains(&reached), "{reached}");
        assert_eq!(
            left.ptp(BENT).run(),
            Ok(Outcome::Completed),
            "the next motion begins at rest there"
        );
    });
}

#[test]
fn arms_begin_together() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, right) = bench.arms();
        let mut far = BENT;
        far[0] = 1.0;
        let first = left.ptp(far).speed(0.5).begin().unwrap();
        let both = together([left.ptp(BENT), right.ptp(far)]).queue().unwrap();
        assert_eq!(
            right.commanded().unwrap(),
            BENT,
            "the right arm waits for the left"
        );
        assert_eq!(first.wait(), Ok(Outcome::Completed));
        assert_eq!(both.wait(), Ok(Outcome::Completed));
        near(&right.commanded().unwrap(), &far, 1e-9);
    });
}

#[test]
fn cancelled_motion_rests_and_ends_its_queue() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut far = BENT;
        far[0] = 2.5;
        let first = left.ptp(far).speed(0.3).begin().unwrap();
        let second = left.ptp(BENT).queue().unwrap();
        first.cancel();
        assert_eq!(first.wait(), Ok(Outcome::Cancelled));
        assert_eq!(second.wait(), Ok(Outcome::Cancelled));
        let rest = left.commanded().unwrap();
        assert_eq!(left.commanded().unwrap(), rest);
        assert_eq!(left.ptp(BENT).run(), Ok(Outcome::Completed));
    });
}

#[test]
fn wrong_arguments_are_refused_before_anything_moves() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left, right) = bench.arms();
        let loaded = bench.nets();
        let text = |result: Result<_, takt_api::Error>| {
            let text = result.map(drop).unwrap_err().kind.to_string();
            text.split("\nhint: ").next().unwrap().to_owned()
        };
        let error = text(left.ptp([0.0; 6]).begin());
        assert_eq!(error, "left has 7 joints, not 6");
        let error = text(left.ptp([0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0]).begin());
        assert_eq!(
            error,
            "left joint 3: 3.0000 rad is out of its range, -2.9000 to 2.9000 rad"
        );
        let error = text(left.ptp([f64::NAN; 7]).begin());
        assert!(error.starts_with("left joint 0: NaN rad"), "{error}");
        let error = text(left.ptp(BENT).speed(2.0).begin());
        assert_eq!(error, "left: the speed is 2; it is above 0, at most 1");
        let half = left.clone().with_speed(0.5);
        let error = text(half.ptp(BENT).speed(2.0).begin());
        assert_eq!(error, "left: the speed is 2; it is above 0, at most 1");
        let error = text(left.ptp(BENT).blend(1.0).begin());
        assert_eq!(error, "left: blend is 1; it is from 0 to below 1");
        let error = text(left.ptp(BENT).until("a b", left.joint(0).over(1.0)).begin());
        assert!(error.contains("`a b` is no name of a condition"), "{error}");
        let error = text(together([left.ptp(BENT), left.ptp(BENT)]).begin());
        assert!(error.contains("different devices"), "{error}");
        let error = text(left.lin(Pose::xyz(f64::INFINITY, 0.0, 0.0)).begin());
        assert!(error.contains("not finite"), "{error}");
        let error = cell.arm("middle").unwrap_err().kind.to_string();
        assert_eq!(
            error,
            "there is no arm `middle`\nhint: the controller has left, right"
        );
        let error = text(right.ptp(BENT).until("x", left.input(4000)).begin());
        assert!(
            error.starts_with("the controller rejected the net"),
            "{error}"
        );
        assert_eq!(bench.nets(), loaded);
    });
}

#[test]
fn line_out_of_reach_fails_and_leaves_the_arm_usable() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let [x, y, z] = left.pose().unwrap().position();
        let far = left.lin(Pose::xyz(x + 1.0, y, z)).unchecked();
        let error = far.run().unwrap_err();
        // Near the end of its reach the elbow stretches faster than the joints may.
        let named = matches!(
            error.kind,
            ErrorKind::Unreachable { .. } | ErrorKind::DeviceFailed { .. }
        );
        assert!(named, "{error}");
        assert_eq!(
            left.ptp(BENT).run(),
            Ok(Outcome::Completed),
            "the arm can be moved again"
        );
    });
}

#[test]
fn two_programs_on_one_arm_conflict_and_the_first_goes_on() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut far = BENT;
        far[0] = 1.0;
        let first = left.ptp(far).speed(0.5).begin().unwrap();
        let other = bench.cell().arm("left").unwrap();
        let error = other.ptp(BENT).run().unwrap_err();
        let ErrorKind::Conflict {
            device,
            joint,
            holder: Some(holder),
        } = &error.kind
        else {
            panic!("{error}");
        };
        assert_eq!((device.as_str(), *joint), ("left", Some(0)));
        let process = format!("process {}", std::process::id());
        for part in ["net rpinet", "of session s", "robotics_api", &process] {
            assert!(holder.contains(part), "{holder}");
        }
        assert_eq!(first.wait(), Ok(Outcome::Completed));
    });
}

#[test]
fn stop_ends_everything_while_another_thread_plans() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left, right) = bench.arms();
        let mut far = BENT;
        far[0] = 2.0;
        let first = left.ptp(far).speed(0.3).begin().unwrap();
        let waiting = left.ptp(BENT).queue().unwrap();
        let is_over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let planner = scope.spawn(|| {
                let mut plans = 0;
                while !is_over.load(Ordering::Relaxed) {
                    right.ptp(far).plan().unwrap();
                    plans += 1;
                }
                plans
            });
            std::thread::sleep(Duration::from_millis(300));
            cell.stop().unwrap();
            is_over.store(true, Ordering::Relaxed);
            assert!(planner.join().unwrap() > 0);
        });
        assert_eq!(first.outcome(), Some(Ok(Outcome::Cancelled)));
        assert_eq!(waiting.outcome(), Some(Ok(Outcome::Cancelled)));
        let rest = left.commanded().unwrap();
        assert!(rest[0] > 1e-4 && rest[0] < 2.0 - 1e-3, "{rest:?}");
        assert_eq!(left.commanded().unwrap(), rest, "it is at rest");
        assert_eq!(left.ptp(BENT).run(), Ok(Outcome::Completed));
    });
}

#[test]
fn program_that_ends_leaves_no_net() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left, _) = bench.arms();
        let mut far = BENT;
        far[0] = 2.5;
        let handle = left.ptp(far).speed(0.2).begin().unwrap();
        drop((handle, left, cell));
        let begun = std::time::Instant::now();
        while bench.nets() > 0 && begun.elapsed() < Duration::from_secs(20) {
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_eq!(bench.nets(), 0);
    });
}

#[test]
fn closed_cell_is_at_rest() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left, _) = bench.arms();
        let mut far = BENT;
        far[0] = 2.5;
        let handle = left.ptp(far).speed(0.3).begin().unwrap();
        cell.close().unwrap();
        assert_eq!(handle.wait(), Ok(Outcome::Cancelled));
        assert_eq!(bench.nets(), 0);
    });
}

#[test]
fn lost_controller_ends_every_handle() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut far = BENT;
        far[0] = 2.5;
        let handle = left.ptp(far).speed(0.1).begin().unwrap();
        drop(bench);
        let error = handle.wait().unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Lost(_)), "{error}");
        let error = left.ptp(BENT).begin().map(drop).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Lost(_)), "{error}");
    });
}

/// Records that it was woken.
struct Flag(AtomicBool);

impl Wake for Flag {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::SeqCst);
    }
}

#[test]
fn handle_can_be_awaited_on_any_executor() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut goal = BENT;
        goal[0] = 0.3;
        let mut ending = Box::pin(left.ptp(goal).begin().unwrap().into_future());
        let flag = Arc::new(Flag(AtomicBool::new(true)));
        let waker = Waker::from(Arc::clone(&flag));
        let outcome = loop {
            if !flag.0.swap(false, Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(1));
                continue;
            }
            if let Poll::Ready(outcome) = ending.as_mut().poll(&mut Context::from_waker(&waker)) {
                break outcome;
            }
        };
        assert_eq!(outcome, Ok(Outcome::Completed));
    });
}

#[test]
fn long_chain_keeps_few_nets_loaded() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let mut most = 0;
        for round in 0..100 {
            let mut goal = BENT;
            goal[0] = if round % 2 == 0 { 0.02 } else { -0.02 };
            let handle = left.ptp(goal).blend(0.3).begin().unwrap();
            most = most.max(bench.nets());
            drop(handle);
        }
        left.finish().unwrap();
        assert!(most <= 4, "{most}");
    });
}
