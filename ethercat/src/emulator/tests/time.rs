//! Distributed clocks: receive times, delays, offsets, drift, SYNC0 and SYNC1.

use super::*;
use crate::emulator::{Clock, Plain, SiiImage, SlaveConfig};

fn clocked(local: u64, drift_ppb: i64) -> Slave {
    let sii = SiiImage {
        clock: true,
        ..SiiImage::default()
    };
    let mut config = SlaveConfig::new(sii);
    config.clock = Some(Clock::new(local, drift_ppb));
    Slave::new(config, Box::new(Plain))
}

fn receive_times(bench: &mut Bench, station: u16) -> [u32; 4] {
    let bytes: [u8; 16] = bench.read(station, register::DC_RECEIVE_TIMES);
    std::array::from_fn(|n| u32::from_le_bytes(bytes[4 * n..4 * n + 4].try_into().unwrap()))
}

fn system_time(bench: &mut Bench, station: u16) -> u64 {
    u64::from_le_bytes(bench.read(station, register::DC_SYSTEM_TIME))
}

#[test]
fn receive_times_give_line_delays() {
    let mut bench = Bench::new((0..3).map(|n| clocked(n * 1_000_000, 0)));
    bench.address();
    assert_eq!(bench.device(Command::Bwr, 0, 0x0900, &[0; 4]).counter, 3);
    let times: Vec<_> = (0..3)
        .map(|n| receive_times(&mut bench, 0x1000 + n))
        .collect();
    // Forwarding 300 ns and 100 ns of cable each way: half of the difference of round trips.
    let trip = |n: usize| times[n][1].wrapping_sub(times[n][0]);
    assert_eq!(trip(0), 1600);
    assert_eq!(trip(1), 800);
    assert_eq!(times[2][1], 0, "nothing is plugged in there");
    assert_eq!((trip(0) - trip(1)) / 2, 400);
    let local = u64::from_le_bytes(bench.read(0x1001, register::DC_RECEIVE_TIME_ECAT));
    let [a, b, c, d, ..] = local.to_le_bytes();
    assert_eq!(u32::from_le_bytes([a, b, c, d]), times[1][0]);
    // A read does not latch.
    assert_eq!(receive_times(&mut bench, 0x1000), times[0]);
}

#[test]
fn branch_is_passed_before_the_next_port() {
    let mut segment = Segment::default();
    let first = segment.add(clocked(0, 0), None);
    segment.add(clocked(0, 0), Some((first, 1)));
    segment.add(clocked(0, 0), Some((first, 3)));
    let mut bench = Bench { segment, now: MS };
    bench.address();
    // Ring order: first, the branch at port 3, the one at port 1.
    let status =
        |bench: &mut Bench, n: u16| u16::from_le_bytes(bench.read(0x1000 + n, register::DL_STATUS));
    assert_eq!(status(&mut bench, 0) & 0xF0, 0xB0);
    assert_eq!(bench.read::<1>(0x1000, 0x0007), [0xCF]);
    bench.device(Command::Bwr, 0, 0x0900, &[0; 4]);
    let [out, back1, _, back3] = receive_times(&mut bench, 0x1000);
    assert_eq!(back3.wrapping_sub(out), 800);
    assert_eq!(back1.wrapping_sub(back3), 800);
}

/// Offsets and delays as a master sets them, then a number of FRMW a millisecond apart.
fn synchronise(bench: &mut Bench, cycles: usize) -> i64 {
    let reference = system_time(bench, 0x1000);
    let copy = system_time(bench, 0x1001);
    let offset = reference.wrapping_sub(copy);
    bench.write(0x1001, register::DC_OFFSET, &offset.to_le_bytes());
    bench.write(0x1001, register::DC_DELAY, &400_u32.to_le_bytes());
    bench.write(0x1001, register::DC_SPEED_START, &0x1000_u16.to_le_bytes());
    for _ in 0..cycles {
        bench.device(Command::Frmw, 0x1000, register::DC_SYSTEM_TIME, &[0; 8]);
        bench.now += MS - 10_000;
    }
    let difference = u32::from_le_bytes(bench.read(0x1001, register::DC_DIFFERENCE));
    let size = i64::from(difference & 0x7FFF_FFFF);
    if difference >> 31 == 1 { size } else { -size }
}

#[test]
fn clock_that_drifts_is_corrected_by_system_time() {
    for drift in [-100_000, -50_000, 0, 50_000, 100_000] {
        let mut bench = Bench::new([clocked(7_000_000_000, 0), clocked(123, drift)]);
        bench.address();
        let difference = synchronise(&mut bench, 2000);
        assert!(difference.abs() < 200, "{drift} ppb: {difference} ns");
        let now = bench.now;
        let mut system = |number: usize| {
            let slave = bench.segment.slave(number).unwrap();
            slave.clock().unwrap().local(now)
        };
        let (reference, copy) = (system(0), system(1));
        let offset = u64::from_le_bytes(bench.read(0x1001, register::DC_OFFSET));
        let apart = copy
            .wrapping_add(offset)
            .wrapping_sub(reference)
            .cast_signed();
        assert!(apart.abs() < 200, "{drift} ppb: {apart} ns");
    }
}

#[test]
fn system_time_of_four_bytes_is_enough() {
    let mut bench = Bench::new([clocked(0xFFFF_FF00_0000, 0), clocked(5, 20_000)]);
    bench.address();
    synchronise(&mut bench, 500);
    let mut last = 0;
    for _ in 0..500 {
        bench.device(Command::Frmw, 0x1000, register::DC_SYSTEM_TIME, &[0; 4]);
        bench.now += MS - 10_000;
        last = u32::from_le_bytes(bench.read(0x1001, register::DC_DIFFERENCE)) & 0x7FFF_FFFF;
    }
    assert!(last < 500, "{last} ns");
}

#[test]
fn speed_counter_write_resets_the_filter() {
    let mut bench = Bench::new([clocked(9_000_000_000, 0)]);
    bench.address();
    // Masters clear the system time of all slaves before they know it.
    bench.device(Command::Bwr, 0, register::DC_SYSTEM_TIME, &[0; 8]);
    bench.device(Command::Bwr, 0, register::DC_SPEED_START, &[0, 0x10]);
    assert_eq!(bench.read(0x1000, register::DC_DIFFERENCE), [0; 4]);
    assert_eq!(bench.read::<2>(0x1000, 0x0932), [0, 0]);
}

#[test]
fn sync0_is_armed_by_the_rising_edge() {
    let mut bench = Bench::new([clocked(0, 0)]);
    bench.address();
    let start = system_time(&mut bench, 0x1000) + 5 * MS;
    bench.write(
        0x1000,
        register::DC_SYNC0_CYCLE,
        &1_000_000_u32.to_le_bytes(),
    );
    bench.write(0x1000, register::DC_SYNC1_CYCLE, &250_000_u32.to_le_bytes());
    bench.write(0x1000, register::DC_START_TIME, &start.to_le_bytes());
    bench.write(0x1000, register::DC_ACTIVATION, &[7]);
    let next = |bench: &mut Bench| u64::from_le_bytes(bench.read(0x1000, register::DC_START_TIME));
    assert_eq!(next(&mut bench), start);
    assert_eq!(bench.read::<1>(0x1000, 0x0984), [3]);
    assert_eq!(
        u64::from_le_bytes(bench.read(0x1000, 0x0998)),
        start + 250_000
    );
    bench.write(0x1000, register::DC_ACTIVATION, &[0]);
    // A start that has passed never comes.
    bench.now += 10 * MS;
    bench.write(0x1000, register::DC_START_TIME, &start.to_le_bytes());
    bench.write(0x1000, register::DC_ACTIVATION, &[3]);
    assert_eq!(bench.read::<1>(0x1000, 0x0984), [4]);
    // And so OP is refused.
    for state in [AlState::PreOp, AlState::SafeOp] {
        assert_eq!(bench.request(0x1000, state, false), (state, false, 0));
    }
    assert_eq!(
        bench.request(0x1000, AlState::Op, false),
        (AlState::SafeOp, true, 0x2D)
    );
}

#[test]
fn invalid_sync_is_refused_before_safe_op() {
    for (cycle, activation, needs, code) in [
        (1_000_000_u32, 3_u8, true, 0),
        (1_000_000, 0, true, 0x30),
        (1_000_000, 2, false, 0x30),
        (10_000, 3, false, 0x36),
        (0, 0, false, 0),
    ] {
        let sii = SiiImage {
            clock: true,
            ..SiiImage::default()
        };
        let mut config = SlaveConfig::new(sii);
        config.needs_sync0 = needs;
        let mut bench = Bench::new([Slave::new(config, Box::new(Plain))]);
        bench.address();
        bench.request(0x1000, AlState::PreOp, false);
        let start = system_time(&mut bench, 0x1000) + 100 * MS;
        bench.write(0x1000, register::DC_SYNC0_CYCLE, &cycle.to_le_bytes());
        bench.write(0x1000, register::DC_START_TIME, &start.to_le_bytes());
        bench.write(0x1000, register::DC_ACTIVATION, &[activation]);
        let answer = bench.request(0x1000, AlState::SafeOp, false);
        assert_eq!(answer.2, code, "{cycle} ns, {activation}, {needs}");
    }
}
