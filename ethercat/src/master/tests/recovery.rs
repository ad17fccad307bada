//! Slaves that are lost and return, cut cables, rings of two ports.

use super::*;
use crate::config::SyncSpec;
use crate::emulator::{Corrupt, ServoConfig, ServoDrive};
use crate::{AlState, AlStatusCode};

/// A line of a coupler and a number of terminals with outputs and inputs, in OP.
fn line(count: usize, config: MasterConfig) -> (Rig, Vec<Io>) {
    let (slaves, ios): (Vec<_>, Vec<_>) = (0..count).map(|_| Io::digital(8, 8)).unzip();
    let mut all = vec![Coupler::slave()];
    all.extend(slaves);
    let mut segment = Segment::line(all);
    segment.set_redundant(config.redundant);
    let mut rig = Rig::new(config, segment);
    rig.until(5000, Master::is_operational);
    rig.events.clear();
    for (number, io) in ios.iter().enumerate() {
        io.set_inputs(&[u8::try_from(number).unwrap() + 1]);
    }
    rig.cycles(5);
    (rig, ios)
}

impl Rig {
    fn texts(&self) -> Vec<String> {
        self.events.iter().map(ToString::to_string).collect()
    }

    fn age(&self, slave: usize) -> u32 {
        self.master.inputs(slave).1
    }
}

#[test]
fn cut_cable_is_named_within_three_cycles_and_recovers() {
    let (mut rig, ios) = line(6, MasterConfig::default());
    rig.segment.set_link(5, false);
    rig.cycles(3);
    let texts = rig.texts();
    let text = "the cable from slave 4 port 1 to slave 5 port 0: no frames pass; check connectors, cable and supply there";
    assert!(texts.contains(&text.to_owned()), "{texts:?}");
    let cuts = rig
        .events
        .iter()
        .filter(|event| matches!(event, Event::CableCut { .. }))
        .count();
    assert_eq!(cuts, 1, "{texts:?}");
    // The others continue; those behind the cut keep their last values, with growing age.
    ios[0].set_inputs(&[77]);
    rig.cycles(10);
    assert_eq!((rig.master.inputs(1), rig.age(4)), ((&[77][..], 0), 0));
    assert_eq!(rig.master.inputs(5).0, [5]);
    assert!(rig.age(5) >= 10);
    // Beyond the watchdog, so that they fell to SAFE-OP meanwhile.
    rig.cycles(300);
    rig.segment.set_link(5, true);
    rig.until(2000, Master::is_operational);
    rig.cycles(3);
    assert_eq!(
        (rig.age(5), rig.age(6), rig.master.groups()[0].counter),
        (0, 0, 18)
    );
    assert!(
        rig.texts()
            .iter()
            .any(|text| text == "slave 6: online again")
    );
}

#[test]
fn slave_after_power_loss_is_reconfigured_without_disturbance() {
    let (mut rig, ios) = line(4, MasterConfig::default());
    // The last one, so that no slave is behind it.
    rig.segment.set_power(4, false);
    rig.cycles(200);
    let before = rig.master.groups()[0].misses;
    rig.segment.set_power(4, true);
    let mut oldest = 0;
    for _ in 0..2000 {
        rig.cycle();
        oldest = (1..4)
            .map(|slave| rig.age(slave))
            .max()
            .unwrap()
            .max(oldest);
        if rig.master.is_operational() {
            break;
        }
    }
    assert!(rig.master.is_operational(), "{:?}", rig.texts());
    rig.master.outputs_mut(4).copy_from_slice(&[0x5A]);
    rig.cycles(3);
    assert_eq!(
        (ios[3].outputs(), rig.master.inputs(4)),
        (vec![0x5A], (&[4][..], 0))
    );
    assert_eq!((oldest, rig.master.groups()[0].misses - before), (0, 0));
}

#[test]
fn power_cycle_between_two_frames_is_detected() {
    let (mut rig, _) = line(3, MasterConfig::default());
    rig.segment.set_power(2, false);
    rig.segment.set_power(2, true);
    rig.cycles(10);
    assert!(!rig.master.is_operational());
    rig.until(2000, Master::is_operational);
    rig.cycles(3);
    assert_eq!((rig.age(2), rig.master.groups()[0].counter), (0, 9));
}

#[test]
fn slave_fallen_is_reported_with_code_and_recovered() {
    let (mut rig, _) = line(3, MasterConfig::default());
    rig.segment
        .slave(2)
        .unwrap()
        .fall(AlState::SafeOp, AlStatusCode(0x001A));
    rig.cycles(4);
    let texts = rig.texts();
    assert!(
        texts[0].starts_with(
            "slave 2: OP wanted, SAFE-OP + error shown: synchronisation error (001Ah)"
        ),
        "{texts:?}"
    );
    rig.until(2000, Master::is_operational);
}

#[test]
fn whole_segment_lost_recovers() {
    let (mut rig, _) = line(3, MasterConfig::default());
    rig.segment.set_link(0, false);
    rig.cycles(6);
    let texts = rig.texts();
    assert!(
        texts
            .iter()
            .any(|text| text.starts_with("the cable from the master to slave 0 port 0")),
        "{texts:?}"
    );
    rig.cycles(500);
    rig.segment.set_link(0, true);
    rig.until(3000, Master::is_operational);
    rig.cycles(3);
    assert_eq!(rig.age(3), 0);
}

#[test]
fn single_lost_frames_affect_their_cycle_only() {
    let (mut rig, _) = line(3, MasterConfig::default());
    for _ in 0..20 {
        rig.segment.faults.lose = 1;
        rig.cycles(7);
        assert_eq!(rig.age(3), 0);
    }
    assert!(rig.events.is_empty(), "{:?}", rig.texts());
    let frames = rig.master.frames();
    assert_eq!((frames.lost, frames.stale), (20, 0));
}

#[test]
fn slaves_count_as_absent_after_configured_number_of_lost_frames() {
    for lost_frames in [1, 3, 20] {
        let config = MasterConfig {
            lost_frames,
            ..MasterConfig::default()
        };
        let (mut rig, _) = line(3, config);
        rig.segment.faults.lose = u32::from(lost_frames) - 1;
        rig.cycles(usize::from(lost_frames) + 6);
        assert!(rig.events.is_empty(), "{lost_frames}: {:?}", rig.texts());
        rig.segment.faults.lose = lost_frames.into();
        rig.cycles(usize::from(lost_frames) + 6);
        let texts = rig.texts();
        assert!(
            texts
                .iter()
                .any(|text| text.starts_with("the cable from the master to slave 0 port 0")),
            "{lost_frames}: {texts:?}"
        );
        rig.until(3000, Master::is_operational);
    }
}

#[test]
fn optional_slave_is_hot_connected_and_removed() {
    let (tool, io) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let _ = io;
    let (gate, _) = Io::digital(8, 8);
    let mapped = |index, bits| takt_cia402::dictionary::Mapped {
        address: takt_cia402::dictionary::Address::new(index, 0),
        bits,
    };
    let pdo = |index, entries| Some(vec![crate::config::PdoSpec { index, entries }]);
    let slaves = vec![
        SlaveSpec::new("gate", Location::Position(0)),
        SlaveSpec {
            optional: true,
            outputs: pdo(0x1600, vec![mapped(0x6040, 16)]),
            inputs: pdo(0x1A00, vec![mapped(0x6041, 16)]),
            ..SlaveSpec::new("tool", Location::Name("TK4021 servo".to_owned()))
        },
    ];
    let mut rig = Rig::new(
        MasterConfig {
            slaves,
            ..MasterConfig::default()
        },
        Segment::line([gate, tool]),
    );
    rig.segment.set_link(1, false);
    rig.until(3000, Master::is_operational);
    assert!(!rig.master.slave(1).unwrap().is_running());
    // The location of its objects is known before it is present.
    let statusword = |master: &Master| {
        let address = takt_cia402::dictionary::Address::new(0x6041, 0);
        let process = master.slave(1).unwrap().process();
        (process.locate(address, false), process.outputs_len())
    };
    let before = statusword(&rig.master);
    assert_eq!((before.0.unwrap().bit, before.1), (0, 2));
    rig.segment.set_link(1, true);
    rig.until(3000, |master| master.slave(1).unwrap().is_running());
    rig.cycles(3);
    assert_eq!(
        (rig.age(0), rig.age(1), rig.master.groups()[0].counter),
        (0, 0, 6)
    );
    assert_eq!(statusword(&rig.master), before);
    rig.segment.set_power(1, false);
    rig.cycles(100);
    assert!(rig.master.is_operational() && rig.age(0) == 0 && rig.age(1) > 90);
    rig.segment.set_power(1, true);
    rig.until(3000, |master| master.slave(1).unwrap().is_running());
}

#[test]
fn unexpected_slave_is_reported_and_stays_in_init() {
    let (gate, _) = Io::digital(8, 8);
    let (other, _) = Io::digital(4, 4);
    let slaves = vec![SlaveSpec::new("gate", Location::Position(0))];
    let mut rig = Rig::new(
        MasterConfig {
            slaves,
            ..MasterConfig::default()
        },
        Segment::line([gate, other]),
    );
    rig.segment.set_link(1, false);
    rig.until(3000, Master::is_operational);
    rig.events.clear();
    rig.segment.set_link(1, true);
    rig.cycles(200);
    assert_eq!(rig.events, [Event::UnexpectedSlave { position: 1 }]);
    assert_eq!(
        (rig.segment.slave(1).unwrap().state(), rig.age(0)),
        (AlState::Init, 0)
    );
    assert_eq!(rig.master.strangers(), 1);
}

#[test]
fn drive_with_sync0_recovers_in_phase() {
    let (a, _) = ServoDrive::slave(ServoConfig {
        needs_sync0: true,
        ..ServoConfig::default()
    })
    .unwrap();
    let (b, _) = ServoDrive::slave(ServoConfig {
        needs_sync0: true,
        clock: (5, 40_000),
        ..ServoConfig::default()
    })
    .unwrap();
    let sync = |position| SlaveSpec {
        sync: Some(SyncSpec::sync0(Duration::from_millis(1))),
        ..SlaveSpec::new(format!("axis {position}"), Location::Position(position))
    };
    let config = MasterConfig {
        slaves: vec![sync(0), sync(1)],
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, Segment::line([a, b]));
    rig.until(8000, Master::is_operational);
    for power in [false, true] {
        if power {
            rig.segment.set_power(1, false);
        } else {
            rig.segment.set_link(1, false);
        }
        rig.cycles(300);
        assert!(
            rig.master.slave(0).unwrap().is_running(),
            "power {power}: {:?}",
            rig.texts()
        );
        rig.segment.set_power(1, true);
        rig.segment.set_link(1, true);
        rig.until(9000, Master::is_operational);
    }
}

#[test]
fn cut_ring_continues_from_both_ends() {
    let config = MasterConfig {
        redundant: true,
        ..MasterConfig::default()
    };
    let (mut rig, ios) = line(5, config);
    assert_eq!(rig.master.ring_open(), None);
    let misses = rig.master.groups()[0].misses;
    rig.segment.set_link(3, false);
    rig.cycles(3);
    assert_eq!(rig.master.ring_open(), Some(3), "{:?}", rig.texts());
    let text = "the cable from slave 2 port 1 to slave 3 port 0: the ring is open there; all slaves are reached still";
    assert_eq!(rig.texts(), [text]);
    ios[4].set_inputs(&[99]);
    rig.master.outputs_mut(5).copy_from_slice(&[0x77]);
    rig.cycles(2);
    assert_eq!(
        (rig.master.inputs(5), ios[4].outputs()),
        ((&[99][..], 0), vec![0x77])
    );
    assert!(rig.master.is_operational() && rig.master.groups()[0].misses - misses <= 1);
    rig.segment.set_link(3, true);
    rig.cycles(3);
    assert_eq!(rig.events.last(), Some(&Event::RingClosed));
}

#[test]
fn ring_cut_at_first_cable_continues_from_second_port() {
    let config = MasterConfig {
        redundant: true,
        ..MasterConfig::default()
    };
    let (mut rig, _) = line(3, config);
    rig.segment.set_link(0, false);
    rig.cycles(10);
    assert_eq!(rig.master.ring_open(), Some(0), "{:?}", rig.texts());
    assert!(
        rig.master.is_operational() && rig.age(3) <= 1,
        "{:?}",
        rig.texts()
    );
}

/// Terminals of one kind in a ring, in OP, whose inputs are 1, 2, 3 and so on.
fn ring_of_equals(count: u8) -> Rig {
    let (slaves, ios): (Vec<_>, Vec<_>) = (0..count).map(|_| Io::digital(8, 8)).unzip();
    let mut segment = Segment::line(slaves);
    segment.set_redundant(true);
    let config = MasterConfig {
        redundant: true,
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, segment);
    rig.until(5000, Master::is_operational);
    for (io, value) in ios.iter().zip(1..) {
        io.set_inputs(&[value]);
    }
    rig.cycles(5);
    rig
}

/// All are in OP and none is confused with another.
fn are_themselves(rig: &mut Rig, count: usize) {
    rig.until(3000, Master::is_operational);
    rig.cycles(5);
    for (slave, value) in (0..count).zip(1..) {
        assert_eq!(rig.master.inputs(slave), (&[value][..], 0), "slave {slave}");
    }
}

#[test]
fn equal_slaves_at_ring_end_are_not_confused() {
    let mut rig = ring_of_equals(4);
    rig.segment.set_power(0, false);
    rig.segment.set_power(1, false);
    rig.cycles(50);
    rig.events.clear();
    rig.segment.set_power(1, true);
    rig.cycles(500);
    for slave in [0, 1] {
        assert_eq!(rig.master.slave(slave).unwrap().position(), None);
    }
    let texts = rig.texts();
    assert_eq!(texts.len(), 1, "{texts:?}");
    assert!(texts[0].contains("another one of its kind is missing"));
    rig.segment.set_power(0, true);
    are_themselves(&mut rig, 4);
}

#[test]
fn slave_returning_into_open_ring_waits_for_closure() {
    let mut rig = ring_of_equals(5);
    rig.segment.set_power(2, false);
    rig.segment.set_power(3, false);
    rig.cycles(50);
    rig.events.clear();
    rig.segment.set_power(3, true);
    rig.cycles(500);
    let texts = rig.texts();
    let unplaced = texts
        .iter()
        .filter(|text| text.contains("its position is ambiguous"));
    assert_eq!(unplaced.count(), 1, "{texts:?}");
    assert_eq!((rig.age(0), rig.age(4)), (0, 0), "the others go on");
    assert_eq!(rig.master.slave(3).unwrap().position(), None);
    rig.segment.set_power(2, true);
    are_themselves(&mut rig, 5);
}

#[test]
fn equal_branch_returning_waits_for_the_other() {
    let mut segment = Segment::line([Coupler::slave()]);
    for port in [1, 3] {
        segment.add(Io::digital(8, 8).0, Some((0, port)));
    }
    let mut rig = Rig::new(MasterConfig::default(), segment);
    rig.until(5000, Master::is_operational);
    rig.segment.set_power(1, false);
    rig.segment.set_power(2, false);
    rig.cycles(50);
    rig.segment.set_power(1, true);
    rig.cycles(500);
    let there = |rig: &Rig, slave| rig.master.slave(slave).unwrap().position().is_some();
    assert!(!there(&rig, 1) && !there(&rig, 2), "{:?}", rig.texts());
    rig.segment.set_power(2, true);
    rig.until(3000, Master::is_operational);
}

#[test]
fn ring_open_at_start_is_reported_and_awaited() {
    let slaves = (0..3).map(|_| Io::digital(8, 8).0).collect::<Vec<_>>();
    let mut segment = Segment::line(slaves);
    segment.set_redundant(true);
    segment.set_link(2, false);
    let config = MasterConfig {
        redundant: true,
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, segment);
    rig.cycles(500);
    assert_eq!(rig.events, [Event::StartSplit { position: 2 }]);
    rig.segment.set_link(2, true);
    rig.until(5000, Master::is_operational);
    // Open behind its last slave it is a line.
    let mut segment = Segment::line([Io::digital(8, 8).0, Io::digital(8, 8).0]);
    segment.set_redundant(true);
    segment.set_link(0, false);
    let config = rig.master.config().clone();
    let mut rig = Rig::new(config, segment);
    rig.until(5000, Master::is_operational);
}

#[test]
fn broken_frames_point_to_the_cable() {
    let (mut rig, _) = line(4, MasterConfig::default());
    rig.cycles(40);
    for _ in 0..5 {
        rig.segment.faults.corrupt = Some(Corrupt {
            slave: 3,
            port: 0,
            frames: 2,
        });
        rig.cycles(60);
    }
    let suspects = rig.master.suspects();
    assert_eq!(
        (suspects.len(), suspects[0].cable.to),
        (1, Some(3)),
        "{suspects:?}"
    );
    let text = suspects[0].to_string();
    assert!(
        text.starts_with("the cable from slave 2 port 1 to slave 3 port 0: 10 broken frames"),
        "{text}"
    );
}

#[test]
fn returning_slave_is_matched_against_each_missing_one() {
    for redundant in [false, true] {
        one_of_two_tools_comes(redundant);
    }
}

fn one_of_two_tools_comes(redundant: bool) {
    let (gate, _) = Io::digital(8, 8);
    let (tool, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let named = |name: &str, order: &str| SlaveSpec {
        optional: true,
        outputs: Some(vec![]),
        inputs: Some(vec![]),
        ..SlaveSpec::new(name, Location::Name(order.to_owned()))
    };
    let slaves = vec![
        SlaveSpec::new("gate", Location::Position(0)),
        named("tool a", "TK1"),
        named("tool b", "TK4021 servo"),
    ];
    let mut rig = Rig::new(
        MasterConfig {
            slaves,
            redundant,
            ..MasterConfig::default()
        },
        Segment::line([gate, tool]),
    );
    rig.segment.set_power(1, false);
    rig.until(3000, Master::is_operational);
    rig.segment.set_power(1, true);
    rig.until(3000, |master| master.slave(2).unwrap().position().is_some());
    rig.cycles(300);
    assert_eq!(rig.master.slave(1).unwrap().position(), None);
    let texts = rig.texts();
    assert!(
        texts
            .iter()
            .any(|text| text.starts_with("slave 1: vendor 00007A87h product 00004021h found")),
        "{texts:?}"
    );
    assert_eq!((rig.age(0), rig.master.strangers()), (0, 0));
}

#[test]
fn replaced_slave_is_not_taken_for_the_original() {
    let spec = |position| SlaveSpec::new(format!("io {position}"), Location::Position(position));
    let config = MasterConfig {
        slaves: vec![spec(0), spec(1)],
        ..MasterConfig::default()
    };
    let segment = Segment::line([Io::digital(8, 8).0, Io::digital(8, 8).0]);
    let mut rig = Rig::new(config, segment);
    rig.until(3000, Master::is_operational);
    rig.segment.set_power(1, false);
    rig.cycles(20);
    // Product code in its SII: words 0Ah and 0Bh.
    rig.segment.slave(1).unwrap().eeprom_mut()[20] ^= 0xFF;
    rig.segment.set_power(1, true);
    rig.cycles(300);
    assert!(
        matches!(
            rig.master.slave(1).unwrap().fault(),
            Some(Fault::Identity { .. })
        ),
        "{:?}",
        rig.texts()
    );
    assert_eq!((rig.master.strangers(), rig.age(0)), (1, 0));
    rig.segment.set_power(1, false);
    rig.cycles(20);
    rig.segment.slave(1).unwrap().eeprom_mut()[20] ^= 0xFF;
    rig.segment.set_power(1, true);
    rig.until(3000, Master::is_operational);
}

/// Named disturbances of a slave.
type Disturbance = (&'static str, fn(&mut Rig));

/// Every change of state of one slave, and back.
const DISTURBANCES: [Disturbance; 10] = [
    ("falls to SAFE-OP", |rig| fall(rig, AlState::SafeOp)),
    ("falls to PRE-OP", |rig| fall(rig, AlState::PreOp)),
    ("falls to INIT", |rig| fall(rig, AlState::Init)),
    ("has no power for a while", |rig| {
        rig.segment.set_power(1, false);
        rig.cycles(300);
        rig.segment.set_power(1, true);
    }),
    ("has no cable for a while", |rig| {
        rig.segment.set_link(1, false);
        rig.cycles(300);
        rig.segment.set_link(1, true);
    }),
    ("has no cable for a moment", |rig| {
        rig.segment.set_link(1, false);
        rig.cycles(2);
        rig.segment.set_link(1, true);
    }),
    ("refuses SAFE-OP for a while", |rig| {
        refuse(rig, AlState::SafeOp);
    }),
    ("refuses OP for a while", |rig| refuse(rig, AlState::Op)),
    ("takes outputs late in OP", |rig| {
        rig.segment.slave(1).unwrap().faults().late_outputs = 40;
        fall(rig, AlState::SafeOp);
    }),
    ("hangs for a while", |rig| {
        rig.segment.slave(1).unwrap().faults().hung = true;
        rig.cycles(300);
        rig.segment.slave(1).unwrap().faults().hung = false;
    }),
];

fn fall(rig: &mut Rig, state: AlState) {
    let slave = rig.segment.slave(1).unwrap();
    slave.fall(state, AlStatusCode(0x001B));
}

fn refuse(rig: &mut Rig, state: AlState) {
    let code = AlStatusCode(0x001E);
    rig.segment.slave(1).unwrap().refuse(Some((state, code)));
    fall(rig, AlState::PreOp);
    rig.cycles(600);
    rig.segment.slave(1).unwrap().refuse(None);
}

#[test]
fn running_slave_beside_one_that_changes_state_is_undisturbed() {
    for (name, disturb) in DISTURBANCES {
        let (terminal, _) = Io::digital(8, 8);
        let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
        let mut rig = Rig::new(MasterConfig::default(), Segment::line([terminal, drive]));
        rig.until(5000, Master::is_operational);
        rig.cycles(20);
        rig.oldest = 0;
        disturb(&mut rig);
        rig.cycles(20);
        rig.until(5000, Master::is_operational);
        rig.cycles(200);
        assert!(
            rig.oldest <= 4,
            "one that {name}: {} cycles without inputs",
            rig.oldest
        );
        assert_eq!(rig.master.inputs(1).1, 0, "one that {name} is back");
    }
}
