//! Speed of all activities, and present values.

mod robotics;

use std::time::Duration;

use robotics::{BENT, Bench};
use takt_api::{ErrorKind, Outcome};
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
