//! `takt fri` with recordings, made here in virtual time by emulated controllers, and `takt emulate iiwa` as seen
//! from the wire.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::fs::File;
use std::net::{SocketAddrV4, UdpSocket};
use std::time::Duration;

use common::{Folder, complaint, expect_status, run};
use serde_json::Value;
use takt_fri::capture::{Datagram, Writer};
use takt_fri::lwr::emulator::{Krc, KrcConfig};
use takt_fri::lwr::{self, wire::Cmd};
use takt_fri::sunrise::emulator::{Cabinet, CabinetConfig};
use takt_fri::sunrise::wire::{Dialect, MESSAGE_MAX, Monitoring, unframe};
use takt_fri::sunrise::{self, Demand};

/// When the recordings begin, since 1970.
const EPOCH: Duration = Duration::from_secs(1_700_000_000);
/// Measurements of each connection.
const CYCLES: usize = 400;

fn ends() -> [SocketAddrV4; 2] {
    ["192.168.0.10:30200", "192.168.0.1:30200"].map(|text| text.parse().unwrap())
}

fn datagram(at: Duration, [from, to]: [SocketAddrV4; 2], bytes: &[u8]) -> Datagram {
    let at = EPOCH + at;
    let bytes = bytes.to_vec();
    Datagram {
        at,
        from,
        to,
        bytes,
    }
}

/// What an iiwa and a host say to each other whose answers take `answer`.
fn sunrise(dialect: Dialect, answer: Duration) -> Vec<Datagram> {
    let config = CabinetConfig {
        dialect,
        ..CabinetConfig::default()
    };
    let mut cabinet = Cabinet::new(config, Duration::ZERO);
    let mut session = sunrise::Session::new(sunrise::SessionConfig::default());
    let [robot, host] = ends();
    let mut said = Vec::new();
    for _ in 0..CYCLES {
        let now = cabinet.poll_timeout();
        let mut buf = [0; MESSAGE_MAX];
        while let Some(len) = cabinet.poll_transmit(now, &mut buf) {
            said.push(datagram(now, [robot, host], &buf[..len]));
            session.handle_datagram(&buf[..len], now).unwrap();
            let len = session.answer(&Demand::Hold, &mut buf).unwrap().len;
            said.push(datagram(now + answer, [host, robot], &buf[..len]));
            cabinet.handle_datagram(&buf[..len], now + answer).unwrap();
        }
    }
    said
}

/// The same of an LWR at the next address.
fn lwr(answer: Duration) -> Vec<Datagram> {
    let mut krc = Krc::new(KrcConfig::default(), Duration::ZERO);
    let mut session = lwr::Session::new(lwr::SessionConfig::default());
    let [robot, host] = ["192.168.0.20:49938", "192.168.0.1:49938"].map(|a| a.parse().unwrap());
    let mut said = Vec::new();
    for _ in 0..CYCLES {
        let now = krc.poll_timeout();
        let mut buf = [0; MESSAGE_MAX];
        while let Some(len) = krc.poll_transmit(now, &mut buf) {
            said.push(datagram(now, [robot, host], &buf[..len]));
            session.handle_datagram(&buf[..len], now).unwrap();
            let mut cmd = [0; Cmd::LEN];
            let len = session.answer(None, &mut cmd).unwrap();
            said.push(datagram(now + answer, [host, robot], &cmd[..len]));
            krc.handle_datagram(&cmd[..len], now + answer).unwrap();
        }
    }
    said
}

fn recorded(place: &Folder, mut said: Vec<Datagram>) -> String {
    said.sort_by_key(|datagram| datagram.at);
    let path = place.file("arm.pcap");
    let mut writer = Writer::new(File::create(&path).unwrap()).unwrap();
    for datagram in said {
        writer.write(&datagram).unwrap();
    }
    path
}

const PROMPT: Duration = Duration::from_micros(50);

#[test]
fn stat_is_content_with_prompt_answers_of_every_dialect() {
    for dialect in [Dialect::V1, Dialect::V2, Dialect::V3] {
        let place = Folder::new();
        let file = recorded(&place, sunrise(dialect, PROMPT));
        let text = expect_status(&run(&["fri", "stat", "--from", &file]), 0);
        let verdict = "192.168.0.10:30200 > 192.168.0.1:30200: good";
        assert!(text.lines().any(|line| line == verdict), "{text}");
        assert!(
            text.contains("FRI of Sunrise") && text.contains("period 2ms"),
            "{text}"
        );
    }
}

#[test]
fn stat_names_a_host_that_answers_late_and_the_remedy() {
    let place = Folder::new();
    let file = recorded(&place, sunrise(Dialect::V1, Duration::from_micros(1_600)));
    let quiet = expect_status(&run(&["fri", "stat", "--from", &file, "--quiet"]), 1);
    let lines: Vec<&str> = quiet.lines().collect();
    assert_eq!(lines.len(), 2, "{quiet}");
    assert!(
        lines[0].contains("this host is late: 100.0 % of answers"),
        "{quiet}"
    );
    assert!(lines[1].contains("takt doctor"), "{quiet}");
}

#[test]
fn stat_tells_two_robots_of_one_recording_apart() {
    let place = Folder::new();
    let mut said = sunrise(Dialect::V2, PROMPT);
    said.extend(
        lwr(PROMPT)
            .into_iter()
            .filter(|d| d.to.port() == 49938 && d.bytes.len() > 900),
    );
    said.push(datagram(PROMPT, ends(), b"not FRI at all"));
    let file = recorded(&place, said);
    let text = expect_status(&run(&["fri", "stat", "--from", &file, "--json"]), 1);
    let told: Value = serde_json::from_str(&text).unwrap();
    let connections = told["connections"].as_array().unwrap();
    let [iiwa, lwr] = &connections[..] else {
        panic!("{text}");
    };
    assert_eq!(
        (&told["good"], &told["foreign"]),
        (&false.into(), &1.into())
    );
    assert_eq!(iiwa["verdict"], "good");
    assert_eq!(iiwa["measurements"], CYCLES);
    assert_eq!(lwr["generation"], "FRI 1.0");
    assert_eq!(lwr["verdict"], "nobody answers the controller");
}

#[test]
fn monitor_shows_one_line_per_datagram() {
    let place = Folder::new();
    let mut said = lwr(PROMPT);
    said.push(datagram(Duration::ZERO, ends(), b"not FRI at all"));
    let count = said.len();
    let file = recorded(&place, said);
    let lines = |more: &[&str]| {
        let arguments = [&["fri", "monitor", "--from", &file], more].concat();
        expect_status(&run(&arguments), 0).lines().count()
    };
    assert_eq!(lines(&[]), count - 1);
    assert_eq!(lines(&["--all"]), count);
    assert_eq!(lines(&["--count", "3"]), 3);
}

#[test]
fn what_is_no_recording_of_fri_is_refused_with_the_remedy() {
    let place = Folder::new();
    let text = place.write(
        "notes.txt",
        "no recording at all, but long enough for a header",
    );
    let refused = run(&["fri", "stat", "--from", &text]);
    expect_status(&refused, 2);
    assert!(
        complaint(&refused).contains("tcpdump"),
        "{}",
        complaint(&refused)
    );
    let file = recorded(&place, vec![datagram(PROMPT, ends(), b"other")]);
    let refused = run(&["fri", "stat", "--from", &file]);
    expect_status(&refused, 2);
    assert!(complaint(&refused).contains("no FRI datagram among 1 others"));
}

#[test]
fn an_emulated_iiwa_speaks_the_dialect_asked_for() {
    for (word, dialect) in [
        ("v1", Dialect::V1),
        ("v2", Dialect::V2),
        ("v3", Dialect::V3),
    ] {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let target = socket.local_addr().unwrap().to_string();
        let arguments = [
            "emulate",
            "iiwa",
            "--target",
            &target,
            "--dialect",
            word,
            "--model",
            "7",
            "--duration",
            "100ms",
        ];
        let text = expect_status(&run(&arguments), 0);
        assert!(
            text.starts_with("iiwa sends messages to 127.0.0.1:"),
            "{text}"
        );
        let mut buf = [0; MESSAGE_MAX];
        let len = socket.recv(&mut buf).unwrap();
        let (is_framed, message) = unframe(&buf[..len]).unwrap();
        let message = Monitoring::decode(message).unwrap();
        assert_eq!(Dialect::of(is_framed, &message), Some(dialect));
    }
}
