//! `takt can` with recordings, its rejections, and a power base at a pseudo-terminal. Tests on an interface are in
//! `can_vcan.rs`.

mod common;

use common::{Process, complaint, expect_status, run};
use serde_json::Value;
use takt_tests::steady;

/// The path of a recording beside this test.
fn recording(name: &str) -> String {
    format!("{}/tests/can/{name}", env!("CARGO_MANIFEST_DIR"))
}

fn lines(arguments: &[&str]) -> Vec<String> {
    let text = expect_status(&run(arguments), 0);
    text.lines().map(str::to_owned).collect()
}

#[test]
fn dump_decodes_canopen_and_errors() {
    let shown = lines(&["can", "dump", "--from", &recording("fault.log")]);
    assert_eq!(shown.len(), 18, "a head and 17 frames");
    for (line, words) in [
        (1, "705  [ 1]  00                       node 5 boot-up"),
        (3, "4B 41 60 00 50 02 00 00  node 5 SDO < 6041h:00 = 50 02"),
        (
            4,
            "T      000  [ 2]  01 05                    NMT start, node 5",
        ),
        (
            11,
            "ERROR  [ 8]  00 00 04 19 00 00 00 00  protocol violation at ACK slot",
        ),
        (13, "CAN FD BRS"),
        (16, "remote                   node 5 guard"),
    ] {
        assert!(shown[line].contains(words), "{line}: {}", shown[line]);
    }
}

#[test]
fn dump_shows_only_filtered_frames() {
    let log = recording("fault.log");
    let shown = lines(&[
        "can", "dump", "--from", &log, "--filter", "sync", "--time", "delta",
    ]);
    let times: Vec<&str> = shown[1..].iter().map(|line| line[..11].trim()).collect();
    assert_eq!(times, ["0.000000", "0.010000", "0.010000", "0.869500"]);
    let shown = lines(&[
        "can", "dump", "--from", &log, "--filter", "error", "--count", "5",
    ]);
    assert_eq!(shown.len(), 2);
    let refused = run(&["can", "dump", "--from", &log, "--filter", "nodes=5"]);
    expect_status(&refused, 2);
    assert!(complaint(&refused).contains("is not a filter\nhint: write an identifier"));
}

/// A candump log is reproduced byte for byte; BLF also keeps class and direction.
#[test]
fn dump_writes_logs_without_loss() {
    let log = recording("fault.log");
    let written = expect_status(&run(&["can", "dump", "--from", &log, "--log"]), 0);
    assert_eq!(written, std::fs::read_to_string(&log).unwrap());
    let of_blf = lines(&[
        "can",
        "dump",
        "--from",
        &recording("python_can.blf"),
        "--log",
    ]);
    assert_eq!(of_blf[5], "(1700000000.005000) 1 20000044#0030000000008205");
    assert!(of_blf[6].ends_with(" T"));
    let of_asc = lines(&[
        "can",
        "dump",
        "--from",
        &recording("python_can.asc"),
        "--log",
    ]);
    assert_eq!(of_asc.len(), 7);
}

/// Recordings of a terminal, tcpdump, Wireshark and PEAK's tools.
#[test]
fn dump_of_every_kind_of_recording_shows_frames() {
    let captures = format!("{}/../can/tests/captures", env!("CARGO_MANIFEST_DIR"));
    for (name, frames, line) in [
        ("made.txt", 6, "node 5 SDO < 6041h:00 = 18 02 (fault)"),
        (
            "made.pcap",
            5,
            "705  [ 0]  remote                   node 5 guard",
        ),
        ("made.pcapng", 5, "vcan0           321  [12]"),
        ("python_can.trc", 3, "123  [ 4]  DE AD BE EF"),
    ] {
        let shown = lines(&["can", "dump", "--from", &format!("{captures}/{name}")]);
        assert_eq!(shown.len(), 1 + frames, "{name}");
        let has = shown.iter().any(|shown| shown.contains(line));
        assert!(has, "{name}: {shown:#?}");
    }
}

/// The period changes by 1017h, the node is reset by a command, and a fault comes and goes.
#[test]
fn stat_of_commanded_reset_reports_no_reboot() {
    let file = std::env::temp_dir().join(format!("takt-stat-{}.log", std::process::id()));
    let mut log = Vec::new();
    let mut at = 0;
    let mut frames = |ms: u32, times: usize, frame: &str| {
        for _ in 0..times {
            at += ms;
            log.push(format!(
                "({}.{:03}000) can0 {frame}",
                1_700_000_000 + at / 1_000,
                at % 1_000
            ));
        }
    };
    frames(100, 20, "701#05");
    frames(10, 1, "000#8201");
    frames(14, 1, "701#00");
    frames(100, 10, "701#7F");
    frames(5, 1, "601#2B171000E8030000");
    frames(4, 1, "581#6017100000000000");
    frames(1_000, 6, "701#05");
    frames(5, 1, "081#0152800000007008");
    frames(900, 1, "081#0000000000000000");
    std::fs::write(&file, log.join("\n")).unwrap();
    let path = file.to_str().unwrap();
    let shown = expect_status(&run(&["can", "stat", "--from", path]), 0);
    let report = expect_status(&run(&["can", "stat", "--from", path, "--json"]), 0);
    std::fs::remove_file(&file).unwrap();
    assert!(
        shown.contains("every 100 ms before  1 by NMT reset communication"),
        "{shown}"
    );
    let warned = "WARN  node 1: emergency 5201h control hardware, 1 times, withdrawn since";
    assert!(shown.contains(warned), "{shown}");
    assert!(
        !shown.contains("late") || shown.matches("WARN").count() == 1,
        "{shown}"
    );
    let report: Value = serde_json::from_str(&report).unwrap();
    let node = &report["nodes"][0];
    assert_eq!(
        (&node["late"], &node["reboots"], &node["resets"]),
        (&0.into(), &0.into(), &1.into())
    );
    assert_eq!(node["mean_us"], 1e6);
    assert_eq!(
        (
            &report["sdos"][0]["requests"],
            &report["sdos"][0]["answered"]
        ),
        (&1.into(), &1.into())
    );
    assert_eq!(
        (
            &report["emergencies"][0]["code"],
            &report["emergencies"][0]["present"]
        ),
        (&0x5201.into(), &false.into())
    );
}

#[test]
fn stat_of_unanswered_sdo_requests_fails() {
    let file = std::env::temp_dir().join(format!("takt-silent-{}.txt", std::process::id()));
    let request_and_abort =
        "  can0  601   [8]  40 00 10 00 00 00 00 00\n  can0  601   [8]  80 00 10 00 00 00 04 05\n";
    std::fs::write(&file, request_and_abort.repeat(8)).unwrap();
    let output = run(&["can", "stat", "--from", file.to_str().unwrap(), "--quiet"]);
    std::fs::remove_file(&file).unwrap();
    let shown = expect_status(&output, 1);
    assert!(
        shown.contains("FAIL  node 1: no answer to 8 SDO requests, last 1000h:00"),
        "{shown}"
    );
}

#[test]
fn dump_json_is_one_object_per_frame() {
    let shown = lines(&["can", "dump", "--from", &recording("fault.log"), "--json"]);
    let objects: Vec<Value> = shown
        .iter()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(objects[0]["at_us"], 1_700_000_000_000_000_u64);
    assert_eq!(
        (&objects[0]["id"], &objects[0]["kind"]),
        (&0x705.into(), &"data".into())
    );
    assert_eq!(objects[10]["kind"], "error");
    assert_eq!(
        (&objects[10]["id"], &objects[10]["direction"]),
        (&Value::Null, &"R".into())
    );
    assert_eq!(objects[11]["interface"], "can1");
}

#[test]
fn dump_of_damaged_recording_reports_left_out_lines() {
    let file = std::env::temp_dir().join(format!("takt-can-{}.log", std::process::id()));
    std::fs::write(
        &file,
        "(1.000000) can0 123#11\nrubbish\n(1.000000) can0 123#45:67:89ABCDEF#11\n",
    )
    .unwrap();
    let output = run(&["can", "dump", "--from", file.to_str().unwrap()]);
    std::fs::write(&file, "rubbish\n").unwrap();
    let empty = run(&["can", "stat", "--from", file.to_str().unwrap()]);
    std::fs::remove_file(&file).unwrap();
    assert_eq!(expect_status(&output, 0).lines().count(), 2);
    let errors = complaint(&output);
    assert!(
        errors.contains("line 2: no time stamp") && errors.contains("line 3: a CAN XL frame"),
        "{errors}"
    );
    expect_status(&empty, 2);
    assert!(complaint(&empty).contains("no recording of a CAN bus: candump log or text, ASC"));
}

#[test]
fn stat_of_recording_reports_findings() {
    let arguments = [
        "can",
        "stat",
        "--from",
        &recording("fault.log"),
        "--bitrate",
        "1M",
        "--json",
    ];
    let report: Value = serde_json::from_str(&expect_status(&run(&arguments), 1)).unwrap();
    assert_eq!(
        (&report["interface"], &report["frames"]),
        (&"can0".into(), &15.into())
    );
    let found = report["findings"].as_array().unwrap().iter();
    let names: Vec<_> = found
        .map(|finding| finding["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["alone", "heartbeat-missing", "emergency"]);
    let load = report["load"].as_f64().unwrap();
    assert!(load > 0.0 && load < 0.01, "{load}");

    let other = run(&[
        "can",
        "stat",
        "--from",
        &recording("fault.log"),
        "--channel",
        "can1",
        "--quiet",
    ]);
    assert_eq!(expect_status(&other, 0), "can1: ok\n");
    let absent = run(&[
        "can",
        "stat",
        "--from",
        &recording("fault.log"),
        "--channel",
        "can7",
    ]);
    expect_status(&absent, 2);
    assert!(complaint(&absent).contains("no frames of can7"));
}

#[test]
fn missing_interface_is_named_by_every_command() {
    let log = recording("fault.log");
    for arguments in [
        &["can", "dump", "nosuch0"][..],
        &["can", "stat", "nosuch0"],
        &["can", "send", "nosuch0", "705#R"],
        &["can", "replay", &log, "nosuch0"],
        &["can", "up", "nosuch0", "--show"],
        &["can", "scan", "nosuch0"],
        &["can", "nmt", "nosuch0", "5", "stop"],
        &["can", "sdo", "nosuch0", "5", "upload", "1000"],
        &["can", "drive", "nosuch0", "5", "--watch"],
        &["can", "rmp", "nosuch0"],
        &["can", "rmp", "--serial", "/dev/nosuch0"],
    ] {
        let output = run(arguments);
        expect_status(&output, 2);
        let error = complaint(&output);
        assert!(
            error.contains("nosuch0") && !error.contains("panicked"),
            "{error}"
        );
    }
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table of arguments")]
fn invalid_arguments_are_rejected_with_the_cause() {
    for (arguments, words) in [
        (
            &["can", "nmt", "can0", "128", "stop"][..],
            "`128` is not a node number; they are 1 to 127, or `all`",
        ),
        (
            &["can", "nmt", "can0", "all", "stop", "--timeout", "1s"],
            "--timeout needs one node",
        ),
        (
            &["can", "sdo", "can0", "0", "upload", "1000"],
            "they are 1 to 127",
        ),
        (&["can", "sdo", "can0", "5", "download", "1017"], "required"),
        (
            &["can", "drive", "can0", "5", "--mode", "fast"],
            "`fast` is no mode",
        ),
        (
            &["can", "drive", "can0", "5", "--jog", "5", "--mode", "hm"],
            "omit --mode",
        ),
        (
            &["can", "scan", "can0", "--nodes", "1-200"],
            "no node number",
        ),
        (&["can", "rmp", "can0", "--jog", "9,0"], "too fast to jog"),
        (&["can", "rmp", "can0", "--set", "scale=3"], "is no setting"),
        (
            &[
                "emulate",
                "drive",
                "--interface",
                "can0",
                "--fault",
                "burns",
            ],
            "`burns` is no fault; those of nodes are off, heartbeat-off",
        ),
        (
            &[
                "emulate",
                "drive",
                "--interface",
                "can0",
                "--interpolation",
                "300ms",
            ],
            "60C2h cannot hold `300ms`",
        ),
        (
            &["can", "dump", "can0", "--dbc", "tests/can/fault.log"],
            "it is no DBC file",
        ),
        (
            &[
                "emulate",
                "node",
                "--eds",
                "tests/can/fault.log",
                "--interface",
                "can0",
            ],
            "tests/can/fault.log",
        ),
    ] {
        let output = run(arguments);
        expect_status(&output, 2);
        let error = complaint(&output);
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn rmp_at_unread_serial_port_ends_and_reports_drops() {
    let mut powerbase = Process::start(&["emulate", "rmp"]);
    let line = powerbase.wait_for("power base at ");
    let port = line.rsplit(' ').next().unwrap();
    // The terminal keeps the packets of a second or two.
    std::thread::sleep(std::time::Duration::from_secs(4));
    let read = run(&["can", "rmp", "--serial", port, "--duration", "1s", "--json"]);
    let read: Value = serde_json::from_str(&expect_status(&read, 0)).unwrap();
    assert_eq!(read["model"], "rmp200");
    powerbase.terminate();
    let (lines, status) = powerbase.end();
    assert_eq!(status, Some(0), "{lines:?}");
    assert!(
        lines
            .iter()
            .any(|line| line.contains("no program read the port: dropped")),
        "{lines:?}"
    );
}

/// The power base at a pseudo-terminal, as at the serial port of its USB chip.
#[test]
fn rmp_at_a_serial_port_is_shown_and_driven() {
    steady(|| {
        let mut powerbase = Process::start(&["emulate", "rmp"]);
        let line = powerbase.wait_for("power base at ");
        let port = line.rsplit(' ').next().unwrap();
        let seen = run(&["can", "rmp", "--serial", port, "--duration", "1s", "--json"]);
        let seen: Value = serde_json::from_str(&expect_status(&seen, 0)).unwrap();
        assert_eq!(
            (&seen["model"], &seen["measured"]["mode"]),
            (&"rmp200".into(), &"disabled".into())
        );
        let refused = run(&["can", "rmp", "--serial", port, "--jog", "0.2"]);
        expect_status(&refused, 2);
        assert!(
            complaint(&refused).contains("with --yes"),
            "{}",
            complaint(&refused)
        );
        let driven = run(&[
            "can",
            "rmp",
            "--serial",
            port,
            "--jog",
            "0.2",
            "--duration",
            "1s",
            "--yes",
        ]);
        let output = expect_status(&driven, 0);
        assert!(output.contains("ok, drove and is at rest"), "{output}");
        powerbase.terminate();
        let (lines, _) = powerbase.end();
        let last = lines.last().unwrap();
        let distance: f64 = last.split([' ', ',']).nth(2).unwrap().parse().unwrap();
        assert!(distance > 0.05, "{last}");
    });
}
