//! `takt stop` against controllers in processes of their own: idle, flooded, starved of processors, and by those who may
//! not. How long it takes is printed, and bounded nowhere: that is the host's matter.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;
#[path = "common/flood.rs"]
mod flood;

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt as _;
use std::process::Output;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use common::{Cell, Folder, Process, alone, complaint, expect_status, net, run, takt};
use flood::Flood;
use serde_json::Value;
use takt_rt::thread::{ThreadConfig, spawn};
use takt_tests::{skip, steady};

/// Ends when it is asked to.
const PATIENT: &str = "{cancel=Cancel(), outTerminate=cancel.outCancel}";

/// `tests/nets/swing`, so slow that it does not end while a test looks at it.
fn slow_swing() -> String {
    net("swing")
        .replace("Max='1'", "Max='60'")
        .replace("Second='1'", "Second='60'")
}

fn stop(cell: &Cell, args: &[&str]) -> Output {
    run(&[&["stop", "--socket", &cell.stop], args].concat())
}

/// The answer of `takt stop --json`, which found what it wanted.
#[track_caller]
fn answer(output: &Output) -> Value {
    let text = expect_status(output, 0);
    serde_json::from_str(text.trim()).unwrap()
}

/// The end of a net as `takt net list` prints it.
fn end_of(cell: &Cell, id: &str) -> String {
    let list = expect_status(&cell.net(&["list"]), 0);
    let line = list.lines().find(|line| line.starts_with(id));
    line.unwrap().to_owned()
}

#[test]
fn stop_ends_a_motion_and_release_starts_nothing() {
    steady(|| {
        let _alone = alone();
        let mut cell = Cell::start();
        let _arm = cell.arm();
        let (moving, bystander, successor) = (
            cell.load(&slow_swing()),
            cell.load(PATIENT),
            cell.load(PATIENT),
        );
        for id in [&moving, &bystander] {
            expect_status(&cell.net(&["start", id]), 0);
        }
        let after = ["schedule", &successor, "--after", &bystander];
        expect_status(&cell.net(&after), 0);
        let stopped = answer(&stop(&cell, &["--json"]));
        assert_eq!(stopped["nets"], 2, "{stopped}");
        assert_eq!(stopped["complete"], true);
        assert!(stopped["by"].as_str().unwrap().contains("of user"));
        for id in [&moving, &bystander] {
            let end = end_of(&cell, id);
            assert!(
                end.contains("TERMINATED") && end.contains("takt stop"),
                "{end}"
            );
        }
        // A second stop changes nothing and reports that.
        let again = expect_status(&stop(&cell, &[]), 0);
        assert!(again.contains("stopped since"), "{again}");
        let next = cell.load(&net("swing"));
        let refused = cell.net(&["start", &next]);
        expect_status(&refused, 1);
        assert!(complaint(&refused).contains("takt stop --release"));
        let released = expect_status(&stop(&cell, &["--release"]), 0);
        assert!(released.contains("released"), "{released}");
        // What was requested before does not happen after.
        assert!(!end_of(&cell, &successor).contains("RUNNING"));
        expect_status(&cell.net(&["start", &next]), 0);
        let (lines, status) = cell.watch(&next).end();
        assert_eq!(status, Some(0), "{lines:#?}");
        assert!(!end_of(&cell, &successor).contains("RUNNING"));
    });
}

#[test]
fn stop_gets_through_a_flooded_server() {
    let _alone = alone();
    let cell = Cell::start();
    let id = cell.load(PATIENT);
    expect_status(&cell.net(&["start", &id]), 0);
    // The page takes the key before it is needed.
    let page = http(
        &cell.http,
        "GET /stop/?format=json HTTP/1.1\r\nHost: 127.0.0.1",
    );
    let page: Value = serde_json::from_str(body(&page)).unwrap();
    let (port, key) = (
        page["port"].as_u64().unwrap(),
        page["key"].as_str().unwrap(),
    );
    let flood = Flood::start(&[cell.tcp.clone(), cell.http.clone()]);
    let stopped = answer(&stop(&cell, &["--json"]));
    assert_eq!(stopped["nets"], 1, "{stopped}");
    let address = format!("127.0.0.1:{port}");
    let host = "Host: 127.0.0.1\r\nOrigin: http://127.0.0.1:8080";
    let request = format!("POST /stop/release?key={key} HTTP/1.1\r\n{host}");
    let released = http(&address, &request);
    assert!(
        body(&released).contains("\"stopped\":false,\"changed\":true"),
        "{released}"
    );
    drop(flood);
}

fn http(address: &str, head: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream
        .write_all(format!("{head}\r\n\r\n").as_bytes())
        .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

fn body(answer: &str) -> &str {
    answer.split_once("\r\n\r\n").unwrap().1
}

#[test]
fn stop_gets_through_with_all_processors_taken() {
    let _alone = alone();
    let cell = Cell::start();
    let id = cell.load(PATIENT);
    expect_status(&cell.net(&["start", &id]), 0);
    // Above the server and all ordinary threads, below net threads; they end by themselves in any case.
    let ending = Arc::new(AtomicBool::new(false));
    let count = std::thread::available_parallelism().unwrap().get();
    let spin = |cpu: usize| {
        let ending = Arc::clone(&ending);
        let config = ThreadConfig {
            priority: Some(60),
            cpus: vec![cpu],
            ..ThreadConfig::new("spin")
        };
        let until = Instant::now() + Duration::from_secs(20);
        spawn(config, move || {
            while !ending.load(Ordering::Relaxed) {
                if Instant::now() > until {
                    return false;
                }
                std::hint::spin_loop();
            }
            true
        })
        .unwrap()
    };
    let path = cell.stop.clone();
    let ended = Arc::clone(&ending);
    let config = ThreadConfig {
        priority: Some(90),
        ..ThreadConfig::new("presses")
    };
    let press = move || {
        std::thread::sleep(Duration::from_millis(50));
        let mut stream = UnixStream::connect(path).unwrap();
        stream.write_all(b"POST /stop HTTP/1.1\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        ended.store(true, Ordering::Relaxed);
        answer
    };
    let press = spawn(config, press).unwrap();
    let spinners: Vec<_> = (0..count).map(spin).collect();
    let answer = press.join().unwrap();
    let is_real_time = spinners[0].grants().iter().all(|grant| !grant.is_refused());
    for spinner in spinners {
        let held = spinner.join().unwrap();
        assert!(held, "the stop came only after the load had ended");
    }
    assert!(answer.contains("\"complete\":true"), "{answer}");
    assert!(end_of(&cell, &id).contains("takt stop"));
    if !is_real_time {
        let name = "stop_gets_through_with_all_processors_taken";
        skip(name, "needs SCHED_FIFO");
    }
}

#[test]
fn port_stops_only_with_the_token() {
    let _alone = alone();
    let folder = Folder::new();
    let token = folder.write("token", "0123456789abcdef");
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(&token, mode).unwrap();
    let wrong = folder.write("wrong", "0123456789abcdeX");
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(&wrong, mode).unwrap();
    let socket = folder.file("stop.sock");
    let config = format!(
        "[controller]\nwebsocket = \"127.0.0.1:0\"\ntcp = \"127.0.0.1:0\"\ntoken_file = \"{token}\"\n\
         stop_socket = \"{socket}\"\n"
    );
    let config = folder.write("cell.toml", &config);
    let mut controller = Process::start(&["run", "--config", &config]);
    let line = controller.wait_for("stop at http://");
    let (_, address) = line.split_once("http://").unwrap();
    let address = address.trim_end_matches("/stop");
    let refused = run(&["stop", "--connect", address]);
    expect_status(&refused, 1);
    assert!(
        complaint(&refused).contains("token"),
        "{}",
        complaint(&refused)
    );
    let refused = run(&["stop", "--connect", address, "--token-file", &wrong]);
    expect_status(&refused, 1);
    assert!(complaint(&refused).contains("the token is wrong"));
    controller.wait_for("the stop channel rejected requests");
    let stopped = run(&["stop", "--connect", address, "--token-file", &token]);
    assert!(expect_status(&stopped, 0).contains("stopped, 0 nets ended"));
}

#[test]
fn foreign_user_may_not_stop() {
    let _alone = alone();
    let cell = Cell::start();
    let mut command = takt(&["stop", "--socket", &cell.stop]);
    // A user without rights.
    let output = command.uid(65_534).gid(65_534).output();
    let output = match output {
        Ok(output) => output,
        Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => {
            return skip("foreign_user_may_not_stop", "needs root");
        }
        Err(error) => panic!("{error}"),
    };
    expect_status(&output, 1);
    assert!(
        complaint(&output).contains("only root"),
        "{}",
        complaint(&output)
    );
    let shown = expect_status(&stop(&cell, &["--show"]), 0);
    assert!(shown.contains("not stopped"), "{shown}");
}

#[test]
fn controller_that_does_not_answer_is_reported() {
    let _alone = alone();
    let cell = Cell::start();
    let missing = format!("{}-none", cell.stop);
    let missed = run(&["stop", "--socket", &missing]);
    expect_status(&missed, 2);
    assert!(complaint(&missed).contains("emergency stop of the robot"));
    cell.process.signal("STOP");
    let silent = stop(&cell, &["--timeout", "300ms"]);
    cell.process.signal("CONT");
    expect_status(&silent, 2);
    assert!(
        complaint(&silent).contains("no answer"),
        "{}",
        complaint(&silent)
    );
}
