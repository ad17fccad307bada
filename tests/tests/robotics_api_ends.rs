//! Speed of all activities, present values, and activities that are cancelled, aborted or lost at random instants.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod robotics;

use std::time::{Duration, Instant};

use robotics::{BENT, Bench};
use takt_api::{ErrorKind, Handle, Outcome};
use takt_tests::steady;

fn turned(by: f64) -> [f64; 7] {
    let mut goal = BENT;
    goal[0] = by;
    goal
}

#[test]
fn override_halts_and_releases_running_and_new_motions() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left, right) = bench.arms();
        let motion = left.ptp(turned(1.0)).begin().unwrap();
        cell.set_override(0.0).unwrap();
        assert_eq!(motion.wait_for(Duration::from_millis(1500)), None);
        let other = right.ptp(turned(0.2)).begin().unwrap();
        assert_eq!(other.wait_for(Duration::from_millis(300)), None);
        assert!(right.commanded().unwrap()[0].abs() < 1e-9, "never moved");
        cell.set_override(1.0).unwrap();
        assert_eq!(motion.wait(), Ok(Outcome::Completed));
        assert_eq!(other.wait(), Ok(Outcome::Completed));
        for wrong in [-0.1, 1.1, f64::NAN] {
            let error = cell.set_override(wrong).unwrap_err();
            assert!(matches!(error.kind, ErrorKind::Invalid(_)), "{error}");
        }
        assert!((cell.override_factor() - 1.0).abs() < 1e-9);
    });
}

#[test]
fn present_values_are_evaluated_once() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left, _) = bench.arms();
        let elbow = left.joint(3);
        let value = cell.value(&(elbow.clone() * 2.0)).unwrap().unwrap();
        assert!((value + 2.4).abs() < 1e-6, "{value}");
        assert!(cell.holds(&elbow.clone().under(-1.0)).unwrap());
        let near = |number: &takt_api::Number, expected: f64| {
            let value = cell.value(number).unwrap().unwrap();
            assert!((value - expected).abs() < 1e-6, "{value} is not {expected}");
        };
        near(&elbow.clone().abs().sqrt(), 1.2_f64.sqrt());
        near(&elbow.clone().sin().asin(), -1.2);
        near(&elbow.clone().cos().acos(), 1.2);
        near(&elbow.clone().tan(), (-1.2_f64).tan());
        near(&elbow.clone().average(Duration::from_secs(1)), -1.2);
        near(&elbow.clone().max(0.5).min(0.4), 0.4);
        // A root that does not exist is neither more nor less than anything.
        let root = elbow.clone().sqrt();
        assert!(!cell.holds(&root.clone().over(-9.0)).unwrap());
        assert!(!cell.holds(&root.under(9.0)).unwrap());
        assert!(cell.holds(&elbow.clone().under(-1.0).rises()).unwrap());
        assert!(!cell.holds(&elbow.clone().under(-1.0).falls()).unwrap());
        assert!(!cell.holds(&elbow.over(-1.0)).unwrap());
        let error = cell.holds(&left.input(4000)).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Refused(_)), "{error}");
        assert_eq!(bench.nets(), 0);
    });
}

/// Numbers from 0 to below `bound` that differ from call to call.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self, bound: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 33) % bound
    }
}

#[test]
fn chain_ended_at_random_instants_leaves_nothing() {
    steady(|| {
        let bench = Bench::start();
        drop(bench.arms());
        let mut numbers = Numbers(7);
        for round in 0..24 {
            let cell = bench.cell();
            let left = cell.arm("left").unwrap();
            let goals = [0.1, 0.0, 0.1, 0.0, 0.1, 0.0];
            let chain: Result<Vec<Handle>, _> = goals
                .iter()
                .map(|goal| left.ptp(turned(*goal)).blend(0.5).queue())
                .collect();
            let chain = chain.unwrap();
            std::thread::sleep(Duration::from_millis(numbers.next(600)));
            let at = usize::try_from(numbers.next(6)).unwrap();
            match round % 4 {
                0 => left.cancel(),
                1 => chain[at].cancel(),
                2 => {
                    let ids = bench.controller.nets();
                    ids.into_iter()
                        .for_each(|id| drop(bench.controller.abort(id)));
                }
                _ => {
                    // The program ends, and its controller ends what it began.
                    drop((chain, left, cell));
                    end_of(&bench, round);
                    continue;
                }
            }
            for (number, handle) in chain.iter().enumerate() {
                let ended = handle.wait_for(Duration::from_secs(20));
                assert!(ended.is_some(), "round {round}: activity {number} goes on");
            }
            drop(chain);
            end_of(&bench, round);
        }
    });
}

/// Nothing stays loaded, the arm is in its range, and another program can move it.
fn end_of(bench: &Bench, round: u32) {
    let begun = Instant::now();
    while bench.nets() > 0 && begun.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(bench.nets(), 0, "round {round}");
    let cell = bench.cell();
    let left = cell.arm("left").unwrap();
    let positions = left.commanded().unwrap();
    let is_inside = positions.iter().all(|position| position.abs() < 2.9);
    assert!(is_inside, "round {round}: {positions:?}");
    assert_eq!(
        left.ptp(BENT).run(),
        Ok(Outcome::Completed),
        "round {round}"
    );
}
