//! Independent EtherCAT masters, unmodified, and our own against the emulated segment: SOEM (by pysoem), KickCAT,
//! ethercrab or ours at one end of a virtual cable, the segment at the other, in a network namespace of
//! the test's own; tshark checks the captured frames. These tests run in real time; those that cannot run on a
//! machine are skipped with a reason.

#![cfg(target_os = "linux")]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may fail anywhere, its helpers too"
)]

mod crab;
mod ours;
mod profiles;
mod wire;

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use takt_ethercat::emulator::Profile;
use takt_rt::thread::{ThreadConfig, spawn};
use takt_tests::{skip, steady};
use wire::{Bench, Cable, Capture};

/// A Python that has that module: the one the runner names, or that of `ethercat/tests/peers/install.sh`.
fn python(module: &str) -> Option<PathBuf> {
    let workspace = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    let target = std::env::var_os("CARGO_TARGET_DIR").map(PathBuf::from);
    let target = target.unwrap_or_else(|| workspace.join("target"));
    let named = std::env::var_os("TAKT_PYTHON").map(PathBuf::from);
    let pythons = named.into_iter().chain([target.join("peers/bin/python")]);
    let has = |python: &PathBuf| {
        let import = format!("import {module}");
        let output = Command::new(python).args(["-c", &import]).output();
        output.is_ok_and(|output| output.status.success())
    };
    pythons.into_iter().find(has)
}

/// Runs a peer of `ethercat/tests/peers` to its end.
fn run(test: &str, script: &str, module: &str, bench: impl Fn() -> Bench) {
    let Some(python) = python(module) else {
        // The runner looks for the word veth, and runs the test once more where it has installed the peers.
        let build = match module {
            "soemx" => ", which pip builds with gcc and libpcap-dev",
            _ => "",
        };
        let why = format!("needs a veth pair and a Python with {module} (TAKT_PYTHON){build}");
        skip(test, &why);
        return;
    };
    let script = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../ethercat/tests/peers")
        .join(script);
    // These masters fail if the host stalls for longer than their timeouts.
    steady(|| once(test, &python, &script, bench()));
}

fn once(test: &str, python: &Path, script: &Path, bench: Bench) {
    let Some(cable) = Cable::lay(test) else {
        return;
    };
    let capture = Capture::begin();
    let served = wire::serve(bench);
    let mut command = Command::new(python);
    command
        // Lines arrive as they are printed, and an abort prints its stack.
        .args(["-u", "-X", "faulthandler"])
        .arg(script)
        .arg(cable.master());
    let Ended {
        good,
        output,
        errors,
    } = peer(command);
    assert!(good, "{output}\n{errors}");
    assert!(output.ends_with("done\n"), "{output}");
    served.end();
    check(test, capture);
}

/// Result of a peer.
struct Ended {
    good: bool,
    output: String,
    errors: String,
}

/// Timeout of a peer; each needs some ten seconds.
const TIMEOUT: Duration = Duration::from_secs(90);

/// Runs a peer; one that hangs is ended and prints where it hung, as none of them has timeouts of its own.
fn peer(mut command: Command) -> Ended {
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let output = collected(child.stdout.take().unwrap());
    let errors = collected(child.stderr.take().unwrap());
    let begin = Instant::now();
    let (mut status, mut hung) = (child.try_wait().unwrap(), false);
    while status.is_none() {
        if !hung && begin.elapsed() > TIMEOUT {
            hung = true;
            kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGABRT).unwrap();
        }
        std::thread::sleep(Duration::from_millis(50));
        status = child.try_wait().unwrap();
    }
    let mut output = output.join().unwrap();
    if hung {
        output += &format!("hung for {TIMEOUT:?} after the line above; stack:");
    }
    Ended {
        good: status.is_some_and(|status| status.success()),
        output,
        errors: errors.join().unwrap(),
    }
}

/// Reads all output in a thread, so that the pipe does not fill.
fn collected(mut from: impl Read + Send + 'static) -> JoinHandle<String> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        from.read_to_end(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

/// Complaints of tshark about the frames of a test.
fn check(test: &str, capture: Option<Capture>) {
    match capture {
        Some(capture) => capture.check(),
        None => skip(
            test,
            "needs a veth pair with dumpcap and tshark to look at it",
        ),
    }
}

#[test]
fn soem_scans_configures_and_moves_two_drives_by_sync0() {
    run(
        "soem_scans_configures_and_moves_two_drives_by_sync0",
        "pysoem_peer.py",
        "pysoem",
        wire::segment,
    );
}

#[test]
fn soem_reads_and_writes_files_in_boot() {
    run(
        "soem_reads_and_writes_files_in_boot",
        "pysoem_foe_peer.py",
        "pysoem",
        wire::files,
    );
}

#[test]
fn soem_exchanges_ethernet_frames_with_slave() {
    run(
        "soem_exchanges_ethernet_frames_with_slave",
        "soemx_eoe_peer.py",
        "soemx",
        wire::ethernet,
    );
}

#[test]
fn kickcat_scans_configures_and_moves_two_drives() {
    run(
        "kickcat_scans_configures_and_moves_two_drives",
        "kickcat_peer.py",
        "kickcat",
        wire::segment,
    );
}

#[test]
fn ethercrab_scans_configures_and_moves_two_drives_by_sync0() {
    let test = "ethercrab_scans_configures_and_moves_two_drives_by_sync0";
    let Some(cable) = Cable::lay(test) else {
        return;
    };
    let capture = Capture::begin();
    let served = wire::serve(wire::segment());
    crab::drive(cable.master());
    served.end();
    check(test, capture);
}

#[test]
fn our_master_moves_two_drives_reports_cut_cable() {
    let test = "our_master_moves_two_drives_reports_cut_cable";
    steady(|| {
        let Some(cable) = Cable::lay(test) else {
            return;
        };
        let capture = Capture::begin();
        let served = wire::serve(wire::segment());
        let (interface, segment) = (cable.master(), served.segment.clone());
        // In the namespace of this thread, as drivers run.
        let config = ThreadConfig {
            priority: Some(50),
            ..ThreadConfig::new("master")
        };
        let master = spawn(config, move || ours::drive(interface, &segment)).unwrap();
        master.join().unwrap();
        served.end();
        check(test, capture);
    });
}

#[test]
fn soem_brings_profiles_of_devices_to_op() {
    run(
        "soem_brings_profiles_of_devices_to_op",
        "pysoem_profiles_peer.py",
        "pysoem",
        || wire::profiles(&Profile::LINE, 1),
    );
}

#[test]
fn kickcat_brings_profiles_of_devices_to_op() {
    run(
        "kickcat_brings_profiles_of_devices_to_op",
        "kickcat_profiles_peer.py",
        "kickcat",
        || wire::profiles(&profiles::KICKCAT, 1),
    );
}

#[test]
fn ethercrab_brings_profiles_of_devices_to_op() {
    let test = "ethercrab_brings_profiles_of_devices_to_op";
    let Some(cable) = Cable::lay(test) else {
        return;
    };
    let capture = Capture::begin();
    let served = wire::serve(wire::profiles(&Profile::LINE, 1));
    profiles::crab(cable.master());
    served.end();
    check(test, capture);
}

#[test]
fn our_master_brings_profiles_of_devices_to_op() {
    let test = "our_master_brings_profiles_of_devices_to_op";
    for times in [1, 2] {
        steady(|| {
            let Some(cable) = Cable::lay(test) else {
                return;
            };
            let served = wire::serve(wire::profiles(&Profile::LINE, times));
            let interface = cable.master();
            let config = ThreadConfig {
                priority: Some(50),
                ..ThreadConfig::new("master")
            };
            let master = spawn(config, move || profiles::ours(interface)).unwrap();
            master.join().unwrap();
            served.end();
        });
    }
}
