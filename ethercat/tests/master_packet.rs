//! The master on a real network interface: a veth pair with the emulated segment on its other end, each by a packet
//! socket. Needs to be allowed to make interfaces; elsewhere it says that it was skipped.
#![cfg(target_os = "linux")]
#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test may fail anywhere, its helpers too"
)]
#![expect(
    clippy::disallowed_methods,
    reason = "the segment's end of the cable is a thread of its own"
)]

use std::io::Write;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use takt_ethercat::config::MasterConfig;
use takt_ethercat::emulator::{
    Coupler, Io, Segment, Server, ServoConfig, ServoDrive, SharedSegment,
};
use takt_ethercat::link::Port;
use takt_ethercat::linux::{PacketLink, monotonic};
use takt_ethercat::master::Master;

/// A veth pair that is gone when it is dropped.
struct Cable;

const ENDS: [&str; 2] = ["tkec-master", "tkec-slaves"];

fn ip(arguments: &str) -> Result<(), String> {
    let done = Command::new("ip").args(arguments.split(' ')).output();
    let done = done.map_err(|error| error.to_string())?;
    if done.status.success() {
        Ok(())
    } else {
        Err(String::from_utf8_lossy(&done.stderr).trim().to_owned())
    }
}

impl Cable {
    fn new() -> Result<Self, String> {
        let _left_behind = ip(&format!("link del {}", ENDS[0]));
        ip(&format!(
            "link add {} type veth peer name {}",
            ENDS[0], ENDS[1]
        ))?;
        let cable = Self;
        for end in ENDS {
            ip(&format!("link set {end} up"))?;
        }
        Ok(cable)
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        let _gone = ip(&format!("link del {}", ENDS[0]));
    }
}

/// One line into the file that collects what could not run.
fn skipped(why: &str) {
    let line = format!("skipped: ethercat master_packet: {why}\n");
    if let Some(path) = std::env::var_os("TAKT_SKIPS") {
        let file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(path);
        file.unwrap().write_all(line.as_bytes()).unwrap();
    }
    eprint!("{line}");
}

/// Serves a segment at the far end until told to stop.
fn serve(segment: Segment, stop: Arc<AtomicBool>) -> thread::JoinHandle<()> {
    let link = PacketLink::open(ENDS[1]).unwrap();
    let mut server = Server::new(SharedSegment::new(segment), link);
    thread::spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            server
                .turn(Duration::from_millis(5), &mut monotonic)
                .unwrap();
        }
    })
}

#[test]
fn a_segment_behind_an_interface_comes_to_op() {
    let _cable = match Cable::new() {
        Ok(cable) => cable,
        Err(why) => return skipped(&why),
    };
    let (terminal, io) = Io::digital(8, 8);
    let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let served = serve(
        Segment::line([Coupler::slave(), terminal, drive]),
        stop.clone(),
    );
    io.set_inputs(&[0xA5]);

    let link = PacketLink::open(ENDS[0]).unwrap();
    let mac = link.mac();
    let mut port = Port::new(link, mac);
    let config = MasterConfig {
        cycle: Duration::from_millis(4),
        ..MasterConfig::default()
    };
    let mut master = Master::new(config).unwrap();
    let mut frame = [0; 1500];
    // Turns, not time: a slow host takes longer for them.
    for turn in 0..20_000 {
        if let Some(len) = master.poll_transmit(monotonic().unwrap(), &mut frame) {
            port.send(&frame[..len]).unwrap();
        }
        while let Some((bytes, at)) = port.receive(Duration::from_millis(20)).unwrap() {
            if master.handle_frame(0, bytes, at) {
                break;
            }
        }
        if master.is_operational() && master.inputs(1) == (&[0xA5][..], 0) && turn > 200 {
            break;
        }
        master.outputs_mut(1).fill(0x3C);
    }
    assert!(
        master.is_operational(),
        "{:?} {:?}",
        master.phase(),
        master.frames()
    );
    assert_eq!(master.inputs(1).0, [0xA5]);
    assert_eq!((io.outputs(), master.frames().foreign), (vec![0x3C], 0));
    stop.store(true, Ordering::Relaxed);
    served.join().unwrap();
}
