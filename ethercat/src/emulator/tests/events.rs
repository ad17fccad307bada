//! Event requests and the interrupt field of datagrams.

use super::*;

fn events(bench: &mut Bench, station: u16) -> u16 {
    u16::from_le_bytes(bench.read(station, register::ECAT_EVENT))
}

#[test]
fn state_change_is_an_event_until_read() {
    let (mut bench, _) = Bench::small();
    bench.device(Command::Brd, 0, register::AL_STATUS, &[0; 2]);
    bench.device(Command::Brd, 0, register::DL_STATUS, &[0; 2]);
    bench.device(Command::Bwr, 0, register::ECAT_EVENT_MASK, &[0x08, 0]);
    bench.write(0x1000, register::AL_CONTROL, &[2, 0]);
    bench.now += MS;
    // Every datagram that passes carries it.
    let answer = bench.device(Command::Brd, 0, 0x0000, &[0]);
    assert_eq!(answer.irq, 0x08);
    assert_eq!(events(&mut bench, 0x1000) & 0x08, 0x08);
    bench.al(0x1000);
    assert_eq!(events(&mut bench, 0x1000) & 0x08, 0);
    assert_eq!(bench.device(Command::Brd, 0, 0x0000, &[0]).irq, 0);
}

#[test]
fn lost_link_is_an_event() {
    let (mut bench, _) = Bench::small();
    bench.device(Command::Brd, 0, register::DL_STATUS, &[0; 2]);
    assert_eq!(events(&mut bench, 0x1001) & 0x04, 0);
    bench.segment.set_link(2, false);
    assert_eq!(events(&mut bench, 0x1001) & 0x04, 0x04);
    assert_eq!(events(&mut bench, 0x1000) & 0x04, 0);
}

#[test]
fn firmware_has_its_own_events() {
    let (mut bench, _) = Bench::small();
    bench.map_terminal();
    bench.write(0x1002, register::AL_CONTROL, &[2, 0]);
    let al = u32::from_le_bytes(bench.read(0x1002, 0x0220));
    assert_eq!(al & 0x11, 0x11, "AL control and activation of channels");
    bench.now += MS;
    let al = u32::from_le_bytes(bench.read(0x1002, 0x0220));
    assert_eq!(al & 0x01, 0);
}
