//! Listeners on an emulated cell: what changes is reported, and a callback disturbs nothing but itself.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests and their helpers fail by panicking"
)]

use std::sync::mpsc::channel;
use std::time::Duration;

use takt_api::{Arm, Cell, ErrorKind, Listener, Outcome};
use takt_embedded::Embedded;
use takt_tests::steady;

const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
const TURNED: [f64; 7] = [0.4, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
/// Longer than anything takes that a test waits for.
const LONG: Duration = Duration::from_secs(20);

fn bench() -> (Embedded, Cell, Arm) {
    let embedded = Embedded::emulated("two_lwr").unwrap();
    let cell = Cell::connect_with(&embedded.address().to_string(), embedded.token()).unwrap();
    let left = cell.arm("left").unwrap();
    assert_eq!(left.ptp(BENT).run(), Ok(Outcome::Completed));
    (embedded, cell, left)
}

fn error_of(listener: &Listener) -> ErrorKind {
    for _ in 0..2000 {
        if let Some(error) = listener.error() {
            return error.kind;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("no error");
}

#[test]
fn listener_reports_changes_until_dropped() {
    steady(|| {
        let (embedded, cell, left) = bench();
        let (sender, seen) = channel();
        let turned = left.joint(0).over(0.2);
        let listener = cell
            .on_change(&turned, move |is| sender.send(is).unwrap())
            .unwrap();
        assert_eq!(seen.recv_timeout(LONG), Ok(false), "the value at the start");
        assert_eq!(left.ptp(TURNED).run(), Ok(Outcome::Completed));
        assert_eq!(seen.recv_timeout(LONG), Ok(true));
        assert!(listener.error().is_none());
        drop(listener);
        assert!(seen.recv_timeout(LONG).is_err(), "its thread has ended");
        let nets = || embedded.controller().unwrap().nets().len();
        for _ in 0..1000 {
            if nets() == 0 {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(nets(), 0, "its net is unloaded");
        cell.close().unwrap();
    });
}

#[test]
fn slow_callback_gets_latest_value_and_delays_no_other() {
    steady(|| {
        let (_embedded, cell, left) = bench();
        let (slow, slow_seen) = channel();
        let (quick, quick_seen) = channel();
        let joint = left.joint(0);
        let sleeps = cell.on_change(&joint, move |value| {
            std::thread::sleep(Duration::from_millis(300));
            slow.send(value).unwrap();
        });
        let counts = cell.on_change(&joint, move |value| quick.send(value).unwrap());
        let (sleeps, counts) = (sleeps.unwrap(), counts.unwrap());
        assert_eq!(left.ptp(TURNED).speed(0.5).run(), Ok(Outcome::Completed));
        let end = left.positions().unwrap()[0];
        let mut calls = 0;
        while slow_seen
            .recv_timeout(LONG)
            .unwrap()
            .is_none_or(|at| (at - end).abs() > 1e-3)
        {
            calls += 1;
        }
        let others = quick_seen.try_iter().count();
        assert!(others > 2 * calls, "{others} and {calls} calls");
        assert!(sleeps.missed() > 0 && sleeps.error().is_none());
        drop((sleeps, counts));
        cell.close().unwrap();
    });
}

#[test]
fn callback_that_panics_ends_its_listener_only() {
    steady(|| {
        let (_embedded, cell, left) = bench();
        let (sender, seen) = channel();
        let wrong = cell.on_change(&left.joint(1), |_| {
            // What a program error does, without its message.
            std::panic::resume_unwind(Box::new("no such tool"));
        });
        let wrong = wrong.unwrap();
        let right = cell.on_change(&left.joint(1), move |at| sender.send(at).unwrap());
        let right = right.unwrap();
        let ErrorKind::Callback(text) = error_of(&wrong) else {
            panic!("{:?}", wrong.error());
        };
        assert_eq!(text, "no such tool");
        assert!(seen.recv_timeout(LONG).unwrap().is_some());
        assert_eq!(
            left.ptp(BENT).run(),
            Ok(Outcome::Completed),
            "the connection goes on"
        );
        assert!(right.error().is_none());
        drop((wrong, right));
        cell.close().unwrap();
    });
}

#[test]
fn listener_may_command_and_drop_itself() {
    steady(|| {
        let (_embedded, cell, left) = bench();
        let (sender, done) = channel();
        let arm = left.clone();
        let turned = left.joint(0).over(0.1);
        let listener = cell
            .on_change(&turned, move |is| {
                if is {
                    arm.cancel();
                    sender.send(()).unwrap();
                }
            })
            .unwrap();
        let outcome = left.ptp(TURNED).speed(0.2).run();
        assert_eq!(outcome, Ok(Outcome::Cancelled));
        done.recv_timeout(LONG).unwrap();
        drop(listener);
        cell.close().unwrap();
    });
}

#[test]
fn listener_ends_with_net_or_connection() {
    steady(|| {
        let (embedded, cell, left) = bench();
        let listener = cell.on_change(&left.joint(0), |_| {}).unwrap();
        let controller = embedded.controller().unwrap();
        for net in controller.nets() {
            controller.abort(net).unwrap();
        }
        assert!(matches!(error_of(&listener), ErrorKind::Ended { .. }));
        let other = cell.on_change(&left.joint(0), |_| {}).unwrap();
        drop(embedded);
        assert!(matches!(
            error_of(&other),
            ErrorKind::Lost(_) | ErrorKind::Ended { .. }
        ));
        let error = cell.on_change(&left.joint(0), |_| {}).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Lost(_)), "{error}");
    });
}
