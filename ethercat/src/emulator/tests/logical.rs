//! Logical addressing: the mapping of bits, and the increment of the working counter.

use super::*;

/// One terminal at 1000h with an output byte at 1000h and an input byte at 1080h, in OP.
fn terminal() -> (Bench, Io) {
    let (mut bench, io) = Bench::small();
    bench.operate();
    (bench, io)
}

#[test]
fn logical_commands_count_once_a_slave_and_direction() {
    let (mut bench, io) = terminal();
    io.set_inputs(&[0xA5]);
    bench.logical(Command::Lwr, 0, &[0x11]);
    bench.now += MS;
    for (command, at, data, expected, counter) in [
        (Command::Lrd, 0, [0, 0], [0, 0xA5], 1),
        (Command::Lwr, 0, [0x11, 0x22], [0x11, 0x22], 1),
        (Command::Lrw, 0, [0x12, 0x22], [0x12, 0xA5], 3),
        // Outputs alone, inputs alone, nothing.
        (Command::Lrw, 0xFFFF_FFFF, [1, 0x13], [1, 0x13], 0),
        (Command::Lrw, 1, [9, 9], [0xA5, 9], 1),
        (Command::Lrw, 2, [9, 9], [9, 9], 0),
    ] {
        let answer = bench.logical(command, at, &data);
        assert_eq!(
            (answer.data, answer.counter),
            (expected.to_vec(), counter),
            "{command:?} {at}"
        );
    }
    // A window that ends with the outputs: write only, which LRW counts twice.
    assert_eq!(bench.logical(Command::Lrw, 0, &[0x14]).counter, 2);
    bench.now += MS;
    bench.segment.poll(bench.now);
    assert_eq!(io.outputs(), [0x14]);
}

#[test]
fn outputs_are_taken_before_inputs_overlap_them() {
    let (mut bench, io) = terminal();
    let fmmu = Fmmu {
        logical: 0,
        len: 1,
        stop_bit: 7,
        physical: 0x1080,
        reads: true,
        active: true,
        ..Fmmu::default()
    };
    bench.fmmu(0x1002, 1, &fmmu);
    io.set_inputs(&[0xC3]);
    bench.logical(Command::Lrw, 0, &[0x5A]);
    bench.now += 2 * MS;
    let answer = bench.logical(Command::Lrw, 0, &[0x5A]);
    assert_eq!((answer.data, answer.counter), (vec![0xC3], 3));
    bench.now += MS;
    bench.segment.poll(bench.now);
    assert_eq!(io.outputs(), [0x5A]);
}

#[test]
fn fmmu_maps_bits_to_their_addresses() {
    // Logical start bit, length, stop bit; physical start bit.
    for (start_bit, len, stop_bit, physical_bit) in [
        (0, 1, 3, 0),
        (4, 1, 7, 0),
        (2, 1, 5, 3),
        (6, 2, 1, 2),
        (7, 3, 0, 5),
    ] {
        let (mut bench, _) = Bench::small();
        bench.write(0x1000, 0x1F00, &[0xFF; 4]);
        let mut fmmu = Fmmu {
            logical: 0x100,
            len,
            start_bit,
            stop_bit,
            physical: 0x1F00,
            physical_bit,
            writes: true,
            active: true,
            ..Fmmu::default()
        };
        bench.fmmu(0x1000, 0, &fmmu);
        assert_eq!(bench.logical(Command::Lwr, 0x100, &[0; 4]).counter, 1);
        let ones = u32::from_le_bytes(bench.read(0x1000, 0x1F00));
        let mask = (1_u32 << fmmu.bits()) - 1;
        assert_eq!(ones, !(mask << physical_bit), "{fmmu:?}");
        // And back: zeros of the memory into ones of the frame.
        (fmmu.writes, fmmu.reads) = (false, true);
        bench.fmmu(0x1000, 0, &fmmu);
        let answer = bench.logical(Command::Lrd, 0x100, &[0xFF; 4]);
        let ones = u32::from_le_bytes(answer.data.try_into().unwrap());
        assert_eq!(ones, !(mask << start_bit), "{fmmu:?}");
    }
}

#[test]
fn image_may_be_split_over_datagrams() {
    let (slave, io) = Io::analogue(0, 4);
    let mut bench = Bench::new([slave]);
    bench.address();
    bench.channel(0x1000, 1, 0x1080, 8, SyncManager::INPUTS);
    let fmmu = Fmmu {
        logical: 0x1000,
        len: 8,
        stop_bit: 7,
        physical: 0x1080,
        reads: true,
        active: true,
        ..Fmmu::default()
    };
    bench.fmmu(0x1000, 0, &fmmu);
    bench.request(0x1000, AlState::PreOp, false);
    bench.request(0x1000, AlState::SafeOp, false);
    io.set_inputs(&[1, 2, 3, 4, 5, 6, 7, 8]);
    bench.now += 2 * MS;
    let first = bench.logical(Command::Lrd, 0x0FFE, &[0; 5]);
    io.set_inputs(&[9; 8]);
    bench.now += 2 * MS;
    let second = bench.logical(Command::Lrd, 0x1003, &[0; 5]);
    assert_eq!((first.data, first.counter), (vec![0, 0, 1, 2, 3], 1));
    // A started buffer is read to its end: the parts are consistent.
    assert_eq!((second.data, second.counter), (vec![4, 5, 6, 7, 8], 1));
    bench.now += 2 * MS;
    let third = bench.logical(Command::Lrd, 0x1000, &[0; 8]);
    assert_eq!(third.data, [9; 8]);
}

#[test]
fn fmmu_may_map_a_register() {
    let (mut bench, _) = Bench::small();
    let fmmu = Fmmu {
        logical: 5,
        len: 1,
        stop_bit: 0,
        physical: register::AL_STATUS,
        reads: true,
        active: true,
        ..Fmmu::default()
    };
    bench.fmmu(0x1000, 2, &fmmu);
    let answer = bench.logical(Command::Lrd, 5, &[0xF0]);
    assert_eq!((answer.data, answer.counter), (vec![0xF1], 1));
}

#[test]
fn slave_without_lrw_ignores_lrw() {
    let sii = crate::emulator::SiiImage {
        flags: 0x02,
        ..crate::emulator::SiiImage::default()
    };
    let config = crate::emulator::SlaveConfig::new(sii);
    let slave = Slave::new(config, Box::new(crate::emulator::Plain));
    let mut bench = Bench::new([slave]);
    bench.address();
    let fmmu = Fmmu {
        len: 1,
        stop_bit: 7,
        physical: 0x1F00,
        reads: true,
        active: true,
        ..Fmmu::default()
    };
    bench.fmmu(0x1000, 0, &fmmu);
    assert_eq!(bench.logical(Command::Lrw, 0, &[0]).counter, 0);
    assert_eq!(bench.logical(Command::Lrd, 0, &[0]).counter, 1);
    assert_eq!(bench.read::<2>(0x1000, 0x0008)[1] & 0x02, 0x02);
}
