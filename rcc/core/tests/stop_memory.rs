//! The stop channel of a process without free memory: a child of this test allocates up to its limit, and is stopped
//! from here. Other parts are not tested without memory.

#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "tests and their helpers fail by panicking"
)]

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use nix::sys::resource::{Resource, setrlimit};
use takt_core::controller::LoadRequest;
use takt_core::stop_channel::{StopChannel, StopChannelConfig, StopSwitch};
use takt_core::{CellConfig, Controller, SessionId};

/// Names the child's socket.
const CHILD: &str = "TAKT_TEST_STOP_SOCKET";
/// Printed by the child when no memory is left.
const EXHAUSTED: &str = "exhausted";
/// Allocations of this size and larger fail.
const PIECE: usize = 8 << 10;

#[test]
fn stop_works_with_memory_exhausted() {
    if let Some(socket) = std::env::var_os(CHILD) {
        exhausted(Path::new(&socket));
    }
    let socket = std::env::temp_dir().join(format!("takt-stop-memory-{}", std::process::id()));
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "stop_works_with_memory_exhausted", "--nocapture"])
        .env(CHILD, &socket)
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut seen = String::new();
    for line in BufReader::new(child.stderr.take().unwrap()).lines() {
        let line = line.unwrap();
        seen = seen + &line + "\n";
        if line.contains(EXHAUSTED) {
            break;
        }
    }
    assert!(seen.contains(EXHAUSTED), "{seen}");
    let answer = ask(&socket);
    let _ = child.kill();
    child.wait().unwrap();
    assert!(
        answer.contains("\"stopped\":true,\"changed\":true,\"complete\":true"),
        "{answer}"
    );
    assert!(answer.contains("\"nets\":1"), "{answer}");
}

fn ask(socket: &PathBuf) -> String {
    let mut stream = UnixStream::connect(socket).unwrap();
    stream.write_all(b"POST /stop HTTP/1.1\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// The child: a controller with a running net and no free memory.
fn exhausted(socket: &Path) -> ! {
    let switch = StopSwitch::default();
    let config = StopChannelConfig {
        socket: Some(socket.to_owned()),
        ..StopChannelConfig::default()
    };
    let _channel = StopChannel::start(config, switch.clone()).unwrap();
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    let controller = Controller::start_under(&cell, None, switch).unwrap();
    let net = controller.load(LoadRequest {
        text: "{cancel=Cancel(), outTerminate=cancel.outCancel}".to_owned(),
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    });
    controller.start_net(net.unwrap()).unwrap();
    let used = std::fs::read_to_string("/proc/self/statm").unwrap();
    let pages: u64 = used.split(' ').next().unwrap().parse().unwrap();
    let limit = pages * 4096 + (8 << 20);
    setrlimit(Resource::RLIMIT_AS, limit, limit).unwrap();
    let (mut size, mut taken) = (64 << 20, 0);
    while size >= PIECE {
        let mut piece: Vec<u8> = Vec::new();
        if piece.try_reserve_exact(size).is_err() {
            size /= 2;
            continue;
        }
        taken += size;
        std::mem::forget(piece);
    }
    assert!(taken > 0);
    eprintln!("{EXHAUSTED}");
    // Until the parent ends it.
    loop {
        std::thread::sleep(std::time::Duration::from_secs(1));
    }
}
