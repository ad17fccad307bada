//! The youBot from its drivers' side: names, process data of both firmwares, TMCL, homing, faults.

use super::*;
use crate::emulator::{Boards, DriveHandle, Firmware, YouBot, YouBotConfig};
use crate::sii::{Category, Sii};

/// A youBot whose drives are in OP: 1001h to 1004h wheels, 1006h to 100Ah joints.
struct Rig {
    bench: Bench,
    bot: YouBot,
    inputs: u16,
    /// Outputs of the drives in order.
    orders: Vec<(i32, u8)>,
}

const WHEELS: std::ops::Range<u16> = 1..5;
const JOINTS: std::ops::Range<u16> = 6..11;

fn drives() -> impl Iterator<Item = u16> {
    WHEELS.chain(JOINTS)
}

impl Rig {
    fn new(firmware: Firmware) -> Self {
        let config = YouBotConfig {
            firmware,
            ..YouBotConfig::default()
        };
        let (segment, bot) = YouBot::segment(&config);
        let mut bench = Bench { segment, now: MS };
        bench.address();
        let inputs = match firmware {
            Firmware::V148 => 20,
            Firmware::V200 => 32,
        };
        for (n, drive) in (0_u32..).zip(drives()) {
            let station = 0x1000 + drive;
            let sms = bench
                .segment
                .slave(drive.into())
                .unwrap()
                .config()
                .sii
                .sync_managers();
            for (number, sm) in (0..).zip(&sms) {
                bench.channel(station, number, sm.start, sm.len, sm.control);
            }
            assert_eq!((sms[2].len, sms[3].len), (5, inputs));
            for (number, logical, sm) in [
                (0, 5 * n, &sms[2]),
                (1, 0x1000 + u32::from(inputs) * n, &sms[3]),
            ] {
                let fmmu = Fmmu {
                    logical,
                    len: sm.len,
                    stop_bit: 7,
                    physical: sm.start,
                    reads: number == 1,
                    writes: number == 0,
                    active: true,
                    ..Fmmu::default()
                };
                bench.fmmu(station, number, &fmmu);
            }
        }
        let mut rig = Self {
            bench,
            bot,
            inputs,
            orders: vec![(0, 0); 9],
        };
        for state in [AlState::PreOp, AlState::SafeOp] {
            rig.request(state);
        }
        rig.cycle(1);
        rig.request(AlState::Op);
        rig
    }

    fn request(&mut self, state: AlState) {
        for drive in drives() {
            let answer = self.bench.request(0x1000 + drive, state, false);
            assert_eq!(answer, (state, false, 0), "{drive}");
        }
    }

    /// Runs cycles of a millisecond; returns the inputs of the last.
    fn cycle(&mut self, count: usize) -> Vec<Vec<u8>> {
        let mut inputs = vec![];
        for _ in 0..count {
            self.bench.now = (self.bench.now / MS + 1) * MS;
            let outputs: Vec<u8> = self
                .orders
                .iter()
                .flat_map(|(value, mode)| {
                    let [a, b, c, d] = value.to_le_bytes();
                    [a, b, c, d, *mode]
                })
                .collect();
            assert_eq!(self.bench.logical(Command::Lwr, 0, &outputs).counter, 9);
            let data = vec![0; 9 * usize::from(self.inputs)];
            let answer = self.bench.logical(Command::Lrd, 0x1000, &data);
            inputs = answer
                .data
                .chunks(self.inputs.into())
                .map(<[u8]>::to_vec)
                .collect();
        }
        inputs
    }

    /// A TMCL request to a drive (0 to 8) and its reply.
    fn tmcl(&mut self, drive: usize, request: [u8; 8]) -> [u8; 8] {
        let station = 0x1000 + drives().nth(drive).unwrap();
        let mut mailbox = request.to_vec();
        mailbox.resize(16, 0);
        self.bench.write(station, 0x1000, &mailbox);
        self.cycle(1);
        let reply: [u8; 16] = self.bench.read(station, 0x1010);
        reply[..8].try_into().unwrap()
    }

    fn get(&mut self, drive: usize, parameter: u8) -> i32 {
        // What is in the value of a request for one does not matter.
        let reply = self.tmcl(drive, [0, 6, parameter, 0, 0, 0, 0, 82]);
        assert_eq!(reply[..4], [0, 0, 100, 6], "{parameter}");
        i32::from_be_bytes(reply[4..].try_into().unwrap())
    }

    /// Writes a parameter; the status.
    fn set(&mut self, drive: usize, parameter: u8, value: i32) -> u8 {
        let [a, b, c, d] = value.to_be_bytes();
        let reply = self.tmcl(drive, [0, 5, parameter, 0, a, b, c, d]);
        assert_eq!(reply[4..], [a, b, c, d], "the value is echoed");
        reply[2]
    }

    fn commutate(&mut self, firmware: Firmware) {
        let order = match firmware {
            Firmware::V148 => (0, 7),
            Firmware::V200 => (100, 2),
        };
        self.orders = vec![order; 9];
        for joint in 4..9 {
            self.orders[joint].0 = -self.orders[joint].0;
        }
        self.cycle(600);
        self.orders = vec![(0, 2); 9];
        let inputs = self.cycle(200);
        for (n, drive) in inputs.iter().enumerate() {
            assert_eq!(flags(drive) & 1 << 15, 1 << 15, "drive {n}");
        }
    }

    fn joint(&self, number: usize) -> &DriveHandle {
        &self.bot.arms[0][number]
    }
}

fn word(inputs: &[u8], at: usize) -> i32 {
    i32::from_le_bytes(inputs[4 * at..4 * at + 4].try_into().unwrap())
}

fn flags(inputs: &[u8]) -> u32 {
    word(inputs, 3).cast_unsigned()
}

#[test]
fn youbot_slaves_have_the_expected_names() {
    for (boards, wheel, joint, arm) in [
        (Boards::New, "TMCM-1632", "TMCM-1610", "KR-845"),
        (Boards::Old, "TMCM-174", "TMCM-KR-841", "KR-843"),
    ] {
        let config = YouBotConfig {
            boards,
            ..YouBotConfig::default()
        };
        let (slaves, bot) = YouBot::slaves(&config);
        let names: Vec<String> = slaves
            .iter()
            .map(|slave| Sii::new(slave.eeprom()).string(1).unwrap().to_owned())
            .collect();
        let mut expected = vec!["KR-845"];
        expected.extend([wheel; 4]);
        expected.push(arm);
        expected.extend([joint; 5]);
        assert_eq!(names, expected);
        let sii = Sii::new(slaves[1].eeprom());
        assert_eq!(sii.identity().unwrap().vendor, 0x286);
        assert_eq!(
            sii.pdos(Category::RxPdo)
                .map(|pdo| pdo.bits())
                .sum::<usize>(),
            40
        );
        assert_eq!((bot.wheels.len(), bot.arms[0].len()), (4, 5));
    }
    let two = YouBotConfig {
        base: false,
        arms: 2,
        ..YouBotConfig::default()
    };
    assert_eq!(YouBot::slaves(&two).0.len(), 12);
}

#[test]
fn firmware_version_has_eight_letters() {
    for (firmware, wheel, joint) in [
        (Firmware::V148, b"1632V148", b"1610V148"),
        (Firmware::V200, b"1632V200", b"1610V200"),
    ] {
        let mut rig = Rig::new(firmware);
        assert_eq!(&rig.tmcl(0, [0, 136, 0, 0, 0, 0, 0, 0]), wheel);
        assert_eq!(&rig.tmcl(8, [0, 136, 0, 0, 0, 0, 0, 0]), joint);
    }
}

#[test]
fn parameters_are_read_written_refused_and_stored() {
    let mut rig = Rig::new(Firmware::V200);
    assert_eq!(rig.get(0, 250), 4000);
    assert_eq!(rig.set(0, 4, 1234), 100);
    assert_eq!(rig.get(0, 4), 1234);
    assert_eq!(rig.set(0, 4, -1), 4, "beyond its range");
    assert_eq!(rig.set(0, 156, 0), 3, "a measurement");
    assert_eq!(rig.set(0, 99, 0), 3, "none such");
    assert_eq!(rig.set(0, 26, 5), 8, "protected");
    assert_eq!((rig.set(0, 248, 1), rig.set(0, 26, 5)), (100, 100));
    assert_eq!(
        rig.tmcl(0, [0, 99, 0, 0, 0, 0, 0, 0])[2],
        2,
        "no such command"
    );
    assert_eq!(
        rig.tmcl(0, [1, 6, 0, 0, 0, 0, 0, 0])[2],
        2,
        "no gripper at a wheel"
    );
    // Bank 2: protected below 16, "calibrated" at 16.
    assert_eq!(rig.tmcl(4, [0, 9, 3, 2, 0, 0, 0, 1])[2], 8);
    assert_eq!(
        rig.tmcl(4, [0, 9, 16, 2, 0, 0, 0, 1]),
        [0, 0, 100, 9, 0, 0, 0, 1]
    );
    assert_eq!(
        rig.tmcl(4, [0, 10, 16, 2, 0, 0, 0, 0]),
        [0, 0, 100, 10, 0, 0, 0, 1]
    );
    // Stored values survive a power cycle, others do not.
    assert_eq!(rig.tmcl(4, [0, 5, 11, 0, 0, 0, 0x10, 0])[2], 100);
    assert_eq!(rig.tmcl(4, [0, 7, 11, 0, 0, 0, 0, 0])[2], 100);
    rig.set(4, 4, 77);
    rig.bench.segment.set_power(6, false);
    rig.bench.segment.set_power(6, true);
    let mut joint = rig.joint(0).lock();
    let mut query = |request: [u8; 8]| {
        let mut reply = Vec::new();
        assert!(joint.tmcl(&request, &mut reply));
        reply
    };
    assert_eq!(query([0, 6, 11, 0, 0, 0, 0, 0])[4..], [0, 0, 0x10, 0]);
    assert_eq!(query([0, 6, 4, 0, 0, 0, 0, 0])[4..], 4000_i32.to_be_bytes());
    assert_eq!(
        query([0, 10, 16, 2, 0, 0, 0, 0])[4..],
        [0; 4],
        "calibration is lost"
    );
}

#[test]
fn wheels_turn_at_the_commanded_speed() {
    for firmware in [Firmware::V148, Firmware::V200] {
        let mut rig = Rig::new(firmware);
        // Without commutation 1.48 does not move at all.
        rig.orders = vec![(1039, 2); 9];
        let inputs = rig.cycle(100);
        assert_eq!(word(&inputs[0], 2) > 0, firmware == Firmware::V200);
        let mut rig = Rig::new(firmware);
        rig.commutate(firmware);
        for (wheel, rpm) in (0..4).zip([-1039, 1039, -1039, 1039]) {
            rig.orders[wheel] = (rpm, 2);
        }
        let before = rig.cycle(300);
        let after = rig.cycle(600);
        for (wheel, rpm) in (0..4).zip([-1039, 1039, -1039, 1039]) {
            assert!(
                (word(&after[wheel], 2) - rpm).abs() < 15,
                "{}",
                word(&after[wheel], 2)
            );
            // 0.6 s at 4000 ticks a revolution.
            let ticks = word(&after[wheel], 0) - word(&before[wheel], 0);
            assert!((ticks - rpm * 40).abs() < 600, "{ticks}");
            assert_eq!(flags(&after[wheel]) & 0x0600, 0x0200, "velocity mode");
        }
        if firmware == Firmware::V200 {
            assert_eq!(word(&after[1], 6), 1039, "target velocity");
        }
    }
}

#[test]
fn arm_is_homed_and_reaches_commanded_positions() {
    let firmware = Firmware::V200;
    let mut rig = Rig::new(firmware);
    rig.commutate(firmware);
    let speeds = [156, 156, 100, 71, 71];
    let limits = [2000, 500, 1000, 500, 500];
    let mut found = [false; 5];
    for (joint, rpm) in speeds.into_iter().enumerate() {
        rig.orders[4 + joint] = (rpm, 2);
    }
    for _ in 0..4000 {
        let inputs = rig.cycle(1);
        for joint in 0..5 {
            if word(&inputs[4 + joint], 1).abs() > limits[joint] {
                rig.orders[4 + joint] = (0, 6);
                found[joint] = true;
            }
        }
        if found == [true; 5] {
            break;
        }
    }
    assert_eq!(found, [true; 5]);
    for joint in 0..5 {
        assert!(rig.joint(joint).lock().angle().abs() < 0.05, "{joint}");
        assert_eq!(rig.set(4 + joint, 1, 0), 100);
    }
    let targets = [-99_313, -49_656, -63_662, -36_160, -67_800];
    for (joint, ticks) in targets.into_iter().enumerate() {
        rig.orders[4 + joint] = (ticks, 1);
    }
    let inputs = rig.cycle(4000);
    for (joint, ticks) in targets.into_iter().enumerate() {
        let drive = &inputs[4 + joint];
        assert!(
            (word(drive, 0) - ticks).abs() < 200,
            "{joint}: {}",
            word(drive, 0)
        );
        assert_eq!(
            flags(drive) & (1 << 14 | 1 << 10),
            1 << 14 | 1 << 10,
            "reached"
        );
    }
}

#[test]
fn arm_without_current_sags() {
    let firmware = Firmware::V200;
    let mut rig = Rig::new(firmware);
    rig.commutate(firmware);
    let before = rig.joint(1).lock().angle();
    rig.orders[5] = (0, 6);
    rig.cycle(1000);
    let after = rig.joint(1).lock().angle();
    assert!((after - before).abs() > 0.02, "{before} {after}");
}

#[test]
fn output_loss_stops_drive_until_timeout_cleared() {
    let mut rig = Rig::new(Firmware::V200);
    rig.commutate(Firmware::V200);
    rig.orders[0] = (1000, 2);
    rig.cycle(300);
    // Frames cease for longer than global parameter 90.
    for _ in 0..200 {
        rig.bench.now += MS;
        rig.bench.segment.poll(rig.bench.now);
    }
    let inputs = rig.cycle(300);
    assert_eq!(flags(&inputs[0]) & 1 << 16, 1 << 16);
    assert!(
        word(&inputs[0], 2).abs() < 5,
        "it stands: {}",
        word(&inputs[0], 2)
    );
    assert_eq!(rig.set(0, 158, 1), 100);
    let inputs = rig.cycle(400);
    assert_eq!(flags(&inputs[0]) & 1 << 16, 0);
    assert!(word(&inputs[0], 2) > 900);
}

#[test]
fn overcurrent_sets_i2t_flag() {
    let mut rig = Rig::new(Firmware::V200);
    rig.commutate(Firmware::V200);
    // Against the stop of the joint.
    rig.orders[4] = (6000, 6);
    let mut inputs = rig.cycle(1000);
    for _ in 0..20 {
        if flags(&inputs[4]) & 1 << 17 != 0 {
            break;
        }
        inputs = rig.cycle(500);
    }
    assert_eq!(flags(&inputs[4]) & 1 << 17, 1 << 17);
    assert_eq!(word(&inputs[4], 1), 0, "no current any more");
    assert_eq!(rig.get(4, 28), 1);
    rig.orders[4] = (0, 6);
    assert_eq!(rig.set(4, 29, 1), 100);
    assert_eq!(flags(&rig.cycle(1)[4]) & 1 << 17, 0);
}

#[test]
fn gripper_opens_and_closes() {
    let mut rig = Rig::new(Firmware::V200);
    let value = |n: i32| n.to_be_bytes();
    let go = |rig: &mut Rig, kind: u8, steps: i32| {
        for bar in 0..2 {
            let [a, b, c, d] = value(steps);
            assert_eq!(rig.tmcl(8, [1, 4, kind, bar, a, b, c, d])[2], 100);
        }
        let reached = |rig: &mut Rig| rig.tmcl(8, [1, 6, 8, 0, 0, 0, 0, 0])[7];
        assert_eq!(reached(rig), 0);
        rig.cycle(3500);
        assert_eq!(reached(rig), 1);
    };
    // Open beyond the stop, back, and that is closed.
    go(&mut rig, 1, -66_000);
    go(&mut rig, 1, 66_000);
    for bar in 0..2 {
        assert_eq!(rig.tmcl(8, [1, 5, 1, bar, 0, 0, 0, 0])[2], 100);
    }
    let openings = |rig: &Rig| {
        let joint = rig.joint(4).lock();
        joint.bars().unwrap().each_ref().map(|bar| bar.opening())
    };
    assert!(openings(&rig).iter().all(|at| *at < 0.0003));
    go(&mut rig, 0, -66_000);
    assert!(openings(&rig).iter().all(|at| (at - 0.0115).abs() < 0.0003));
}

#[test]
fn youbot_faults_can_be_injected() {
    let mut rig = Rig::new(Firmware::V148);
    rig.commutate(Firmware::V148);
    rig.orders[0] = (500, 2);
    rig.bot.wheels[0].lock().extra_flags = 1 << 5;
    rig.bot.wheels[1].lock().emergency_stop = true;
    rig.orders[1] = (500, 2);
    let inputs = rig.cycle(200);
    assert_eq!(flags(&inputs[0]) & 1 << 5, 1 << 5);
    assert_eq!(flags(&inputs[1]) & 1 << 12, 1 << 12);
    assert_eq!(word(&inputs[1], 1), 0);
    assert!(word(&inputs[0], 4) > 0, "1.48 shows its duty");
}
