//! Activities that are prepared beforehand: begun with one request, refused where they no longer fit, and given back.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests and their helpers fail by panicking"
)]

use takt_api::{Arm, Cell, ErrorKind, Outcome, Pose, together};
use takt_client::Client;
use takt_embedded::Embedded;
use takt_tests::steady;

const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];

fn aside(first: f64) -> [f64; 7] {
    let mut goal = BENT;
    goal[0] = first;
    goal
}

/// A controller with the emulated arms `left` and `right`, and a program whose left arm is bent.
fn bench() -> (Embedded, Cell, Arm) {
    let embedded = Embedded::emulated("two_lwr").unwrap();
    let cell = Cell::connect_with(&embedded.address().to_string(), embedded.token()).unwrap();
    let left = cell.arm("left").unwrap();
    assert_eq!(left.ptp(BENT).run(), Ok(Outcome::Completed));
    (embedded, cell, left)
}

fn nets(embedded: &Embedded) -> usize {
    embedded.controller().unwrap().nets().len()
}

/// Waits until the controller has this number of nets: they are unloaded after the end of their activities.
fn wait_for_nets(embedded: &Embedded, count: usize) {
    for _ in 0..2000 {
        if nets(embedded) == count {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    panic!("{} nets, not {count}", nets(embedded));
}

#[test]
fn prepared_motions_begin_once_in_any_order() {
    steady(|| {
        let (embedded, cell, left) = bench();
        wait_for_nets(&embedded, 0);
        let there = left.ptp(aside(0.1)).prepare().unwrap();
        let back = left.ptp(BENT).prepare().unwrap();
        assert_eq!(nets(&embedded), 2, "loaded, and nothing moves");
        assert!(left.commanded().unwrap()[0].abs() < 1e-6);
        assert_eq!(there.run(), Ok(Outcome::Completed));
        assert!((left.commanded().unwrap()[0] - 0.1).abs() < 1e-6);
        assert_eq!(back.run(), Ok(Outcome::Completed));
        wait_for_nets(&embedded, 0);
        cell.close().unwrap();
    });
}

#[test]
fn prepared_activities_follow_and_begin_together() {
    steady(|| {
        let (embedded, cell, left) = bench();
        let right = cell.arm("right").unwrap();
        let sequence = left
            .ptp(aside(0.05))
            .then(left.ptp(BENT))
            .prepare()
            .unwrap();
        let both = together([left.ptp(aside(0.1)), right.ptp(BENT)])
            .prepare()
            .unwrap();
        let first = sequence.begin().unwrap();
        // It waits for the sequence.
        let second = both.queue().unwrap();
        assert_eq!(first.wait(), Ok(Outcome::Completed));
        assert_eq!(second.wait(), Ok(Outcome::Completed));
        assert!((left.commanded().unwrap()[0] - 0.1).abs() < 1e-6);
        drop((first, second));
        wait_for_nets(&embedded, 0);
        cell.close().unwrap();
    });
}

#[test]
fn prepared_line_from_elsewhere_is_stale() {
    steady(|| {
        let (embedded, cell, left) = bench();
        let up = Pose::xyz(0.0, 0.0, 0.05) * left.pose().unwrap();
        let fits = left.lin(up).prepare().unwrap();
        let moved = left.lin(up).prepare().unwrap();
        let followed = left.lin(up).prepare().unwrap();
        assert_eq!(
            fits.run(),
            Ok(Outcome::Completed),
            "from where it was prepared"
        );
        let rest = left.commanded().unwrap();
        let error = moved.begin().unwrap_err();
        assert!(
            matches!(&error.kind, ErrorKind::Stale { device, .. } if device == "left"),
            "{error}"
        );
        assert!(error.place.file().ends_with("prepared.rs"), "{error}");
        assert!(
            error.to_string().contains("\nhint: prepare it again"),
            "{error}"
        );
        let away = left.commanded().unwrap().into_iter().zip(&rest);
        assert!(
            away.into_iter()
                .all(|(now, rest)| (now - rest).abs() < 1e-6),
            "nothing moved"
        );
        // What it would follow leaves the arm elsewhere: refused before anything is requested.
        let running = left.ptp(aside(0.3)).speed(0.5).begin().unwrap();
        let error = followed.queue().unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Stale { .. }), "{error}");
        assert_eq!(running.wait(), Ok(Outcome::Completed), "it goes on");
        drop(running);
        wait_for_nets(&embedded, 0);
        cell.close().unwrap();
    });
}

#[test]
fn prepared_net_unloaded_by_another_is_stale() {
    steady(|| {
        let (embedded, cell, left) = bench();
        wait_for_nets(&embedded, 0);
        let prepared = left.ptp(aside(0.1)).prepare().unwrap();
        let [net] = embedded.controller().unwrap().nets()[..] else {
            panic!("one net is loaded");
        };
        let other =
            Client::connect_with(&embedded.address().to_string(), embedded.token()).unwrap();
        other.call("neun", [net.to_string().as_str()]).unwrap();
        // The controller reports it in its own time.
        std::thread::sleep(std::time::Duration::from_millis(200));
        let error = prepared.begin().unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Stale { .. }), "{error}");
        assert_eq!(left.ptp(aside(0.1)).run(), Ok(Outcome::Completed));
        cell.close().unwrap();
    });
}

#[test]
fn prepared_and_dropped_leaves_no_net() {
    steady(|| {
        let (embedded, cell, left) = bench();
        wait_for_nets(&embedded, 0);
        for _ in 0..50 {
            drop(left.ptp(aside(0.1)).prepare().unwrap());
        }
        assert_eq!(nets(&embedded), 0, "unloaded when it is dropped");
        // The second part is rejected: nothing of the first remains.
        let missing = left.joint(9).over(1.0);
        let wrong = left
            .ptp(BENT)
            .then(left.ptp(BENT).until("missing", missing));
        let error = wrong.prepare().unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Rejected(_)), "{error}");
        assert_eq!(nets(&embedded), 0);
        let error = left
            .circ(Pose::xyz(0.3, 0.0, 0.5), Pose::xyz(0.3, 0.1, 0.5))
            .now()
            .prepare()
            .unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Invalid(_)), "{error}");
        cell.close().unwrap();
    });
}

#[test]
fn prepared_motion_keeps_later_override() {
    steady(|| {
        let (_embedded, cell, left) = bench();
        let prepared = left.ptp(aside(0.3)).prepare().unwrap();
        cell.set_override(0.0).unwrap();
        let handle = prepared.begin().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(300));
        assert_eq!(handle.outcome(), None, "it stands still on its path");
        assert!(left.commanded().unwrap()[0] < 0.01);
        cell.set_override(1.0).unwrap();
        assert_eq!(handle.wait(), Ok(Outcome::Completed));
        cell.close().unwrap();
    });
}
