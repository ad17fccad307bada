//! The emulated drive seen from the master: frames only, in virtual time.

use super::*;
use crate::canopen::pdo::{Direction, Rpdo};
use crate::{Frame, LogLine};

const MS: Duration = Duration::from_millis(1);

struct Rig {
    drive: DriveNode,
    now: Duration,
    received: Vec<String>,
}

impl Rig {
    fn new(change: impl FnOnce(&mut DriveNodeConfig)) -> Self {
        let mut config = DriveNodeConfig::new(NodeId::new(5).unwrap());
        change(&mut config);
        let now = Duration::ZERO;
        let drive = DriveNode::power_on(config, now).unwrap();
        let received = vec![];
        let mut rig = Self {
            drive,
            now,
            received,
        };
        assert_eq!(rig.run(1)[0], "705#00");
        rig
    }

    fn send(&mut self, frame: &str) -> Vec<String> {
        let frame: Frame = LogLine::parse(&format!("(1.000000) can0 {frame}"))
            .unwrap()
            .frame;
        self.drive.handle_frame(&frame, self.now);
        self.poll()
    }

    fn poll(&mut self) -> Vec<String> {
        let polled = std::iter::from_fn(|| self.drive.poll_transmit(self.now));
        let polled: Vec<_> = polled.map(|frame| frame.to_string()).collect();
        self.received.extend(polled.iter().cloned());
        polled
    }

    fn run(&mut self, ms: u32) -> Vec<String> {
        let mut received = vec![];
        for _ in 0..ms {
            self.now += MS;
            received.extend(self.poll());
        }
        received
    }

    /// The drive in Operation enabled, controlled by controlwords in RPDO 1.
    fn enabled(change: impl FnOnce(&mut DriveNodeConfig)) -> Self {
        let mut rig = Self::new(change);
        rig.send("000#0105");
        for word in ["0600", "0700", "0F00"] {
            rig.send(&format!("205#{word}"));
            rig.run(300);
        }
        assert_eq!(
            rig.received.last().unwrap(),
            "185#3702",
            "{:?}",
            rig.received
        );
        rig
    }
}

#[test]
fn drive_enabled_by_pdo_reports_each_state() {
    let rig = Rig::enabled(|config| config.heartbeat_ms = 0);
    let words = ["705#00", "185#5002", "185#3102", "185#3302", "185#3702"];
    let seen: Vec<_> = words
        .iter()
        .map(|word| rig.received.iter().position(|h| h == word))
        .collect();
    assert!(
        seen.is_sorted() && seen.iter().all(Option::is_some),
        "{:?}",
        rig.received
    );
}

#[test]
fn drive_fault_emcy_precedes_statusword() {
    let mut rig = Rig::enabled(|_| ());
    rig.received.clear();
    rig.drive
        .application_mut()
        .axis_mut(0)
        .unwrap()
        .fault(FaultCode::SHORT_CIRCUIT);
    rig.run(200);
    assert_eq!(rig.received[0], "085#2023030000000000");
    assert!(
        rig.received.iter().any(|h| h.starts_with("185#1F")),
        "fault reaction active: {:?}",
        rig.received
    );
    assert_eq!(rig.received.last().unwrap(), "185#1802", "fault");
    rig.drive
        .application_mut()
        .axis_mut(0)
        .unwrap()
        .clear_cause();
    rig.send("205#0000");
    rig.run(5);
    rig.received.clear();
    rig.send("205#8000");
    rig.run(5);
    assert_eq!(rig.received, ["085#0000000000000000", "185#5002"]);
}

/// The reaction of 6007h to each kind of master loss.
#[test]
fn drive_master_loss_triggers_6007h() {
    for (cause, emergency) in [("heartbeat", "085#3081"), ("nmt", ""), ("pdo", "085#5082")] {
        let mut rig = Rig::enabled(|_| ());
        rig.send("605#2B07600003000000"); // 6007h = 3: quick stop
        rig.send("605#2F29100101000000"); // stay in Operational
        rig.received.clear();
        match cause {
            "heartbeat" => {
                rig.send("605#2316100114000100");
                rig.send("701#05");
            }
            "nmt" => drop(rig.send("000#8005")),
            _ => {
                rig.send("605#2B00140514000000"); // RPDO 1: 20 ms
                rig.send("205#0F00");
            }
        }
        rig.run(500);
        let state = rig.drive.application().axis(0).unwrap().state();
        assert_eq!(state, takt_cia402::State::SwitchOnDisabled, "{cause}");
        let reported =
            emergency.is_empty() || rig.received.iter().any(|h| h.starts_with(emergency));
        assert!(reported, "{cause}: {:?}", rig.received);
    }
}

#[test]
fn drive_follows_cyclic_sync_position() {
    let mut rig = Rig::enabled(|_| ());
    for frame in [
        "000#8005",
        "605#2F60600008000000", // CSP
        "605#2302140105040080",
        "605#2F02140201000000",
        "605#2302140105040000", // RPDO 3 with every SYNC
        "605#2302180185030080",
        "605#2F02180201000000",
        "605#2302180185030000", // TPDO 3 with every SYNC
        "000#0105",
    ] {
        rig.send(frame);
    }
    // Leaving Operational triggered 6007h: a fault. Reset and enable again.
    for word in ["0000", "8000", "0600", "0700", "0F00"] {
        rig.send(&format!("205#{word}"));
        rig.run(300);
    }
    let mut position = 0;
    for n in 0..500_i32 {
        let target = (20 * n).to_le_bytes().map(|b| format!("{b:02X}")).concat();
        rig.now += 2 * MS;
        let sent = rig.send("080#");
        let reported = sent
            .iter()
            .find(|h| h.starts_with("385#"))
            .expect("TPDO 3 with each SYNC");
        let bytes = u32::from_str_radix(&reported[8..16], 16)
            .unwrap()
            .swap_bytes();
        position = bytes.cast_signed();
        rig.send(&format!("405#0F00{target}"));
    }
    assert!((position - 9940).abs() < 200, "it is at {position}");
}

#[test]
fn drive_axes_have_separate_pdos_and_faults() {
    let mut rig = Rig::new(|config| config.axes = vec![DriveConfig::default(); 2]);
    assert_eq!(rig.send("605#4000100000000000"), ["585#430010009201FFFF"]);
    assert_eq!(rig.send("605#40FF6F0000000000"), ["585#43FF6F0092010200"]);
    for index in [0x1440, 0x1640, 0x1840, 0x1A40] {
        assert!(
            rig.drive.dictionary().object(index).is_some(),
            "{index:04X}h"
        );
    }
    assert!(Rpdo::new(rig.drive.dictionary(), 64).unwrap().is_some());
    let pdo = Parameters::read(rig.drive.dictionary(), Direction::Transmit, 64).unwrap();
    assert_eq!(pdo.mapping[0].address, Address::new(0x6841, 0));
    rig.drive
        .application_mut()
        .axis_mut(1)
        .unwrap()
        .fault(FaultCode::ENCODER);
    rig.run(100);
    let state = |axis| rig.drive.application().axis(axis).unwrap().state();
    assert_eq!(state(0), takt_cia402::State::SwitchOnDisabled);
    assert_eq!(state(1), takt_cia402::State::Fault);
    assert!(
        rig.received.contains(&"085#0573010100000000".into()),
        "{:?}",
        rig.received
    );
}

#[test]
fn drive_unsupported_modes_and_methods_are_rejected() {
    let mut rig = Rig::new(|_| ());
    assert_eq!(rig.send("605#2F60600005000000"), ["585#8060600030000906"]);
    assert_eq!(rig.send("605#2F98600010000000"), ["585#8098600030000906"]);
    assert_eq!(rig.send("605#2F60600008000000"), ["585#6060600000000000"]);
}

/// 60C4h over the wire: records by SDO until the buffer is full, and by an RPDO of any type.
#[test]
fn drive_interpolated_position_records_fill_buffer() {
    for (kind, sync) in [("FF", false), ("01", true)] {
        let mut rig = Rig::enabled(|_| ());
        for frame in [
            "605#2F60600007000000", // IP
            "605#23C4600203000000", // a queue of three
            "605#2FC4600601000000",
            "605#2302140105040080",
            "605#2F02160000000000",
            "605#230216012001C160",
            "605#2F02160001000000",
        ] {
            assert!(rig.send(frame)[0].starts_with("585#60"), "{frame}");
        }
        rig.send(&format!("605#2F021402{kind}000000"));
        rig.send("605#2302140105040000");
        rig.run(20);
        let level = |rig: &mut Rig| {
            rig.run(2);
            rig.send("605#40C4600400000000")[0][12..14].to_owned()
        };
        assert_eq!(rig.send("605#23C1600164000000"), ["585#60C1600100000000"]);
        assert_eq!(level(&mut rig), "01");
        rig.send("405#C8000000");
        if sync {
            assert_eq!(level(&mut rig), "01", "waits for SYNC");
            rig.send("080#");
        }
        assert_eq!(level(&mut rig), "02");
        if sync {
            rig.send("080#");
            assert_eq!(level(&mut rig), "02", "no new record");
        }
        assert_eq!(rig.send("605#23C160012C010000"), ["585#60C1600100000000"]);
        assert_eq!(rig.send("605#23C1600190010000"), ["585#80C1600122000008"]);
    }
}

#[test]
fn drive_reset_keeps_motor_position() {
    let mut rig = Rig::new(|config| config.axes[0].position = 7.5);
    assert_eq!(rig.send("000#8105"), ["705#00"]);
    let motor = rig.drive.application().axis(0).unwrap().motor();
    assert!((motor.position - 7.5).abs() < 1e-6);
}

/// Cyclic synchronous position at a SYNC of 10 ms, from a master that never writes 60C2h.
fn led_by_sync(rig: &mut Rig) {
    rig.send("605#2F60600008000000");
    rig.send("605#2300140105020080");
    rig.send("605#2F02140201000000");
    rig.send("000#0105");
    for word in [6_u16, 7, 15] {
        for _ in 0..30 {
            let [low, high] = word.to_le_bytes();
            rig.send(&format!("605#2B406000{low:02X}{high:02X}0000"));
            rig.send("080#");
            rig.run(10);
        }
    }
}

#[test]
fn drive_takes_60c2h_from_sync() {
    let mut rig = Rig::new(|_| ());
    led_by_sync(&mut rig);
    let axis = |rig: &Rig| rig.drive.application().axis(0).unwrap().state();
    assert_eq!(axis(&rig), takt_cia402::State::OperationEnabled);
    let number = |rig: &Rig, sub| {
        rig.drive
            .dictionary()
            .bytes(Address::new(0x60C2, sub))
            .unwrap()[0]
    };
    assert_eq!((number(&rig, 1), number(&rig, 2).cast_signed()), (10, -3));
    // SYNC stops: set-points are missing.
    rig.received.clear();
    rig.run(200);
    assert!(
        rig.received
            .iter()
            .any(|frame| frame.starts_with("085#0087")),
        "{:?}",
        rig.received
    );
}

#[test]
fn drive_keeps_written_60c2h() {
    let mut rig = Rig::new(|_| ());
    rig.send("605#2FC2600101000000");
    led_by_sync(&mut rig);
    let value = rig
        .drive
        .dictionary()
        .bytes(Address::new(0x60C2, 1))
        .unwrap();
    assert_eq!(value, [1]);
    assert!(
        rig.received
            .iter()
            .any(|frame| frame.starts_with("085#0087")),
        "{:?}",
        rig.received
    );
}
