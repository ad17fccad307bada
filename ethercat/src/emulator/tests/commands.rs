//! Every command against the table of ETG.1000.4: which slaves execute it, the increment of the working counter, and
//! the change of the address. Logical commands are in `logical.rs`.

use super::*;

/// User RAM in the process data memory.
const RAM: u16 = 0x1F00;

/// Three slaves that hold 1, 2, 4 in their RAM.
fn bench() -> Bench {
    let mut bench = Bench::new([Coupler::slave(), Coupler::slave(), Coupler::slave()]);
    bench.address();
    for (station, value) in [(0x1000, 1), (0x1001, 2), (0x1002, 4)] {
        bench.write(station, RAM, &[value]);
    }
    bench
}

#[test]
fn commands_act_and_count_as_the_table() {
    // Command, ADP, value returned for F0h, working counter, ADP after, RAM of the slaves after.
    let second = 0_u16.wrapping_sub(1);
    let table = [
        (Command::Nop, 0, 0xF0, 0, 0, [1, 2, 4]),
        (Command::Aprd, 0, 1, 1, 3, [1, 2, 4]),
        (Command::Aprd, second, 2, 1, 2, [1, 2, 4]),
        (Command::Aprd, 5, 0xF0, 0, 8, [1, 2, 4]),
        (Command::Apwr, second, 0xF0, 1, 2, [1, 0xF0, 4]),
        (Command::Aprw, second, 2, 3, 2, [1, 0xF0, 4]),
        (Command::Fprd, 0x1002, 4, 1, 0x1002, [1, 2, 4]),
        (Command::Fprd, 0x1003, 0xF0, 0, 0x1003, [1, 2, 4]),
        (Command::Fpwr, 0x1002, 0xF0, 1, 0x1002, [1, 2, 0xF0]),
        (Command::Fprw, 0x1002, 4, 3, 0x1002, [1, 2, 0xF0]),
        (Command::Brd, 0, 0xF7, 3, 3, [1, 2, 4]),
        (Command::Bwr, 0, 0xF0, 3, 3, [0xF0, 0xF0, 0xF0]),
        // Each slave writes the received value, then adds its previous one.
        (Command::Brw, 0, 0xF7, 9, 3, [0xF0, 0xF1, 0xF3]),
        (Command::Armw, 0, 1, 3, 3, [1, 1, 1]),
        (Command::Armw, second, 2, 3, 2, [0xF0, 2, 2]),
        (Command::Frmw, 0x1000, 1, 3, 0x1000, [1, 1, 1]),
        (Command::Frmw, 0x1001, 2, 3, 0x1001, [0xF0, 2, 2]),
        (Command::Other(0x37), 0, 0xF0, 0, 0, [1, 2, 4]),
    ];
    for (command, adp, data, counter, after, ram) in table {
        let mut bench = bench();
        let answer = bench.device(command, adp, RAM, &[0xF0]);
        let expected = (vec![data], counter, after);
        let found = (answer.data, answer.counter, answer.adp);
        assert_eq!(found, expected, "{command:?} {adp:04X}h");
        let held = [0x1000, 0x1001, 0x1002].map(|station| bench.read::<1>(station, RAM)[0]);
        assert_eq!(held, ram, "{command:?} {adp:04X}h");
    }
}

#[test]
fn alias_is_an_address_only_when_enabled() {
    let mut bench = Bench::new([Coupler::slave()]);
    bench.address();
    let slave = bench.segment.slave(0).unwrap();
    slave.eeprom_mut()[8..10].copy_from_slice(&0x0042_u16.to_le_bytes());
    let sum = crate::sii::checksum(&slave.eeprom()[..14]);
    slave.eeprom_mut()[14] = sum;
    bench.write(0x1000, register::SII_CONTROL, &0x0400_u16.to_le_bytes());
    bench.now += MS;
    assert_eq!(bench.read(0x1000, register::STATION_ALIAS), [0x42, 0]);
    let query = |bench: &mut Bench| bench.device(Command::Fprd, 0x0042, 0, &[0]).counter;
    assert_eq!(query(&mut bench), 0);
    bench.write(0x1000, register::DL_CONTROL + 3, &[1]);
    assert_eq!(query(&mut bench), 1);
}

#[test]
fn datagrams_of_a_frame_are_executed_in_order() {
    let mut bench = bench();
    let mut buffer = [0; 200];
    let mut writer = FrameWriter::new(&mut buffer).unwrap();
    let address = |adp| Address::Device { adp, ado: RAM };
    writer.push(Command::Bwr, 1, address(0), &[0x55]).unwrap();
    writer
        .push(Command::Fprd, 2, address(0x1002), &[0])
        .unwrap();
    writer
        .push(Command::Fpwr, 3, address(0x1002), &[0x66])
        .unwrap();
    writer
        .push(Command::Fprd, 4, address(0x1002), &[0])
        .unwrap();
    let len = writer.finish();
    let now = bench.now;
    bench
        .segment
        .process(&mut buffer[..len], Entry::First, now)
        .unwrap();
    let frame = Frame::decode(&buffer[..len]).unwrap();
    let data: Vec<_> = frame.datagrams().map(|d| d.unwrap().data[0]).collect();
    assert_eq!(data, [0x55, 0x55, 0x66, 0x66]);
}

#[test]
fn registers_missing_read_zero_and_constant_ones_persist() {
    let mut bench = bench();
    assert_eq!(bench.read(0x1000, 0x0F00), [0; 4]);
    assert_eq!(bench.read::<1>(0x1000, 0x0000), [0x11]);
    bench.write(0x1000, 0x0000, &[0x99]);
    assert_eq!(bench.read::<1>(0x1000, 0x0000), [0x11]);
    // Beyond its memory, and at the end of the address space.
    for at in [0x2FFF, 0x3000, 0xFFFF] {
        for command in [Command::Fprd, Command::Fpwr] {
            assert_eq!(bench.device(command, 0x1000, at, &[1, 1]).counter, 0);
        }
    }
}

#[test]
fn clock_registers_without_clock_do_not_answer() {
    let (mut bench, _) = Bench::small();
    // Two couplers with a clock, a terminal without.
    assert_eq!(bench.device(Command::Bwr, 0, 0x0900, &[0; 4]).counter, 2);
    assert_eq!(bench.device(Command::Brd, 0, 0x0910, &[0; 8]).counter, 2);
    assert_eq!(bench.device(Command::Brd, 0, 0x0120, &[0; 2]).counter, 3);
    assert_eq!(bench.read::<2>(0x1002, 0x0008)[0] & 0x0C, 0);
    assert_eq!(bench.read::<2>(0x1000, 0x0008)[0] & 0x0C, 0x0C);
}

#[test]
fn ethernet_frame_returns_marked_others_are_dropped() {
    let mut bench = bench();
    let mut frame = [0_u8; 60];
    frame[..6].fill(0xFF);
    frame[6..12].copy_from_slice(&[0x10, 1, 2, 3, 4, 5]);
    frame[12..14].copy_from_slice(&[0x88, 0xA4]);
    let mut writer = FrameWriter::new(&mut frame[14..]).unwrap();
    let address = Address::Device { adp: 0, ado: 0 };
    writer.push(Command::Brd, 0, address, &[0]).unwrap();
    let now = bench.now;
    let returned = bench
        .segment
        .process_ethernet(&mut frame, Entry::First, now);
    assert_eq!(returned.unwrap().by, Entry::First);
    assert_eq!(frame[6], 0x12);
    let decoded = Frame::decode(&frame[14..]).unwrap();
    let counter = decoded.datagrams().next().unwrap().unwrap().working_counter;
    assert_eq!(counter.raw(), 3);
    for ethertype in [[0x08, 0x00], [0x88, 0xA5]] {
        frame[12..14].copy_from_slice(&ethertype);
        let returned = bench
            .segment
            .process_ethernet(&mut frame, Entry::First, now);
        assert_eq!(returned, None);
    }
    assert_eq!(
        bench
            .segment
            .process_ethernet(&mut [0; 13], Entry::First, now),
        None
    );
}

#[test]
fn frame_with_wrong_lengths_is_counted_and_truncated() {
    let mut bench = bench();
    let mut buffer = [0; 200];
    let mut writer = FrameWriter::new(&mut buffer).unwrap();
    let address = |adp| Address::Device { adp, ado: RAM };
    writer.push(Command::Bwr, 1, address(0), &[0x55]).unwrap();
    writer.push(Command::Bwr, 2, address(0), &[0x66]).unwrap();
    let len = writer.finish();
    // The second datagram claims to be longer than the frame.
    buffer[2 + 13 + 6] = 100;
    let now = bench.now;
    bench.segment.process(&mut buffer[..len], Entry::First, now);
    assert_eq!(bench.read(0x1000, RAM), [0x55]);
    assert_eq!(bench.read(0x1001, 0x030C), [1]);
    bench.write(0x1001, 0x030C, &[0]);
    assert_eq!(bench.read(0x1001, 0x030C), [0]);
}
