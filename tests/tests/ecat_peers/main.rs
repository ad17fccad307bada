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

use std::io::Read;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
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
    let mut command = Command::new(python);
    command
        // Lines come as they are printed, and an abort shows where it stood.
        .args(["-u", "-X", "faulthandler"])
        .arg(script)
        .arg(cable.master());
    let Ended { good, told, errors } = peer(command);
    assert!(good, "{told}\n{errors}");
    assert!(told.ends_with("done\n"), "{told}");
    served.end();
    check(test, capture);
}

/// A peer that has come to its end.
struct Ended {
    good: bool,
    told: String,
    errors: String,
}

/// How long a peer may take; each needs some ten seconds.
const PATIENCE: Duration = Duration::from_secs(90);

/// Runs a peer; one that hangs is ended and says where it stood, as none of them bounds its own waits.
fn peer(mut command: Command) -> Ended {
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let told = collected(child.stdout.take().unwrap());
    let errors = collected(child.stderr.take().unwrap());
    let begin = Instant::now();
    let (mut status, mut hung) = (child.try_wait().unwrap(), false);
    while status.is_none() {
        if !hung && begin.elapsed() > PATIENCE {
            hung = true;
            kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGABRT).unwrap();
        }
        std::thread::sleep(Duration::from_millis(50));
        status = child.try_wait().unwrap();
    }
    let mut told = told.join().unwrap();
    if hung {
        told += &format!("hung for {PATIENCE:?} after the line above; where it stood:");
    }
    Ended {
        good: status.is_some_and(|status| status.success()),
        told,
        errors: errors.join().unwrap(),
    }
}

/// Reads all that comes, in a thread, so that no pipe fills.
fn collected(mut from: impl Read + Send + 'static) -> JoinHandle<String> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        from.read_to_end(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes).into_owned()
    })
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
