//! `takt ecat scan` and `takt run` bring up a segment of real devices, as emulated by their profiles, over a veth pair. How
//! long that takes is printed and not asserted; `TAKT_STARTS=100` repeats it.

mod common;
#[path = "common/network.rs"]
mod network;

use std::time::{Duration, Instant};

use common::{Folder, Process, alone, expect_status, run};
use network::network;
use takt_tests::steady;

const VETH: [&str; 4] = [
    "link set lo up",
    "link add near type veth peer name far",
    "link set near up",
    "link set far up",
];
const DEVICES: &str = "ek1100,el1004,el2004,el2889,el3004,akd";

fn cell() -> String {
    let slaves = ["coupler", "in", "out", "out16", "volts"];
    let slaves = slaves.iter().enumerate();
    let slaves: String = slaves
        .map(|(position, name)| {
            format!("[[ethercat.slave]]\nname = '{name}'\nposition = {position}\n")
        })
        .collect();
    format!(
        "[controller]\nwebsocket = '127.0.0.1:0'\ntcp = '127.0.0.1:0'\n\
         [[ethercat]]\nname = 'line'\ninterface = 'near'\ncycle = '4ms'\npriority = 80\n{slaves}\
         [[ethercat.slave]]\nname = 'drive'\nposition = 5\naxes = 1\nsync0 = true\n\
         [[ethercat.arm]]\nname = 'arm'\n\
         [[ethercat.arm.joint]]\ndrive = 'drive'\nincrements_per_turn = 1048576\nrange = [-90, 90]\n\
         velocity_max = 10\nacceleration_max = 10\n"
    )
}

/// How often a start is repeated.
fn starts() -> usize {
    let named = std::env::var("TAKT_STARTS").ok();
    named.and_then(|text| text.parse().ok()).unwrap_or(2)
}

#[expect(clippy::print_stderr, reason = "figures for those who ask for them")]
fn report(what: &str, slower: &str, times: &mut [Duration]) {
    times.sort();
    let (median, longest) = (times[times.len() / 2], times[times.len() - 1]);
    let within = times.iter().filter(|time| **time < Duration::from_secs(3));
    eprintln!(
        "{what}, device times x{slower}: median {median:?}, longest {longest:?}, {} of {} within 3 s",
        within.count(),
        times.len()
    );
}

fn bring_up(test: &str, slower: &str) {
    let Some(()) = network(test, "needs veth", &VETH) else {
        return;
    };
    let _alone = alone();
    let mut segment = Process::start(&[
        "ecat",
        "sim",
        "far",
        "--devices",
        DEVICES,
        "--slower",
        slower,
    ]);
    segment.wait_for("far");
    let folder = Folder::new();
    let config = folder.write("cell.toml", &cell());
    let (mut scans, mut runs) = (Vec::new(), Vec::new());
    for _ in 0..starts() {
        let begin = Instant::now();
        let table = expect_status(&run(&["ecat", "scan", "near"]), 0);
        scans.push(begin.elapsed());
        for device in ["EK1100", "EL1004", "EL2004", "EL2889", "EL3004", "AKD"] {
            assert!(table.contains(device), "{table}");
        }
        let begin = Instant::now();
        let mut controller = Process::start(&["run", "--config", &config]);
        controller.wait_until("an operational arm", |line| {
            line.contains("device=\"arm\"") && line.contains("now=operational")
        });
        runs.push(begin.elapsed());
        controller.terminate();
        let (lines, status) = controller.end();
        assert_eq!(status, Some(0), "{lines:#?}");
    }
    report("takt ecat scan", slower, &mut scans);
    report("takt run, to an operational drive", slower, &mut runs);
}

#[test]
fn profile_segment_is_scanned_and_run() {
    steady(|| bring_up("profile_segment_is_scanned_and_run", "1"));
}

#[test]
fn slow_profile_segment_is_scanned_and_run() {
    steady(|| bring_up("slow_profile_segment_is_scanned_and_run", "2"));
}
