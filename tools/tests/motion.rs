//! `takt move` against a controller with an emulated arm: plans, motions, cancellation and errors. That motions keep their
//! limits is tested in takt-api and takt-motion.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use common::{Cell, Folder, Process, alone, complaint, expect_status, run};
use serde_json::Value;
use takt_tests::steady;

/// Arguments of a motion of the arm of a cell.
fn arguments<'a>(cell: &'a Cell, args: &[&'a str]) -> Vec<&'a str> {
    [&["move", "left"], args, &["--connect", &cell.tcp]].concat()
}

fn object(text: &str) -> Value {
    assert_eq!(text.lines().count(), 1, "{text}");
    serde_json::from_str(text).unwrap()
}

fn angles(list: &Value) -> Vec<f64> {
    let list = list.as_array().unwrap().iter();
    list.map(|angle| angle.as_f64().unwrap()).collect()
}

const BENT: [&str; 8] = ["ptp", "0", "30deg", "0", "-70deg", "0", "45deg", "0"];

#[test]
fn move_plans_moves_and_reports() {
    let _alone = alone();
    steady(|| {
        let mut cell = Cell::start();
        let _arm = cell.arm();
        let run = |args: &[&str]| run(&arguments(&cell, args));
        let folder = Folder::new();
        let svg = folder.file("plan.svg");

        let planned = [
            &BENT[..],
            &["--speed", "0.9", "--dry-run", "--json", "--svg", &svg],
        ];
        let planned = object(&expect_status(&run(&planned.concat()), 0));
        assert_eq!(planned["outcome"], Value::Null);
        assert!(planned["duration_s"].as_f64().unwrap() > 0.1, "{planned}");
        assert!(
            planned["cycle_cost_us"].as_f64().unwrap() > 0.0,
            "{planned}"
        );
        assert!(
            !planned["rules"].as_array().unwrap().is_empty(),
            "{planned}"
        );
        let goal = planned["joints"][3]["to_rad"].as_f64().unwrap();
        assert!((goal + 70_f64.to_radians()).abs() < 1e-6, "{planned}");
        let picture = std::fs::read_to_string(&svg).unwrap();
        assert!(picture.contains("planned joint velocities"), "{picture}");

        let moved = [&BENT[..], &["--yes", "--json", "--speed", "0.9"]].concat();
        let moved = object(&expect_status(&run(&moved), 0));
        assert_eq!(moved["outcome"], "completed");
        let at = angles(&moved["at_rad"]);
        assert!((at[3] - goal).abs() < 1e-6, "{moved}");

        let line = ["lin", "-0.6m,-50mm,0.6m", "--yes", "--json", "--speed", "1"];
        let line = object(&expect_status(&run(&line), 0));
        let from = line["joints"][3]["from_rad"].as_f64().unwrap();
        assert!((from - at[3]).abs() < 1e-9, "{line}");
        let home = expect_status(&run(&["home", "--yes", "--speed", "1"]), 0);
        assert!(home.contains("completed after"), "{home}");
        assert!(
            home.ends_with("left at 0.00 0.00 0.00 0.00 0.00 0.00 0.00 deg\n"),
            "{home}"
        );
        let net = expect_status(&run(&["home", "--print-net"]), 0);
        assert!(net.contains("RobotArm::JointPosition"), "{net}");
    });
}

#[test]
fn move_interrupted_rests_on_its_path() {
    let _alone = alone();
    steady(|| {
        let mut cell = Cell::start();
        let _arm = cell.arm();
        let slow = [&BENT[..], &["--yes", "--json", "--speed", "0.05"]].concat();
        let moving = Process::start(&arguments(&cell, &slow));
        std::thread::sleep(std::time::Duration::from_secs(2));
        moving.signal("INT");
        let (lines, status) = moving.end();
        assert_eq!(status, Some(1), "{lines:#?}");
        let report = lines.iter().find(|line| line.starts_with('{')).unwrap();
        let report = object(report);
        assert_eq!(report["outcome"], "cancelled");
        let there = report["at_rad"][3].as_f64().unwrap();
        let goal = report["joints"][3]["to_rad"].as_f64().unwrap();
        assert!(goal < there, "{report}");
        // It rests there: nothing moves until the next plan begins.
        let next = run(&arguments(&cell, &["home", "--dry-run", "--json"]));
        let next = object(&expect_status(&next, 0));
        let from = next["joints"][3]["from_rad"].as_f64().unwrap();
        assert!((from - there).abs() < 1e-6, "{next} {report}");
    });
}

#[test]
fn move_errors_name_cause_and_hint() {
    let _alone = alone();
    let mut cell = Cell::start();
    let _arm = cell.arm();
    let cases: [(&[&str], i32, &str); 7] = [
        (&["ptp", "0", "0", "0"], 2, "left has 7 joints, not 3"),
        (
            &["ptp", "0", "179deg", "0", "0", "0", "0", "0"],
            1,
            "hint: its range is -1",
        ),
        (&["ptp", "30"], 2, "write a number and a unit, such as 5deg"),
        (&["lin", "3m,0,0"], 1, "hint: name a nearer pose"),
        (&["lin", "-3m,0"], 2, "a pose has 3 or 6 parts, not 2"),
        (&["home", "--speed", "-1"], 2, "must be 0 to 1"),
        // Emulated arms are as real to the controller: without a terminal and --yes nothing moves.
        (
            &["home"],
            2,
            "moving left (kuka_lwr_fri) can set a machine in motion",
        ),
    ];
    for (args, status, cause) in cases {
        let output = run(&arguments(&cell, args));
        expect_status(&output, status);
        let text = complaint(&output);
        assert!(text.contains(cause), "{args:?}: {text}");
    }
    let unknown = run(&["move", "middle", "home", "--connect", &cell.tcp]);
    expect_status(&unknown, 1);
    assert!(complaint(&unknown).contains("the controller has left"));
    let nowhere = run(&["move", "left", "home", "--connect", "127.0.0.1:1"]);
    expect_status(&nowhere, 2);
}
