//! `takt can` on a virtual interface: `TAKT_VCAN`, or `vcan0` if it exists; otherwise each test reports that it is
//! skipped.

mod common;

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use common::{Process, expect_status, run};
use serde_json::Value;
use takt_can::link::Link as _;
use takt_can::linux::{Options, SocketCan};
use takt_tests::{skip, vcan};

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
    let stat = stat.stdout(Stdio::piped()).spawn().unwrap();
    // `stat` may start to listen late: the recording is sent again.
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
        found.iter().any(|finding| finding["name"] == "boot-loop"),
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

/// A virtual interface used by one test only.
struct OwnInterface(&'static str);

fn has(program: &str) -> bool {
    let paths = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&paths).any(|path| path.join(program).is_file())
}

fn does(program: &str, arguments: &str) -> bool {
    let mut command = Command::new(program);
    let status = command
        .args(arguments.split(' '))
        .stderr(Stdio::null())
        .status();
    status.is_ok_and(|status| status.success())
}

impl OwnInterface {
    fn create(test: &str, name: &'static str) -> Option<Self> {
        if !does("ip", &format!("link add {name} type vcan")) {
            skip(
                test,
                "needs ip of iproute2 and to create a virtual interface",
            );
            return None;
        }
        let own = Self(name);
        assert!(does("ip", &format!("link set {name} up")));
        Some(own)
    }

    /// An interface that a shaper limits to the rate of a bus.
    fn create_slow(test: &str, name: &'static str) -> Option<Self> {
        let own = Self::create(test, name)?;
        let shaper =
            format!("qdisc replace dev {name} root tbf rate 100kbit burst 1600 limit 1600");
        if !does("tc", &shaper) {
            skip(test, "needs tc of iproute2 and the module sch_tbf");
            return None;
        }
        Some(own)
    }
}

impl Drop for OwnInterface {
    fn drop(&mut self) {
        let mut command = Command::new("ip");
        let _ = command.args(["link", "delete", self.0]).status();
    }
}

/// cansend sends the error frames that a controller would report; the kernel passes them on alike.
#[test]
fn stat_reports_errors_of_the_controller() {
    let test = "stat_reports_errors_of_the_controller";
    if vcan(test).is_none() {
        return;
    }
    if !has("cansend") {
        return skip(test, "needs cansend of can-utils");
    }
    let Some(own) = OwnInterface::create(test, "taktvcan3") else {
        return;
    };
    // No acknowledgement, with both counters; error-passive; bus-off and the restart after it.
    for (reports, name) in [
        (["20000220#0000000000008000"; 3], "alone"),
        (["20000204#0020000000008800"; 3], "weak"),
        (["20000040#0000000000000000"; 3], "bus-off"),
    ] {
        let mut stat = common::takt(&["can", "stat", own.0, "--duration", "2s", "--json"]);
        let mut stat = stat.stdout(Stdio::piped()).spawn().unwrap();
        while stat.try_wait().unwrap().is_none() {
            for report in reports {
                let sent = Command::new("cansend").args([own.0, report]).status();
                assert!(sent.unwrap().success(), "{report}");
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        let report = stat.wait_with_output().unwrap();
        let report: Value = serde_json::from_str(&String::from_utf8_lossy(&report.stdout)).unwrap();
        let found = report["findings"].as_array().unwrap();
        assert!(
            found.iter().any(|finding| finding["name"] == name),
            "{name}: {report}"
        );
    }
}

/// The kernel drops frames of another program; `stat` reads its counter.
#[test]
fn stat_reports_full_send_queue() {
    let test = "stat_reports_full_send_queue";
    if vcan(test).is_none() {
        return;
    }
    let Some(own) = OwnInterface::create_slow(test, "taktvcan2") else {
        return;
    };
    let mut stat = common::takt(&["can", "stat", own.0, "--duration", "3s", "--json"]);
    let mut stat = stat.stdout(Stdio::piped()).spawn().unwrap();
    let mut link = SocketCan::open(own.0, &Options::default()).unwrap();
    let frame = takt_can::log::parse_frame("001#0000000000000000").unwrap();
    while stat.try_wait().unwrap().is_none() {
        while link.send(&frame).is_ok() {}
        std::thread::sleep(Duration::from_millis(10));
    }
    let report = expect_status(&stat.wait_with_output().unwrap(), 1);
    let report: Value = serde_json::from_str(&report).unwrap();
    let found = report["findings"].as_array().unwrap();
    assert!(
        found.iter().any(|finding| finding["name"] == "refused"),
        "{report}"
    );
    assert!(report["refused"].as_u64().unwrap() > 0, "{report}");
}

#[test]
fn up_prints_the_interface_state() {
    let Some(vcan) = vcan("up_prints_the_interface_state") else {
        return;
    };
    let output = expect_status(&run(&["can", "up", &vcan, "--show"]), 0);
    assert!(
        output.starts_with(&format!("{vcan}: up, virtual, queue of ")),
        "{output}"
    );
}

/// Starts an emulated drive. Each test uses another number, because the tests share the interface.
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

/// Repeats a command for half a minute until it succeeds: a stalled host can exceed the timeout of single attempts.
fn eventually(arguments: &[&str]) -> String {
    let until = Instant::now() + Duration::from_secs(30);
    loop {
        let output = run(arguments);
        if output.status.code() == Some(0) || Instant::now() > until {
            return expect_status(&output, 0);
        }
    }
}

/// On an interface of its own: the scan would also query nodes of other tests.
#[test]
fn scan_nmt_and_sdo_reach_the_node() {
    let test = "scan_nmt_and_sdo_reach_the_node";
    if vcan(test).is_none() {
        return;
    }
    let Some(own) = OwnInterface::create(test, "taktvcan4") else {
        return;
    };
    let vcan = own.0;
    let _drive = drive(vcan, "61");
    let found = eventually(&["can", "scan", vcan, "--nodes", "60-62", "--json"]);
    let found: Value = serde_json::from_str(&found).unwrap();
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
    let preop = run(&["can", "nmt", vcan, "61", "preop", "--timeout", "30s"]);
    assert!(expect_status(&preop, 0).contains("node 61: pre-operational after"));
    let silent = run(&["can", "nmt", vcan, "60", "preop", "--wait", "300ms"]);
    assert!(expect_status(&silent, 1).contains("no answer within"));
    // Hosts may be slow.
    let timeout = ["--timeout", "30s"];
    let sdo = |words: &[&str]| run(&[&["can", "sdo", vcan, "61"], words, &timeout].concat());
    let name = sdo(&["upload", "1008"]);
    assert!(expect_status(&name, 0).contains("\"Takt emulated drive\""));
    let refused = sdo(&["upload", "5FFF"]);
    expect_status(&refused, 1);
    assert!(common::complaint(&refused).contains("there is no such object"));
    let file = std::env::temp_dir().join(format!("takt-vcan-{}.dcf", std::process::id()));
    let file = file.to_str().unwrap();
    let dumped = sdo(&["dump", "--dcf", file]);
    expect_status(&dumped, 0);
    let compared = sdo(&["compare", file]);
    std::fs::remove_file(file).unwrap();
    let compared = String::from_utf8_lossy(&compared.stdout).into_owned();
    assert!(compared.contains("entries compared"), "{compared}");
}

#[test]
fn drive_comes_up_turns_and_brakes() {
    let Some(vcan) = vcan("drive_comes_up_turns_and_brakes") else {
        return;
    };
    let _drive = drive(&vcan, "63");
    // An attempt on a host that stalled leaves the drive in fault.
    let jogged = eventually(&[
        "can",
        "drive",
        &vcan,
        "63",
        "--reset",
        "--jog",
        "20000",
        "--duration",
        "500ms",
        "--json",
    ]);
    let jogged: Value = serde_json::from_str(&jogged).unwrap();
    assert_eq!(
        (&jogged["enabled"], &jogged["diagnosis"]),
        (&true.into(), &Value::Null)
    );
    // A Ctrl-C.
    let mut jog = Process::start(&[
        "can",
        "drive",
        &vcan,
        "63",
        "--jog",
        "2000",
        "--duration",
        "1min",
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
fn rmp_on_can_is_read() {
    let Some(vcan) = vcan("rmp_on_can_is_read") else {
        return;
    };
    let mut powerbase = Process::start(&["emulate", "rmp", "--interface", &vcan]);
    powerbase.wait_for("power base on");
    let until = Instant::now() + Duration::from_secs(30);
    let mut cycles = 0;
    while cycles <= 20 {
        let seen = run(&["can", "rmp", &vcan, "--duration", "1s", "--json"]);
        let seen: Value = serde_json::from_str(&String::from_utf8_lossy(&seen.stdout)).unwrap();
        cycles += seen["cycles"].as_u64().unwrap();
        assert!(Instant::now() < until, "{seen}");
    }
}

/// A device from its data sheet; then the same with a fault.
#[test]
fn emulated_node_answers_until_its_fault() {
    let test = "emulated_node_answers_until_its_fault";
    if vcan(test).is_none() {
        return;
    }
    let Some(own) = OwnInterface::create(test, "taktvcan5") else {
        return;
    };
    let vcan = own.0;
    let file = std::env::temp_dir().join(format!("takt-vcan-{}.eds", std::process::id()));
    let eds = file.to_str().unwrap();
    let written = run(&["emulate", "drive", "--interface", vcan, "--write-eds", eds]);
    expect_status(&written, 0);
    let arguments = [
        "emulate",
        "node",
        "--eds",
        eds,
        "--node",
        "9",
        "--interface",
        vcan,
        "--heartbeat",
        "100ms",
        "--signal",
        "6064=ramp:5:100:1s",
    ];
    let mut node = Process::start(&arguments);
    node.wait_for("node 9 on");
    eventually(&[
        "can",
        "nmt",
        vcan,
        "9",
        "start",
        "--timeout",
        "10s",
        "--yes",
    ]);
    let read = [
        "can",
        "sdo",
        vcan,
        "9",
        "upload",
        "6064",
        "--timeout",
        "10s",
    ];
    let value = eventually(&read);
    assert!(value.contains("position actual value = "), "{value}");
    assert!(!value.contains("= 0 "), "{value}");
    drop(node);
    let mut silent = Process::start(&[&arguments[..], &["--fault", "sdo-silent"]].concat());
    silent.wait_for("node 9 on");
    let answer = run(&["can", "sdo", vcan, "9", "upload", "6064", "--timeout", "1s"]);
    std::fs::remove_file(file).unwrap();
    expect_status(&answer, 1);
}
