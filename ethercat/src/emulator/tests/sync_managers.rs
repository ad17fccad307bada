//! SyncManagers: mailboxes that are full or empty, three buffers, what may be written when.

use super::*;
use crate::emulator::Chip;

/// The mailbox that the master writes: SyncManager 2, which the coupler itself leaves alone.
const OUT: Register = register::SYNC_MANAGER + 16;

/// A slave with a mailbox of 16 bytes in each direction, to test its memory.
fn mailbox() -> Bench {
    let mut bench = Bench::new([Coupler::slave()]);
    bench.address();
    bench.channel(0x1000, 2, 0x1400, 16, SyncManager::MAILBOX_OUT);
    bench.channel(0x1000, 3, 0x1410, 16, SyncManager::MAILBOX_IN);
    bench
}

fn status(bench: &mut Bench, number: u16) -> u8 {
    let [status] = bench.read(0x1000, register::SYNC_MANAGER + 8 * number + 5);
    status
}

fn put(bench: &mut Bench, at: u16, data: &[u8]) -> u16 {
    bench.device(Command::Fpwr, 0x1000, at, data).counter
}

fn take(bench: &mut Bench, at: u16, len: usize) -> (u16, Vec<u8>) {
    let answer = bench.device(Command::Fprd, 0x1000, at, &vec![0xEE; len]);
    (answer.counter, answer.data)
}

#[test]
fn mailbox_is_full_after_last_byte_then_refuses() {
    let mut bench = mailbox();
    assert_eq!(
        put(&mut bench, 0x1404, &[1; 4]),
        0,
        "not begun at its first byte"
    );
    assert_eq!(put(&mut bench, 0x1400, &[1; 8]), 1);
    assert_eq!(status(&mut bench, 2) & 0x08, 0);
    assert_eq!(put(&mut bench, 0x1408, &[2; 8]), 1, "goes on");
    assert_eq!(status(&mut bench, 2) & 0x09, 0x09);
    assert_eq!(put(&mut bench, 0x1400, &[3; 16]), 0, "full");
    assert_eq!(
        take(&mut bench, 0x1400, 4),
        (0, vec![0xEE; 4]),
        "not the master's to read"
    );
    // In INIT the firmware leaves it there.
    bench.segment.poll(2 * MS);
    assert_eq!(status(&mut bench, 2) & 0x08, 0x08);
}

#[test]
fn mailbox_is_empty_after_last_byte_is_read() {
    let mut memory = crate::emulator::memory::Memory::new(Chip::default(), false, false);
    let sm = SyncManager {
        start: 0x1000,
        len: 8,
        control: SyncManager::MAILBOX_IN,
        activate: 1,
        ..SyncManager::default()
    };
    assert!(memory.write(register::SYNC_MANAGER + 8, &sm.encode()));
    let mut data = [0xEE; 8];
    assert!(!memory.read(0x1000, &mut data));
    assert_eq!(data, [0xEE; 8]);
    assert!(memory.put_mailbox(1, &[1, 2, 3]));
    assert!(!memory.put_mailbox(1, &[4]), "full");
    assert!(!memory.put_mailbox(0, &[4]), "switched off");
    assert!(!memory.write(0x1000, &[9]), "not the master's to write");
    assert!(memory.read(0x1000, &mut data[..4]));
    assert!(memory.sync_manager(1).is_full());
    assert!(memory.read(0x1004, &mut data[4..]));
    assert_eq!(data, [1, 2, 3, 0, 0, 0, 0, 0]);
    assert!(!memory.sync_manager(1).is_full());
    assert!(!memory.read(0x1000, &mut data), "read once");
    // The master requests a repeat, and the slave acknowledges it.
    assert!(memory.write(register::SYNC_MANAGER + 8 + 6, &[0x03]));
    assert!(memory.events.repeat);
    memory.repeat(1);
    assert!(memory.sync_manager(1).is_full());
    assert_eq!(memory.sync_manager(1).pdi & 0x02, 0x02);
    assert!(memory.read(0x1000, &mut data));
    assert_eq!(data[..3], [1, 2, 3]);
}

#[test]
fn sync_manager_write_access_of_the_master() {
    let mut bench = mailbox();
    // Status and the slave's byte never; the rest only while it is off.
    put(&mut bench, OUT, &[0, 0x20, 99, 0, 0x24, 0xFF, 0x01, 0xFF]);
    let bytes: [u8; 8] = bench.read(0x1000, OUT);
    assert_eq!(bytes, [0, 0x14, 16, 0, 0x26, 0x00, 1, 0]);
    put(&mut bench, OUT + 6, &[0]);
    put(&mut bench, OUT, &[0, 0x20, 99, 0]);
    let bytes: [u8; 8] = bench.read(0x1000, OUT);
    assert_eq!(bytes, [0, 0x20, 99, 0, 0x26, 0x00, 0, 0]);
}

#[test]
fn sync_manager_off_by_master_unlocks_by_slave_locks() {
    let mut bench = mailbox();
    put(&mut bench, OUT + 6, &[0]);
    assert_eq!(put(&mut bench, 0x1404, &[5]), 1);
    assert_eq!(take(&mut bench, 0x1404, 1), (1, vec![5]));
    // A terminal in INIT has its outputs switched off from its side.
    let (terminal, _) = Io::digital(8, 0);
    let mut bench = Bench::new([terminal.with_firmware()]);
    bench.address();
    bench.channel(0x1000, 0, 0x1000, 1, SyncManager::OUTPUTS);
    assert_eq!(bench.read::<8>(0x1000, register::SYNC_MANAGER)[7], 1);
    assert_eq!(put(&mut bench, 0x1000, &[1]), 0);
}

#[test]
fn three_buffers_return_the_newest_complete_one() {
    let mut memory = crate::emulator::memory::Memory::new(Chip::default(), false, false);
    for (number, control) in [(0, SyncManager::OUTPUTS), (1, SyncManager::INPUTS)] {
        let sm = SyncManager {
            start: 0x1000 + 0x100 * number,
            len: 4,
            control,
            activate: 1,
            ..SyncManager::default()
        };
        assert!(memory.write(register::SYNC_MANAGER + 8 * number, &sm.encode()));
    }
    // Outputs: whole ones only.
    assert_eq!(memory.outputs(0), None);
    assert!(memory.write(0x1000, &[1, 2]));
    assert_eq!(memory.outputs(0), None, "half");
    assert!(memory.write(0x1002, &[3, 4]));
    assert_eq!(memory.outputs(0), Some(&[1, 2, 3, 4][..]));
    assert!(memory.write(0x1000, &[5, 6]));
    assert_eq!(
        memory.outputs(0),
        Some(&[1, 2, 3, 4][..]),
        "half of the next"
    );
    assert!(memory.write(0x1000, &[7, 8, 9, 10]));
    assert_eq!(memory.outputs(0), Some(&[7, 8, 9, 10][..]));
    // Inputs: nothing before the first, no tearing, as often as wanted.
    let mut data = [0xEE; 4];
    assert!(!memory.read(0x1100, &mut data));
    memory.set_inputs(1, &[1, 1, 1, 1]);
    assert!(memory.read(0x1100, &mut data[..2]));
    memory.set_inputs(1, &[2, 2, 2, 2]);
    assert!(memory.read(0x1102, &mut data[2..]));
    assert_eq!(data, [1; 4]);
    for _ in 0..2 {
        assert!(memory.read(0x1100, &mut data));
        assert_eq!(data, [2; 4]);
    }
    // The number of the last buffer goes round.
    let last: Vec<_> = (0..4)
        .map(|_| {
            memory.set_inputs(1, &[3; 4]);
            memory.sync_manager(1).status >> 4 & 3
        })
        .collect();
    assert_eq!(last, [0, 1, 2, 0]);
}

#[test]
fn datagram_across_two_areas_counts_one_access() {
    let mut memory = crate::emulator::memory::Memory::new(Chip::default(), false, false);
    let sm = SyncManager {
        start: 0x1002,
        len: 2,
        control: SyncManager::INPUTS,
        activate: 1,
        ..SyncManager::default()
    };
    assert!(memory.write(register::SYNC_MANAGER, &sm.encode()));
    assert!(memory.write(0x1000, &[1, 2, 3, 4, 5, 6]));
    memory.set_inputs(0, &[7, 8]);
    let mut data = [0; 6];
    assert!(memory.read(0x1000, &mut data));
    assert_eq!(data, [1, 2, 7, 8, 5, 6]);
}
