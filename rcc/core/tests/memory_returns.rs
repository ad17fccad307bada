//! Memory of unloaded nets is returned to the host though the process locks its memory. Alone in its process, as the
//! whole process is measured.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetState};
use takt_core::{CellConfig, Controller, SessionId};
use takt_rt::host::{HostConfig, MEMORY, prepare};

const MIB: u64 = 1 << 20;

/// A net of that many primitives.
fn net(primitives: u32) -> String {
    let mut text = "{x=Cancel(),outTerminate=x.outCancel".to_owned();
    for number in 0..primitives {
        write!(text, ",c{number}=Core::Clock()").unwrap();
    }
    text.push('}');
    text
}

fn request(text: String) -> LoadRequest {
    LoadRequest {
        text,
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    }
}

/// Resident memory of this process, bytes.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib: u64 = line.unwrap().trim_end_matches("kB").trim().parse().unwrap();
    kib << 10
}

/// The number of heaps that the allocator makes at most, read when a process starts.
const HEAPS_MAX: &str = "MALLOC_ARENA_MAX";

/// In a process of its own that has one heap from its start: programs prepare the host before they start threads, the test
/// harness does not, and each heap of an earlier thread keeps free memory of its own.
#[test]
fn unloaded_nets_return_memory_to_host() {
    if std::env::var_os(HEAPS_MAX).is_some() {
        return measure();
    }
    let mut again = std::process::Command::new(std::env::current_exe().unwrap());
    again.args([
        "--exact",
        "unloaded_nets_return_memory_to_host",
        "--nocapture",
    ]);
    assert!(again.env(HEAPS_MAX, "1").status().unwrap().success());
}

fn measure() {
    let host = prepare(&HostConfig::default());
    let locked = host
        .grants()
        .iter()
        .any(|grant| grant.item == MEMORY && grant.is_granted());
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    cell.controller.nets_memory_mib = 900;
    let controller = Arc::new(Controller::start(&cell).unwrap());
    let begin = resident();
    // Like connections, each from a thread of its own; small nets that remain are loaded in between.
    let load = |text: String| {
        let controller = Arc::clone(&controller);
        let thread = std::thread::spawn(move || {
            let id = controller.load(request(text)).unwrap();
            let info = controller.net(id).unwrap();
            assert_eq!(info.state(), NetState::Ready, "{info:?}");
            id
        });
        thread.join().unwrap()
    };
    let (mut large, mut small) = (Vec::new(), Vec::new());
    for _ in 0..110 {
        large.push(load(net(10_000)));
        small.push(load(net(3)));
    }
    let loaded = resident();
    for id in large {
        controller.unload(id).unwrap();
    }
    // The controller returns memory within seconds; the heap keeps 24 MiB for later nets.
    let wanted = begin + 24 * MIB + (loaded - begin) / 10;
    let until = Instant::now() + Duration::from_secs(60);
    while resident() > wanted && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(20));
    }
    let after = resident();
    let used = [begin, loaded, after].map(|bytes| bytes / MIB);
    assert!(
        loaded - begin > 100 * MIB,
        "the nets are too small to show it"
    );
    assert!(
        after <= wanted,
        "MiB at start, with the nets, after: {used:?}; locked {locked}"
    );
    // A net loaded afterwards is evaluated without a page fault if memory is locked.
    let last = load(net(1000));
    controller.start_net(last).unwrap();
    while controller.net(last).unwrap().state() == NetState::Ready {
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(Duration::from_millis(50));
    if locked {
        assert_eq!(controller.real_time_page_faults().all(), 0);
    }
}
