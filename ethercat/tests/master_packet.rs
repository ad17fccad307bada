//! The master on a real network interface: a veth pair with the emulated segment on its other end, each by a packet
//! socket. Needs such a pair; without one it reports that it was skipped.
#![cfg(target_os = "linux")]
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]
#![expect(
    clippy::disallowed_methods,
    reason = "the segment's end of the cable is a thread of its own"
)]

use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use takt_ethercat::config::MasterConfig;
use takt_ethercat::emulator::{
    Coupler, Io, Segment, Server, ServoConfig, ServoDrive, SharedSegment,
};
use takt_ethercat::link::{Link, Port};
use takt_ethercat::linux::{PacketLink, TapLink, monotonic};
use takt_ethercat::master::Master;

/// The interfaces of the runner's veth pair.
fn cable() -> Option<(String, String)> {
    let end = |name| std::env::var(name).ok();
    Some((end("TAKT_VETH")?, end("TAKT_VETH_SECOND")?))
}

/// Writes one line to the runner's file, which runs the test again where there is a cable.
fn skipped(test: &str) {
    takt_tests::skip(test, "needs a veth pair (TAKT_VETH, TAKT_VETH_SECOND)");
}

/// Serves a segment at the far end until stopped.
fn serve<L: Link + Send + 'static>(
    link: L,
    segment: Segment,
    stop: Arc<AtomicBool>,
) -> thread::JoinHandle<()> {
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
fn segment_behind_interface_reaches_op() {
    let Some((near, far)) = cable() else {
        return skipped("segment_behind_interface_reaches_op");
    };
    let (terminal, io) = Io::digital(8, 8);
    let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let served = serve(
        PacketLink::open(&far).unwrap(),
        Segment::line([Coupler::slave(), terminal, drive]),
        stop.clone(),
    );
    exchange(PacketLink::open(&near).unwrap(), &io);
    // The same with polling instead of sleeping, and sleeping after the polling time.
    let spinning = PacketLink::open(&near).unwrap();
    exchange(spinning.spinning(Duration::from_millis(2)), &io);
    stop.store(true, Ordering::Relaxed);
    served.join().unwrap();
}

#[test]
fn segment_behind_tap_reaches_op() {
    let test = "segment_behind_tap_reaches_op";
    let name = format!("tkt{}", std::process::id());
    let Ok(tap) = TapLink::open(&name) else {
        let why = "needs to make a TAP, as root may, and where a veth pair is";
        return takt_tests::skip(test, why);
    };
    let up = Command::new("ip")
        .args(["link", "set", &name, "up"])
        .status();
    if !up.is_ok_and(|status| status.success()) {
        let why = "needs `ip` to bring a TAP up, as for a veth pair";
        return takt_tests::skip(test, why);
    }
    let (terminal, io) = Io::digital(8, 8);
    let stop = Arc::new(AtomicBool::new(false));
    let segment = Segment::line([Coupler::slave(), terminal]);
    let served = serve(tap, segment, stop.clone());
    exchange(PacketLink::open(&name).unwrap(), &io);
    stop.store(true, Ordering::Relaxed);
    served.join().unwrap();
}

/// Brings the segment at the end of a link to OP and exchanges a byte each way with its terminal at position 1.
fn exchange(link: PacketLink, io: &Io) {
    io.set_inputs(&[0xA5]);
    let mac = link.mac();
    let mut port = Port::new(link, mac);
    let config = MasterConfig {
        cycle: Duration::from_millis(4),
        ..MasterConfig::default()
    };
    let mut master = Master::new(config).unwrap();
    let mut frame = [0; 1500];
    // Counts turns instead of time: a slow host takes longer.
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
}
