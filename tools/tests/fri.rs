//! `takt fri` live, against emulated controllers over UDP on the loopback. Texts are asserted, never how fast a host
//! is; networks that are wrong are in `fri_network`.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot go on ends"
)]

mod common;

use std::net::UdpSocket;
use std::time::Duration;

use common::{Folder, Process, alone, complaint, expect_status, run};
use serde_json::Value;
use takt_fri::capture::{Datagram, Writer};
use takt_fri::lwr::emulator::{Krc, KrcConfig};
use takt_fri::lwr::wire::Msr;
use takt_fri::lwr::{Session, SessionConfig};
use takt_tests::steady;

/// `takt fri` with these words at a port that the system chooses, and that port's address.
fn listening(words: &[&str]) -> (Process, String) {
    let mut process = Process::start(&[&["fri"], words, &["--listen", "127.0.0.1:0"]].concat());
    let line = process.wait_for("waiting for a controller at");
    let address = line.rsplit(' ').next().unwrap().to_owned();
    (process, address)
}

fn lwr(target: &str, more: &[&str]) -> Process {
    Process::start(&[&["emulate", "lwr", "--connect", target], more].concat())
}

fn iiwa(target: &str, dialect: &str) -> Process {
    Process::start(&["emulate", "iiwa", "--connect", target, "--dialect", dialect])
}

/// The JSON report among the lines of a process that has ended.
fn report(lines: &[String]) -> Value {
    let json = lines.iter().find(|line| line.starts_with('{'));
    serde_json::from_str(json.unwrap_or_else(|| panic!("no report among {lines:#?}"))).unwrap()
}

#[test]
fn monitor_answers_every_controller() {
    let _alone = alone();
    let (mut monitor, address) = listening(&["monitor"]);
    let mut arm = lwr(&address, &[]);
    monitor.wait_for("speaks FRI 1.0 (LWR), period 1ms");
    monitor.wait_for("answered 1.000");
    // The posture in which the emulated arm rests: nothing was asked of it.
    monitor.wait_for("joints 0.00 28.65 0.00 -68.75 0.00 45.84 0.00 deg");
    arm.kill();
    monitor.wait_for("the controller is silent");
    let _arm = iiwa(&address, "v3");
    monitor.wait_for("speaks FRI 2.7 (3.0) of Sunrise, period 2ms");
    monitor.terminate();
    let (lines, status) = monitor.end();
    assert_eq!(status, Some(1), "{lines:#?}");
    let says = |text: &str| lines.iter().any(|line| line.contains(text));
    assert!(says("the controller fell silent 1 times"), "{lines:#?}");
}

#[test]
fn stat_judges_live_arm() {
    let _alone = alone();
    let (stat, address) = listening(&["stat", "--duration", "2s", "--json"]);
    let _arm = iiwa(&address, "v2");
    let (lines, _) = stat.end();
    let report = report(&lines);
    let connection = &report["connections"][0];
    assert_eq!(connection["generation"], "FRI 2.0 to 2.5 of Sunrise");
    assert_eq!(connection["period_us"], 2000.0);
    assert_eq!(connection["host"], address.as_str());
    assert!(connection["answers"].as_u64().unwrap() > 0);
    assert!(connection["latency_us"]["p50"].as_f64().unwrap() > 0.0);
    assert_eq!(report["silence"], Value::Null);
    assert_eq!(report["rt_allocations"], 0);
}

#[test]
fn stat_fails_where_the_network_loses_datagrams() {
    let _alone = alone();
    let (stat, address) = listening(&["stat", "--duration", "2s", "--json"]);
    let _arm = lwr(&address, &["--drop", "0.2"]);
    let (lines, status) = stat.end();
    assert_eq!(status, Some(1));
    let report = report(&lines);
    assert_eq!(report["good"], false);
    assert!(
        report["connections"][0]["lost"].as_u64().unwrap() > 50,
        "{report}"
    );
}

#[test]
fn move_moves_one_joint_of_either_robot() {
    steady(|| {
        let _alone = alone();
        let words = [
            "move",
            "--joint",
            "4",
            "--by",
            "-2deg",
            "--velocity",
            "10deg/s",
            "--yes",
        ];
        let (process, address) = listening(&words);
        let arm = lwr(&address, &[]);
        let (lines, status) = process.end();
        assert_eq!(status, Some(0), "{lines:#?}");
        let says = |text: &str| lines.iter().any(|line| line.contains(text));
        assert!(
            says("A3 (joint 4) moves from -68.75 deg to -70.75 deg"),
            "{lines:#?}"
        );
        assert!(
            says("A3 arrived: -2.00 deg requested, -2.00 deg measured"),
            "{lines:#?}"
        );
        drop(arm);
        for dialect in ["v1", "v3"] {
            let (process, address) = listening(&words);
            let _arm = iiwa(&address, dialect);
            let (lines, status) = process.end();
            assert_eq!(status, Some(0), "{lines:#?}");
            let says = |text: &str| lines.iter().any(|line| line.contains(text));
            assert!(says("A4 arrived: -2.00 deg requested"), "{lines:#?}");
        }
    });
}

#[test]
fn fri_move_brakes_on_sigterm() {
    steady(|| {
        let _alone = alone();
        let words = [
            "move",
            "--joint",
            "1",
            "--by",
            "15deg",
            "--velocity",
            "1deg/s",
            "--yes",
        ];
        let (mut process, address) = listening(&words);
        let _arm = lwr(&address, &[]);
        process.wait_for("the robot follows; Ctrl-C brakes");
        process.terminate();
        let (lines, status) = process.end();
        assert_eq!(status, Some(1), "{lines:#?}");
        assert!(
            lines
                .iter()
                .any(|line| line == "braked to rest before the goal, as requested"),
            "{lines:#?}"
        );
    });
}

#[test]
fn move_refuses_unsafe_requests() {
    let _alone = alone();
    let (process, address) = listening(&[
        "move",
        "--joint",
        "1",
        "--by",
        "5deg",
        "--yes",
        "--ready-timeout",
        "3s",
    ]);
    let arm = lwr(&address, &["--drop", "0.5"]);
    let (lines, status) = process.end();
    assert_eq!(status, Some(1), "{lines:#?}");
    assert!(
        lines
            .iter()
            .any(|line| line.contains("too bad for a motion")),
        "{lines:#?}"
    );
    drop(arm);
    // No terminal to ask on, and no --yes.
    let (process, address) = listening(&["move", "--joint", "1", "--by", "5deg"]);
    let _arm = lwr(&address, &[]);
    let (lines, status) = process.end();
    assert_eq!(status, Some(2), "{lines:#?}");
    assert!(
        lines.iter().any(|line| line.contains("with --yes")),
        "{lines:#?}"
    );
}

#[test]
fn listen_on_unavailable_port_names_cause() {
    let (first, address) = listening(&["monitor"]);
    let second = run(&["fri", "stat", "--listen", &address]);
    expect_status(&second, 2);
    let text = complaint(&second);
    assert!(
        text.contains("is taken by `takt` (process ") && text.contains("\nhint: end it first"),
        "{text}"
    );
    drop(first);
    // An address for documentation (RFC 5737) that no host has.
    let wrong = run(&["fri", "monitor", "--listen", "203.0.113.77:49938"]);
    expect_status(&wrong, 2);
    let text = complaint(&wrong);
    assert!(
        text.contains("203.0.113.77 is no address of this host, which has 127.0.0.1/8 on lo"),
        "{text}"
    );
}

#[test]
fn silence_is_explained() {
    // Datagrams to another port would be the explanation.
    let _alone = alone();
    let silent = run(&["fri", "stat", "--listen", "127.0.0.1:0", "--timeout", "1s"]);
    let text = expect_status(&silent, 1);
    assert!(
        text.contains("no measurement arrives at 127.0.0.1:"),
        "{text}"
    );
    assert!(text.contains("has the robot program opened FRI"), "{text}");
}

#[test]
fn stat_names_datagrams_other_than_measurements() {
    let _alone = alone();
    let (stat, address) = listening(&["stat", "--expect", "v1"]);
    let arm = iiwa(&address, "v3");
    let (lines, status) = stat.end();
    assert_eq!(status, Some(1));
    let says = |lines: &[String], text: &str| {
        assert!(lines.iter().any(|line| line.contains(text)), "{lines:#?}");
    };
    says(
        &lines,
        "the controller speaks FRI 2.7 (3.0), this session is configured for FRI 1.x",
    );
    drop(arm);
    let (stat, address) = listening(&["stat", "--expect", "v2"]);
    let arm = lwr(&address, &[]);
    let (lines, status) = stat.end();
    assert_eq!(status, Some(1));
    says(
        &lines,
        "the controller speaks FRI 1.0 (LWR), expected FRI 2.0 to 2.5 of Sunrise",
    );
    drop(arm);
    let (stat, address) = listening(&["stat"]);
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut command = [0; takt_fri::lwr::wire::Cmd::LEN];
    takt_fri::lwr::wire::Cmd::default()
        .encode(&mut command)
        .unwrap();
    client.send_to(&command, &address).unwrap();
    let (lines, status) = stat.end();
    assert_eq!(status, Some(1));
    says(
        &lines,
        "a second client sends to this host instead of a controller",
    );
}

#[test]
fn two_controllers_with_one_target_are_distinguished() {
    let _alone = alone();
    let (stat, address) = listening(&["stat", "--duration", "2s"]);
    let _arms = [lwr(&address, &[]), lwr(&address, &[])];
    let (lines, status) = stat.end();
    assert_eq!(status, Some(1));
    assert!(
        lines
            .iter()
            .any(|line| line.contains("sends measurements to this port too")),
        "{lines:#?}"
    );
}

#[test]
fn krc_strict_loses_10_answers_leaves_command_mode() {
    let _alone = alone();
    let (mut monitor, address) = listening(&["monitor"]);
    let mut arm = lwr(&address, &["--strict"]);
    arm.wait_for("CMD, quality PERFECT");
    monitor.kill();
    let line = arm.wait_for("left command mode");
    assert!(
        line.contains("no answer for 10 cycles") || line.contains("UNACCEPTABLE"),
        "{line}"
    );
}

#[test]
fn krc_with_handshake_starts_on_request_only() {
    let _alone = alone();
    let (_monitor, address) = listening(&["monitor"]);
    let words = ["--handshake", "kuka-lwr", "--duration", "3s"];
    let (lines, status) = lwr(&address, &words).end();
    assert_eq!(status, Some(0), "{lines:#?}");
    assert!(
        lines.iter().any(|line| line.starts_with("MON, ")),
        "{lines:#?}"
    );
    assert!(
        !lines.iter().any(|line| line.starts_with("CMD, ")),
        "{lines:#?}"
    );
}

/// A loopback address and port that nothing has.
fn free_address() -> String {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.local_addr().unwrap().to_string()
}

#[test]
fn stat_started_after_controller_is_good() {
    steady(|| {
        let _alone = alone();
        let address = free_address();
        for robot in ["lwr", "iiwa"] {
            let words = ["emulate", robot, "--connect", &address, "--period", "10ms"];
            let mut arm = Process::start(&words);
            arm.wait_for("from 127.0.0.1:");
            let words = [
                "fri",
                "stat",
                "--listen",
                &address,
                "--duration",
                "2s",
                "--json",
            ];
            let (lines, status) = Process::start(&words).end();
            assert_eq!(status, Some(0), "{lines:#?}");
            let report = report(&lines);
            let connection = &report["connections"][0];
            assert_eq!(connection["verdict"], "good", "{report}");
            assert!(connection["wake_up_us"]["p50"].as_f64().unwrap() > 0.0);
            arm.kill();
        }
    });
}

#[test]
fn client_connected_to_robot_receives_messages() {
    let _alone = alone();
    // As a client of KUKA does: it receives from the address of the robot alone.
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    let robot = UdpSocket::bind("127.0.0.2:0")
        .unwrap()
        .local_addr()
        .unwrap();
    client.connect(robot).unwrap();
    client
        .set_read_timeout(Some(Duration::from_secs(60)))
        .unwrap();
    let (target, bind) = (client.local_addr().unwrap().to_string(), robot.to_string());
    let mut words = vec!["emulate", "iiwa", "--connect", &target, "--bind", &bind];
    words.extend([
        "--input",
        "Media.Key=true",
        "--output",
        "Media.Count=3",
        "--frame",
        "Tool",
    ]);
    let mut arm = Process::start(&words);
    let mut bytes = [0; 1_500];
    let mut next = || {
        let len = client.recv(&mut bytes).unwrap();
        takt_fri::sunrise::wire::Monitoring::decode(&bytes[..len]).unwrap()
    };
    let message = next();
    let ios = message.monitor.unwrap().ios;
    let names: Vec<_> = ios.iter().map(|io| io.name.to_string()).collect();
    assert_eq!(names, ["Media.Key", "Media.Count"]);
    assert!(message.requested.iter().next().unwrap().name.is("Tool"));
    // It handles signals once it prints its state.
    arm.wait_for("MONITORING_WAIT");
    for _ in 0..300 {
        next();
    }
    arm.terminate();
    // The last message says that the session is closed.
    while next().state() != takt_fri::sunrise::wire::SessionState::Idle {}
    assert_eq!(arm.end().1, Some(0));
}

#[test]
fn fri_move_names_wrong_overlay_at_once() {
    let _alone = alone();
    let (process, address) = listening(&["move", "--joint", "1", "--by", "5deg", "--yes"]);
    let _arm = Process::start(&[
        "emulate",
        "iiwa",
        "--connect",
        &address,
        "--overlay",
        "wrench",
    ]);
    let (lines, status) = process.end();
    assert_eq!(status, Some(1), "{lines:#?}");
    let says = |text: &str| lines.iter().any(|line| line.contains(text));
    assert!(
        says("the overlay of the robot program accepts wrench"),
        "{lines:#?}"
    );
}

#[test]
fn cut_recording_is_judged_up_to_the_cut() {
    let folder = Folder::new();
    let path = folder.file("cut.pcap");
    let whole = recording(Duration::from_micros(50));
    std::fs::write(&path, &whole[..whole.len() - 400]).unwrap();
    let output = run(&["fri", "stat", "--from", &path, "--quiet"]);
    let text = expect_status(&output, 0);
    assert_eq!(text, "192.168.0.20:49152 > 192.168.0.5:49938: good\n");
    assert!(
        complaint(&output).starts_with("note: "),
        "{}",
        complaint(&output)
    );
}

/// 500 measurements of an emulated arm in virtual time, and their answers `late` after them.
fn recording(late: Duration) -> Vec<u8> {
    let (robot, host) = ("192.168.0.20:49152", "192.168.0.5:49938");
    let mut writer = Writer::new(Vec::new()).unwrap();
    let mut krc = Krc::new(KrcConfig::default(), Duration::ZERO);
    let mut session = Session::new(SessionConfig::default());
    let mut bytes = [0; Msr::LEN];
    let mut write = |at, from: &str, to: &str, bytes: &[u8]| {
        let (from, to) = (from.parse().unwrap(), to.parse().unwrap());
        let bytes = bytes.to_vec();
        let datagram = Datagram {
            at,
            from,
            to,
            bytes,
        };
        writer.write(&datagram).unwrap();
    };
    for _ in 0..500 {
        let now = krc.poll_timeout();
        let len = krc.poll_transmit(now, &mut bytes).unwrap();
        write(now, robot, host, &bytes[..len]);
        session.handle_datagram(&bytes[..len], now).unwrap();
        let len = session.answer(None, &mut bytes).unwrap();
        write(now + late, host, robot, &bytes[..len]);
        krc.handle_datagram(&bytes[..len], now).unwrap();
    }
    writer.into_inner()
}

#[test]
fn recordings_are_judged_as_live_connections_are() {
    let folder = Folder::new();
    let stat = |name: &str, late_us, more: &[&str]| {
        let path = folder.file(name);
        std::fs::write(&path, recording(Duration::from_micros(late_us))).unwrap();
        run(&[&["fri", "stat", "--from", &path], more].concat())
    };
    let good = expect_status(&stat("good.pcap", 50, &["--quiet"]), 0);
    assert_eq!(good, "192.168.0.20:49152 > 192.168.0.5:49938: good\n");
    let late = expect_status(&stat("late.pcap", 1_500, &["--json"]), 1);
    let late: Value = serde_json::from_str(&late).unwrap();
    let connection = &late["connections"][0];
    let verdict = connection["verdict"].as_str().unwrap();
    let expected = "this host answers late: 100.0 % of answers";
    assert!(verdict.starts_with(expected), "{late}");
    let timeline = connection["timeline"].as_array().unwrap();
    assert_eq!(timeline[0]["state"], "MON", "{late}");
    assert!(timeline.iter().any(|it| it["state"] == "CMD"), "{late}");
    assert_eq!(connection["latency_us"], Value::Null);
    let path = folder.file("good.pcap");
    let shown = run(&["fri", "monitor", "--from", &path, "--count", "2"]);
    let shown = expect_status(&shown, 0);
    let lines: Vec<_> = shown.lines().collect();
    assert_eq!(lines.len(), 2);
    assert!(
        lines[0].contains("192.168.0.20:49152 > 192.168.0.5:49938 MSR"),
        "{shown}"
    );
}
