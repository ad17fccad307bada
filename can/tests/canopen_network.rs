//! A master and emulated drives on one bus in virtual time: bring-up, motion, homing, and every
//! fault of a node, which must stay local.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::wildcard_enum_match_arm,
    reason = "a test that cannot continue ends and prints the state"
)]

#[path = "canopen/bus.rs"]
mod bus;

use std::time::Duration;

use bus::{Bus, MS, node, plan};
use takt_can::canopen::emulator::DriveNodeConfig;
use takt_can::canopen::network::{
    AxisCommand, AxisFault, AxisPlan, AxisState, Download, Event, Network, NetworkConfig,
    NetworkError, NodeFault, NodePlan, Phase, Supervision, Transfer,
};
use takt_can::canopen::pdo::Parameters;
use takt_can::canopen::sdo::Outcome;
use takt_can::canopen::{Emergency, emergency};
use takt_cia402::dictionary::{Address, Mapped};
use takt_cia402::emulator::FaultCode;
use takt_cia402::{Change, DriveFault, Goal, HomingError, SetPoint, SetPointError, State};
use takt_tests::Random;

const CSP: i8 = 8;
const PV: i8 = 3;
const SECOND: Duration = Duration::from_secs(1);

/// Enables an axis at its current position.
fn enable(bus: &mut Bus, raw: u8) {
    let axis = bus.master.axis_mut(node(raw), 0).unwrap();
    let position = axis.state().position;
    axis.command(AxisCommand {
        position,
        ..AxisCommand::default()
    });
    axis.set_goal(Goal::OperationEnabled, CSP);
}

fn all_follow(bus: &mut Bus) -> Option<()> {
    let mut nodes = bus.master.nodes();
    let follow = nodes.all(|n| bus.master.axis(n, 0).is_some_and(|a| a.state().follows));
    follow.then_some(())
}

fn six_following() -> Bus {
    let mut bus = Bus::running(6, |_| ());
    (1..=6).for_each(|raw| enable(&mut bus, raw));
    bus.until(5 * SECOND, all_follow);
    bus
}

/// Moves axes along ramps of `step` units per period from their positions.
fn ramp(bus: &mut Bus, axes: &[u8], time: Duration, step: i32) {
    ramp_and(bus, axes, time, step, |_| ());
}

/// The same, with an additional action in each period.
fn ramp_and(
    bus: &mut Bus,
    axes: &[u8],
    time: Duration,
    step: i32,
    mut other: impl FnMut(&mut Bus),
) {
    let mut targets: Vec<_> = axes
        .iter()
        .map(|raw| bus.master.axis(node(*raw), 0).unwrap().state().position)
        .collect();
    let end = bus.now + time;
    while bus.now < end {
        for (raw, target) in axes.iter().zip(&mut targets) {
            *target += step;
            let axis = bus.master.axis_mut(node(*raw), 0).unwrap();
            axis.command(AxisCommand {
                position: *target,
                ..AxisCommand::default()
            });
        }
        other(bus);
        bus.run(bus.period);
    }
}

fn position(bus: &Bus, raw: u8) -> i32 {
    bus.master.axis(node(raw), 0).unwrap().state().position
}

#[test]
fn six_axes_follow_sync_at_2_ms() {
    let mut bus = six_following();
    bus.frames = 0;
    ramp(&mut bus, &[1, 2, 3, 4, 5, 6], SECOND, 20);
    for raw in 1..=6 {
        let at = position(&bus, raw);
        assert!((9_500..=10_100).contains(&at), "axis {raw} is at {at}");
        assert_eq!(bus.master.fault(node(raw)), None);
        assert_eq!(bus.master.axis(node(raw), 0).unwrap().state().missing, 0);
    }
    assert_eq!(bus.rpdos_late, 0);
    assert!(bus.rpdo_latest < bus.period, "{:?}", bus.rpdo_latest);
    // SYNC, six RPDOs and six TPDOs in each of 500 periods, and heartbeats.
    assert!(bus.frames >= 500 * 13, "{}", bus.frames);
}

#[test]
fn node_death_stops_only_itself_recovers_without_motion() {
    let mut bus = six_following();
    bus.drives[2] = None;
    ramp(&mut bus, &[1, 2, 4, 5, 6], SECOND / 2, 20);
    for raw in [1, 2, 4, 5, 6] {
        assert!(position(&bus, raw) > 4_500, "axis {raw} goes on");
        assert_eq!(bus.master.fault(node(raw)), None);
    }
    let lost = NodeFault::HeartbeatLost(250 * MS);
    assert_eq!(bus.master.fault(node(3)), Some(lost));
    assert!(bus.events.contains(&Event::Fault(node(3), lost)));
    assert_eq!(
        bus.master.axis(node(3), 0).unwrap().fault(),
        Some(AxisFault::NodeDown)
    );
    // Power restored: configured again at once, but not enabled.
    let config = DriveNodeConfig::new(node(3));
    let powered = takt_can::canopen::emulator::DriveNode::power_on(config, bus.now).unwrap();
    bus.drives[2] = Some(powered);
    bus.until(5 * SECOND, |bus| {
        (bus.master.phase(node(3)) == Some(Phase::Running)).then_some(())
    });
    bus.run(SECOND / 2);
    let axis = bus.master.axis(node(3), 0).unwrap();
    assert!(!axis.state().follows);
    assert_eq!(axis.goal(), Goal::SwitchOnDisabled);
    enable(&mut bus, 3);
    bus.until(5 * SECOND, all_follow);
}

#[test]
fn drive_fault_stays_local_and_resets_by_edge() {
    let mut bus = six_following();
    let drive = bus.drive(4).application_mut().axis_mut(0).unwrap();
    drive.fault(FaultCode::SHORT_CIRCUIT);
    ramp(&mut bus, &[1, 2, 3, 5, 6], SECOND / 4, 20);
    assert!(
        [1, 2, 3, 5, 6]
            .iter()
            .all(|raw| position(&bus, *raw) > 2_000)
    );
    let axis = bus.master.axis(node(4), 0).unwrap();
    assert_eq!(axis.fault(), Some(AxisFault::Drive(DriveFault::Fault)));
    let is_reported = |event: &Event| matches!(event, Event::Emergency(n, e, 1) if *n == node(4) && e.code == 0x2320);
    assert!(bus.events.iter().any(is_reported), "{:?}", bus.events);
    bus.drive(4)
        .application_mut()
        .axis_mut(0)
        .unwrap()
        .clear_cause();
    bus.master.axis_mut(node(4), 0).unwrap().reset_fault();
    bus.until(5 * SECOND, all_follow);
}

#[test]
fn emergency_storm_does_not_disturb_other_nodes() {
    let mut bus = six_following();
    let storm = Emergency {
        code: 0xFF00,
        register: 0x81,
        data: [0; 5],
    };
    let before = bus.frames;
    bus.rpdos_late = 0;
    let mut sent = 0;
    // Three in each period: the remaining capacity of a 1 Mbit/s bus.
    ramp_and(&mut bus, &[1, 2, 3, 4, 5, 6], SECOND, 20, |bus| {
        bus.foreign_frames.extend([emergency(node(3), &storm); 3]);
        sent += 3;
    });
    assert!(bus.frames - before > sent);
    assert_eq!(bus.rpdos_late, 0);
    let counted = |event: &Event| match event {
        Event::Emergency(_, _, count) => u64::from(*count),
        _ => 0,
    };
    assert!(bus.events.iter().map(counted).sum::<u64>() + 10 > sent);
    (1..=6).for_each(|raw| assert!(position(&bus, raw) > 9_000, "axis {raw}"));
}

#[test]
fn drives_stop_when_their_master_dies() {
    let mut bus = Bus::new(
        NetworkConfig {
            heartbeat: Some((node(127), 20 * MS)),
            ..NetworkConfig::default()
        },
        vec![plan(1), plan(2)],
        vec![DriveNodeConfig::new(node(1)), DriveNodeConfig::new(node(2))],
    );
    bus.master.start(bus.now);
    bus.run(SECOND);
    [1, 2].into_iter().for_each(|raw| enable(&mut bus, raw));
    bus.until(5 * SECOND, all_follow);
    ramp(&mut bus, &[1, 2], SECOND / 4, 20);
    bus.master_dead = true;
    bus.run(SECOND);
    for raw in [1, 2] {
        let drive = bus.drive(raw).application().axis(0).unwrap();
        assert_ne!(drive.state(), State::OperationEnabled);
        assert!(drive.motor().velocity.abs() < 0.1, "it is at rest");
    }
}

#[test]
fn block_transfer_of_1_mib_does_not_disturb_motion() {
    const LEN: usize = 1 << 20;
    let plans = [1, 2].map(|raw| {
        let mut plan = plan(raw);
        plan.sdo_len_max = LEN;
        plan
    });
    let mut drives = [1, 2].map(|raw| DriveNodeConfig::new(node(raw)));
    drives[1].domain_len = LEN;
    let config = NetworkConfig {
        sdo_per_cycle: 24,
        sdo_timeout: SECOND,
        ..NetworkConfig::default()
    };
    let mut bus = Bus::new(config, plans.to_vec(), drives.to_vec());
    bus.period = 4 * MS;
    bus.master.start(bus.now);
    bus.run(SECOND);
    [1, 2].into_iter().for_each(|raw| enable(&mut bus, raw));
    bus.until(5 * SECOND, all_follow);
    let value: Vec<u8> = (0..LEN).map(|n| (n * 7 % 251) as u8).collect();
    let write = Transfer {
        address: Address::new(0x2000, 0),
        write: true,
        in_blocks: true,
        data: value.clone(),
        tag: 1,
    };
    bus.events.clear();
    bus.master.transfer(node(2), write).unwrap();
    bus.rpdos_late = 0;
    let begun = bus.now;
    while !bus
        .events
        .iter()
        .any(|e| matches!(e, Event::Transferred(..)))
    {
        ramp(&mut bus, &[1, 2], SECOND / 10, 1);
        assert!(bus.now - begun < 60 * SECOND, "{:?}", bus.events);
    }
    let Some(Event::Transferred(n, done, outcome)) = bus.events.pop() else {
        panic!("{:?}", bus.events);
    };
    assert_eq!((n, done.tag, outcome), (node(2), 1, Outcome::Written));
    let there = bus
        .drive(2)
        .dictionary()
        .bytes(Address::new(0x2000, 0))
        .unwrap();
    assert_eq!(there, value);
    assert_eq!((bus.rpdos_late, bus.master.fault(node(2))), (0, None));
    assert!(all_follow(&mut bus).is_some());
}

#[test]
fn network_tolerates_one_percent_frame_loss() {
    for seed in 1..=3 {
        let config = NetworkConfig {
            retry: SECOND / 5,
            sdo_timeout: SECOND / 20,
            ..NetworkConfig::default()
        };
        let plans = [1, 2].map(|raw| {
            let mut plan = plan(raw);
            plan.axes[0].missing_max = 10;
            plan
        });
        let drives = [1, 2].map(|raw| {
            let mut config = DriveNodeConfig::new(node(raw));
            config.axes[0].quirks.missing_set_points = Some(10);
            config
        });
        let mut bus = Bus::new(config, plans.to_vec(), drives.to_vec());
        (bus.loss, bus.random) = (0.01, Random::new(seed));
        bus.master.start(bus.now);
        let running = |bus: &mut Bus| {
            let mut nodes = bus.master.nodes();
            nodes
                .all(|n| bus.master.phase(n) == Some(Phase::Running))
                .then_some(())
        };
        bus.until(60 * SECOND, running);
        [1, 2].into_iter().for_each(|raw| enable(&mut bus, raw));
        bus.until(10 * SECOND, all_follow);
        ramp(&mut bus, &[1, 2], SECOND, 20);
        for raw in [1, 2] {
            assert!(
                (9_000..=10_100).contains(&position(&bus, raw)),
                "seed {seed}"
            );
        }
    }
}

#[test]
fn axis_after_homing_waits_for_close_target() {
    let mut bus = Bus::new(
        NetworkConfig::default(),
        vec![{
            let mut plan = plan(1);
            // Method 35 homes at the current position; 607Ch moves the zero far away.
            plan.downloads = vec![
                Download::new(0x6098, 0, &[35]),
                Download::new(0x607C, 0, &50_000_i32.to_le_bytes()),
            ];
            plan
        }],
        vec![DriveNodeConfig::new(node(1))],
    );
    bus.master.start(bus.now);
    bus.run(SECOND);
    enable(&mut bus, 1);
    bus.until(5 * SECOND, all_follow);
    let before = bus.drive(1).application().axis(0).unwrap().motor().position;
    bus.master.axis_mut(node(1), 0).unwrap().home();
    bus.until(5 * SECOND, |bus| {
        bus.events.contains(&Event::Homed(node(1))).then_some(())
    });
    bus.run(SECOND / 2);
    let axis = bus.master.axis(node(1), 0).unwrap();
    assert_eq!(axis.state().homed, 1);
    assert!(
        (axis.state().position + 50_000).abs() < 10,
        "{:?}",
        axis.state()
    );
    let Some(AxisFault::NotAligned { target, actual }) = axis.fault() else {
        panic!("the old target is far away: {:?}", axis.fault());
    };
    assert!((target - actual).abs() > 49_000);
    let motor = bus.drive(1).application().axis(0).unwrap().motor();
    assert!((motor.position - before).abs() < 0.01, "it did not move");
    enable(&mut bus, 1);
    bus.until(SECOND, all_follow);
}

#[test]
fn homing_without_switch_times_out() {
    let mut bus = Bus::running(1, |plan| {
        plan.axes[0].homing = SECOND;
        plan.downloads = vec![
            Download::new(0x6098, 0, &[1]),
            Download::new(0x6099, 1, &10_u32.to_le_bytes()),
        ];
    });
    bus.master.axis_mut(node(1), 0).unwrap().home();
    bus.until(5 * SECOND, |bus| {
        bus.events.contains(&Event::Homed(node(1))).then_some(())
    });
    bus.run(SECOND / 10);
    let fault = bus.master.axis(node(1), 0).unwrap().fault();
    let timed_out = AxisFault::Homing(HomingError::TimedOut(SECOND));
    assert_eq!(fault, Some(timed_out));
}

/// Each reason for a failed start, produced by its cause.
#[test]
fn node_start_failure_names_its_cause() {
    let expect = |plan, drive: Option<DriveNodeConfig>, expected: &str| {
        let config = NetworkConfig {
            boot_up_max: SECOND / 10,
            sdo_timeout: SECOND / 20,
            ..NetworkConfig::default()
        };
        let mut bus = Bus::new(config, vec![plan], drive.into_iter().collect());
        bus.master.start(bus.now);
        bus.run(SECOND);
        let fault = bus.master.fault(node(1)).expect(expected).to_string();
        assert!(fault.starts_with(expected), "{fault}");
        assert_eq!(bus.master.phase(node(1)), Some(Phase::Failed), "{fault}");
    };
    let drive = || Some(DriveNodeConfig::new(node(1)));
    expect(plan(1), None, "no boot-up message 100");
    let mut other = plan(1);
    other.identity = [None, Some(0x403), None, None];
    expect(
        other,
        drive(),
        "1018h:02 is 00000402h, 00000403h was planned",
    );
    let mut mode = plan(1);
    mode.downloads = vec![Download::new(0x6060, 0, &[5])];
    expect(
        mode,
        drive(),
        "6060h:00: the value is not allowed (0609 0030h)",
    );
    let mut absent = plan(1);
    absent.rpdos[0].0 = 5;
    expect(absent, drive(), "1405h:01: there is no such object");
    let mut mapped = plan(1);
    mapped.rpdos[0].1.mapping[0].bits = 8;
    expect(mapped, drive(), "1600h:01: the object cannot be mapped");
    let mut limited = plan(1);
    // 6041h can be mapped but is read-only; 1003h:00 accepts only 0.
    limited.downloads = vec![Download::new(0x1012, 0, &0x8000_0100_u32.to_le_bytes())];
    limited.supervision = Supervision::Heartbeat(Duration::ZERO);
    expect(limited, drive(), "no heartbeat 200");
}

#[test]
fn node_fault_while_running_is_named() {
    // A restart: the boot-up message comes while it runs.
    let mut bus = Bus::running(2, |_| ());
    bus.foreign_frames
        .push_back(takt_can::canopen::NmtCommand::ResetNode.frame(Some(node(1))));
    bus.run(SECOND / 100);
    let restarted = Event::Fault(node(1), NodeFault::Restarted);
    assert!(bus.events.contains(&restarted), "{:?}", bus.events);
    bus.run(SECOND);
    assert_eq!(
        bus.master.phase(node(1)),
        Some(Phase::Running),
        "configured again"
    );
    // Another master sends it to Pre-operational.
    let pre = takt_can::canopen::NmtCommand::EnterPreOperational.frame(Some(node(2)));
    bus.foreign_frames.push_back(pre);
    bus.run(SECOND / 5);
    let text = bus.master.fault(node(2)).unwrap().to_string();
    assert!(
        text.starts_with("it went to pre-operational without a command"),
        "{text}"
    );
    // Its TPDO is disabled without the master.
    let mut bus = six_following();
    let off = 0xC000_0185_u32.to_le_bytes();
    let write = Transfer {
        address: Address::new(0x1800, 1),
        write: true,
        data: off.to_vec(),
        ..Transfer::default()
    };
    bus.master.transfer(node(5), write).unwrap();
    bus.run(SECOND / 10);
    let text = bus.master.fault(node(5)).unwrap().to_string();
    assert!(text.starts_with("TPDO 1 missing for 4 SYNCs"), "{text}");
    let axis = bus.master.axis(node(5), 0).unwrap();
    assert_eq!(axis.fault(), Some(AxisFault::HeldBack));
}

#[test]
fn guarding_monitors_node_without_heartbeat() {
    let mut bus = Bus::running(1, |plan| {
        plan.supervision = Supervision::Guarding(20 * MS, 3);
    });
    bus.run(SECOND);
    assert_eq!(bus.master.fault(node(1)), None);
    bus.drives[0] = None;
    bus.run(SECOND / 5);
    assert_eq!(bus.master.fault(node(1)), Some(NodeFault::GuardingLost));
}

/// Only its heartbeat is lost: it still receives frames and would turn forever.
#[test]
fn node_given_up_stops_its_motor() {
    for on_link_loss in [0, 1, 3] {
        let mut bus = Bus::running(1, |plan| {
            let drive = NodePlan::drive(plan.id, plan.axes[0]);
            (plan.rpdos, plan.tpdos) = (drive.rpdos, drive.tpdos);
            plan.axes[0].on_link_loss = Some(on_link_loss);
        });
        let axis = bus.master.axis_mut(node(1), 0).unwrap();
        axis.command(AxisCommand {
            velocity: 5_000,
            ..AxisCommand::default()
        });
        axis.set_goal(Goal::OperationEnabled, PV);
        let turns = |bus: &mut Bus| {
            let velocity = bus.drive(1).application().axis(0).unwrap().motor().velocity;
            (velocity.abs() > 0.5).then_some(())
        };
        bus.until(5 * SECOND, turns);
        bus.run(SECOND / 2);
        bus.muted = Some(0x701);
        bus.run(SECOND);
        let lost = NodeFault::HeartbeatLost(250 * MS);
        assert!(bus.events.contains(&Event::Fault(node(1), lost)));
        let drive = bus.drive(1).application().axis(0).unwrap();
        let (state, velocity) = (drive.state(), drive.motor().velocity);
        assert_ne!(state, State::OperationEnabled, "6007h = {on_link_loss}");
        assert!(velocity.abs() < 0.01, "6007h = {on_link_loss}: {velocity}");
        assert_eq!(bus.drive(1).state(), takt_can::canopen::nmt::State::Stopped);
        // Its heartbeat is received again; it restarts at rest.
        bus.muted = None;
        bus.until(10 * SECOND, |bus| {
            (bus.master.phase(node(1)) == Some(Phase::Running)).then_some(())
        });
        bus.run(SECOND);
        assert!(!bus.master.axis(node(1), 0).unwrap().state().follows);
        let velocity = bus.drive(1).application().axis(0).unwrap().motor().velocity;
        assert!(velocity.abs() < 0.01, "6007h = {on_link_loss}: {velocity}");
    }
}

#[test]
fn tpdo_recovery_clears_fault_next_loss_is_reported() {
    let mut bus = six_following();
    for _ in 0..2 {
        bus.events.clear();
        bus.muted = Some(0x182);
        bus.run(SECOND / 20);
        let missing = NodeFault::PdoMissing {
            number: 0,
            cycles: 4,
        };
        assert!(bus.events.contains(&Event::Fault(node(2), missing)));
        assert_eq!(bus.master.fault(node(2)), Some(missing));
        bus.muted = None;
        bus.run(SECOND / 20);
        assert_eq!(bus.master.fault(node(2)), None);
        assert_eq!(bus.master.phase(node(2)), Some(Phase::Running));
        enable(&mut bus, 2);
        bus.until(5 * SECOND, all_follow);
    }
}

#[test]
fn drive_period_and_link_loss_reaction_are_configured() {
    for (period, value, exponent) in [(2 * MS, 2_u8, -3_i8), (MS / 4, 25, -5)] {
        let bus = Bus::running(2, |plan| {
            plan.axes[0].set_point_period = Some(period);
            plan.axes[0].on_link_loss = Some(3);
        });
        for drive in bus.drives.iter().flatten() {
            let bytes = |index, sub| drive.dictionary().bytes(Address::new(index, sub)).unwrap();
            assert_eq!(bytes(0x60C2, 1), value.to_le_bytes());
            assert_eq!(bytes(0x60C2, 2), exponent.to_le_bytes());
            assert_eq!(bytes(0x6007, 0), 3_i16.to_le_bytes());
        }
    }
}

#[test]
fn drive_jerk_and_buffer_are_configured_if_planned() {
    let bus = Bus::running(1, |plan| {
        plan.axes[0].jerk_max = Some(5_000_000);
        plan.axes[0].records = Some(4);
    });
    let drive = bus.drives[0].as_ref().unwrap();
    let bytes = |index, sub| drive.dictionary().bytes(Address::new(index, sub)).unwrap();
    assert_eq!(bytes(0x6086, 0), 3_i16.to_le_bytes());
    assert_eq!(bytes(0x60A4, 1), 5_000_000_u32.to_le_bytes());
    assert_eq!(bytes(0x60C4, 2), 4_u32.to_le_bytes());
    assert_eq!((bytes(0x60C4, 3), bytes(0x60C4, 6)), (&[0][..], &[1][..]));
}

/// With a buffer in the drive and without.
#[test]
fn interpolated_position_is_sent_by_data_records() {
    const IP: i8 = 7;
    for records in [None, Some(4)] {
        let mut bus = Bus::running(1, |plan| {
            let record = Mapped {
                address: Address::new(0x60C1, 1),
                bits: 32,
            };
            plan.rpdos[0].1.mapping[2] = record;
            plan.axes[0].set_point_period = Some(2 * MS);
            plan.axes[0].records = records;
        });
        let axis = bus.master.axis_mut(node(1), 0).unwrap();
        axis.set_goal(Goal::OperationEnabled, IP);
        bus.until(5 * SECOND, all_follow);
        for cycle in 1..=500 {
            let axis = bus.master.axis_mut(node(1), 0).unwrap();
            axis.command(AxisCommand {
                position: 20 * cycle,
                ..AxisCommand::default()
            });
            bus.run(bus.period);
        }
        bus.run(SECOND / 10);
        let off = position(&bus, 1) - 10_000;
        assert!(off.abs() < 20, "{records:?}: {off}");
    }
}

#[test]
fn master_number_must_differ_from_nodes() {
    let config = NetworkConfig {
        heartbeat: Some((node(2), 20 * MS)),
        ..NetworkConfig::default()
    };
    let refused = Network::new(config, vec![plan(1), plan(2)]).unwrap_err();
    assert_eq!(refused, NetworkError::Master(node(2)));
}

#[test]
fn profile_position_set_points_are_acknowledged_in_order() {
    let mut bus = Bus::running(1, |plan| {
        plan.downloads = vec![
            Download::new(0x6081, 0, &40_000_u32.to_le_bytes()),
            Download::new(0x6083, 0, &400_000_u32.to_le_bytes()),
            Download::new(0x6084, 0, &400_000_u32.to_le_bytes()),
        ];
    });
    bus.master
        .axis_mut(node(1), 0)
        .unwrap()
        .set_goal(Goal::OperationEnabled, 1);
    bus.until(5 * SECOND, all_follow);
    let there = |bus: &mut Bus, target: i32, taken: u32| {
        bus.until(5 * SECOND, |bus| {
            let axis = bus.master.axis(node(1), 0).unwrap();
            assert_eq!(axis.fault(), None);
            let state = axis.state();
            let arrived = (state.position - target).abs() < 10 && state.taken == taken;
            arrived.then_some(())
        });
    };
    let to = |target, relative, change| SetPoint {
        target,
        relative,
        change,
    };
    let offer = |bus: &mut Bus, set_point| {
        bus.until(5 * SECOND, |bus| {
            let axis = bus.master.axis(node(1), 0).unwrap();
            (!axis.is_handing_over()).then_some(())
        });
        bus.master.axis_mut(node(1), 0).unwrap().move_to(set_point);
    };
    offer(&mut bus, to(3_000, false, Change::AfterStop));
    offer(&mut bus, to(1_000, true, Change::AfterStop));
    there(&mut bus, 4_000, 2);
    // Away, and back before it arrives.
    offer(&mut bus, to(400_000, false, Change::AfterStop));
    bus.run(SECOND / 4);
    offer(&mut bus, to(-2_000, false, Change::AtOnce));
    there(&mut bus, -2_000, 4);
    // In fault it accepts none and reports that.
    let drive = bus.drive(1).application_mut().axis_mut(0).unwrap();
    drive.fault(FaultCode::SHORT_CIRCUIT);
    bus.run(SECOND / 10);
    offer(&mut bus, to(0, false, Change::AfterStop));
    bus.run(SECOND / 10);
    let drive = bus.drive(1).application_mut().axis_mut(0).unwrap();
    drive.clear_cause();
    bus.master.axis_mut(node(1), 0).unwrap().reset_fault();
    bus.until(5 * SECOND, all_follow);
    let fault = bus.master.axis(node(1), 0).unwrap().fault();
    let interrupted = AxisFault::SetPoint(SetPointError::Interrupted);
    assert_eq!(fault, Some(interrupted));
    assert!((position(&bus, 1) + 2_000).abs() < 20, "it stays");
}

#[test]
fn axes_of_one_drive_have_separate_pdos() {
    move_axes_of_one_drive(&[0, 1, 3], &[20, 0, -10]);
    assert!(NodePlan::drives(node(1), &[]).is_none());
    assert!(NodePlan::drives(node(1), &[AxisPlan::default(); 9]).is_none());
}

#[test]
fn six_axis_drive_uses_identifiers_of_next_node() {
    move_axes_of_one_drive(&[0, 1, 2, 3, 4, 5], &[20, 0, -10, 5, 15, -20]);
    let axes = [AxisPlan::default(); 5];
    assert!(NodePlan::drives(node(127), &axes).is_none());
    let plans = vec![NodePlan::drives(node(1), &axes).unwrap(), plan(2)];
    let collision = NetworkError::Collision {
        node: node(2),
        id: node(2).cob(0x180),
    };
    let refused = Network::new(NetworkConfig::default(), plans).unwrap_err();
    assert_eq!(refused, collision);
}

/// Its mode is written once, and one PDO in each direction holds position and torque.
/// Two axes of one drive with a constant mode.
fn constant_mode() -> NodePlan {
    let axis = |axis| AxisPlan {
        axis,
        set_point_period: Some(2 * MS),
        mode: Some(CSP),
        ..AxisPlan::default()
    };
    NodePlan::drives(node(1), &[axis(0), axis(1)]).unwrap()
}

fn state_of(bus: &Bus, axis: u8) -> AxisState {
    *bus.master.axis(node(1), axis.into()).unwrap().state()
}

/// The bus with these axes, which follow.
fn constant_mode_following() -> Bus {
    let mut config = DriveNodeConfig::new(node(1));
    config.axes = vec![config.axes[0].clone(); 2];
    let mut bus = Bus::new(
        NetworkConfig::default(),
        vec![constant_mode()],
        vec![config],
    );
    bus.master.start(bus.now);
    bus.until(5 * SECOND, |bus| {
        (bus.master.phase(node(1)) == Some(Phase::Running)).then_some(())
    });
    for n in 0..2 {
        let axis = bus.master.axis_mut(node(1), n).unwrap();
        axis.set_goal(Goal::OperationEnabled, CSP);
    }
    bus.until(5 * SECOND, |bus| {
        (0..2).all(|n| state_of(bus, n).follows).then_some(())
    });
    bus
}

#[test]
fn axis_with_constant_mode_exchanges_torques() {
    let plan = constant_mode();
    let mapped = |pdos: &[(u16, Parameters)]| -> Vec<Vec<u16>> {
        let of = |pdo: &Parameters| pdo.mapping.iter().map(|it| it.address.index).collect();
        pdos.iter().map(|(_, pdo)| of(pdo)).collect()
    };
    let second = [[0x6840, 0x687A, 0x68B2], [0x6841, 0x6864, 0x6877]];
    assert_eq!(mapped(&plan.rpdos), [[0x6040, 0x607A, 0x60B2], second[0]]);
    assert_eq!(mapped(&plan.tpdos), [[0x6041, 0x6064, 0x6077], second[1]]);
    let mut bus = constant_mode_following();
    for (n, torque_offset) in [(0, 37), (1, -21)] {
        let axis = bus.master.axis_mut(node(1), n).unwrap();
        let command = AxisCommand {
            torque_offset,
            ..axis.commanded()
        };
        axis.command(command);
    }
    bus.run(SECOND / 10);
    let states = [state_of(&bus, 0), state_of(&bus, 1)];
    let objects = bus.drive(1).dictionary();
    let word = |index| {
        let bytes = objects.bytes(Address::new(index, 0)).unwrap();
        i16::from_le_bytes(bytes.try_into().unwrap())
    };
    for (n, modes, offset, measured) in [(0, 0x6061, 0x60B2, 0x6077), (1, 0x6861, 0x68B2, 0x6877)] {
        assert_eq!(objects.bytes(Address::new(modes, 0)).unwrap(), [8]);
        assert_eq!(word(offset), [37, -21][n]);
        assert!((states[n].torque - word(measured)).abs() < 10, "{n}");
        assert_eq!(states[n].mode, None);
    }
    assert_eq!(bus.master.fault(node(1)), None);
}

#[test]
fn axis_with_constant_mode_refuses_others_and_is_watched() {
    let mut bus = constant_mode_following();
    // Another tool changes the mode: the axis no longer follows, until the drive shows its mode again.
    for (mode, follows) in [(PV, false), (CSP, true)] {
        let write = Transfer {
            address: Address::new(0x6860, 0),
            write: true,
            data: vec![mode.cast_unsigned()],
            ..Transfer::default()
        };
        bus.master.transfer(node(1), write).unwrap();
        bus.run(3 * SECOND);
        let axis = bus.master.axis(node(1), 1).unwrap();
        assert_eq!(axis.state().follows, follows, "{mode}");
        let text = axis.fault().map(|fault| fault.to_string());
        assert_eq!(text.is_none(), follows, "{text:?}");
        assert!(state_of(&bus, 0).follows, "the other axis goes on");
    }
    // Another mode and homing are refused, and the axis goes on; its power can be taken whatever the mode.
    let fault = |planned, requested| Some(AxisFault::ConstantMode { planned, requested });
    bus.master.axis_mut(node(1), 0).unwrap().home();
    let other = bus.master.axis_mut(node(1), 1).unwrap();
    other.set_goal(Goal::OperationEnabled, PV);
    bus.run(SECOND / 10);
    for (n, requested) in [(0, 6), (1, PV)] {
        let axis = bus.master.axis(node(1), n).unwrap();
        assert_eq!(axis.fault(), fault(CSP, requested));
        assert!(axis.state().follows);
    }
    let other = bus.master.axis_mut(node(1), 1).unwrap();
    other.set_goal(Goal::SwitchOnDisabled, 0);
    bus.until(SECOND, |bus| {
        let axis = bus.master.axis(node(1), 1).unwrap();
        let is_forgotten = !matches!(axis.fault(), Some(AxisFault::ConstantMode { .. }));
        (!axis.state().follows && is_forgotten).then_some(())
    });
}

/// The PDOs of the first axis are enabled at power-on and use the identifiers planned for the other axes.
#[test]
fn axis_without_goal_gets_no_power() {
    move_axes_of_one_drive(&[1, 3], &[20, -10]);
}

/// Moves some axes of a six-axis drive, each by its own step per cycle; the others must not be enabled.
fn move_axes_of_one_drive(axes: &[u8], steps: &[i32]) {
    let plans = axes.iter().map(|axis| AxisPlan {
        axis: *axis,
        set_point_period: Some(2 * MS),
        ..AxisPlan::default()
    });
    let plan = NodePlan::drives(node(1), &plans.collect::<Vec<_>>()).unwrap();
    let numbers: Vec<_> = plan.rpdos.iter().map(|(number, _)| *number).collect();
    let expected = axes.iter().map(|axis| 64 * u16::from(*axis));
    assert_eq!(numbers, expected.collect::<Vec<_>>(), "64 for each axis");
    let mut config = DriveNodeConfig::new(node(1));
    config.axes = vec![config.axes[0].clone(); 6];
    let mut bus = Bus::new(NetworkConfig::default(), vec![plan], vec![config]);
    bus.master.start(bus.now);
    bus.until(5 * SECOND, |bus| {
        (bus.master.phase(node(1)) == Some(Phase::Running)).then_some(())
    });
    let state = |bus: &Bus, n| *bus.master.axis(node(1), n).unwrap().state();
    for n in 0..axes.len() {
        let axis = bus.master.axis_mut(node(1), n).unwrap();
        axis.set_goal(Goal::OperationEnabled, CSP);
    }
    bus.until(5 * SECOND, |bus| {
        (0..axes.len()).all(|n| state(bus, n).follows).then_some(())
    });
    for cycle in 1..=500 {
        for (n, step) in steps.iter().enumerate() {
            let axis = bus.master.axis_mut(node(1), n).unwrap();
            axis.command(AxisCommand {
                position: cycle * step,
                ..AxisCommand::default()
            });
        }
        bus.run(bus.period);
    }
    bus.run(SECOND / 10);
    for (n, step) in steps.iter().enumerate() {
        assert!((state(&bus, n).position - 500 * step).abs() < 20, "{n}");
    }
    for axis in 0..6_u8 {
        let drive = bus.drive(1).application().axis(axis.into()).unwrap();
        let enabled = drive.state() == State::OperationEnabled;
        assert_eq!(enabled, axes.contains(&axis), "axis {axis}");
    }
    assert_eq!(bus.master.fault(node(1)), None);
}

/// Both boot-up messages, its own and the one after the master's reset, arrive during SDO requests.
#[test]
fn node_powered_up_with_master_starts_at_once() {
    let mut plan = plan(1);
    plan.device_type = None;
    let drives = vec![DriveNodeConfig::new(node(1))];
    let mut bus = Bus::new(NetworkConfig::default(), vec![plan], drives);
    bus.master.start(bus.now);
    bus.until(SECOND, |bus| {
        (bus.master.phase(node(1)) == Some(Phase::Running)).then_some(())
    });
    let failed = |event: &Event| *event == Event::Phase(node(1), Phase::Failed);
    assert!(!bus.events.iter().any(failed), "{:?}", bus.events);
}
