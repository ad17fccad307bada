//! `takt can` on a virtual interface: `TAKT_VCAN`, or `vcan0` if there is one; else each test notes that it
//! was skipped.
#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test that cannot go on ends"
)]

mod common;

use std::io::Write as _;
use std::path::Path;

use common::{Process, expect_status, run};
use serde_json::Value;

fn vcan(test: &str) -> Option<String> {
    let name = std::env::var("TAKT_VCAN").unwrap_or_else(|_| "vcan0".to_owned());
    if Path::new("/sys/class/net").join(&name).exists() {
        return Some(name);
    }
    eprintln!("skipped: needs vcan");
    if let Some(path) = std::env::var_os("TAKT_SKIPS") {
        let mut file = std::fs::OpenOptions::new().append(true).open(path).unwrap();
        file.write_all(format!("{test}: needs vcan\n").as_bytes())
            .unwrap();
    }
    None
}

#[test]
fn dump_shows_what_send_sends() {
    let Some(vcan) = vcan("dump_shows_what_send_sends") else {
        return;
    };
    let mut dump = Process::start(&["can", "dump", &vcan, "--filter", "node=77"]);
    dump.wait_for("time s");
    let sent = run(&[
        "can", "send", &vcan, "000#014D", "24D#0F00", "--count", "2", "--period", "1ms",
    ]);
    assert_eq!(expect_status(&sent, 0), format!("{vcan}: sent 4\n"));
    dump.wait_for("NMT start, node 77");
    dump.wait_for("node 77 RPDO1");
}

#[test]
fn replayed_recording_is_seen_by_stat() {
    let Some(vcan) = vcan("replayed_recording_is_seen_by_stat") else {
        return;
    };
    let log = format!("{}/tests/can/fault.log", env!("CARGO_MANIFEST_DIR"));
    let mut stat = common::takt(&[
        "can",
        "stat",
        &vcan,
        "--duration",
        "20s",
        "--bitrate",
        "1M",
        "--json",
    ]);
    let stat = stat.stdout(std::process::Stdio::piped()).spawn().unwrap();
    // Until it listens, and then some: what it has not seen is sent again.
    for _ in 0..10 {
        let sent = run(&[
            "can",
            "replay",
            &log,
            &vcan,
            "--channel",
            "can0",
            "--speed",
            "2",
        ]);
        assert_eq!(expect_status(&sent, 0), format!("{vcan}: sent 15 of 15\n"));
    }
    let report = expect_status(&stat.wait_with_output().unwrap(), 1);
    let report: Value = serde_json::from_str(&report).unwrap();
    let found = report["findings"].as_array().unwrap();
    assert!(
        found.iter().any(|finding| finding["name"] == "rebooted"),
        "{report}"
    );
    assert!(
        report["nodes"]
            .as_array()
            .unwrap()
            .iter()
            .any(|node| node["node"] == 5)
    );
}

#[test]
fn up_tells_how_an_interface_is() {
    let Some(vcan) = vcan("up_tells_how_an_interface_is") else {
        return;
    };
    let told = expect_status(&run(&["can", "up", &vcan, "--show"]), 0);
    assert!(
        told.starts_with(&format!("{vcan}: up, virtual, queue of ")),
        "{told}"
    );
}

/// A node of its own number in each test: they share the interface.
fn drive(vcan: &str, node: &str) -> Process {
    let arguments = [
        "emulate",
        "drive",
        "--interface",
        vcan,
        "--node",
        node,
        "--heartbeat",
        "100ms",
    ];
    let mut drive = Process::start(&arguments);
    drive.wait_for("drive ");
    drive
}

#[test]
fn nodes_are_scanned_commanded_and_asked() {
    let Some(vcan) = vcan("nodes_are_scanned_commanded_and_asked") else {
        return;
    };
    let _drive = drive(&vcan, "61");
    let found = run(&["can", "scan", &vcan, "--nodes", "60-62", "--json"]);
    let found: Value = serde_json::from_str(&expect_status(&found, 0)).unwrap();
    let node = found["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .find(|node| node["node"] == 61)
        .unwrap();
    assert_eq!(
        (&node["profile"], &node["serial"]),
        (&"drive (CiA 402)".into(), &61.into())
    );
    let preop = run(&["can", "nmt", &vcan, "61", "preop", "--wait", "5s"]);
    assert!(expect_status(&preop, 0).contains("node 61: pre-operational after"));
    let silent = run(&["can", "nmt", &vcan, "60", "preop", "--wait", "300ms"]);
    assert!(expect_status(&silent, 1).contains("says nothing"));
    let name = run(&["can", "sdo", &vcan, "61", "upload", "1008"]);
    assert!(expect_status(&name, 0).contains("\"Takt emulated drive\""));
    let refused = run(&["can", "sdo", &vcan, "61", "upload", "5FFF"]);
    expect_status(&refused, 1);
    assert!(common::complaint(&refused).contains("there is no such object"));
    let file = std::env::temp_dir().join(format!("takt-vcan-{}.dcf", std::process::id()));
    let file = file.to_str().unwrap();
    let dumped = run(&["can", "sdo", &vcan, "61", "dump", "--dcf", file]);
    let compared = run(&["can", "sdo", &vcan, "61", "compare", file]);
    std::fs::remove_file(file).unwrap();
    expect_status(&dumped, 0);
    let compared = String::from_utf8_lossy(&compared.stdout).into_owned();
    assert!(compared.contains("entries compared"), "{compared}");
}

#[test]
fn a_drive_comes_up_turns_and_brakes() {
    let Some(vcan) = vcan("a_drive_comes_up_turns_and_brakes") else {
        return;
    };
    let _drive = drive(&vcan, "63");
    let jogged = run(&[
        "can", "drive", &vcan, "63", "--jog", "20000", "--for", "500ms", "--json",
    ]);
    let jogged: Value = serde_json::from_str(&expect_status(&jogged, 0)).unwrap();
    assert_eq!(
        (&jogged["enabled"], &jogged["diagnosis"]),
        (&true.into(), &Value::Null)
    );
    // A Ctrl-C.
    let mut jog = Process::start(&[
        "can", "drive", &vcan, "63", "--jog", "2000", "--for", "1min",
    ]);
    jog.wait_for("s  operation enabled");
    jog.terminate();
    let (lines, status) = jog.end();
    assert_eq!(status, Some(0), "{lines:?}");
    assert!(
        lines.last().unwrap().contains("stopped on request"),
        "{lines:?}"
    );
}

#[test]
fn a_power_base_on_can_is_seen() {
    let Some(vcan) = vcan("a_power_base_on_can_is_seen") else {
        return;
    };
    let mut powerbase = Process::start(&["emulate", "rmp", "--interface", &vcan]);
    powerbase.wait_for("power base on");
    let seen = run(&["can", "rmp", &vcan, "--duration", "1s", "--json"]);
    let seen: Value = serde_json::from_str(&String::from_utf8_lossy(&seen.stdout)).unwrap();
    assert!(seen["cycles"].as_u64().unwrap() > 20, "{seen}");
}
