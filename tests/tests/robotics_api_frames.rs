//! Programs that give goals in frames of the cell.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod robotics;

use robotics::Bench;
use takt_api::{ErrorKind, Outcome, Pose, coupled};
use takt_core::CellConfig;
use takt_tests::steady;

/// The arms stand on a table, 1 m beside each other; a camera is at the flange of the left one.
const FRAMES: &str = r#"
[[frame]]
name = "table"
position = [1, 0, 0.7]
rotation = [90, 0, 0]
[[frame]]
name = "camera"
parent = "left.flange"
position = [0, 0, 0.1]
[[base]]
device = "left"
parent = "table"
[[base]]
device = "right"
parent = "table"
position = [0, 1, 0]
rotation = [180, 0, 0]
"#;

fn bench() -> Bench {
    let bench = Bench::start();
    let frames = CellConfig::parse(FRAMES, &[]).unwrap().frames;
    bench.controller.set_frames(frames);
    bench
}

#[test]
fn goals_in_a_frame_reach_both_arms() {
    steady(|| {
        let bench = bench();
        let (cell, left, right) = bench.arms();
        let table = cell.frame("table").unwrap();
        let right_base = cell.frame("right.base").unwrap().within(&table).unwrap();
        let up = Pose::xyz(0.0, 0.0, 0.05);
        let goal = up * left.pose().unwrap();
        assert_eq!(left.lin(goal.in_(&table)).run(), Ok(Outcome::Completed));
        let error = goal.inverse() * left.pose().unwrap();
        assert!(
            error.isometry().translation.vector.norm() < 1e-3,
            "{error:?}"
        );
        // The same in the base of the other arm, which is turned.
        let own = up * right.pose().unwrap();
        let in_table = table.pose(right_base * own);
        assert_eq!(right.ptp_to(in_table).run(), Ok(Outcome::Completed));
        let error = own.inverse() * right.pose().unwrap();
        assert!(
            error.isometry().translation.vector.norm() < 1e-3,
            "{error:?}"
        );
        cell.close().unwrap();
    });
}

#[test]
fn unknown_or_unconnected_frame_moves_nothing() {
    steady(|| {
        let bench = bench();
        let (cell, left, right) = bench.arms();
        let error = cell.frame("tabel").unwrap_err();
        assert!(matches!(error.kind, ErrorKind::NoDevice { .. }), "{error}");
        assert!(error.to_string().contains("table"), "{error}");
        let camera = cell.frame("camera").unwrap();
        let pose = Pose::xyz(0.0, 0.0, 0.1);
        for activity in [
            right.lin(pose.in_(&camera)),
            right.ptp_to(pose.in_(&camera)),
            right.circ(pose, pose.in_(&camera)),
            right.spline([pose.in_(&camera)]),
        ] {
            let error = activity.begin().unwrap_err();
            assert!(
                matches!(error.kind, ErrorKind::NotConnected { .. }),
                "{error}"
            );
            let text = error.to_string();
            assert!(text.contains("`camera` and `right.base`"), "{text}");
        }
        assert_eq!(bench.nets(), 0);
        drop(left);
    });
}

#[test]
fn coupled_arms_have_the_bases_of_the_cell() {
    steady(|| {
        let bench = bench();
        let (cell, left, right) = bench.arms();
        let [x, y, z] = left.base().position();
        assert!((x - 1.0).abs() < 1e-9 && y.abs() < 1e-9 && (z - 0.7).abs() < 1e-9);
        // The second base is 1 m along y of the turned table.
        assert!(right.base().position()[0].abs() < 1e-9);
        let grip = left.base() * left.pose().unwrap();
        let part = coupled(grip, [&left, &right]).unwrap();
        let goal = Pose::xyz(0.0, 0.0, 0.05) * grip;
        assert_eq!(part.lin(goal).speed(0.3).run(), Ok(Outcome::Completed));
        let error = goal.inverse() * left.base() * left.pose().unwrap();
        assert!(
            error.isometry().translation.vector.norm() < 1e-3,
            "{error:?}"
        );
        cell.close().unwrap();
    });
}
