//! What programs do wrong, and what happens to them: a typed error with its cause and a hint, the arm at rest within its limits,
//! and the other arm undisturbed. Programs of the same process have connections of their own.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests and their helpers fail by panicking"
)]

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::time::Duration;

use takt_api::{Arm, Cell, Error, ErrorKind, Outcome, Pose, Twist, coupled, deg, together};
use takt_embedded::Embedded;
use takt_tests::steady;

const BENT: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];

/// A controller with the emulated arms `left` and `right`, bent.
struct Bench {
    embedded: Embedded,
}

impl Bench {
    fn start() -> Self {
        let bench = Self {
            embedded: Embedded::emulated("two_lwr").unwrap(),
        };
        let (cell, left) = bench.left();
        let right = cell.arm("right").unwrap();
        let bent = together([left.ptp(BENT), right.ptp(BENT)]).run();
        assert_eq!(bent, Ok(Outcome::Completed));
        cell.close().unwrap();
        bench
    }

    fn address(&self) -> String {
        self.embedded.address().to_string()
    }

    /// A program of its own.
    fn cell(&self) -> Cell {
        self.cell_at(&self.address())
    }

    fn cell_at(&self, address: &str) -> Cell {
        Cell::connect_with(address, self.embedded.token()).unwrap()
    }

    fn left(&self) -> (Cell, Arm) {
        let cell = self.cell();
        let left = cell.arm("left").unwrap();
        (cell, left)
    }
}

/// Waits until an arm rests, and checks that it does so within its limits.
fn rests(arm: &Arm) -> Vec<f64> {
    let mut before = arm.commanded().unwrap();
    for _ in 0..200 {
        std::thread::sleep(Duration::from_millis(50));
        let now = arm.commanded().unwrap();
        let moved = before
            .iter()
            .zip(&now)
            .any(|(from, to)| (from - to).abs() > 1e-9);
        if !moved {
            let limits = &arm.description().joints;
            let is_inside = now
                .iter()
                .zip(limits)
                .all(|(at, joint)| (joint.position_min..=joint.position_max).contains(at));
            assert!(is_inside, "{now:?}");
            return now;
        }
        before = now;
    }
    panic!("it does not come to rest: {before:?}");
}

/// Does something wrong with the left arm of a bench.
type Wrong = fn(&Bench) -> Error;

/// What is wrong, how it is done, the kind of its error, and a part of its text.
type Case = (&'static str, Wrong, fn(&ErrorKind) -> bool, &'static str);

fn begun(bench: &Bench, activity: impl FnOnce(&Arm) -> takt_api::Activity) -> Error {
    let (_cell, left) = bench.left();
    activity(&left).begin().unwrap_err()
}

fn is_invalid(kind: &ErrorKind) -> bool {
    matches!(kind, ErrorKind::Invalid(_))
}

const CASES: &[Case] = &[
    (
        "pose out of reach",
        |bench| begun(bench, |left| left.lin(Pose::xyz(3.0, 0.0, 0.0))),
        |kind| matches!(kind, ErrorKind::Unreachable { device, progress, .. } if device == "left" && *progress > 0.0),
        " % of the motion: ",
    ),
    (
        "pose out of reach for joints",
        |bench| begun(bench, |left| left.ptp_to(Pose::xyz(3.0, 0.0, 0.0))),
        |kind| matches!(kind, ErrorKind::Unreachable { .. }),
        "left: the arm cannot follow",
    ),
    (
        "joint beyond its range, in degrees",
        |bench| {
            begun(bench, |left| {
                left.ptp([0.0, 30.0, 0.0, -70.0, 0.0, 45.0, 0.0])
            })
        },
        |kind| matches!(kind, ErrorKind::Limit { joint, .. } if joint == "left joint 1"),
        "30.0000 rad is out of its range",
    ),
    (
        "wrong joint count",
        |bench| begun(bench, |left| left.ptp([0.0; 6])),
        is_invalid,
        "left has 7 joints, not 6",
    ),
    (
        "NaN as joint position",
        |bench| begun(bench, |left| left.ptp([f64::NAN; 7])),
        |kind| matches!(kind, ErrorKind::Limit { .. }),
        "NaN rad is out of its range",
    ),
    (
        "infinite pose",
        |bench| begun(bench, |left| left.lin(Pose::xyz(f64::INFINITY, 0.0, 0.0))),
        is_invalid,
        "left: the pose is not finite",
    ),
    (
        "NaN in a curve",
        |bench| begun(bench, |left| left.spline([Pose::xyz(0.0, f64::NAN, 0.0)])),
        is_invalid,
        "left: a point of the curve is not finite",
    ),
    (
        "NaN in a tool",
        |bench| {
            begun(bench, |left| {
                let left = left.clone().with_tool(Pose::xyz(f64::NAN, 0.0, 0.0));
                left.lin(Pose::IDENTITY)
            })
        },
        is_invalid,
        "left: the motion centre is not finite",
    ),
    (
        "unknown device",
        |bench| bench.cell().arm("middle").unwrap_err(),
        |kind| matches!(kind, ErrorKind::NoDevice { .. }),
        "there is no arm `middle`",
    ),
    (
        "unknown frame",
        |bench| bench.cell().frame("tabel").unwrap_err(),
        |kind| matches!(kind, ErrorKind::NoDevice { .. }),
        "there is no frame `tabel`",
    ),
    (
        "frames that are not connected",
        |bench| {
            let flange = bench.cell().frame("right.flange").unwrap();
            begun(bench, |left| left.lin(Pose::IDENTITY.in_(&flange)))
        },
        |kind| matches!(kind, ErrorKind::NotConnected { .. }),
        "`right.flange` and `left.base` are not connected",
    ),
    (
        "two programs on one arm",
        |bench| {
            let (first, left) = bench.left();
            let mut far = BENT;
            far[0] = 1.0;
            let running = left.ptp(far).speed(0.2).begin().unwrap();
            let (_second, same) = bench.left();
            let error = same.ptp([0.0; 7]).run().unwrap_err();
            assert_eq!(running.wait(), Ok(Outcome::Completed), "the first goes on");
            assert_eq!(left.ptp(BENT).run(), Ok(Outcome::Completed));
            first.close().unwrap();
            error
        },
        |kind| matches!(kind, ErrorKind::Conflict { device, joint: Some(0), holder: Some(_) } if device == "left"),
        "left joint 0: net rpinet",
    ),
    (
        "controller of another version",
        |_| {
            let listener = TcpListener::bind("127.0.0.1:0").unwrap();
            let address = listener.local_addr().unwrap().to_string();
            let other = std::thread::spawn(move || {
                let (mut stream, _) = listener.accept().unwrap();
                let mut line = String::new();
                let mut reader = BufReader::new(stream.try_clone().unwrap());
                reader.read_line(&mut line).unwrap();
                let tag = line.split('=').next().unwrap();
                writeln!(stream, "{tag}=err(\"bad handshake\")").unwrap();
            });
            let error = Cell::connect(&address).unwrap_err();
            other.join().unwrap();
            error
        },
        |kind| matches!(kind, ErrorKind::Version { .. }),
        "is of another version: bad handshake",
    ),
    (
        "connection lost in motion",
        |bench| {
            let cut = cut_line(&bench.address());
            let cell = bench.cell_at(&cut.address);
            let mut far = BENT;
            far[0] = 2.0;
            let arm = cell.arm("left").unwrap();
            let running = arm.ptp(far).speed(0.2).begin().unwrap();
            std::thread::sleep(Duration::from_millis(300));
            (cut.cut)();
            running.wait().unwrap_err()
        },
        |kind| matches!(kind, ErrorKind::Lost(_)),
        "the connection to the controller is lost",
    ),
    (
        "callback that panics",
        |bench| {
            let (cell, left) = bench.left();
            // What a program error does, without its message.
            let wrong = |_| std::panic::resume_unwind(Box::new("no such tool"));
            let listener = cell.on_change(&left.joint(0), wrong).unwrap();
            let error = (0..2000).find_map(|_| {
                std::thread::sleep(Duration::from_millis(5));
                listener.error()
            });
            cell.close().unwrap();
            error.unwrap()
        },
        |kind| matches!(kind, ErrorKind::Callback(_)),
        "the callback failed: no such tool",
    ),
    (
        "prepared motion of an arm that was moved",
        |bench| {
            let (cell, left) = bench.left();
            let up = Pose::xyz(0.0, 0.0, 0.02) * left.pose().unwrap();
            let prepared = left.lin(up).prepare().unwrap();
            let mut aside = BENT;
            aside[0] = 0.1;
            assert_eq!(left.ptp(aside).run(), Ok(Outcome::Completed));
            let error = prepared.begin().unwrap_err();
            cell.close().unwrap();
            error
        },
        |kind| matches!(kind, ErrorKind::Stale { device, .. } if device == "left"),
        "left: the prepared activity no longer fits: the arm is not where it was to begin",
    ),
];

/// A connection to a controller through this process, which can be cut.
struct CutLine {
    address: String,
    cut: Box<dyn FnOnce()>,
}

fn cut_line(controller: &str) -> CutLine {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let controller = TcpStream::connect(controller).unwrap();
    let (ends, accepted) = std::sync::mpsc::channel();
    let other = controller.try_clone().unwrap();
    std::thread::spawn(move || {
        let (program, _) = listener.accept().unwrap();
        let copy = |mut from: TcpStream, mut to: TcpStream| {
            std::thread::spawn(move || std::io::copy(&mut from, &mut to));
        };
        copy(program.try_clone().unwrap(), other.try_clone().unwrap());
        copy(other, program.try_clone().unwrap());
        ends.send(program).unwrap();
    });
    let cut = move || {
        let program = accepted.recv().unwrap();
        for end in [program, controller] {
            // It may be closed already.
            let _ = end.shutdown(Shutdown::Both);
        }
    };
    CutLine {
        address,
        cut: Box::new(cut),
    }
}

#[test]
fn bad_input_is_typed_and_disturbs_no_other() {
    steady(|| {
        let bench = Bench::start();
        let other = bench.cell();
        let right = other.arm("right").unwrap();
        for (name, wrong, is_kind, cause) in CASES {
            let mut far = BENT;
            far[0] = deg(60.0);
            let undisturbed = right.ptp(far).speed(0.1).begin().unwrap();
            let error = wrong(&bench);
            let text = error.to_string();
            assert!(is_kind(&error.kind), "{name}: {error:?}");
            assert!(text.contains(cause), "{name}: {text}");
            let (cell, left) = bench.left();
            rests(&left);
            let goes_on = undisturbed.outcome();
            assert!(
                goes_on.is_none() || goes_on == Some(Ok(Outcome::Completed)),
                "{name}: {goes_on:?}"
            );
            assert!(text.contains("\nhint: "), "{name}: {text}");
            // The next program can use the arm.
            assert_eq!(left.ptp(BENT).run(), Ok(Outcome::Completed), "{name}");
            cell.close().unwrap();
            undisturbed.cancel();
            undisturbed.wait().unwrap();
            assert_eq!(right.ptp(BENT).run(), Ok(Outcome::Completed), "{name}");
        }
        other.close().unwrap();
    });
}

#[test]
fn coupled_goal_beyond_second_arm_moves_neither() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left) = bench.left();
        let right = cell.arm("right").unwrap();
        // The base of the second arm stands so far aside that only the first one reaches the goal.
        let start = left.pose().unwrap();
        let right = right.with_base(Pose::xyz(0.0, 0.0, 0.0));
        let arms = [left, right];
        let mut bent = BENT;
        bent[3] = -0.6;
        assert_eq!(arms[1].ptp(bent).run(), Ok(Outcome::Completed));
        let before = arms.each_ref().map(|arm| arm.commanded().unwrap());
        let part = coupled(start, &arms).unwrap();
        let mut outward = Pose::xyz(0.0, 0.0, 0.0);
        let mut error = None;
        // The first step that one of them cannot go: the second one is stretched further.
        for step in 1..12 {
            let [x, ..] = start.position();
            outward = Pose::xyz(x.signum() * 0.05 * f64::from(step), 0.0, 0.0);
            if let Err(found) = part.lin(outward * start).plan() {
                error = Some(found);
                break;
            }
        }
        assert!(error.is_some(), "{outward:?}");
        let error = part.lin(outward * start).begin().unwrap_err();
        let is_second = matches!(&error.kind, ErrorKind::Unreachable { device, .. } | ErrorKind::TooFast { device, .. } if device == "right");
        assert!(is_second, "{error}");
        assert!(error.to_string().contains("\nhint: "), "{error}");
        let after = arms.each_ref().map(rests);
        assert_eq!(before, after, "neither moves");
        cell.close().unwrap();
    });
}

/// Programs whose last reference is in a thread that dies end as programs do: their arm brakes.
#[test]
fn program_thread_that_dies_leaves_arm_at_rest() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left) = bench.left();
        let mut far = BENT;
        far[0] = 2.0;
        let dying = std::thread::spawn(move || {
            let _running = left.ptp(far).speed(0.1).begin().unwrap();
            std::thread::sleep(Duration::from_millis(300));
            drop(cell);
            std::panic::resume_unwind(Box::new("dies"));
        });
        dying.join().unwrap_err();
        let (cell, left) = bench.left();
        let at = rests(&left);
        assert!(at[0] < 1.9, "it did not go on: {at:?}");
        assert_eq!(left.ptp(BENT).run(), Ok(Outcome::Completed));
        cell.close().unwrap();
    });
}

/// The dead man of a jog brakes when the thread that sends dies; the rest of the program goes on.
#[test]
fn jogging_thread_that_dies_leaves_arm_at_rest() {
    steady(|| {
        let bench = Bench::start();
        let (cell, left) = bench.left();
        let right = cell.arm("right").unwrap();
        let mut far = BENT;
        far[0] = 1.0;
        let undisturbed = right.ptp(far).speed(0.2).begin().unwrap();
        let before = left.commanded().unwrap();
        let jog = left.jog().begin().unwrap();
        let dying = std::thread::spawn(move || {
            for _ in 0..20 {
                jog.send(Twist::xyz(0.0, 0.0, 0.05)).unwrap();
                std::thread::sleep(Duration::from_millis(20));
            }
            std::panic::resume_unwind(Box::new("dies"));
        });
        dying.join().unwrap_err();
        let at = rests(&left);
        assert_ne!(at, before, "it has moved");
        assert_eq!(left.ptp(BENT).now().run(), Ok(Outcome::Completed));
        assert_eq!(undisturbed.wait(), Ok(Outcome::Completed));
        cell.close().unwrap();
    });
}
