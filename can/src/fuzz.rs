//! Fuzz targets: properties that must hold for arbitrary input bytes. Each function panics if its property is violated;
//! the fuzzer generates the input.

use std::time::Duration;

use crate::bits::Rates;
use crate::canopen::eds::Eds;
use crate::canopen::lss;
use crate::canopen::sdo::{BlockSegment, Client, Request, Response};
use crate::canopen::{Emergency, Message, NodeId};
use crate::cia402::dictionary::Address;
use crate::link::{Link as _, Replay};
use crate::log::{Log, Record};
use crate::rmp::{self, Channel, Packet, PacketReader};
use crate::stat::{Limits, Meter};
use crate::{Frame, Id};

/// Input bytes per frame: identifier, kind, eight bytes of data.
const FRAME: usize = 12;

/// Classic CAN frames of all kinds.
fn frames(data: &[u8]) -> impl Iterator<Item = Frame> + '_ {
    data.chunks_exact(FRAME).filter_map(|bytes| {
        let (head, data) = bytes.split_first_chunk::<4>()?;
        let raw = u32::from_le_bytes(*head);
        let (kind, len) = (raw >> 29, (raw >> 25 & 0xF) as usize % 9);
        let id = match kind {
            0 => Id::extended(raw & 0x1FFF_FFFF),
            _ => Id::standard((raw & 0x7FF) as u16),
        };
        match kind {
            1 => Frame::remote(id.ok()?, len).ok(),
            _ => Frame::new(id.ok()?, data.get(..len)?).ok(),
        }
    })
}

/// CANopen: every frame decodes and prints; SDO messages survive a round trip; SDO client, LSS master and LSS slave
/// accept every message.
///
/// # Panics
/// If a property is violated.
pub fn canopen(data: &[u8]) {
    let mut client = Client::new(64, Duration::from_millis(10));
    let mut master = lss::Master::new(Duration::from_millis(10));
    let mut slave = lss::Slave::new(lss::Identity::default(), None);
    for (turn, frame) in (0_u64..).zip(frames(data)) {
        let now = Duration::from_millis(turn);
        let message = Message::decode(&frame);
        assert!(!message.to_string().is_empty());
        let Some(bytes) = frame.data().first_chunk::<8>() else {
            continue;
        };
        sdo(bytes);
        assert_eq!(Emergency::decode(bytes).encode(), *bytes);
        if client.is_idle() {
            let address = Address::new(u16::from_le_bytes([bytes[1], bytes[2]]), bytes[3]);
            let in_blocks = bytes[4] % 2 == 1;
            if bytes[4] % 4 < 2 {
                let _ = client.read(address, in_blocks, now);
            } else {
                let value = data.get(..40).unwrap_or(data);
                let _ = client.write(address, value, in_blocks, now);
            }
        }
        let _ = client.handle(bytes, now);
        while client.poll(now).send.is_some() {}
        if master.is_idle() {
            master.start(lss::Job::FastScan([None; 4]));
        }
        let _ = (master.poll_transmit(now), slave.handle(bytes));
        master.handle(bytes);
    }
}

fn sdo(bytes: &[u8; 8]) {
    if let Some(request) = Request::decode(bytes) {
        assert_eq!(Request::decode(&request.encode()), Some(request));
    }
    if let Some(response) = Response::decode(bytes) {
        assert_eq!(Response::decode(&response.encode()), Some(response));
    }
    if let Some(segment) = BlockSegment::decode(bytes) {
        assert_eq!(BlockSegment::decode(&segment.encode()), Some(segment));
    }
}

/// EDS: what a data sheet contains is skipped or becomes objects, and the printed data sheet reads back as the same
/// objects.
///
/// # Panics
/// If the round trip changes objects or values.
pub fn eds(data: &[u8]) {
    let Ok(first) = Eds::parse(&String::from_utf8_lossy(data)) else {
        return;
    };
    if let Ok(node) = NodeId::new(5) {
        let _ = (first.plan(node), first.node_config(Some(node)));
    }
    let again = Eds::parse(&first.print());
    let indices = |eds: &Eds| -> Vec<_> { eds.objects.iter().map(|object| object.index).collect() };
    assert_eq!(again.as_ref().map(&indices), Ok(indices(&first)));
    assert_eq!(again.map(|again| again.node), Ok(first.node));
}

/// Logs: every recording is read; the records print as candump lines that read back unchanged, and the statistics
/// accept them.
///
/// # Panics
/// If a property is violated.
pub fn log(data: &[u8]) {
    let log = Log::read(data);
    assert!(log.left_out.len() <= log.left_out_count);
    for record in &log.records {
        let line = record.to_string();
        let again = Record::parse(&line);
        assert_eq!(again.map(|again| again.frame), Ok(record.frame), "{line}");
    }
    measure(log);
}

fn measure(log: Log) {
    let mut meter = Meter::new(Some(Rates::classic(500_000)));
    let mut link = Replay::new(log.records);
    while let Ok(Some(received)) = link.receive(Duration::MAX) {
        meter.handle_frame(&received);
    }
    let findings = meter.report().findings(&Limits::default());
    assert!(findings.iter().all(|found| !found.to_string().is_empty()));
}

/// Segway RMP: messages and packets survive a round trip; a driver accepts all of them, and the packet reader finds a
/// valid packet after arbitrary bytes.
///
/// # Panics
/// If a property is violated.
pub fn rmp(data: &[u8]) {
    let mut base = rmp::Base::new(rmp::DriverConfig::default(), 1.0, 1.0);
    for (turn, frame) in (0_u64..).zip(frames(data)) {
        let now = Duration::from_millis(turn);
        if let Some(message) = rmp::Message::decode(&frame) {
            assert_eq!(rmp::Message::decode(&message.frame()), Some(message));
        }
        base.handle_frame(Channel::A, &frame, now);
        let _ = base.poll_transmit(Some([0.5, 0.5]), now);
        let pose = base.motion().pose;
        assert!(pose.x.is_finite() && pose.y.is_finite() && pose.heading.is_finite());
    }
    let mut reader = PacketReader::default();
    for byte in data {
        if let Some(packet) = reader.push(*byte) {
            let _ = (packet.decode(), packet.decode_host());
        }
    }
    let frame = rmp::Message::Attitude {
        pitch: 1,
        pitch_rate: 2,
        roll: 3,
        roll_rate: 4,
    }
    .frame();
    let Packet(good) = Packet::from_powerbase(Channel::B, &frame);
    // The preceding bytes may look like the start of a packet, which consumes the first valid ones.
    let found = std::iter::repeat_n(good, 3)
        .flatten()
        .filter_map(|byte| reader.push(byte))
        .any(|packet| packet.decode() == Some((Channel::B, frame)));
    assert!(found, "no valid packet found");
}
