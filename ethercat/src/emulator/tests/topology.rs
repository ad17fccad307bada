//! Cables: which slaves a frame reaches, the port status they report, the second cable of a ring.

use super::*;

fn count(bench: &mut Bench) -> u16 {
    bench.device(Command::Brd, 0, 0x0000, &[0]).counter
}

fn dl_status(bench: &mut Bench, station: u16) -> u16 {
    u16::from_le_bytes(bench.read(station, register::DL_STATUS))
}

/// Sends a counting frame by an entry; returns the count and the entry of return.
fn count_by(segment: &mut Segment, entry: Entry, now: u64) -> Option<(u16, Entry)> {
    let mut buffer = [0; 64];
    let mut writer = FrameWriter::new(&mut buffer).unwrap();
    let address = Address::Device { adp: 0, ado: 0 };
    writer.push(Command::Brd, 0, address, &[0]).unwrap();
    let len = writer.finish();
    let returned = segment.process(&mut buffer[..len], entry, now)?;
    let frame = Frame::decode(&buffer[..len]).unwrap();
    let datagram = frame.datagrams().next().unwrap().unwrap();
    Some((datagram.working_counter.raw(), returned.by))
}

#[test]
fn dl_status_follows_the_cables() {
    let (mut bench, _) = Bench::small();
    assert_eq!(dl_status(&mut bench, 0x1000), 0x5A33);
    assert_eq!(dl_status(&mut bench, 0x1002), 0x5613);
    bench.segment.set_link(2, false);
    assert_eq!(count(&mut bench), 2);
    assert_eq!(dl_status(&mut bench, 0x1001), 0x5613);
    bench.segment.set_link(2, true);
    assert_eq!(count(&mut bench), 3);
    assert_eq!(dl_status(&mut bench, 0x1001), 0x5A33);
    assert_eq!(bench.read::<4>(0x1001, register::LOST_LINKS), [0, 1, 0, 0]);
    assert_eq!(bench.read::<4>(0x1002, register::LOST_LINKS), [1, 0, 0, 0]);
    bench.write(0x1002, register::LOST_LINKS, &[0]);
    assert_eq!(bench.read::<4>(0x1002, register::LOST_LINKS), [0; 4]);
}

#[test]
fn slave_after_power_loss_is_reset() {
    let (mut bench, _) = Bench::small();
    bench.request(0x1001, AlState::PreOp, false);
    bench.segment.set_power(1, false);
    assert_eq!(count(&mut bench), 1);
    bench.segment.set_power(1, true);
    assert_eq!(count(&mut bench), 3);
    assert_eq!(
        bench.device(Command::Fprd, 0x1001, 0, &[0]).counter,
        0,
        "no address"
    );
    assert_eq!(
        bench.device(Command::Fprd, 0x1002, 0, &[0]).counter,
        1,
        "kept its address"
    );
    bench.address();
    assert_eq!(bench.al(0x1001), (AlState::Init, false, 0));
    assert_eq!(bench.read::<4>(0x1002, register::LOST_LINKS), [1, 0, 0, 0]);
}

#[test]
fn frames_to_a_cut_segment_are_lost() {
    let (mut bench, _) = Bench::small();
    bench.segment.set_link(0, false);
    let address = Address::Device { adp: 0, ado: 0 };
    assert_eq!(bench.try_send(Command::Brd, address, &[0]), None);
    assert_eq!(Bench::new([]).try_send(Command::Brd, address, &[0]), None);
}

#[test]
fn loop_closed_by_dl_control_ends_the_line() {
    let (mut bench, _) = Bench::small();
    bench.write(0x1000, register::DL_CONTROL + 1, &[0x0C]);
    assert_eq!(count(&mut bench), 1);
    assert_eq!(
        dl_status(&mut bench, 0x1000) & 0x0C20,
        0x0420,
        "link, but closed"
    );
    bench.write(0x1000, register::DL_CONTROL + 1, &[0]);
    assert_eq!(count(&mut bench), 3);
}

#[test]
fn ring_is_passed_once_and_cut_ring_twice() {
    let (mut bench, _) = Bench::small();
    let segment = &mut bench.segment;
    assert_eq!(count_by(segment, Entry::First, MS), Some((3, Entry::First)));
    assert_eq!(count_by(segment, Entry::Last, MS), None, "no second cable");
    segment.set_redundant(true);
    assert_eq!(count_by(segment, Entry::First, MS), Some((3, Entry::Last)));
    assert_eq!(count_by(segment, Entry::Last, MS), Some((0, Entry::First)));
    for cut in 1..3 {
        segment.set_link(usize::from(cut), false);
        assert_eq!(
            count_by(segment, Entry::First, MS),
            Some((cut, Entry::First))
        );
        assert_eq!(
            count_by(segment, Entry::Last, MS),
            Some((3 - cut, Entry::Last))
        );
        segment.set_link(usize::from(cut), true);
    }
    segment.set_link(0, false);
    assert_eq!(count_by(segment, Entry::First, MS), None);
    assert_eq!(count_by(segment, Entry::Last, MS), Some((3, Entry::Last)));
    segment.set_link(0, true);
    segment.set_power(1, false);
    assert_eq!(count_by(segment, Entry::First, MS), Some((1, Entry::First)));
    assert_eq!(count_by(segment, Entry::Last, MS), Some((1, Entry::Last)));
}

#[test]
fn frame_through_a_ring_does_not_return_to_ports() {
    let (mut bench, _) = Bench::small();
    bench.segment.set_redundant(true);
    let latch = |bench: &mut Bench| {
        bench.now += MS;
        bench.device(Command::Bwr, 0, register::DC_RECEIVE_TIMES, &[0; 4]);
        let times: [u8; 8] = bench.read(0x1000, register::DC_RECEIVE_TIMES);
        (times[..4] == [0; 4], times[4..] == [0; 4])
    };
    assert_eq!(latch(&mut bench), (false, true), "port 1 keeps what it had");
    // With the loop of the last slave closed the ring is a line.
    bench.write(0x1002, register::DL_CONTROL + 1, &[0x0C]);
    assert_eq!(latch(&mut bench), (false, false));
    let segment = &mut bench.segment;
    assert_eq!(
        count_by(segment, Entry::First, 9 * MS),
        Some((3, Entry::First))
    );
    assert_eq!(count_by(segment, Entry::Last, 9 * MS), None);
    bench.write(0x1002, register::DL_CONTROL + 1, &[0]);
    let through = count_by(&mut bench.segment, Entry::First, 9 * MS);
    assert_eq!(through, Some((3, Entry::Last)));
}
