//! A master and nodes with observed quirks of real ones: late boot-up, emergencies that are never cleared, slow, stale,
//! noisy and repeated SDO responses, COB-IDs with additional bits, missing objects, faults during enabling.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that cannot continue ends and prints the state"
)]

#[path = "canopen/bus.rs"]
mod bus;

use std::time::Duration;

use bus::{Bus, MS, node, plan};
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::canopen::network::{
    AxisCommand, AxisFault, Event, NetworkConfig, NodeFault, Phase, Transfer,
};
use takt_can::canopen::node::NodeQuirks;
use takt_can::canopen::sdo::Outcome;
use takt_can::canopen::{NmtState, heartbeat};
use takt_can::{Frame, LogLine};
use takt_cia402::dictionary::{AbortCode, Address};
use takt_cia402::emulator::Quirks;
use takt_cia402::{DriveFault, Goal, State};

const CSP: i8 = 8;
const SECOND: Duration = Duration::from_secs(1);

/// A master and one drive of that kind, being started.
fn started(change: impl FnOnce(&mut DriveNodeConfig)) -> Bus {
    let mut config = DriveNodeConfig::new(node(1));
    change(&mut config);
    let mut bus = Bus::new(NetworkConfig::default(), vec![plan(1)], vec![config]);
    bus.master.start(bus.now);
    bus
}

fn quirky(name: &str) -> Bus {
    started(|config| config.quirks = NodeQuirks::named(name).unwrap())
}

fn until_running(bus: &mut Bus) {
    bus.until(5 * SECOND, |bus| {
        (bus.master.phase(node(1)) == Some(Phase::Running)).then_some(())
    });
    let failed = Event::Phase(node(1), Phase::Failed);
    assert!(!bus.events.contains(&failed), "{:?}", bus.events);
}

/// Enables it at its position, and moves it by 500 increments.
fn move_it(bus: &mut Bus) {
    let axis = bus.master.axis_mut(node(1), 0).unwrap();
    let from = axis.state().position;
    let to = |position| AxisCommand {
        position,
        ..AxisCommand::default()
    };
    axis.command(to(from));
    axis.set_goal(Goal::OperationEnabled, CSP);
    bus.until(2 * SECOND, |bus| {
        let axis = bus.master.axis(node(1), 0).unwrap();
        axis.state().follows.then_some(())
    });
    for step in 1..=100 {
        let axis = bus.master.axis_mut(node(1), 0).unwrap();
        axis.command(to(from + 5 * step));
        bus.run(bus.period);
    }
    bus.run(SECOND / 10);
    let axis = bus.master.axis(node(1), 0).unwrap();
    assert_eq!(axis.fault(), None);
    assert!((axis.state().position - from - 500).abs() < 20);
}

fn emergencies(bus: &Bus) -> Vec<u16> {
    let code = |event: &Event| match event {
        Event::Emergency(_, emergency, _) => Some(emergency.code),
        Event::Phase(..)
        | Event::Fault(..)
        | Event::Homed(_)
        | Event::Axis(_)
        | Event::Transferred(..) => None,
    };
    bus.events.iter().filter_map(code).collect()
}

#[test]
fn node_of_every_quirk_starts_and_moves() {
    for name in NodeQuirks::NAMES {
        println!("{name}");
        let mut bus = quirky(name);
        until_running(&mut bus);
        move_it(&mut bus);
    }
}

#[test]
fn node_with_all_quirks_at_once_starts() {
    let all = NodeQuirks::NAMES.into_iter().filter_map(NodeQuirks::named);
    // Bits cannot be both high and low.
    let all = all.filter(|quirks| quirks.cob_low == 0);
    let all = all.fold(NodeQuirks::default(), NodeQuirks::and);
    let mut bus = started(|config| {
        config.quirks = all;
        config.identity.serial = 1;
    });
    until_running(&mut bus);
    move_it(&mut bus);
}

/// Sends a frame to a drive and returns its frames of the next `ms`, with times in us.
fn exchange(drive: &mut DriveNode, from: Duration, frame: &str, ms: u64) -> Vec<(u64, String)> {
    let line = format!("(1.000000) can0 {frame}");
    let frame: Frame = LogLine::parse(&line).unwrap().frame;
    drive.handle_frame(&frame, from);
    let mut answers = Vec::new();
    for us in (0..=ms * 1000).step_by(100) {
        let now = from + Duration::from_micros(us);
        let sent = std::iter::from_fn(|| drive.poll_transmit(now));
        answers.extend(sent.map(|frame| (us, frame.to_string())));
    }
    answers
}

fn power_on(name: &str) -> DriveNode {
    let mut config = DriveNodeConfig::new(node(1));
    config.quirks = NodeQuirks::named(name).unwrap();
    let mut drive = DriveNode::power_on(config, Duration::ZERO).unwrap();
    // Until its boot-up message.
    let _ = exchange(&mut drive, Duration::ZERO, "7FF#", 600);
    drive
}

#[test]
fn boot_up_late_emergencies_follow_not_withdrawn() {
    let mut drive = power_on("late-boot-up");
    let sent = exchange(&mut drive, SECOND, "000#8201", 3000);
    let expected = [
        (14_400, "701#00"),
        (16_900, "081#B081010000000000"),
        (19_200, "081#A081010000000000"),
    ];
    let expected = expected.map(|(at, frame)| (at, frame.to_owned()));
    assert_eq!(sent, expected);
    let mut bus = quirky("late-boot-up");
    until_running(&mut bus);
    assert_eq!(emergencies(&bus), [0x81B0, 0x81A0]);
    assert_eq!(bus.master.fault(node(1)), None);
}

#[test]
fn sdo_answers_slow_stay_in_their_range() {
    let mut drive = power_on("slow-sdo");
    let mut seen = Vec::new();
    for turn in 1..100 {
        let at = SECOND + 20 * MS * turn;
        let sent = exchange(&mut drive, at, "601#4000100000000000", 19);
        assert_eq!(sent.len(), 1, "{sent:?}");
        assert_eq!(sent[0].1, "581#4300100092010200");
        seen.push(sent[0].0);
    }
    let (least, most) = (seen.iter().min().unwrap(), seen.iter().max().unwrap());
    assert!((2_600..3_200).contains(least), "{least}");
    assert!((6_000..=6_700).contains(most), "{most}");
}

#[test]
fn answers_stale_after_boot_up_start_nothing_wrong() {
    let mut drive = power_on("stale-answers");
    let reset = exchange(&mut drive, SECOND, "000#8101", 0);
    assert!(reset.is_empty());
    for _ in 0..2 {
        let early = exchange(&mut drive, SECOND, "601#4000100000000000", 0);
        assert!(early.is_empty(), "{early:?}");
    }
    let late = exchange(&mut drive, SECOND, "7FF#", 600);
    let frames: Vec<_> = late.iter().map(|(_, frame)| frame.as_str()).collect();
    let answer = "581#4300100092010200";
    assert_eq!(frames, ["701#00", answer, answer]);
    // Another program sent requests while the drive powered up; the master receives those responses
    // too.
    let mut bus = quirky("stale-answers");
    bus.run(SECOND / 10);
    for data in [
        [0x40, 0, 0x10, 0, 0, 0, 0, 0],
        [0x40, 0x18, 0x10, 1, 0, 0, 0, 0],
    ] {
        let request = Frame::new(node(1).cob(0x600), &data).unwrap();
        bus.foreign_frames.extend([request; 2]);
    }
    until_running(&mut bus);
    move_it(&mut bus);
}

#[test]
fn unused_bytes_with_noise_change_no_value() {
    let mut drive = power_on("noise");
    let sent = exchange(&mut drive, SECOND, "601#4041600000000000", 1);
    let (.., answer) = &sent[0];
    assert!(answer.starts_with("581#4B4160005002") && !answer.ends_with("0000"));
    let mut bus = quirky("noise");
    until_running(&mut bus);
    for (index, len) in [(0x6041, 2), (0x6061, 1), (0x6064, 4)] {
        let transfer = Transfer {
            address: Address::new(index, 0),
            ..Transfer::default()
        };
        bus.master.transfer(node(1), transfer).unwrap();
        bus.run(SECOND / 10);
        let Some(Event::Transferred(_, done, Outcome::Read)) = bus.events.pop() else {
            panic!("{:?}", bus.events);
        };
        assert_eq!(done.data.len(), len, "{index:04X}h");
    }
}

/// `F000_0181h` while it is disabled; bit 30 is always clear.
#[test]
fn cob_id_bits_28_to_30_differ_node_starts() {
    for (name, shown) in [("cob-bits-set", 0xF0), ("cob-bits-clear", 0x80)] {
        let mut drive = power_on(name);
        let sent = exchange(&mut drive, SECOND, "601#4001180100000000", 1);
        // TPDO 2 is disabled until it is configured.
        let second = exchange(&mut drive, 2 * SECOND, "601#4001180100000000", 1);
        assert_eq!(sent[0].1, second[0].1);
        assert_eq!(
            sent[0].1,
            format!("581#43011801810200{shown:02X}"),
            "{name}"
        );
        until_running(&mut quirky(name));
    }
}

/// Differences in the identifier still count.
#[test]
fn cob_id_of_other_identifier_is_refused() {
    for bits in [0x0000_0002, 0x8000_0000] {
        let mut bus = started(|config| config.quirks.cob_high = bits);
        bus.run(SECOND);
        let not_taken = NodeFault::NotTaken(Address::new(0x1400, 1));
        assert_eq!(bus.master.fault(node(1)), Some(not_taken), "{bits:08X}h");
    }
}

#[test]
fn object_6502h_absent_node_starts() {
    let mut bus = quirky("no-6502h");
    until_running(&mut bus);
    let modes = Transfer {
        address: Address::new(0x6502, 0),
        ..Transfer::default()
    };
    bus.master.transfer(node(1), modes).unwrap();
    bus.run(SECOND / 10);
    let Some(Event::Transferred(_, _, outcome)) = bus.events.pop() else {
        panic!("{:?}", bus.events);
    };
    assert_eq!(outcome, Outcome::Refused(AbortCode::NoObject));
    move_it(&mut bus);
}

#[test]
fn answers_repeated_and_shifted_are_aborted_once_each() {
    let mut drive = power_on("repeated-answers");
    let answers = exchange(&mut drive, SECOND, "601#4000100000000000", 1);
    assert_eq!(answers.len(), 10);
    assert_eq!(answers[1].1, "581#0043001000920102");
    let mut bus = quirky("repeated-answers");
    until_running(&mut bus);
    let garbled = |event: &&Event| matches!(event, Event::Fault(_, NodeFault::Garbled { .. }));
    assert_eq!(
        bus.events.iter().filter(garbled).count(),
        1,
        "reported once"
    );
    let requests = plan(1).all_downloads(None).len() * 2 + 1;
    assert!(
        bus.aborts > 0 && bus.aborts as usize <= requests,
        "{}",
        bus.aborts
    );
}

#[test]
fn node_that_only_babbles_fails_after_a_few_requests() {
    let mut bus = started(|_| ());
    // Its own responses are lost, and another sender interferes.
    bus.muted = Some(0x581 + 0x100);
    bus.drives[0] = None;
    bus.foreign_frames
        .push_back(heartbeat(node(1), NmtState::BootUp));
    for _ in 0..2_000 {
        bus.foreign_frames
            .push_back(Frame::new(node(1).cob(0x580), &[0, 0x20, 0, 0, 0, 0, 0, 0]).unwrap());
        bus.run(MS);
    }
    bus.run(3 * SECOND);
    assert_eq!(bus.master.phase(node(1)), Some(Phase::Failed));
    assert!((1..=6).contains(&bus.aborts), "{}", bus.aborts);
}

#[test]
fn enabling_that_faults_shows_each_emergency_and_stops() {
    let mut bus = started(|config| {
        config.axes[0].quirks.faults_on_enable = u32::MAX;
        config.axes[0].quirks.reached_in_fault = true;
    });
    until_running(&mut bus);
    let axis = bus.master.axis_mut(node(1), 0).unwrap();
    axis.set_goal(Goal::OperationEnabled, CSP);
    // A program that never stops retrying.
    for _ in 0..50 {
        bus.master.axis_mut(node(1), 0).unwrap().reset_fault();
        bus.run(SECOND / 10);
    }
    let faults: Vec<_> = emergencies(&bus);
    assert_eq!(faults, [0x5201, 0, 0x5201, 0, 0x5201]);
    let axis = bus.master.axis(node(1), 0).unwrap();
    let fails = DriveFault::EnablingFails(3);
    assert_eq!(axis.fault(), Some(AxisFault::Drive(fails)));
    assert_eq!(axis.state().status.raw() & 0x044F, 0x0408, "0638h");
    // Another goal is a new request, and its cause is repaired.
    let axis = bus.master.axis_mut(node(1), 0).unwrap();
    axis.set_goal(Goal::SwitchOnDisabled, CSP);
    axis.reset_fault();
    bus.run(SECOND / 5);
    let drive = bus.drive(1).application().axis(0).unwrap();
    assert_eq!(drive.state(), State::SwitchOnDisabled);
}

#[test]
fn enabling_that_faults_twice_comes_up_at_the_third() {
    let mut bus = started(|config| config.axes[0].quirks.faults_on_enable = 2);
    until_running(&mut bus);
    bus.master
        .axis_mut(node(1), 0)
        .unwrap()
        .set_goal(Goal::OperationEnabled, CSP);
    for _ in 0..2 {
        bus.run(SECOND / 5);
        bus.master.axis_mut(node(1), 0).unwrap().reset_fault();
    }
    bus.run(SECOND);
    assert_eq!(emergencies(&bus), [0x5201, 0, 0x5201, 0]);
    move_it(&mut bus);
}

#[test]
fn remote_bit_never_set_drive_moves() {
    for name in ["never-remote", "reached-in-fault"] {
        let quirks = Quirks::named(name).unwrap();
        let mut bus = started(|config| config.axes[0].quirks = quirks);
        until_running(&mut bus);
        move_it(&mut bus);
        let status = bus.master.axis(node(1), 0).unwrap().state().status;
        assert_eq!(status.remote(), name != "never-remote");
    }
}

/// 702h 00 of a master that is not in the plan, and with the number of our own.
#[test]
fn boot_up_of_another_master_disturbs_no_node() {
    let config = NetworkConfig {
        heartbeat: Some((node(3), 20 * MS)),
        ..NetworkConfig::default()
    };
    let drives = vec![DriveNodeConfig::new(node(1))];
    let mut bus = Bus::new(config, vec![plan(1)], drives);
    bus.master.start(bus.now);
    let boot_ups = [2, 3, 100].map(|raw| heartbeat(node(raw), NmtState::BootUp));
    bus.foreign_frames.extend(boot_ups);
    until_running(&mut bus);
    bus.foreign_frames.extend(boot_ups);
    move_it(&mut bus);
    assert_eq!(bus.master.fault(node(1)), None);
}

#[test]
fn serial_number_1_on_two_nodes_starts_both() {
    let drives = [1, 2].map(|raw| {
        let mut config = DriveNodeConfig::new(node(raw));
        config.identity.serial = 1;
        config
    });
    let mut bus = Bus::new(
        NetworkConfig::default(),
        vec![plan(1), plan(2)],
        drives.to_vec(),
    );
    bus.master.start(bus.now);
    bus.run(SECOND);
    let running = |n| bus.master.phase(node(n)) == Some(Phase::Running);
    assert!(running(1) && running(2));
}
