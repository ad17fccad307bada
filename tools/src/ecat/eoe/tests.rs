//! A tunnel to an emulated slave, refused addresses, and arguments that are no addresses.

use std::collections::VecDeque;
use std::io;

use takt_ethercat::emulator::{Coupler, Segment, ServoConfig, ServoDrive};
use takt_ethercat::eoe::EoeResult;

use super::*;
use crate::ecat::tests::{Emulated, up};

/// The side of a TAP that this process has: frames of the host, and frames for it.
#[derive(Debug, Default)]
struct Host {
    sends: VecDeque<Vec<u8>>,
    got: Vec<Vec<u8>>,
}

impl Link for Host {
    fn send(&mut self, frame: &[u8]) -> io::Result<usize> {
        self.got.push(frame.to_vec());
        Ok(frame.len())
    }

    fn receive(&mut self, buf: &mut [u8], _: Duration) -> io::Result<Option<(usize, Duration)>> {
        let frame = self.sends.pop_front();
        Ok(frame.map(|frame| {
            buf[..frame.len()].copy_from_slice(&frame);
            (frame.len(), Duration::ZERO)
        }))
    }
}

fn session() -> Session<Emulated> {
    let drive = ServoDrive::slave(ServoConfig::default()).unwrap().0;
    let segment = Segment::line([Coupler::slave(), drive.with_ethernet()]);
    let mut session = up(segment, AlState::PreOp);
    session.hold_ethernet(1, Duration::from_secs(10)).unwrap();
    session
}

/// An ARP request for 192.168.7.2.
fn arp() -> Vec<u8> {
    let mut frame = vec![0xFF; 6];
    frame.extend([2, 0, 0, 0, 0, 1, 8, 6, 0, 1, 8, 0, 6, 4, 0, 1]);
    frame.extend([
        2, 0, 0, 0, 0, 1, 192, 168, 7, 1, 0, 0, 0, 0, 0, 0, 192, 168, 7, 2,
    ]);
    frame
}

#[test]
fn eoe_tunnel_carries_frames_and_counts_losses() {
    let mut session = session();
    let port = session.wire().segment.slave(1).unwrap().ethernet().unwrap();
    let settings = Addresses::of(subnet("192.168.7.2/24").unwrap()).settings(1);
    assert_eq!(set(&mut session, 1, 0, &settings).unwrap(), Verdict::Good);
    assert_eq!(port.lock().settings, settings);
    assert_eq!(get(&mut session, 1, 0, true).unwrap(), Verdict::Good);
    assert_eq!(limit(&session, 1), 48);
    let (mut host, mut traffic) = (Host::default(), Traffic::default());
    host.sends.extend([arp(), arp(), arp()]);
    port.lock().faults.deaf = 1;
    host.sends.push_back(vec![7; FRAME_MAX + 1]);
    port.lock().faults.too_long = 1;
    for _ in 0..200 {
        let ended = carry(&mut session, 1, 0, &mut host, &mut traffic).unwrap();
        assert_eq!(ended, Ok(()));
    }
    assert_eq!(
        (traffic.to_slave, traffic.refused),
        ((3, 180), 1),
        "{traffic:?}"
    );
    assert_eq!(
        (traffic.from_slave, traffic.broken),
        ((1, 60), 1),
        "{traffic:?}"
    );
    assert_eq!(
        host.got[0][..14],
        [2, 0, 0, 0, 0, 1, 2, 0x54, 0x4B, 0, 0, 1, 8, 6]
    );
    let text = traffic.text();
    for part in [
        "3 frames, 180 bytes",
        "last: an Ethernet frame of 1519 bytes",
        "a frame of 60 bytes",
    ] {
        assert!(text.contains(part), "{text}");
    }
    session.wire().segment.set_power(1, false);
    let lost = (0..200).find_map(|_| {
        let ended = carry(&mut session, 1, 0, &mut host, &mut traffic).unwrap();
        ended.err()
    });
    assert!(lost.is_some_and(|why| why.contains("lost")));
}

#[test]
fn eoe_refused_address_fails_with_result() {
    let mut session = session();
    let port = session.wire().segment.slave(1).unwrap().ethernet().unwrap();
    port.lock().faults.refuse = (1, EoeResult::NO_IP);
    let settings = Addresses::of(subnet("10.0.0.2/8").unwrap()).settings(1);
    assert_eq!(set(&mut session, 1, 0, &settings).unwrap(), Verdict::Failed);
    assert_eq!(set(&mut session, 0, 0, &settings).unwrap(), Verdict::Failed);
}

#[test]
fn eoe_invalid_addresses_are_rejected_with_cause() {
    assert_eq!(
        subnet("10.1.2.3/20").unwrap().mask(),
        Ipv4Addr::new(255, 255, 240, 0)
    );
    for text in ["10.0.0.1", "10.0.0.1/31", "10.0.0/8", "x/8"] {
        assert!(
            subnet(text).unwrap_err().contains("192.168.7.2/24"),
            "{text}"
        );
    }
    assert_eq!(mac("02-00-00-00-00-ff"), Ok([2, 0, 0, 0, 0, 0xFF]));
    for text in ["02:00:00:00:00", "02:00:00:00:00:100", ""] {
        assert!(mac(text).unwrap_err().contains("no MAC address"), "{text}");
    }
    assert!(
        mac("01:00:00:00:00:00")
            .unwrap_err()
            .contains("group address")
    );
    assert!(host_name("a b").is_err());
}
