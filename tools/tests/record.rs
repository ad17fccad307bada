//! `takt record` on recordings of a controller, whole and cut off.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use takt_core::record::{Recorder, replay};
use takt_core::{CellConfig, Controller};

use common::{Folder, Process, alone};

fn takt(arguments: &[&str]) -> Output {
    let mut takt = Command::new(env!("CARGO_BIN_EXE_takt"));
    takt.args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

/// Records an idle controller for a moment; returns how many cycles.
fn recorded(path: &Path) -> u64 {
    let recording = Recorder::start(path).unwrap();
    let cell = CellConfig::default();
    let controller = Controller::start_recording(&cell, Some(recording)).unwrap();
    std::thread::sleep(Duration::from_millis(200));
    controller.finish_recording().unwrap().unwrap()
}

#[test]
fn record_info_lists_topics_of_whole_recording() {
    let folder = Folder::new();
    let whole = folder.file("whole.mcap");
    let cycles = recorded(Path::new(&whole));
    let output = takt(&["record", "info", &whole, "--json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["is_cut"], false);
    let topics = found["topics"].as_array().unwrap();
    let of = |name: &str| topics.iter().find(|topic| topic["name"] == name).unwrap();
    assert_eq!(of("/takt/cycles")["messages"], cycles);
    assert_eq!(of("/takt/thread")["type"], "takt_msgs/msg/Cycle");
    let output = takt(&["record", "info", &whole]);
    assert!(
        text(&output.stdout).contains("takt_msgs/msg/Words"),
        "{output:?}"
    );
}

#[test]
fn record_recover_makes_cut_recording_whole() {
    let folder = Folder::new();
    let (whole, cut, new) = (
        folder.file("whole.mcap"),
        folder.file("cut.mcap"),
        folder.file("new.mcap"),
    );
    recorded(Path::new(&whole));
    let bytes = std::fs::read(&whole).unwrap();
    // The index at the end is missing.
    std::fs::write(&cut, &bytes[..bytes.len() - 40]).unwrap();
    let output = takt(&["record", "info", &cut]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(
        text(&output.stdout).contains("hint: takt record recover "),
        "{output:?}"
    );
    let output = takt(&["record", "recover", &cut, "--output", &new]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_eq!(takt(&["record", "info", &new]).status.code(), Some(0));
    let (before, after) = (
        replay(Path::new(&cut)).unwrap(),
        replay(Path::new(&new)).unwrap(),
    );
    assert_eq!((before.cycles, before.is_cut), (after.cycles, true));
    assert!(!after.is_cut && after.differs.is_none(), "{after:?}");
    // It overwrites nothing.
    let output = takt(&["record", "recover", &cut, "--output", &new]);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(text(&output.stderr).contains("exists"), "{output:?}");
}

#[test]
fn record_refuses_what_is_no_recording() {
    let folder = Folder::new();
    let (empty, new) = (folder.file("empty.mcap"), folder.file("new.mcap"));
    std::fs::write(&empty, b"").unwrap();
    for wrong in [empty.as_str(), "/dev/null", "/nonexistent", "/etc/hostname"] {
        let output = takt(&["record", "recover", wrong, "--output", &new]);
        assert_eq!(output.status.code(), Some(2), "{wrong}: {output:?}");
        assert!(text(&output.stderr).starts_with("takt: "), "{output:?}");
        assert!(!Path::new(&new).exists(), "{wrong} leaves half a file");
    }
    assert_ne!(
        takt(&["record", "info", "/etc/hostname"]).status.code(),
        Some(0)
    );
}

#[test]
fn record_csv_has_a_row_for_each_cycle() {
    let folder = Folder::new();
    let (whole, table) = (folder.file("whole.mcap"), folder.file("table.csv"));
    let cycles = recorded(Path::new(&whole));
    let probe = "thread:nets.*";
    let output = takt(&[
        "record", "csv", &whole, "--probe", probe, "--output", &table,
    ]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let csv = std::fs::read_to_string(&table).unwrap();
    let mut lines = csv.lines();
    let head =
        "time s,thread:nets.cycle,thread:nets.interval_us,thread:nets.missed,thread:nets.nets";
    assert_eq!(lines.next(), Some(head));
    assert_eq!(lines.clone().count() as u64, cycles);
    let first: Vec<_> = lines.next().unwrap().split(',').collect();
    // The interval of the first cycle is not known.
    assert_eq!((first[0], first[2], first[4]), ("0.000000000", "", "0"));
    let output = takt(&["record", "csv", &whole, "--probe", "nothing.*"]);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(
        text(&output.stderr).contains("hint: without --probe"),
        "{output:?}"
    );
    let output = takt(&["record", "csv", &whole, "--output", &table]);
    assert_eq!(output.status.code(), Some(2), "it overwrites nothing");
}

#[test]
fn record_plot_draws_chosen_values() {
    let folder = Folder::new();
    let (whole, picture) = (folder.file("whole.mcap"), folder.file("plot.svg"));
    recorded(Path::new(&whole));
    let plot = |probe: &str| {
        takt(&[
            "record", "plot", &whole, "--probe", probe, "--svg", &picture,
        ])
    };
    let output = plot("thread:nets.*");
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let svg = std::fs::read_to_string(&picture).unwrap();
    assert!(svg.contains("thread:nets.interval_us"), "{svg}");
    assert!(svg.matches("<polyline").count() >= 1);
    let output = plot("nothing.*");
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("no value matches\nhint:"),
        "{output:?}"
    );
}

#[test]
fn stalled_controller_writes_flight_of_overruns() {
    let _alone = alone();
    let folder = Folder::new();
    let stop = folder.file("stop.sock");
    let config = format!(
        "[controller]\nwebsocket = \"127.0.0.1:0\"\nstop_socket = \"{stop}\"\nflight_recorder = \"flights\"\n"
    );
    let config = folder.write("cell.toml", &config);
    let mut process = Process::start(&["run", "--config", &config]);
    process.wait_for("DirectIO at ws");
    // Cycles that were missed before are no burst: they are counted from the first reading on.
    std::thread::sleep(Duration::from_millis(500));
    process.stall(Duration::from_millis(200));
    process.wait_for("missed ");
    let line = process.wait_for("-overruns.mcap is complete");
    let name = line
        .split_whitespace()
        .find(|word| word.ends_with("-overruns.mcap"));
    let output = takt(&["record", "info", name.unwrap(), "--json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["is_cut"], false);
    let topics = found["topics"].as_array().unwrap();
    let cycles = topics.iter().find(|topic| topic["name"] == "/takt/thread");
    assert!(
        cycles.unwrap()["messages"].as_u64().unwrap() > 500,
        "{found}"
    );
}
