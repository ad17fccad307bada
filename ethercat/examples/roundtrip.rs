//! How long a cycle takes on a veth pair, from asking the master for its frame to having its answer taken, against a
//! bare loop that sends the same frame by the same socket and waits for it. The emulated segment answers on the other
//! end, on the other processor, in both. Cycles and bare frames alternate, so that a busy host is busy for both. Needs
//! to be allowed to make interfaces and raw sockets.
//!
//! ```console
//! # cargo run --release -p takt-ethercat --example roundtrip [CYCLES] [SPIN_US]
//! ```
//!
//! With `SPIN_US` both ask so long for their answer before they sleep (`PacketLink::spinning`).
#![expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "an example: it prints, and the segment's end of the cable is a thread of its own"
)]

use std::error::Error;
use std::io;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use nix::sched::{CpuSet, sched_setaffinity};
use nix::unistd::Pid;
use takt_cia402::emulator::DriveConfig;
use takt_ethercat::config::MasterConfig;
use takt_ethercat::emulator::{
    Coupler, Io, Segment, Server, ServoConfig, ServoDrive, SharedSegment,
};
use takt_ethercat::link::Port;
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_ethercat::master::Master;

const ENDS: [&str; 2] = ["tkrt-master", "tkrt-slaves"];
const PATIENCE: Duration = Duration::from_millis(20);

fn ip(arguments: &str) -> io::Result<()> {
    let done = Command::new("ip").args(arguments.split(' ')).output()?;
    if done.status.success() {
        return Ok(());
    }
    Err(io::Error::other(
        String::from_utf8_lossy(&done.stderr).trim().to_owned(),
    ))
}

/// A coupler, terminals, and a drive of six axes.
fn segment() -> Result<Segment, Box<dyn Error>> {
    let axes = vec![DriveConfig::default(); 6];
    let (drive, _) = ServoDrive::slave(ServoConfig {
        axes,
        ..ServoConfig::default()
    })?;
    Ok(Segment::line([
        Coupler::slave(),
        Io::digital(8, 8).0,
        Io::analogue(4, 4).0,
        drive,
    ]))
}

/// Sends a frame and waits for it; how long that took, if it came back.
fn bare(port: &mut Port<PacketLink>, frame: &[u8]) -> io::Result<Option<Duration>> {
    let begin = monotonic()?;
    port.send(frame)?;
    let back = port.receive(PATIENCE)?.is_some();
    Ok(if back {
        Some(monotonic()?.saturating_sub(begin))
    } else {
        None
    })
}

/// One cycle of the master; how long it took, if its answer came.
fn cycle(
    master: &mut Master,
    port: &mut Port<PacketLink>,
    frame: &mut [u8],
) -> io::Result<Option<(usize, Duration)>> {
    let begin = monotonic()?;
    let Some(len) = master.poll_transmit(begin, frame) else {
        return Ok(None);
    };
    port.send(frame.get(..len).unwrap_or_default())?;
    while let Some((bytes, at)) = port.receive(PATIENCE)? {
        if master.handle_frame(0, bytes, at) {
            return Ok(Some((len, monotonic()?.saturating_sub(begin))));
        }
    }
    Ok(None)
}

/// Keeps the calling thread on a processor; where there is no such one it stays where it is.
fn stay_on(cpu: usize) {
    let mut set = CpuSet::new();
    let _placed = set
        .set(cpu)
        .and_then(|()| sched_setaffinity(Pid::from_raw(0), &set));
}

fn told(name: &str, times: &mut [Duration]) {
    times.sort_unstable();
    let at = |share: usize| {
        times
            .get(times.len() * share / 1000)
            .copied()
            .unwrap_or_default()
    };
    let us = |share| at(share).as_secs_f64() * 1e6;
    println!(
        "{name:8} p50 {:7.1} us  p90 {:7.1} us  p99 {:7.1} us  ({} frames)",
        us(500),
        us(900),
        us(990),
        times.len()
    );
}

fn measure(cycles: usize, spin: Duration) -> Result<(), Box<dyn Error>> {
    let mut port = {
        let link = PacketLink::open(ENDS[0])?.spinning(spin);
        let mac = link.mac();
        Port::new(link, mac)
    };
    let mut master = Master::new(MasterConfig::default())?;
    let mut frame = [0; 1500];
    let (mut ours, mut theirs) = (Vec::with_capacity(cycles), Vec::with_capacity(cycles));
    while !master.is_operational() {
        cycle(&mut master, &mut port, &mut frame)?;
        while master.poll_event().is_some() {}
    }
    for _ in 0..cycles {
        if let Some((len, time)) = cycle(&mut master, &mut port, &mut frame)? {
            ours.push(time);
            theirs.extend(bare(&mut port, frame.get(..len).unwrap_or_default())?);
        }
    }
    told("bare", &mut theirs);
    told("master", &mut ours);
    println!("frames {:?}", master.frames());
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let cycles = std::env::args()
        .nth(1)
        .map_or(Ok(20_000), |text| text.parse())?;
    let spin = std::env::args().nth(2).map_or(Ok(0), |text| text.parse())?;
    let _left_behind = ip(&format!("link del {}", ENDS[0]));
    ip(&format!(
        "link add {} type veth peer name {}",
        ENDS[0], ENDS[1]
    ))?;
    for end in ENDS {
        ip(&format!("link set {end} up"))?;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = stop.clone();
    let mut server = Server::new(SharedSegment::new(segment()?), PacketLink::open(ENDS[1])?);
    let served = thread::spawn(move || {
        stay_on(0);
        while !stopped.load(Ordering::Relaxed) && server.turn(PATIENCE, &mut monotonic).is_ok() {}
    });
    stay_on(1);
    let measured = measure(cycles, Duration::from_micros(spin));
    stop.store(true, Ordering::Relaxed);
    let _ended = served.join();
    ip(&format!("link del {}", ENDS[0]))?;
    measured
}
