//! A served segment at the end of in-process cables.

use std::time::Duration;

use super::*;
use crate::emulator::{Server, SharedSegment};
use crate::link::{Link, Memory, Port, pair};

fn server(count: usize) -> (Server<Memory>, Port<Memory>) {
    let (near, far) = pair();
    let slaves = (0..count).map(|_| Coupler::slave());
    let segment = SharedSegment::new(Segment::line(slaves));
    (
        Server::new(segment, far),
        Port::new(near, [0, 1, 2, 3, 4, 5]),
    )
}

fn query(port: &mut Port<Memory>) {
    let mut buffer = [0; 64];
    let mut writer = FrameWriter::new(&mut buffer).unwrap();
    let address = Address::Device { adp: 0, ado: 0 };
    writer.push(Command::Brd, 9, address, &[0]).unwrap();
    let len = writer.finish();
    port.send(&buffer[..len]).unwrap();
}

fn counter(port: &mut Port<Memory>) -> Option<u16> {
    let (bytes, _) = port.receive(Duration::ZERO).unwrap()?;
    let frame = Frame::decode(bytes).unwrap();
    let datagram = frame.datagrams().next().unwrap().unwrap();
    Some(datagram.working_counter.raw())
}

#[test]
fn server_returns_ethercat_frames_only() {
    let (mut server, mut port) = server(3);
    let mut clock = || Ok(Duration::from_millis(5));
    query(&mut port);
    port.link().send(&[0; 60]).unwrap();
    query(&mut port);
    assert_eq!(server.turn(Duration::ZERO, &mut clock).unwrap(), 3);
    assert_eq!([counter(&mut port), counter(&mut port)], [Some(3), Some(3)]);
    assert_eq!(counter(&mut port), None);
    server.segment().lock().set_link(1, false);
    query(&mut port);
    server.turn(Duration::ZERO, &mut clock).unwrap();
    assert_eq!(counter(&mut port), Some(1));
}

#[test]
fn delayed_frames_return_when_due() {
    let (mut server, mut port) = server(1);
    server.segment().lock().faults.late = Some((1, 2 * MS));
    query(&mut port);
    let mut now = 0;
    let mut turn = |server: &mut Server<Memory>, ms| {
        now += ms;
        let mut clock = || Ok(Duration::from_millis(now));
        server.turn(Duration::ZERO, &mut clock).unwrap()
    };
    assert_eq!(turn(&mut server, 0), 1);
    assert_eq!(counter(&mut port), None);
    turn(&mut server, 1);
    assert_eq!(counter(&mut port), None);
    turn(&mut server, 2);
    assert_eq!(counter(&mut port), Some(1));
}

#[test]
fn ring_is_served_at_both_ends() {
    let (mut server, mut first) = server(3);
    let (near, far) = pair();
    let mut second = Port::new(near, [0, 1, 2, 3, 4, 6]);
    server = server.with_second(far);
    let turn = |server: &mut Server<Memory>| {
        let mut clock = || Ok(Duration::from_millis(5));
        server.turn(Duration::ZERO, &mut clock).unwrap();
    };
    query(&mut first);
    turn(&mut server);
    assert_eq!((counter(&mut first), counter(&mut second)), (None, Some(3)));
    server.segment().lock().set_link(1, false);
    query(&mut first);
    query(&mut second);
    turn(&mut server);
    assert_eq!(
        (counter(&mut first), counter(&mut second)),
        (Some(1), Some(2))
    );
}
