//! The servo drive from the master's side: mailbox, PDOs, SYNC0, faults.

use takt_cia402::State;
use takt_cia402::emulator::FaultCode;

use super::*;
use crate::emulator::{ServoConfig, ServoDrive, SlaveFaults};
use crate::{Emergency, MailboxHeader, MailboxKind};

const STATION: u16 = 0x1000;
const MAILBOX: usize = 128;

/// A drive in its own segment, accessed by mailbox.
struct Rig {
    bench: Bench,
    drive: ServoDrive,
    counter: u8,
    /// Unsolicited CoE messages.
    unasked: Vec<Vec<u8>>,
}

impl Rig {
    fn new(config: ServoConfig) -> Self {
        let (slave, drive) = ServoDrive::slave(config).unwrap();
        Self::of(slave, drive)
    }

    fn of(slave: Slave, drive: ServoDrive) -> Self {
        let mut bench = Bench::new([slave]);
        bench.address();
        let mut rig = Self {
            bench,
            drive,
            counter: 0,
            unasked: Vec::new(),
        };
        rig.bench
            .channel(STATION, 0, 0x1000, 128, SyncManager::MAILBOX_OUT);
        rig.bench
            .channel(STATION, 1, 0x1080, 128, SyncManager::MAILBOX_IN);
        assert_eq!(
            rig.bench.request(STATION, AlState::PreOp, false).0,
            AlState::PreOp
        );
        rig
    }

    fn send(&mut self, inside: &[u8]) {
        self.counter = MailboxHeader::next_counter(self.counter);
        self.send_again(inside);
    }

    fn send_again(&mut self, inside: &[u8]) {
        let header = MailboxHeader {
            len: u16::try_from(inside.len()).unwrap(),
            address: 0,
            kind: MailboxKind::Coe,
            counter: self.counter,
        };
        let mut mailbox = header.encode().to_vec();
        mailbox.extend_from_slice(inside);
        mailbox.resize(MAILBOX, 0);
        self.bench.write(STATION, 0x1000, &mailbox);
    }

    /// The next mailbox message, if there is one.
    fn fetch(&mut self) -> Option<(MailboxHeader, Vec<u8>)> {
        self.bench.now += MS;
        let answer = self
            .bench
            .device(Command::Fprd, STATION, 0x1080, &[0; MAILBOX]);
        if answer.counter == 0 {
            return None;
        }
        let (header, inside) = MailboxHeader::decode(&answer.data).unwrap();
        Some((header, inside.to_vec()))
    }

    /// The answer to an SDO; emergencies are stored.
    fn sdo(&mut self, request: [u8; 8]) -> Vec<u8> {
        let mut inside = vec![0, 0x20];
        inside.extend(request);
        self.send(&inside);
        loop {
            let (_, inside) = self.fetch().expect("an answer");
            if inside[1] >> 4 == 1 {
                self.unasked.push(inside);
            } else {
                return inside[2..].to_vec();
            }
        }
    }

    fn upload(&mut self, index: u16, sub: u8) -> u32 {
        let [low, high] = index.to_le_bytes();
        let reply = self.sdo([0x40, low, high, sub, 0, 0, 0, 0]);
        assert_eq!(reply[0] & 0xE2, 0x42, "{index:04X}h:{sub} {reply:X?}");
        let len = 4 - usize::from(reply[0] >> 2 & 3);
        let mut value = [0; 4];
        value[..len].copy_from_slice(&reply[4..4 + len]);
        u32::from_le_bytes(value)
    }

    /// The abort code, or 0.
    fn download(&mut self, index: u16, sub: u8, value: u32, len: u8) -> u32 {
        let ([low, high], [a, b, c, d]) = (index.to_le_bytes(), value.to_le_bytes());
        let reply = self.sdo([0x23 | (4 - len) << 2, low, high, sub, a, b, c, d]);
        match reply[0] {
            0x60 => 0,
            0x80 => u32::from_le_bytes(reply[4..8].try_into().unwrap()),
            other => panic!("{other:02X}h"),
        }
    }

    /// Process data at the addresses of the SII, mapped to logical address 0 (outputs) and behind.
    fn map(&mut self, outputs: u16, inputs: u16) {
        let own = self
            .bench
            .segment
            .slave(0)
            .unwrap()
            .config()
            .sii
            .sync_managers();
        let control = [SyncManager::OUTPUTS, SyncManager::INPUTS];
        let mut logical = 0;
        for (number, len) in [(0_u16, outputs), (1, inputs)] {
            let start = own[usize::from(number) + 2].start;
            let sm = number + 2;
            self.bench
                .channel(STATION, sm, start, len, control[usize::from(number)]);
            let fmmu = Fmmu {
                logical,
                len,
                stop_bit: 7,
                physical: start,
                reads: number == 1,
                writes: number == 0,
                active: true,
                ..Fmmu::default()
            };
            self.bench.fmmu(STATION, number, &fmmu);
            logical += u32::from(len);
        }
    }

    /// SYNC0 each ms from 5 ms from now on, at 0.5 ms within the grid of the frames.
    fn sync0(&mut self, period: u32) {
        let now = u64::from_le_bytes(self.bench.read(STATION, register::DC_SYSTEM_TIME));
        let start = now / MS * MS + 20 * MS + MS / 2;
        self.bench
            .write(STATION, register::DC_SYNC0_CYCLE, &period.to_le_bytes());
        self.bench
            .write(STATION, register::DC_START_TIME, &start.to_le_bytes());
        self.bench.write(STATION, register::DC_ACTIVATION, &[3]);
    }

    /// One cycle of process data; the inputs.
    fn cycle(&mut self, outputs: &[u8], inputs: usize) -> Vec<u8> {
        self.bench.now = (self.bench.now / MS + 1) * MS;
        let mut data = outputs.to_vec();
        data.resize(outputs.len() + inputs, 0);
        let answer = self.bench.logical(Command::Lrw, 0, &data);
        answer.data[outputs.len()..].to_vec()
    }

    /// Brings a drive of the default mapping into OP with SYNC0.
    fn operate(&mut self) {
        self.map(14, 16);
        self.sync0(1_000_000);
        let safe = self.bench.request(STATION, AlState::SafeOp, false);
        assert_eq!(safe, (AlState::SafeOp, false, 0));
        for _ in 0..30 {
            self.cycle(&outputs(0, 0, 0), 16);
        }
        self.bench.write(STATION, register::AL_CONTROL, &[8, 0]);
        for _ in 0..3 {
            self.cycle(&outputs(0, 0, 0), 16);
        }
        assert_eq!(self.bench.al(STATION), (AlState::Op, false, 0));
    }

    /// Follows the statusword until operation is enabled in CSP; the position then.
    fn enable(&mut self) -> i32 {
        let mut inputs = self.cycle(&outputs(0, 8, 0), 16);
        for _ in 0..200 {
            let position = position(&inputs);
            let word = match status(&inputs) & 0x6F {
                0x21 => 0x07,
                0x23 | 0x27 => 0x0F,
                word if word & 0x4F == 0x08 => 0x80,
                _ => 0x06,
            };
            if status(&inputs) & 0x6F == 0x27 {
                return position;
            }
            inputs = self.cycle(&outputs(word, 8, position), 16);
        }
        panic!("statusword {:04X}h", status(&inputs));
    }
}

fn outputs(word: u16, mode: u8, position: i32) -> [u8; 14] {
    let mut bytes = [0; 14];
    bytes[..2].copy_from_slice(&word.to_le_bytes());
    bytes[2] = mode;
    bytes[4..8].copy_from_slice(&position.to_le_bytes());
    bytes
}

fn status(inputs: &[u8]) -> u16 {
    u16::from_le_bytes([inputs[0], inputs[1]])
}

fn position(inputs: &[u8]) -> i32 {
    i32::from_le_bytes(inputs[4..8].try_into().unwrap())
}

#[test]
fn objects_are_read_and_written_by_mailbox() {
    let mut rig = Rig::new(ServoConfig::default());
    assert_eq!(rig.upload(0x1000, 0), 0x0002_0192);
    assert_eq!(rig.upload(0x1C00, 4), 4);
    assert_eq!(rig.download(0x6083, 0, 12345, 4), 0);
    assert_eq!(rig.upload(0x6083, 0), 12345);
    assert_eq!(
        rig.download(0x6060, 0, 0x64, 1),
        0x0609_0030,
        "a mode that it has not"
    );
    assert_eq!(rig.download(0x1000, 0, 0, 4), 0x0601_0002);
    assert_eq!(rig.upload(0x6041, 0) & 0x4F, 0x40, "it lives in PRE-OP");
}

#[test]
fn repeated_request_is_executed_once() {
    let mut rig = Rig::new(ServoConfig::default());
    let request = [0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0];
    rig.send(&request);
    let (first, _) = rig.fetch().unwrap();
    rig.send_again(&request);
    assert_eq!(rig.fetch(), None);
    // The answer was lost: the repeat bit requests it again.
    rig.bench
        .write(STATION, register::SYNC_MANAGER + 8 + 6, &[3]);
    let [acknowledge] = rig.bench.read(STATION, register::SYNC_MANAGER + 8 + 7);
    assert_eq!(acknowledge & 2, 2);
    let (again, inside) = rig.fetch().unwrap();
    assert_eq!((again.counter, inside[2]), (first.counter, 0x43));
}

#[test]
fn wrong_mailboxes_are_answered_by_errors() {
    let mut rig = Rig::new(ServoConfig::default());
    // An EoE message, a header that promises more than the mailbox holds.
    for (bytes, code) in [([4, 0, 0, 0, 0, 0x12], 2), ([0xFF, 0xFF, 0, 0, 0, 0x13], 6)] {
        let mut mailbox = bytes.to_vec();
        mailbox.resize(MAILBOX, 0);
        rig.bench.write(STATION, 0x1000, &mailbox);
        let (header, inside) = rig.fetch().unwrap();
        assert_eq!(header.kind, MailboxKind::Error);
        assert_eq!(inside, [1, 0, code, 0], "{bytes:?}");
    }
}

#[test]
fn emergencies_are_sent_unsolicited_before_an_answer() {
    let mut rig = Rig::new(ServoConfig::default());
    let emergency = Emergency {
        code: 0x7320,
        register: 0x20,
        data: [0; 5],
    };
    rig.drive.emergency(&emergency);
    assert_eq!(rig.fetch().unwrap().1[..4], [0, 0x10, 0x20, 0x73]);
    rig.bench.segment.slave(0).unwrap().faults().mailbox_errors = Some((1, 4));
    rig.send(&[0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0]);
    assert_eq!(rig.fetch().unwrap().0.kind, MailboxKind::Error);
    assert_eq!(rig.upload(0x1000, 0), 0x0002_0192);
}

#[test]
fn mailbox_faults_delay_drop_or_duplicate_answers() {
    let mut rig = Rig::new(ServoConfig::default());
    let request = [0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0];
    let faults = |rig: &mut Rig, faults| *rig.bench.segment.slave(0).unwrap().faults() = faults;
    faults(
        &mut rig,
        SlaveFaults {
            lose_answers: 1,
            ..SlaveFaults::default()
        },
    );
    rig.send(&request);
    assert_eq!(rig.fetch(), None);
    faults(
        &mut rig,
        SlaveFaults {
            repeat_answers: 1,
            ..SlaveFaults::default()
        },
    );
    rig.send(&request);
    let (first, second) = (rig.fetch().unwrap(), rig.fetch().unwrap());
    assert_eq!(first, second);
    assert_eq!(rig.fetch(), None);
}

#[test]
fn pdos_change_in_pre_op_with_count_zero() {
    let mut rig = Rig::new(ServoConfig::default());
    assert_eq!(
        rig.download(0x1600, 1, 0x6040_0010, 4),
        0x0601_0000,
        "count is not zero"
    );
    assert_eq!(rig.download(0x1600, 0, 0, 1), 0);
    assert_eq!(rig.download(0x1600, 1, 0x6040_0010, 4), 0);
    assert_eq!(
        rig.download(0x1600, 2, 0x6041_0010, 4),
        0x0604_0041,
        "6041h is not to be received"
    );
    assert_eq!(rig.download(0x1600, 2, 0x60FF_0020, 4), 0);
    assert_eq!(rig.download(0x1600, 0, 2, 1), 0);
    assert_eq!(rig.download(0x1C12, 0, 0, 1), 0);
    assert_eq!(rig.download(0x1C12, 1, 0x1A00, 2), 0);
    assert_eq!(
        rig.download(0x1C12, 0, 1, 1),
        0x0604_0043,
        "a PDO of the other direction"
    );
    assert_eq!(rig.download(0x1C12, 1, 0x1600, 2), 0);
    assert_eq!(rig.download(0x1C12, 0, 1, 1), 0);
    // The lengths must agree with the new mapping.
    rig.map(14, 16);
    assert_eq!(rig.bench.request(STATION, AlState::SafeOp, false).2, 0x1D);
    rig.bench
        .write(STATION, register::SYNC_MANAGER + 8 * 2 + 6, &[0]);
    rig.bench
        .write(STATION, register::SYNC_MANAGER + 8 * 3 + 6, &[0]);
    rig.map(6, 15);
    assert_eq!(rig.bench.request(STATION, AlState::SafeOp, true).2, 0x1E);
    rig.bench
        .write(STATION, register::SYNC_MANAGER + 8 * 3 + 6, &[0]);
    rig.bench
        .write(STATION, register::SYNC_MANAGER + 8 * 2 + 6, &[0]);
    rig.map(6, 16);
    let safe = rig.bench.request(STATION, AlState::SafeOp, true);
    assert_eq!(safe, (AlState::SafeOp, false, 0));
    assert_eq!(
        rig.download(0x1C12, 0, 0, 1),
        0x0800_0022,
        "not outside PRE-OP"
    );
}

#[test]
fn missing_pdo_or_wrong_cycle_is_refused() {
    let mut rig = Rig::new(ServoConfig {
        needs_sync0: true,
        ..ServoConfig::default()
    });
    rig.map(14, 16);
    assert_eq!(
        rig.bench.request(STATION, AlState::SafeOp, false).2,
        0x30,
        "needs SYNC0"
    );
    rig.sync0(1_000_001);
    assert_eq!(rig.bench.request(STATION, AlState::SafeOp, true).2, 0x35);
    rig.bench.request(STATION, AlState::PreOp, true);
    rig.sync0(1_000_000);
    assert_eq!(rig.bench.request(STATION, AlState::SafeOp, true).2, 0);
    assert_eq!(
        (rig.upload(0x1C32, 1), rig.upload(0x1C32, 2)),
        (2, 1_000_000)
    );
    rig.bench.request(STATION, AlState::PreOp, false);
    // SYNC0 selected by object, but not active.
    let mut rig = Rig::new(ServoConfig::default());
    rig.download(0x1C32, 1, 2, 2);
    rig.map(14, 16);
    assert_eq!(rig.bench.request(STATION, AlState::SafeOp, false).2, 0x30);
}

#[test]
fn axis_follows_cyclic_positions_by_sync0() {
    let mut rig = Rig::new(ServoConfig::default());
    rig.operate();
    let start = rig.enable();
    let mut inputs = vec![];
    for n in 1..=500 {
        inputs = rig.cycle(&outputs(0x0F, 8, start + 8 * n), 16);
    }
    let behind = start + 8 * 500 - position(&inputs);
    assert!((0..200).contains(&behind), "{behind} increments behind");
    assert_eq!(status(&inputs) & 0x6F, 0x27);
    assert_eq!(rig.upload(0x1C32, 0x0B), 0, "no outputs were missed");
    assert_eq!(
        rig.drive.axis(0, |axis| axis.state()),
        Some(State::OperationEnabled)
    );
}

#[test]
fn drive_runs_by_outputs_without_sync0() {
    let mut rig = Rig::new(ServoConfig::default());
    rig.map(14, 16);
    rig.bench.request(STATION, AlState::SafeOp, false);
    rig.cycle(&outputs(0, 0, 0), 16);
    rig.bench.request(STATION, AlState::Op, false);
    let start = rig.enable();
    let mut inputs = vec![];
    for n in 1..=200 {
        inputs = rig.cycle(&outputs(0x0F, 8, start + 8 * n), 16);
    }
    assert!(position(&inputs) > start + 1200);
}

#[test]
fn drive_after_init_without_sync0_runs_by_outputs() {
    let mut rig = Rig::new(ServoConfig::default());
    rig.operate();
    assert_eq!(rig.upload(0x1C32, 1), 2);
    rig.bench.request(STATION, AlState::Init, false);
    rig.bench.write(STATION, register::DC_ACTIVATION, &[0]);
    rig.bench.request(STATION, AlState::PreOp, false);
    rig.map(14, 16);
    assert_eq!(rig.upload(0x1C32, 1), 1);
    let safe = rig.bench.request(STATION, AlState::SafeOp, false);
    assert_eq!(safe, (AlState::SafeOp, false, 0));
}

#[test]
fn drives_with_other_pdos_have_other_products() {
    let products = (1..=8).map(|axes| {
        ServoConfig::with_axes(vec![takt_cia402::emulator::DriveConfig::default(); axes])
    });
    let products: Vec<_> = products.map(|config| config.product).collect();
    assert_eq!(products[0], ServoConfig::default().product);
    assert!(products.is_sorted_by(|a, b| a < b), "{products:X?}");
}

#[test]
fn outputs_that_miss_sync0_end_op() {
    let mut rig = Rig::new(ServoConfig::default());
    rig.operate();
    rig.bench.now += 7 * MS;
    assert_eq!(rig.bench.al(STATION), (AlState::SafeOp, true, 0x1A));
    assert_eq!(rig.upload(0x1C32, 0x0B), 4);
}

#[test]
fn sync0_loss_ends_op_where_required() {
    let mut rig = Rig::new(ServoConfig {
        needs_sync0: true,
        ..ServoConfig::default()
    });
    rig.operate();
    rig.bench.write(STATION, register::DC_ACTIVATION, &[0]);
    rig.bench.now += MS;
    assert_eq!(rig.bench.al(STATION), (AlState::SafeOp, true, 0x2C));
}

#[test]
fn drive_fault_shows_in_status_object_and_emergency() {
    let mut rig = Rig::new(ServoConfig::default());
    rig.operate();
    let start = rig.enable();
    rig.drive
        .axis(0, |axis| axis.fault(FaultCode::SHORT_CIRCUIT));
    let mut inputs = vec![];
    for _ in 0..300 {
        inputs = rig.cycle(&outputs(0x0F, 8, start), 16);
    }
    assert_eq!(status(&inputs) & 0x4F, 0x08);
    assert_eq!(inputs[14..16], [0x20, 0x23]);
    assert_eq!(
        rig.bench.al(STATION).0,
        AlState::Op,
        "a fault of the axis is none of the bus"
    );
    let (_, message) = rig.fetch().unwrap();
    assert_eq!(message, [0, 0x10, 0x20, 0x23, 0x03, 0, 0, 0, 0, 0]);
    rig.drive.axis(0, |axis| axis.clear_cause());
    for word in [0, 0x80, 0x80, 0] {
        inputs = rig.cycle(&outputs(word, 8, start), 16);
    }
    assert_eq!(status(&inputs) & 0x4F, 0x40);
    assert_eq!(
        rig.fetch().unwrap().1[..5],
        [0, 0x10, 0, 0, 0],
        "the fault was reset"
    );
}

#[test]
fn axis_under_power_stops_when_op_ends() {
    let mut rig = Rig::new(ServoConfig::default());
    rig.operate();
    let start = rig.enable();
    for n in 1..=100 {
        rig.cycle(&outputs(0x0F, 8, start + 8 * n), 16);
    }
    rig.bench.now += 200 * MS;
    assert_eq!(rig.bench.al(STATION).0, AlState::SafeOp);
    for _ in 0..2000 {
        rig.bench.now += MS;
        rig.bench.segment.poll(rig.bench.now);
    }
    let state = rig
        .drive
        .axis(0, |axis| (axis.state(), axis.motor().velocity.abs() < 0.1));
    assert_eq!(state, Some((State::Fault, true)));
}

#[test]
fn tx90_has_six_axes_in_one_slave() {
    let (slave, drive) = ServoDrive::slave(ServoConfig::tx90()).unwrap();
    let mut rig = Rig::of(slave, drive);
    for axis in 0..6_u16 {
        assert_eq!(rig.upload(0x6502 + 0x800 * axis, 0), 0x380);
        assert_eq!(
            rig.upload(0x1600 + 0x10 * axis, 4),
            0x607A_0020 + (0x0800_0000 * u32::from(axis))
        );
    }
    rig.map(6 * 14, 6 * 16);
    rig.sync0(2_000_000);
    let safe = rig.bench.request(STATION, AlState::SafeOp, false);
    assert_eq!(safe, (AlState::SafeOp, false, 0));
    let each = |word, positions: [i32; 6]| -> Vec<u8> {
        positions
            .iter()
            .flat_map(|p| outputs(word, 8, *p))
            .collect()
    };
    for _ in 0..40 {
        rig.cycle(&each(0, [0; 6]), 96);
    }
    rig.bench.write(STATION, register::AL_CONTROL, &[8, 0]);
    let mut inputs = rig.cycle(&each(0, [0; 6]), 96);
    for word in [6, 6, 7, 7, 15, 15] {
        for _ in 0..50 {
            let held: [i32; 6] = std::array::from_fn(|n| position(&inputs[16 * n..]));
            inputs = rig.cycle(&each(word, held), 96);
        }
    }
    for n in 0..6 {
        assert_eq!(status(&inputs[16 * n..]) & 0x6F, 0x27, "axis {n}");
    }
}

#[test]
fn power_on_resets_everything() {
    let mut rig = Rig::new(ServoConfig::default());
    rig.download(0x6083, 0, 1, 4);
    rig.bench.segment.set_power(0, false);
    rig.bench.segment.set_power(0, true);
    let Rig { bench, drive, .. } = rig;
    let value = drive.dictionary(|d| {
        d.bytes(takt_cia402::dictionary::Address::new(0x6083, 0))
            .map(<[u8]>::to_vec)
    });
    assert_eq!(value, Some(400_000_u32.to_le_bytes().to_vec()));
    assert_eq!(bench.segment.len(), 1);
}
