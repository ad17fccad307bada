//! `takt scope` against a peer that speaks the scope's messages: samples in files, captures, losses, lost connections, wrong names;
//! and against a controller with an emulated arm.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;
#[path = "common/terminal.rs"]
mod terminal;

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use common::{Cell, Folder, Process, alone, complaint, expect_status, run, takt};
use serde_json::{Value, json};
use takt_tests::steady;
use terminal::Terminal;
use tungstenite::{Message, WebSocket};

type Socket = WebSocket<TcpStream>;

/// A controller that has the resources of the scope only.
struct Peer {
    address: String,
    is_refusing: Arc<AtomicBool>,
}

impl Peer {
    /// Calls `serve` with each connection and what it requests.
    fn start(serve: impl Fn(&mut Socket, &Value) + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let is_refusing = Arc::new(AtomicBool::new(false));
        let (serve, refuses) = (Arc::new(serve), Arc::clone(&is_refusing));
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                if refuses.load(Ordering::Relaxed) {
                    continue;
                }
                let serve = Arc::clone(&serve);
                std::thread::spawn(move || answer(stream, &*serve));
            }
        });
        Self {
            address,
            is_refusing,
        }
    }

    fn scope(&self, args: &[&str]) -> std::process::Output {
        run(&[&["scope"], args, &["--connect", &self.address]].concat())
    }
}

fn answer(mut stream: TcpStream, serve: &dyn Fn(&mut Socket, &Value)) {
    let mut head = [0; 1024];
    let count = stream.peek(&mut head).unwrap();
    if head[..count].starts_with(b"GET /scope ") {
        let mut socket = tungstenite::accept(stream).unwrap();
        let request = socket.read().unwrap();
        let request = serde_json::from_str(request.to_text().unwrap()).unwrap();
        serve(&mut socket, &request);
        return;
    }
    let _ = stream.read(&mut head);
    let name =
        |name: &str| json!({ "name": name, "unit": "rad", "thread": "nets", "period_s": 0.001 });
    let probes = json!({ "probe": [name("left.joint.0.measured"), name("left.joint.0.error")] });
    let body = probes.to_string();
    let length = body.len();
    let _ = write!(
        stream,
        "HTTP/1.1 200 OK\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    );
}

fn say(socket: &mut Socket, message: &Value) {
    // The client may have ended.
    let _ = socket.send(Message::text(message.to_string()));
}

/// All requested probes in one group; those with `jont` in their names are rejected.
fn setup(socket: &mut Socket, request: &Value) -> usize {
    let names = request["probes"].as_array().unwrap().iter();
    let (wrong, good): (Vec<_>, Vec<_>) =
        names.partition(|name| name.as_str().unwrap().contains("jont"));
    let probe = |name: &&Value| json!({ "name": name, "unit": "rad" });
    let rejected =
        |name: &Value| json!({ "probe": name, "cause": "there is no such probe", "hint": "" });
    let group = json!({
        "thread": "nets", "period_s": 0.001, "probes": good.iter().map(probe).collect::<Vec<_>>(),
    });
    let rejected: Vec<_> = wrong.into_iter().map(rejected).collect();
    let scope = json!({ "version": 1, "groups": [group], "rejected": rejected });
    say(socket, &json!({ "scope": scope }));
    good.len()
}

fn send(socket: &mut Socket, group: u32, lost: u32, columns: usize, values: &[f64]) -> bool {
    let rows = u32::try_from(values.len() / (columns + 1)).unwrap();
    let head = [group, rows, u32::try_from(columns).unwrap(), lost];
    let head = head.iter().flat_map(|it| it.to_le_bytes());
    let values = values.iter().flat_map(|it| it.to_le_bytes());
    let bytes: Vec<u8> = head.chain(values).collect();
    socket.send(Message::binary(bytes)).is_ok()
}

/// Three samples of each probe, and then nothing until the client ends.
fn three(socket: &mut Socket, request: &Value) {
    let columns = setup(socket, request);
    if request["trigger"].is_object() {
        say(
            socket,
            &json!({ "triggered": { "time_s": 1.001, "cause": "left.joint.0.measured above 0.2" } }),
        );
    }
    let mut values = Vec::new();
    for (time, value) in [(1.0, 0.5), (1.001, 0.25), (1.002, f64::NAN)] {
        values.push(time);
        values.extend(std::iter::repeat_n(value, columns));
    }
    send(socket, 0, 0, columns, &values);
    if request["trigger"].is_object() {
        say(
            socket,
            &json!({ "done": { "cause": "mode single has its capture" } }),
        );
    }
    while socket.read().is_ok() {}
}

const CSV: &str = "\
time (s),left.joint.0.measured (rad),left.joint.0.error (rad)
1.000000000,0.5,0.5
1.001000000,0.25,0.25
1.002000000,,
";

#[test]
fn scope_writes_csv_svg_mcap_and_figures() {
    let peer = Peer::start(three);
    let folder = Folder::new();
    let (csv, svg, mcap) = (
        folder.file("a.csv"),
        folder.file("a.svg"),
        folder.file("a.mcap"),
    );
    let args = [
        "--probe",
        "left.joint.0.*",
        "--duration=1s",
        "--csv",
        &csv,
        "--svg",
        &svg,
        "--mcap",
        &mcap,
        "--json",
    ];
    let json: Value = serde_json::from_str(&expect_status(&peer.scope(&args), 0)).unwrap();
    assert_eq!(std::fs::read_to_string(&csv).unwrap(), CSV);
    assert!(
        std::fs::read_to_string(&svg)
            .unwrap()
            .contains("left.joint.0.error")
    );
    let recording = std::fs::read(&mcap).unwrap();
    assert!(recording.starts_with(b"\x89MCAP0\r\n") && recording.ends_with(b"\x89MCAP0\r\n"));
    assert_eq!(json["schema"], "takt-scope/1");
    assert_eq!(json["probes"][1]["name"], "left.joint.0.error");
    assert_eq!(json["probes"][1]["samples"], 3);
    assert_eq!(json["probes"][1]["null"], 1);
    assert_eq!(json["lost"], 0);
    // The same on standard output, for a pipe, and as a table.
    let args = ["--probe", "left.joint.0.*", "--duration=1s", "--csv", "-"];
    assert_eq!(expect_status(&peer.scope(&args), 0), CSV);
    let args = ["--probe", "left.joint.0.error", "--duration=1s"];
    let text = expect_status(&peer.scope(&args), 0);
    assert!(text.contains(": 0.002 s, 0 samples lost\nprobe "), "{text}");
}

#[test]
fn scope_single_capture_ends_by_itself() {
    let peer = Peer::start(|socket, request| {
        assert_eq!(request["mode"], "single");
        assert_eq!(request["pre_s"], 0.25);
        assert_eq!(request["trigger"]["level"], 0.2);
        three(socket, request);
    });
    let args = [
        "--probe",
        "left.joint.0.measured",
        "--trigger",
        "left.joint.0.measured>0.2",
        "--pre=250ms",
        "--csv=-",
    ];
    let output = peer.scope(&args);
    let text = expect_status(&output, 0);
    assert_eq!(
        text,
        "capture,time (s),from trigger (s),left.joint.0.measured (rad)\n\
         1,1.000000000,-0.001000000,0.5\n1,1.001000000,0.000000000,0.25\n1,1.002000000,0.001000000,\n"
    );
    let why = complaint(&output);
    assert!(
        why.contains("triggered at 1.001000 s: left.joint.0.measured above 0.2"),
        "{why}"
    );
}

#[test]
fn scope_without_trigger_event_fails() {
    let peer = Peer::start(|socket, request| {
        setup(socket, request);
        while socket.read().is_ok() {}
    });
    let args = ["--probe=a.b", "--trigger=fault left", "--duration=500ms"];
    let output = peer.scope(&args);
    expect_status(&output, 1);
    assert!(complaint(&output).contains("no trigger was found\nhint: "));
}

#[test]
fn scope_slow_reader_shows_what_was_lost() {
    // More than is buffered on the way; the controller counts what does not fit.
    let peer = Peer::start(|socket, request| {
        let columns = setup(socket, request);
        for number in 0..2_000_u32 {
            let rows: Vec<f64> = (0..64)
                .flat_map(|row| [f64::from(number) + f64::from(row) / 64.0, 1.0])
                .collect();
            let lost = if number == 1_000 { 7 } else { 0 };
            if !send(socket, 0, lost, columns, &rows) {
                return;
            }
        }
        say(socket, &json!({ "lost": { "group": 0, "samples": 5 } }));
        while socket.read().is_ok() {}
    });
    let folder = Folder::new();
    let csv = folder.file("a.csv");
    let args = ["--probe=a.b", "--duration=8s", "--json", "--csv", &csv];
    let output = peer.scope(&args);
    let json: Value = serde_json::from_str(&expect_status(&output, 0)).unwrap();
    assert_eq!(json["probes"][0]["samples"], 128_000);
    assert_eq!(json["lost"], 12);
    assert!(complaint(&output).contains("WARN  12 samples were lost"));
    let lines = std::fs::read_to_string(&csv).unwrap().lines().count();
    assert_eq!(lines, 128_001);
}

#[test]
fn scope_lost_controller_keeps_what_came() {
    let peer = Peer::start(|socket, request| {
        let columns = setup(socket, request);
        send(socket, 0, 0, columns, &[1.0, 0.5]);
        let _ = socket.get_ref().shutdown(std::net::Shutdown::Both);
    });
    let folder = Folder::new();
    let csv = folder.file("a.csv");
    let output = peer.scope(&["--probe=a.b", "--csv", &csv]);
    expect_status(&output, 2);
    assert!(complaint(&output).contains("the connection was lost"));
    let text = std::fs::read_to_string(&csv).unwrap();
    assert_eq!(text, "time (s),a.b (rad)\n1.000000000,0.5\n");
    // A controller that damages its messages is one that cannot be understood.
    let peer = Peer::start(|socket, request| {
        setup(socket, request);
        let _ = socket.send(Message::binary(vec![0; 17]));
        while socket.read().is_ok() {}
    });
    let output = peer.scope(&["--probe=a.b", "--json"]);
    expect_status(&output, 2);
    assert!(complaint(&output).contains("the controller sent a frame of 17 bytes"));
}

#[test]
fn scope_shows_figures_of_fri_connection() {
    let _alone = alone();
    steady(|| {
        let mut cell = Cell::start();
        let _arm = cell.arm();
        let connect = ["--connect", cell.http.as_str()];
        let list = run(&[&["scope", "--list", "left.fri"], &connect[..]].concat());
        let list = expect_status(&list, 0);
        for name in [
            "quality",
            "state",
            "lost",
            "malformed",
            "answer_time",
            "phase_error",
        ] {
            assert!(list.contains(&format!("left.fri.{name}")), "{name}: {list}");
        }
        let folder = Folder::new();
        let file = folder.file("fri.csv");
        let probes = ["left.fri.state", "left.fri.quality", "left.fri.answer_time"];
        let args = ["--duration", "500ms", "--csv", &file];
        let shown = run(&[&["scope", "--probe"][..], &probes, &args, &connect].concat());
        expect_status(&shown, 0);
        let text = std::fs::read_to_string(&file).unwrap();
        let last: Vec<f64> = text
            .lines()
            .last()
            .unwrap()
            .split(',')
            .map(|it| it.parse().unwrap())
            .collect();
        let [_, state, quality, answer] = last[..] else {
            panic!("{text}");
        };
        assert!((state - 2.0).abs() < 0.1, "command mode: {state}");
        assert!((1.0..=3.0).contains(&quality), "{quality}");
        assert!(answer > 0.0 && answer < 1.0, "{answer}");
    });
}

#[test]
fn scope_wrong_names_have_nearest() {
    let peer = Peer::start(three);
    let output = peer.scope(&["--probe", "left.jont.0.measured", "--duration=1s"]);
    expect_status(&output, 1);
    let why = complaint(&output);
    assert_eq!(
        why,
        "left.jont.0.measured: there is no such probe\nhint: did you mean `left.joint.0.measured`?\n"
    );
    let output = peer.scope(&["--probe", "right.*"]);
    assert_eq!(
        expect_status(&output, 1),
        "no probe matches `right.*`\nhint: `takt scope --list` shows all\n"
    );
    assert_eq!(
        expect_status(&peer.scope(&["--list", "err"]), 0),
        "probe               unit        period  thread\nleft.joint.0.error  rad           1 ms  nets\n"
    );
    expect_status(&peer.scope(&["--list", "none"]), 1);
}

#[test]
fn scope_live_draws_and_returns_after_loss() {
    let peer = Peer::start(|socket, request| {
        let columns = setup(socket, request);
        for number in 0..25_u32 {
            let time = f64::from(number) / 10.0;
            let row: Vec<f64> = [time, time]
                .into_iter()
                .chain(std::iter::repeat_n(0.0, columns - 1))
                .collect();
            if !send(socket, 0, 0, columns, &row) {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = socket.get_ref().shutdown(std::net::Shutdown::Both);
    });
    let args = [
        "scope",
        "--probe",
        "left.joint.0.measured",
        "--connect",
        &peer.address,
    ];
    let mut terminal = Terminal::start(takt(&args), 80, 24);
    terminal.wait_for("rad   left.joint.0.measured");
    peer.is_refusing.store(true, Ordering::Relaxed);
    terminal.wait_for(": lost: ");
    // What was there remains.
    assert!(terminal.text().contains("left.joint.0.measured"));
    peer.is_refusing.store(false, Ordering::Relaxed);
    terminal.wait_for(&format!("{}\n", peer.address));
    terminal.key(" ");
    terminal.wait_for("PAUSED");
    terminal.key("q");
    assert!(terminal.end(Duration::from_secs(20)).is_some());
}

#[test]
fn scope_without_controller_or_scope_is_status_2() {
    let output = run(&["scope", "--probe=a.b", "--connect=127.0.0.1:1"]);
    expect_status(&output, 2);
    let why = complaint(&output);
    assert!(why.contains("no controller answers there\nhint: "), "{why}");
    // A controller of an older version.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let _ = stream.read(&mut [0; 1024]);
            let _ = stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 2\r\n\r\nno");
        }
    });
    let output = run(&["scope", "--probe=a.b", "--connect", &address]);
    expect_status(&output, 2);
    let why = complaint(&output);
    assert!(
        why.contains("this controller has no scope\nhint: "),
        "{why}"
    );
}

#[test]
fn scope_of_emulated_arm_streams_triggers_and_ends() {
    let _alone = alone();
    steady(|| {
        let mut cell = Cell::start();
        let _arm = cell.arm();
        let http = cell.http.clone();
        let scope = |args: &[&str]| run(&[&["scope"], args, &["--connect", &http]].concat());
        let list = expect_status(&scope(&["--list", "left.joint.0."]), 0);
        assert!(list.contains("left.joint.0.measured"), "{list}");
        let args = [
            "--probe",
            "left.joint.*.measured",
            "thread:nets.latency",
            "--duration=1s",
            "--json",
        ];
        let json: Value = serde_json::from_str(&expect_status(&scope(&args), 0)).unwrap();
        let probes = json["probes"].as_array().unwrap();
        assert_eq!(probes.len(), 8, "{json}");
        for probe in probes {
            assert!(probe["samples"].as_u64().unwrap() > 100, "{probe}");
        }
        // The latency is above nothing at once.
        let args = [
            "--probe=thread:nets.latency",
            "--trigger=thread:nets.latency>-1",
            "--pre=50ms",
            "--post=100ms",
            "--duration=30s",
            "--csv=-",
        ];
        let output = scope(&args);
        let text = expect_status(&output, 0);
        assert!(
            text.starts_with("capture,time (s),from trigger (s),thread:nets.latency (s)\n1,"),
            "{text}"
        );
        assert!(text.lines().count() > 50, "{text}");
        assert!(complaint(&output).contains("triggered at "));
        let output = scope(&["--probe=left.jont.0.measured", "--json"]);
        expect_status(&output, 1);
        let why = complaint(&output);
        assert!(why.contains("left.joint.0.measured"), "{why}");
        let mut live = Process::start(&[
            "scope",
            "--probe=thread:nets.latency",
            "--json",
            "--connect",
            &http,
        ]);
        std::thread::sleep(Duration::from_millis(500));
        cell.process.kill();
        live.wait_for("\"schema\":\"takt-scope/1\"");
        assert_eq!(live.end().1, Some(2));
    });
}
