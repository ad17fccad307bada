//! `takt arm check` on files that describe an arm and files that do not.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::process::{Command, Output};

use serde_json::Value;

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
