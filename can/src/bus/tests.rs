//! Load and order as on a real bus, and every cause of a lost frame.

use super::*;
use crate::link::{Link as _, Origin};
use crate::{FdFrame, Frame};

const MS: Duration = Duration::from_millis(1);

fn data(id: u16, data: &[u8]) -> AnyFrame {
    Frame::new(Id::standard(id).unwrap(), data).unwrap().into()
}

fn bus(ports: usize) -> (Bus, Vec<PortId>) {
    let mut bus = Bus::new(Config::default());
    let ports = (0..ports).map(|_| bus.attach()).collect();
    (bus, ports)
}

fn received(bus: &mut Bus, port: PortId) -> Vec<Received> {
    std::iter::from_fn(|| bus.receive(port)).collect()
}

fn frames(bus: &mut Bus, port: PortId) -> Vec<AnyFrame> {
    let received = received(bus, port).into_iter().map(|r| r.frame);
    received
        .filter(|frame| !matches!(frame, AnyFrame::Error(_)))
        .collect()
}

fn reports(bus: &mut Bus, port: PortId) -> Vec<ErrorFrame> {
    let received = received(bus, port).into_iter();
    received
        .filter_map(|r| match r.frame {
            AnyFrame::Error(report) => Some(report),
            AnyFrame::Classic(_) | AnyFrame::Fd(_) => None,
        })
        .collect()
}

#[test]
fn bus_lowest_identifier_wins_with_exact_bit_times() {
    let (mut bus, ports) = bus(4);
    let (high, low) = (data(0x701, &[5]), data(0x181, &[1; 8]));
    let extended = Frame::empty(Id::extended(0x181 << 18).unwrap()).into();
    let remote = Frame::remote(Id::standard(0x181).unwrap(), 0)
        .unwrap()
        .into();
    let order = [low, remote, extended, high];
    for (port, frame) in ports.iter().zip([high, extended, remote, low]) {
        bus.send(*port, &frame, Duration::ZERO).unwrap();
    }
    let observer = bus.attach();
    bus.advance(MS);
    let frames_received = received(&mut bus, observer);
    let mut ends = Duration::ZERO;
    for (frame, received) in order.iter().zip(&frames_received) {
        ends += Bits::of(frame).time(Rates::classic(1_000_000));
        assert_eq!((received.frame, received.at), (*frame, ends));
        assert_eq!(received.origin, Origin::Bus);
    }
    assert_eq!(frames_received.len(), 4);
    assert_eq!((bus.traffic().frames, bus.traffic().busy), (4, ends));
    assert_eq!(bus.now(), MS);
}

#[test]
fn bus_running_transmission_is_not_interrupted() {
    let (mut bus, ports) = bus(3);
    bus.send(ports[0], &data(0x700, &[0; 8]), Duration::ZERO)
        .unwrap();
    bus.send(ports[1], &data(0x001, &[]), Duration::from_micros(1))
        .unwrap();
    bus.advance(MS);
    let order = frames(&mut bus, ports[2]);
    assert_eq!(order, [data(0x700, &[0; 8]), data(0x001, &[])]);
}

#[test]
fn bus_full_load_matches_real_bus() {
    let (mut bus, ports) = bus(2);
    let second = Duration::from_secs(1);
    let mut count = 0;
    while bus.now() < second {
        let at = bus.now();
        while bus.send(ports[0], &data(0x181, &[0xA5; 8]), at).is_ok() {}
        bus.advance(at + MS / 10);
        count += frames(&mut bus, ports[1]).len();
    }
    assert!((7_400..=9_009).contains(&count), "{count} frames/s");
    assert!(bus.traffic().busy > Duration::from_millis(999));
}

/// Two seconds of a fully loaded bus, read every 10 ms as by a driver: each frame arrives in order, is decoded and
/// counted.
#[test]
fn full_bus_is_decoded_and_dispatched_without_loss() {
    use crate::canopen::Message;
    use crate::stat::{Limits, Meter};
    let (mut bus, ports) = bus(2);
    let mut meter = Meter::new(Some(Rates::classic(1_000_000)));
    let (mut sent, mut pdos, mut frames_received) = (0_u32, 0_u32, 0_u32);
    while bus.now() < Duration::from_secs(2) {
        let cycle = bus.now() + 10 * MS;
        while bus.now() < cycle {
            let at = bus.now();
            let numbered = |sent: u32| data(0x181, &(u64::from(sent) << 16).to_be_bytes());
            while bus.send(ports[0], &numbered(sent), at).is_ok() {
                sent += 1;
            }
            bus.advance((at + MS / 2).min(cycle));
        }
        for received in received(&mut bus, ports[1]) {
            assert_eq!(received.dropped, 0);
            meter.handle_frame(&received);
            let frame = received.frame.classic().expect("a classic frame");
            pdos += u32::from(matches!(Message::decode(frame), Message::Tpdo(..)));
            let number = u64::from_be_bytes(*frame.data().first_chunk().expect("eight bytes"));
            assert_eq!(number >> 16, u64::from(frames_received));
            frames_received += 1;
        }
    }
    assert!(
        (14_800..=18_018).contains(&frames_received),
        "{frames_received} frames in 2 s"
    );
    assert_eq!(
        (pdos, u64::from(frames_received)),
        (frames_received, meter.report().frames)
    );
    assert!(
        sent - frames_received <= 11,
        "frames not received are queued or on the wire"
    );
    let report = meter.report();
    assert!(
        report.load().is_some_and(|load| load > 0.99),
        "{:?}",
        report.load()
    );
    let findings = report.findings(&Limits::default());
    assert!(
        findings.iter().any(|finding| finding.name() == "load"),
        "{findings:?}"
    );
}

#[test]
fn bus_queues_are_bounded() {
    let mut bus = Bus::new(Config {
        receive_queue: 3,
        ..Config::default()
    });
    let (from, to) = (bus.attach(), bus.attach());
    let frame = data(0x181, &[]);
    for _ in 0..10 {
        bus.send(from, &frame, Duration::ZERO).unwrap();
    }
    assert_eq!(
        bus.send(from, &frame, Duration::ZERO),
        Err(LinkError::QueueFull)
    );
    assert_eq!(bus.waiting(from), 10);
    bus.advance(MS);
    let frames_received = received(&mut bus, to);
    assert_eq!((frames_received.len(), frames_received[2].dropped), (3, 0));
    bus.send(from, &frame, MS).unwrap();
    bus.advance(2 * MS);
    assert_eq!(
        received(&mut bus, to)[0].dropped,
        7,
        "reported with the next received frame"
    );
    let report = ErrorFrame::new(0, [0; 8]).into();
    assert_eq!(bus.send(from, &report, 2 * MS), Err(LinkError::Kind));
    assert_eq!(
        Bus::new(Config::default()).send(to, &frame, MS),
        Err(LinkError::Lost)
    );
}

#[test]
fn bus_echo_returns_own_frames() {
    let (mut bus, ports) = bus(2);
    bus.set_echo(ports[0], true);
    bus.send(ports[0], &data(1, &[]), Duration::ZERO).unwrap();
    bus.advance(MS);
    let own = received(&mut bus, ports[0]);
    let other = received(&mut bus, ports[1]);
    assert_eq!((own[0].origin, own[0].at), (Origin::Own, other[0].at));
}

#[test]
fn bus_destroyed_frame_is_retransmitted() {
    let (mut bus, ports) = bus(3);
    let id = Id::standard(0x181).unwrap();
    bus.inject(Fault {
        from: Some(ports[0]),
        id: Some(id),
        frames: 2,
    });
    bus.send(ports[1], &data(0x182, &[]), Duration::ZERO)
        .unwrap();
    bus.send(ports[0], &data(0x181, &[]), Duration::ZERO)
        .unwrap();
    bus.advance(MS);
    assert_eq!(bus.traffic().destroyed, 2);
    assert_eq!(
        frames(&mut bus, ports[2]),
        [data(0x181, &[]), data(0x182, &[])]
    );
    assert_eq!(
        bus.counters(ports[0]),
        Counters {
            transmit: 15,
            receive: 1 - 1
        }
    );
    assert_eq!(
        bus.counters(ports[2]),
        Counters {
            transmit: 0,
            receive: 0
        }
    );
    let reported = reports(&mut bus, ports[0]);
    assert_eq!(reported.len(), 2);
    assert_eq!(reported[1].counters(), Some((16, 0)));
}

#[test]
fn bus_too_many_errors_cause_bus_off_and_restart() {
    let restart = Some(100 * MS);
    let mut bus = Bus::new(Config {
        restart,
        ..Config::default()
    });
    let (sender, observer) = (bus.attach(), bus.attach());
    bus.inject(Fault {
        from: Some(sender),
        id: None,
        frames: 32,
    });
    bus.send(sender, &data(1, &[]), Duration::ZERO).unwrap();
    bus.advance(50 * MS);
    assert_eq!(bus.state(sender), BusState::BusOff);
    let states: Vec<_> = reports(&mut bus, sender)
        .iter()
        .filter_map(ErrorFrame::state)
        .collect();
    let expected = [
        BusState::ErrorWarning,
        BusState::ErrorPassive,
        BusState::BusOff,
    ];
    assert_eq!(states, expected);
    assert_eq!(frames(&mut bus, observer), []);
    bus.advance(200 * MS);
    let states: Vec<_> = reports(&mut bus, sender)
        .iter()
        .filter_map(ErrorFrame::state)
        .collect();
    assert_eq!(states, [BusState::ErrorActive]);
    assert_eq!(
        frames(&mut bus, observer),
        [data(1, &[])],
        "it was only delayed"
    );
}

#[test]
fn bus_off_port_receives_nothing_until_restart() {
    let (mut bus, ports) = bus(3);
    bus.set_counters(
        ports[0],
        Counters {
            transmit: 256,
            receive: 0,
        },
    );
    bus.send(ports[1], &data(1, &[]), Duration::ZERO).unwrap();
    bus.send(ports[0], &data(2, &[]), Duration::ZERO).unwrap();
    bus.advance(MS);
    assert_eq!(frames(&mut bus, ports[0]), []);
    assert_eq!(frames(&mut bus, ports[2]), [data(1, &[])]);
    bus.restart(ports[0]);
    bus.advance(2 * MS);
    assert_eq!(frames(&mut bus, ports[2]), [data(2, &[])]);
}

#[test]
fn bus_single_port_becomes_passive_and_queue_fills() {
    let (mut bus, ports) = bus(1);
    bus.send(ports[0], &data(1, &[]), Duration::ZERO).unwrap();
    bus.advance(100 * MS);
    assert_eq!(bus.state(ports[0]), BusState::ErrorPassive);
    assert_eq!(
        bus.counters(ports[0]).transmit,
        128,
        "it never goes bus-off"
    );
    assert_eq!(bus.waiting(ports[0]), 1);
    assert!(
        reports(&mut bus, ports[0])
            .iter()
            .any(ErrorFrame::is_unacknowledged)
    );
    let observer = bus.attach();
    bus.set_listen_only(observer, true);
    bus.advance(101 * MS);
    assert_eq!(
        frames(&mut bus, observer),
        [],
        "a listen-only port does not acknowledge"
    );
    bus.set_listen_only(observer, false);
    bus.advance(102 * MS);
    assert_eq!(frames(&mut bus, observer), [data(1, &[])]);
}

#[test]
fn bus_wrong_bit_rate_destroys_frames_until_passive() {
    let (mut bus, ports) = bus(3);
    bus.set_rates(ports[2], Rates::classic(500_000));
    for _ in 0..10 {
        bus.send(ports[0], &data(1, &[]), bus.now()).unwrap();
    }
    bus.advance(100 * MS);
    assert_eq!(frames(&mut bus, ports[2]), []);
    // The sender counts eight for each error, the wrong one counts one: the sender goes bus-off
    // first.
    assert_eq!(bus.state(ports[0]), BusState::BusOff);
}

#[test]
fn bus_identifier_collision_drives_both_senders_bus_off() {
    let (mut bus, ports) = bus(3);
    bus.send(ports[0], &data(0x185, &[1]), Duration::ZERO)
        .unwrap();
    bus.send(ports[1], &data(0x185, &[2]), Duration::ZERO)
        .unwrap();
    bus.advance(100 * MS);
    assert_eq!(bus.state(ports[0]), BusState::BusOff);
    assert_eq!(bus.state(ports[1]), BusState::BusOff);
    assert_eq!(frames(&mut bus, ports[2]), []);
}

#[test]
fn bus_ports_are_links_in_virtual_time() {
    let shared = Shared::new(Bus::new(Config::default()));
    let (mut a, mut b) = (shared.attach(), shared.attach());
    let frame = data(0x181, &[1, 2]);
    a.send(&frame).unwrap();
    assert_eq!(
        b.receive(Duration::ZERO),
        Ok(None),
        "it is still on the wire"
    );
    let received = b.receive(MS).unwrap().unwrap();
    assert_eq!(received.frame, frame);
    assert_eq!(shared.lock().now(), received.at, "no longer than needed");
    assert_eq!(b.receive(MS), Ok(None));
    assert_eq!(shared.lock().now(), received.at + MS);
    assert_ne!(a.id(), b.id());
}

#[test]
fn bus_fd_frames_use_both_bit_rates() {
    let rates = Rates {
        nominal: 500_000,
        data: 2_000_000,
    };
    let mut bus = Bus::new(Config {
        rates,
        ..Config::default()
    });
    let (from, to) = (bus.attach(), bus.attach());
    let frame: AnyFrame = FdFrame::new(Id::standard(1).unwrap(), &[7; 64])
        .unwrap()
        .with_flags(1)
        .into();
    bus.send(from, &frame, Duration::ZERO).unwrap();
    bus.advance(MS);
    let frames_received = received(&mut bus, to);
    assert_eq!(frames_received[0].at, Bits::of(&frame).time(rates));
    assert!(frames_received[0].at < MS / 2);
}
