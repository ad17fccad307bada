//! Activities that are begun in one call: sequences, alternatives, events and conditions, decided by the controller.

mod robotics;

use std::time::Duration;

use robotics::{BENT, Bench};
use takt_api::{ErrorKind, Event, Outcome, either, together, when};
use takt_tests::steady;

fn turned(by: f64) -> [f64; 7] {
    let mut goal = BENT;
    goal[0] = by;
    goal
}

#[test]
fn sequence_ends_at_its_last_goal() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, right) = bench.arms();
        let sequence = left
            .ptp(turned(0.2))
            .blend(0.5)
            .then(left.ptp(turned(0.1)))
            .then(together([left.ptp(BENT), right.ptp(turned(0.1))]));
        assert_eq!(sequence.run(), Ok(Outcome::Completed));
        assert!(left.commanded().unwrap()[0].abs() < 1e-9);
        assert!((right.commanded().unwrap()[0] - 0.1).abs() < 1e-9);
    });
}

#[test]
fn sequence_with_an_invalid_part_moves_nothing() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let loaded = bench.nets();
        let sequence = left.ptp(turned(0.2)).then(left.ptp(turned(3.0)));
        assert!(matches!(
            sequence.run().unwrap_err().kind,
            ErrorKind::Limit { .. }
        ));
        let unknown = left.ptp(BENT).until("x", left.input(4000));
        let error = left.ptp(turned(0.2)).then(unknown).run().unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Rejected(_)), "{error}");
        assert_eq!(left.commanded().unwrap(), BENT);
        assert_eq!(bench.nets(), loaded);
    });
}

#[test]
fn stopped_motion_starts_the_successor_of_its_condition() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let motion = || {
            left.ptp(turned(1.0))
                .until("far", left.joint(0).over(0.3))
                .on(Event::Completed, left.ptp(turned(0.9)))
        };
        let back = motion().on(Event::Stopped("far".to_owned()), left.ptp(BENT));
        assert_eq!(back.run(), Ok(Outcome::Completed));
        assert!(left.commanded().unwrap()[0].abs() < 1e-9);
        // Without a successor for what occurs, the outcome is that of the motion itself.
        let stopped = motion().run().unwrap();
        assert!(stopped.is_stopped_by("far"), "{stopped:?}");
        let next = left.ptp(BENT).run();
        assert_eq!(next, Ok(Outcome::Completed));
    });
}

#[test]
fn progress_of_one_arm_starts_the_other() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, right) = bench.arms();
        let both = left
            .ptp(turned(1.0))
            .speed(0.5)
            .on(Event::Progress(0.5), right.ptp(turned(0.1)))
            .begin()
            .unwrap();
        assert!(right.commanded().unwrap()[0].abs() < 1e-9);
        assert_eq!(both.wait(), Ok(Outcome::Completed));
        assert!((right.commanded().unwrap()[0] - 0.1).abs() < 1e-9);
    });
}

#[test]
fn condition_starts_an_arm_and_chooses_between_two_motions() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, right) = bench.arms();
        let far = left.joint(0).over(0.3);
        let waiting = when(far.clone()).start(right.ptp(turned(0.1))).begin();
        let waiting = waiting.unwrap();
        assert_eq!(waiting.wait_for(Duration::from_millis(50)), None);
        assert_eq!(left.ptp(turned(0.5)).run(), Ok(Outcome::Completed));
        assert_eq!(waiting.wait(), Ok(Outcome::Completed));
        assert!((right.commanded().unwrap()[0] - 0.1).abs() < 1e-9);
        for (limit, goal) in [(0.3, 0.2), (0.7, -0.2)] {
            let is_far = left.joint(0).over(limit);
            let chosen = when(is_far).choose(right.ptp(turned(0.2)), right.ptp(turned(-0.2)));
            assert_eq!(chosen.run(), Ok(Outcome::Completed));
            assert!((right.commanded().unwrap()[0] - goal).abs() < 1e-9);
        }
    });
}

#[test]
fn alternative_runs_if_the_first_is_impossible() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, right) = bench.arms();
        let unknown = left.ptp(BENT).until("x", left.input(4000));
        let first = either([left.ptp(turned(3.0)), unknown, right.ptp(turned(0.1))]);
        assert_eq!(first.run(), Ok(Outcome::Completed));
        assert!((right.commanded().unwrap()[0] - 0.1).abs() < 1e-9);
        let second = either([left.ptp(turned(0.1)), right.ptp(BENT)]);
        assert_eq!(second.run(), Ok(Outcome::Completed));
        assert!(
            (right.commanded().unwrap()[0] - 0.1).abs() < 1e-9,
            "skipped"
        );
        let error = either([left.ptp(turned(3.0)), left.ptp(turned(4.0))]).run();
        assert!(
            matches!(&error, Err(error) if matches!(error.kind, ErrorKind::Limit { .. })),
            "{error:?}"
        );
    });
}

#[test]
fn recovery_follows_a_cancelled_motion() {
    steady(|| {
        let bench = Bench::start();
        let (_cell, left, _) = bench.arms();
        let motion = left.ptp(turned(1.5)).speed(0.3).begin().unwrap();
        let recovery = left.ptp(BENT).after_failure().queue().unwrap();
        motion.cancel();
        assert_eq!(motion.wait(), Ok(Outcome::Cancelled));
        assert_eq!(recovery.wait(), Ok(Outcome::Completed));
        assert!(left.commanded().unwrap()[0].abs() < 1e-9);
        assert_eq!(bench.nets(), 0);
    });
}
