//! Behaviour of real slaves beyond the standard: mirrored acknowledgements, clocks that are announced but missing or
//! have 32 bits, outputs in registers, AL control unread by firmware, an EEPROM that does not answer while it stores.

use super::*;
use crate::config::SyncSpec;
use crate::emulator::{
    Chip, Clock, ClockUnit, Plain, ServoConfig, ServoDrive, SiiImage, Slave, SlaveConfig, Span,
    Times,
};
use crate::{AlStatusCode, register};

/// Timeout of most tests.
const CYCLE: Duration = Duration::from_millis(1);
/// Timeout of long tests.
const LONG: Duration = Duration::from_millis(4);
/// 2^32 ns.
const WRAP: u64 = 1 << 32;

/// A coupler-like slave with a chip and firmware times of its own.
fn slave(chip: Chip, clock: u64, times: Times) -> Slave {
    let sii = SiiImage {
        name: "TK chip".to_owned(),
        clock: true,
        ..SiiImage::default()
    };
    let config = SlaveConfig {
        chip,
        times,
        clock: Some(Clock::new(clock, 0)),
        ..SlaveConfig::new(sii)
    };
    Slave::new(config, Box::new(Plain))
}

fn with_clock(unit: ClockUnit) -> Slave {
    let chip = Chip {
        clock: unit,
        features: (unit == ClockUnit::ReceiveTimes).then_some(0x01FC),
        ..Chip::default()
    };
    slave(chip, 0, Times::default())
}

/// A drive whose clock shows a time at power-on, ns, and has so many bits.
fn drive(clock_ns: u64, unit: ClockUnit) -> Slave {
    let config = ServoConfig {
        needs_sync0: true,
        clock: (clock_ns, 20_000),
        clock_unit: unit,
        ..ServoConfig::default()
    };
    ServoDrive::slave(config).unwrap().0
}

fn by_sync0(drives: u16) -> MasterConfig {
    let spec = |position| SlaveSpec {
        sync: Some(SyncSpec::sync0(LONG)),
        ..SlaveSpec::new(format!("axis {position}"), Location::Position(position))
    };
    MasterConfig {
        cycle: LONG,
        slaves: (0..drives).map(spec).collect(),
        ..MasterConfig::default()
    }
}

#[test]
fn mirrored_acknowledgement_left_by_another_master_is_no_error() {
    for left in [0x0011_u16, 0x0012, 0x0014, 0x0018] {
        let (terminal, _) = Io::digital(8, 8);
        let mut rig = Rig::new(
            MasterConfig::default(),
            Segment::line([Coupler::slave(), terminal]),
        );
        for slave in 0..2 {
            let slave = rig.segment.slave(slave).unwrap();
            slave.set_al_control(left);
            assert_eq!(slave.al_status(), left);
        }
        rig.until(1000, Master::is_operational);
        let faults = rig
            .events
            .iter()
            .filter(|e| matches!(e, Event::Fault { .. }));
        assert_eq!(faults.count(), 0, "{left:04X}h: {:?}", rig.events);
    }
}

#[test]
fn mirrored_acknowledgement_while_running_causes_no_inspection() {
    let (terminal, _) = Io::digital(8, 8);
    let mut rig = Rig::new(
        MasterConfig::default(),
        Segment::line([Coupler::slave(), terminal]),
    );
    rig.until(1000, Master::is_operational);
    rig.events.clear();
    // As another master or a tool may write it.
    rig.segment.slave(1).unwrap().set_al_control(0x0018);
    rig.cycles(100);
    let (status, _) = rig.master.slave(1).unwrap().al();
    assert_eq!((status.state, status.error), (AlState::Op, false));
    assert!(rig.master.is_operational() && rig.events.is_empty());
    let inspected = rig.inspections(100);
    assert_eq!(inspected, 0, "the census accounts for its status");
}

#[test]
fn fallen_terminal_without_firmware_is_acknowledged_and_runs() {
    let (terminal, _) = Io::digital(8, 8);
    let mut rig = Rig::new(MasterConfig::default(), Segment::line([terminal]));
    rig.until(1000, Master::is_operational);
    let slave = rig.segment.slave(0).unwrap();
    slave.fall(AlState::SafeOp, AlStatusCode(0x001A));
    rig.until(40, |master| !master.is_operational());
    let text = rig.master.slave(0).unwrap().fault().unwrap().to_string();
    assert!(text.contains("(001Ah)"), "{text}");
    rig.until(1000, Master::is_operational);
}

#[test]
fn announced_clock_without_unit_is_none_and_never_reference() {
    let line = [
        with_clock(ClockUnit::ReceiveTimes),
        with_clock(ClockUnit::Bits64),
        with_clock(ClockUnit::ReceiveTimes),
        with_clock(ClockUnit::Absent),
        with_clock(ClockUnit::Bits64),
    ];
    let mut rig = Rig::new(MasterConfig::default(), Segment::line(line));
    rig.until(1000, Master::is_operational);
    let info = |n| rig.master.slave(n).unwrap().info().clone();
    let clocks: Vec<_> = (0..5)
        .map(|n| (info(n).announces_clock(), info(n).has_clock()))
        .collect();
    let (latch, none, whole) = ((true, false), (false, false), (true, true));
    assert_eq!(clocks, [latch, whole, latch, none, whole]);
    assert_eq!(rig.master.reference(), Some(1));
    // Their receive times count: 400 ns from each to the next.
    let delays: Vec<_> = (0..5)
        .map(|n| rig.master.slave(n).unwrap().delay_ns())
        .collect();
    assert!(
        delays[4].abs_diff(1200) <= 2 && delays[2].abs_diff(400) <= 2,
        "{delays:?}"
    );
    let faults = rig
        .events
        .iter()
        .filter(|e| matches!(e, Event::Fault { .. }));
    assert_eq!(faults.count(), 0, "{:?}", rig.events);
    // When the reference is lost, the next real clock replaces it.
    rig.segment.set_redundant(true);
    rig.segment.set_power(1, false);
    rig.cycles(400);
    assert_ne!(rig.master.reference(), Some(2));
}

#[test]
fn segment_of_announced_clocks_only_has_no_reference() {
    let line = [ClockUnit::ReceiveTimes, ClockUnit::ReceiveTimes].map(with_clock);
    let mut rig = Rig::new(MasterConfig::default(), Segment::line(line));
    rig.until(1000, Master::is_operational);
    assert_eq!(rig.master.reference(), None);
}

#[test]
fn sync0_with_announced_clock_only_is_refused() {
    let line = [with_clock(ClockUnit::ReceiveTimes)];
    let mut rig = Rig::new(by_sync0(1), Segment::line(line));
    rig.until(1000, |master| {
        master.slave(0).is_some_and(|slave| slave.fault().is_some())
    });
    let text = rig.master.slave(0).unwrap().fault().unwrap().to_string();
    assert!(
        text.starts_with("SYNC0 is wanted, and the slave has no clock"),
        "{text}"
    );
}

/// Brings drives with these clocks to OP by SYNC0, runs over two wraps of 32 bits, and watches time and drives.
fn runs_over_wraps(units: &[ClockUnit]) {
    let drives = (1..)
        .zip(units)
        .map(|(n, unit)| drive(n * 0x1234_5678_9ABC, *unit));
    let count = u16::try_from(units.len()).unwrap();
    // The first wrap comes two seconds after the start.
    let config = MasterConfig {
        clocks: crate::config::ClockConfig {
            epoch_ns: 700_000_000_000_000_000 / WRAP * WRAP + WRAP - 3_000_000_000,
            ..crate::config::ClockConfig::default()
        },
        ..by_sync0(count)
    };
    let epoch = config.clocks.epoch_ns;
    let mut rig = Rig::new(config, Segment::line(drives));
    rig.until(3000, Master::is_operational);
    let mut last: Option<Sample> = None;
    for _ in 0..2200 {
        rig.cycle();
        let Some(sample) = rig.master.poll_sample() else {
            continue;
        };
        // No jump, and to within the drift of its crystal the time that the master gave.
        let sent = u64::try_from(sample.sent.as_nanos()).unwrap();
        assert!(
            sample.system_ns.abs_diff(epoch + sent) < 1_000_000,
            "{sample:?}"
        );
        if let Some(last) = last.replace(sample) {
            let passed = u64::try_from((sample.sent - last.sent).as_nanos()).unwrap();
            assert!((sample.system_ns - last.system_ns).abs_diff(passed) < 1000);
        }
    }
    assert!(last.unwrap().system_ns > epoch + 2 * WRAP, "two wraps");
    assert!(rig.master.is_operational(), "{:?}", rig.events);
    for number in 0..units.len() {
        let slave = rig.master.slave(number).unwrap();
        let difference = slave.clock_difference_ns().unwrap();
        assert!(difference.abs() < 500, "slave {number}: {difference} ns");
        assert_eq!(slave.clock_violations(), 0);
        assert_eq!(slave.sync_start_ns().unwrap() % 4_000_000, 0);
        let clock = rig.segment.slave(number).unwrap().clock().unwrap();
        assert!(clock.next_sync0().is_some(), "slave {number}");
    }
    let faults = rig
        .events
        .iter()
        .filter(|e| matches!(e, Event::Fault { .. }));
    assert_eq!(faults.count(), 0, "{:?}", rig.events);
}

#[test]
fn clocks_of_32_bits_run_sync0_over_wraps() {
    runs_over_wraps(&[ClockUnit::Bits32; 2]);
}

#[test]
fn clocks_of_both_widths_follow_a_reference_of_32_bits() {
    runs_over_wraps(&[ClockUnit::Bits32, ClockUnit::Bits64, ClockUnit::Bits32]);
}

#[test]
fn clocks_of_both_widths_follow_a_reference_of_64_bits() {
    runs_over_wraps(&[ClockUnit::Bits64, ClockUnit::Bits32, ClockUnit::Bits64]);
}

/// Firmware that reads AL control late.
fn slow(times: u64) -> Times {
    Times {
        al_read: Some(Span::micros(6_800, 18_000)),
        to_pre_op: Span::micros(7_000, 18_500),
        to_safe_op: Span::micros(15_000, 18_500),
        ..Times::default()
    }
    .scaled(times)
}

#[test]
fn al_control_unread_for_long_is_retried() {
    for (cycle, times) in [(1000, 1), (250, 1), (1000, 2), (250, 10)] {
        let slow = || slave(Chip::default(), 0, slow(times));
        let config = MasterConfig {
            cycle: Duration::from_micros(cycle),
            ..MasterConfig::default()
        };
        let mut rig = Rig::new(config, Segment::line([slow(), Coupler::slave(), slow()]));
        rig.until(4000, Master::is_operational);
        let faults = rig
            .events
            .iter()
            .filter(|e| matches!(e, Event::Fault { .. }));
        assert_eq!(faults.count(), 0, "{cycle} us: {:?}", rig.events);
    }
}

#[test]
fn hung_firmware_is_named_and_blocks_no_slave() {
    let hung = slave(Chip::default(), 0, slow(1));
    let mut rig = Rig::new(
        MasterConfig::default(),
        Segment::line([Coupler::slave(), hung, Coupler::slave()]),
    );
    rig.segment.slave(1).unwrap().faults().hung = true;
    // It holds a request of a previous master.
    rig.segment.slave(1).unwrap().set_al_control(0x0002);
    rig.until(12_000, |master| {
        [0, 2]
            .iter()
            .all(|n| master.slave(*n).is_some_and(|slave| slave.is_running()))
    });
    let text = rig.master.slave(1).unwrap().fault().unwrap().to_string();
    assert!(
        text.contains("its firmware has not read AL control for 3s"),
        "{text}"
    );
}

#[test]
fn slow_firmware_refusal_shows_its_code() {
    let mut slave = slave(Chip::default(), 0, slow(1));
    slave.refuse(Some((AlState::SafeOp, AlStatusCode(0x001D))));
    let mut rig = Rig::new(MasterConfig::default(), Segment::line([slave]));
    rig.until(4000, |master| {
        master.slave(0).is_some_and(|slave| slave.fault().is_some())
    });
    let text = rig.master.slave(0).unwrap().fault().unwrap().to_string();
    assert!(text.contains("(001Dh)"), "{text}");
}

/// An EEPROM as on EtherCAT terminals: free at once after a write, while it stores for most of a millisecond.
fn storing(store_us: u64) -> Slave {
    let times = Times {
        sii_read: Span::micros(600, 900),
        sii_write: Span::exactly(0),
        sii_store: Span::micros(store_us, store_us),
        ..Times::default()
    };
    slave(Chip::default(), 0, times)
}

fn job(rig: &mut Rig, kind: JobKind, data: Vec<u8>) -> Result<Vec<u8>, JobError> {
    let job = Job {
        slave: 0,
        kind,
        data,
        token: 0,
    };
    rig.master.submit(job).unwrap();
    for _ in 0..4000 {
        rig.cycle();
        if let Some(reply) = rig.master.poll_reply() {
            return reply.result.map(|()| reply.job.data);
        }
    }
    panic!("no reply");
}

#[test]
fn eeprom_without_acknowledge_is_retried() {
    for store_us in [900, 9000] {
        let mut rig = Rig::new(MasterConfig::default(), Segment::line([storing(store_us)]));
        rig.until(3000, Master::is_operational);
        // One write behind the other, then a read at once.
        for (word, bytes) in [(0x50, [1, 2]), (0x51, [3, 4]), (0x52, [5, 6])] {
            let written = job(&mut rig, JobKind::WriteSii { word }, bytes.to_vec());
            assert!(written.is_ok(), "{written:?}");
        }
        let kind = JobKind::ReadSii {
            word: 0x50,
            words: 3,
        };
        let read = job(&mut rig, kind, Vec::with_capacity(64));
        assert_eq!(read, Ok(vec![1, 2, 3, 4, 5, 6]));
    }
}

#[test]
fn eeprom_that_never_acknowledges_is_reported() {
    let mut rig = Rig::new(
        MasterConfig::default(),
        Segment::line([storing(60_000_000)]),
    );
    rig.until(3000, Master::is_operational);
    let write = JobKind::WriteSii { word: 0x50 };
    assert!(job(&mut rig, write, vec![1, 2]).is_ok());
    let begin = rig.now;
    let refused = job(&mut rig, write, vec![1, 2]);
    assert_eq!(refused, Err(JobError::NoAcknowledge));
    assert!(rig.now - begin >= rig.master.config().timeouts.sii);
}

impl Rig {
    /// Number of inspections of single slaves in a number of cycles.
    fn inspections(&mut self, cycles: usize) -> usize {
        let mut found = 0;
        for _ in 0..cycles {
            let mut frame = [0; 1500];
            let Some(len) = self.master.poll_transmit(self.now, &mut frame) else {
                continue;
            };
            let sent = crate::Frame::decode(&frame[..len]).unwrap();
            let inspects = |datagram: &crate::Datagram<'_>| {
                let at = datagram.header.address;
                matches!(
                    at,
                    crate::Address::Device {
                        ado: register::AL_STATUS,
                        ..
                    }
                ) && datagram.header.command == crate::Command::Fprd
            };
            found += sent
                .datagrams()
                .filter(|d| d.as_ref().is_ok_and(inspects))
                .count();
            self.exchange(&frame[..len]);
            self.now += CYCLE;
        }
        found
    }
}
