//! Injected faults of frames and slaves.

use super::*;
use crate::emulator::{Corrupt, Faults};

fn query(bench: &mut Bench) -> Option<u16> {
    let address = Address::Device {
        adp: 0,
        ado: 0x1F00,
    };
    bench
        .try_send(Command::Bwr, address, &[9])
        .map(|answer| answer.counter)
}

/// Invalid frames by port, forwarded errors by port.
fn counters(bench: &mut Bench, station: u16) -> ([u8; 4], [u8; 4]) {
    let bytes: [u8; 12] = bench.read(station, register::ERROR_COUNTERS);
    let invalid = [bytes[0], bytes[2], bytes[4], bytes[6]];
    (invalid, bytes[8..].try_into().unwrap())
}

#[test]
fn lost_frames_have_effect_only_when_returning() {
    for (faults, done) in [
        (
            Faults {
                lose: 2,
                ..Faults::default()
            },
            0,
        ),
        (
            Faults {
                lose_returned: 2,
                ..Faults::default()
            },
            9,
        ),
    ] {
        let (mut bench, _) = Bench::small();
        bench.segment.faults = faults;
        assert_eq!([query(&mut bench), query(&mut bench)], [None, None]);
        assert_eq!(bench.read(0x1002, 0x1F00), [done]);
        assert_eq!(query(&mut bench), Some(3));
    }
}

#[test]
fn outbound_broken_frame_is_counted_and_forwarded() {
    let (mut bench, _) = Bench::small();
    let corrupt = Corrupt {
        slave: 1,
        port: 0,
        frames: 3,
    };
    bench.segment.faults.corrupt = Some(corrupt);
    for _ in 0..3 {
        assert_eq!(query(&mut bench), None);
    }
    // Before the corruption the frame was intact.
    assert_eq!(bench.read(0x1000, 0x1F00), [9]);
    assert_eq!(bench.read(0x1001, 0x1F00), [0]);
    assert_eq!(counters(&mut bench, 0x1000), ([0; 4], [0, 3, 0, 0]));
    assert_eq!(counters(&mut bench, 0x1001), ([3, 0, 0, 0], [0, 3, 0, 0]));
    assert_eq!(counters(&mut bench, 0x1002), ([0; 4], [3, 0, 0, 0]));
    bench.device(Command::Bwr, 0, register::ERROR_COUNTERS, &[0]);
    assert_eq!(counters(&mut bench, 0x1001), ([0; 4], [0; 4]));
}

#[test]
fn returning_broken_frame_was_processed_by_all() {
    let (mut bench, _) = Bench::small();
    let corrupt = Corrupt {
        slave: 1,
        port: 1,
        frames: 1,
    };
    bench.segment.faults.corrupt = Some(corrupt);
    assert_eq!(query(&mut bench), None);
    assert_eq!(bench.read(0x1002, 0x1F00), [9]);
    assert_eq!(counters(&mut bench, 0x1000), ([0; 4], [0, 1, 0, 0]));
    assert_eq!(counters(&mut bench, 0x1001), ([0, 1, 0, 0], [0; 4]));
    assert_eq!(counters(&mut bench, 0x1002), ([0; 4], [0; 4]));
}

#[test]
fn counters_stay_at_255() {
    let (mut bench, _) = Bench::small();
    let corrupt = Corrupt {
        slave: 0,
        port: 0,
        frames: 300,
    };
    bench.segment.faults.corrupt = Some(corrupt);
    for _ in 0..300 {
        assert_eq!(query(&mut bench), None);
    }
    assert_eq!(counters(&mut bench, 0x1000).0, [255, 0, 0, 0]);
    assert_eq!(query(&mut bench), Some(3));
}

#[test]
fn delayed_frames_report_their_arrival() {
    let (mut bench, _) = Bench::small();
    let mut buffer = [0; 64];
    let mut writer = FrameWriter::new(&mut buffer).unwrap();
    let address = Address::Device { adp: 0, ado: 0 };
    writer.push(Command::Brd, 0, address, &[0]).unwrap();
    let len = writer.finish();
    let usual = bench
        .segment
        .process(&mut buffer[..len], Entry::First, MS)
        .unwrap();
    bench.segment.faults.late = Some((1, 5 * MS));
    let late = bench
        .segment
        .process(&mut buffer[..len], Entry::First, MS)
        .unwrap();
    assert_eq!(late.after, usual.after + 5 * MS);
    let after = bench
        .segment
        .process(&mut buffer[..len], Entry::First, MS)
        .unwrap();
    assert_eq!(after, usual);
}

#[test]
fn hung_firmware_keeps_its_working_counter_and_freezes_its_inputs() {
    let (mut bench, io) = Bench::small();
    bench.operate();
    io.set_inputs(&[1]);
    bench.logical(Command::Lrw, 0, &[0, 0]);
    bench.now += MS;
    bench.logical(Command::Lrw, 0, &[0, 0]);
    bench.segment.slave(2).unwrap().faults().hung = true;
    io.set_inputs(&[2]);
    bench.now += 300 * MS;
    let answer = bench.logical(Command::Lrw, 0, &[0, 0]);
    assert_eq!((answer.data, answer.counter), (vec![0, 1], 3));
    assert_eq!(bench.request(0x1002, AlState::SafeOp, false).0, AlState::Op);
}
