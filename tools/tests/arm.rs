//! `takt arm check` on files that describe an arm and files that do not; `takt arm identify` with an emulated LWR over its wire.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::process::{Command, Output};

use common::{Cell, Process, alone, complaint, expect_status, run};
use serde_json::Value;
use takt_tests::steady;

const TX90: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../rcc/motion/tests/arms/tx90.urdf"
);

fn check(arguments: &[&str]) -> Output {
    let mut takt = Command::new(env!("CARGO_BIN_EXE_takt"));
    takt.args(["arm", "check"])
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn arm_check_reports_structure_reach_and_inverse() {
    let output = check(&[TX90, "--payload", "6", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["structure"], "Opw");
    assert_eq!(found["tip"], "tool0");
    assert_eq!(found["inverse"]["near"], 1.0);
    assert_eq!(found["inverse"]["far"], 1.0);
    // From the base to the shoulder, along both links, to the flange.
    let reach = found["reach_m"].as_f64().unwrap();
    assert!(reach > 1.2 && reach < 1.45, "{reach}");
    // The wrist is singular where its outer axes coincide, the elbow where it is stretched.
    let singular = found["singular"].as_array().unwrap();
    let of = |joint: &str| singular.iter().find(|it| it["joint"] == joint).unwrap();
    for joint in ["joint_3", "joint_5"] {
        assert_eq!(of(joint)["position"], 0.0, "{singular:?}");
    }
    // The second joint carries the links behind it: more than the wrist, and more with a payload.
    let holding =
        |found: &Value, joint: usize| found["joints"][joint]["holding_effort"].as_f64().unwrap();
    assert!(holding(&found, 1) > 10.0 * holding(&found, 4));
    let empty: Value = serde_json::from_slice(&check(&[TX90, "--json"]).stdout).unwrap();
    assert!(holding(&found, 1) > holding(&empty, 1) + 30.0);
}

#[test]
fn arm_check_names_payload_beyond_effort() {
    let output = check(&[TX90, "--payload", "200"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("TOO MUCH"), "{text}");
    let output = check(&[TX90, "--payload=-1"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn arm_check_of_file_without_arm_names_line() {
    let folder = std::env::temp_dir().join(format!("takt-arm-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("wrong.urdf");
    let text = std::fs::read_to_string(TX90).unwrap();
    std::fs::write(
        &file,
        text.replace("lower=\"-2.5307\" upper=\"2.5307\"", ""),
    )
    .unwrap();
    let output = check(&[file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains("line 24: joint `joint_3` has no limits\nhint: add <limit"),
        "{text}"
    );
    let output = check(&[file.to_str().unwrap(), "--json"]);
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["faults"][0]["line"], 24);
    let output = check(&["/no/such.urdf"]);
    assert_eq!(output.status.code(), Some(2));
    std::fs::remove_dir_all(folder).unwrap();
}

/// What the arm of a cell with this load carries, by the tool.
fn identified(load: [&str; 4]) -> Value {
    let mut cell = Cell::start();
    let arm = [&["emulate", "lwr", "--connect", &cell.udp][..], &load].concat();
    let _arm = Process::start(&arm);
    cell.process.wait_for("now=operational");
    let at = ["--connect", &cell.tcp];
    let bent = ["0", "35deg", "0", "-70deg", "0", "50deg", "0"];
    let go = [&["move", "left", "ptp"], &bent[..], &["--yes"], &at].concat();
    expect_status(&run(&go), 0);
    let mut identify = vec!["arm", "identify", "left", "--json", "--http", &cell.http];
    identify.extend(at);
    let asked = run(&identify);
    assert!(complaint(&asked).contains("--yes"), "{}", complaint(&asked));
    expect_status(&asked, 2);
    identify.extend(["--yes", "--speed", "0.3", "--swing", "20deg"]);
    serde_json::from_str(&expect_status(&run(&identify), 0)).unwrap()
}

#[test]
fn load_of_emulated_arm_is_identified() {
    let _alone = alone();
    steady(|| {
        let found = identified(["--carries", "2.5", "--tool", "120mm"]);
        assert_eq!(found["has_load"], true, "{found}");
        let number = |value: &Value| value.as_f64().unwrap();
        assert!((number(&found["mass_kg"]) - 2.5).abs() < 0.05, "{found}");
        for (at, expected) in [0.0, 0.0, 0.12].into_iter().enumerate() {
            let at = number(&found["centre_of_mass_m"][at]);
            assert!((at - expected).abs() < 0.005, "{found}");
        }
    });
}
