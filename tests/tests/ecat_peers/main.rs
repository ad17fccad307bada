//! Independent EtherCAT masters, unmodified, against the emulated segment: SOEM (by pysoem), KickCAT
//! and ethercrab at one end of a virtual cable, the segment at the other, in a network namespace of
//! the test's own; tshark reads what went over the cable. These run in real time and so wait for
//! it; what cannot run on a machine says so.

#![cfg(target_os = "linux")]
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod crab;
mod wire;

use std::path::PathBuf;
use std::process::Command;

use takt_tests::skip;
use wire::{Cable, Capture};

/// The Python with the peers in it, if they are installed.
fn python() -> Option<PathBuf> {
    let workspace = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    let target = std::env::var_os("CARGO_TARGET_DIR").map(PathBuf::from);
    let target = target.unwrap_or_else(|| workspace.join("target"));
    Some(target.join("peers/bin/python")).filter(|python| python.exists())
}

/// Runs a peer of `ethercat/tests/peers` to its end.
fn run(test: &str, script: &str) {
    let Some(python) = python() else {
        skip(
            test,
            "needs pysoem and kickcat: run ethercat/tests/peers/install.sh",
        )
        .unwrap();
        return;
    };
    let Some(cable) = Cable::lay(test) else {
        return;
    };
    let capture = Capture::begin();
    let served = wire::serve(wire::segment());
    let script = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../ethercat/tests/peers")
        .join(script);
    let output = Command::new(python)
        .arg(script)
        .arg(cable.master())
        .output();
    let output = output.unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{told}\n{errors}");
    assert!(told.ends_with("done\n"), "{told}");
    served.end();
    check(test, capture);
}

/// What tshark has to say against the frames of a test.
fn check(test: &str, capture: Option<Capture>) {
    match capture {
        Some(capture) => capture.check(),
        None => skip(test, "needs dumpcap and tshark to look at the frames").unwrap(),
    }
}

#[test]
fn soem_scans_configures_and_moves_two_drives_by_sync0() {
    run(
        "soem_scans_configures_and_moves_two_drives_by_sync0",
        "pysoem_peer.py",
    );
}

#[test]
fn kickcat_scans_configures_and_moves_two_drives() {
    run(
        "kickcat_scans_configures_and_moves_two_drives",
        "kickcat_peer.py",
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
