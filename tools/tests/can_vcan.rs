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
        writeln!(file, "{test}: needs vcan").unwrap();
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
