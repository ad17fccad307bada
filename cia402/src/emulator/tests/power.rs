//! States, option codes, faults and loss of the master.

use super::*;

use State::{
    Fault, FaultReactionActive, NotReadyToSwitchOn, OperationEnabled, QuickStopActive,
    ReadyToSwitchOn, SwitchOnDisabled, SwitchedOn,
};

fn moving(options: &[(u16, i16)]) -> Rig {
    let mut rig = Rig::enabled(DriveConfig::default(), 3);
    for (index, option) in options {
        rig.set(*index, *option);
    }
    rig.set(0x60FF, 40_000_i32);
    rig.run(300);
    assert!((rig.velocity() - 40_000).abs() < 400, "{}", rig.velocity());
    rig.states.clear();
    rig
}

/// Stopping time, ms, and distance.
fn stopping(rig: &mut Rig) -> (u32, i32) {
    let from = rig.position();
    for ms in 0..5000 {
        rig.step();
        if rig.velocity().abs() < 50 {
            return (ms, rig.position() - from);
        }
    }
    panic!("it does not stop: {}", rig.velocity());
}

#[test]
fn power_states_up_and_down_are_all_visible() {
    let mut rig = Rig::new(DriveConfig::default());
    rig.reach(Goal::OperationEnabled);
    let up = [
        SwitchOnDisabled,
        ReadyToSwitchOn,
        SwitchedOn,
        OperationEnabled,
    ];
    assert_eq!(rig.states[rig.states.len() - 4..], up);
    rig.states.clear();
    rig.reach(Goal::SwitchedOn);
    rig.reach(Goal::ReadyToSwitchOn);
    rig.reach(Goal::SwitchOnDisabled);
    let down = [SwitchedOn, ReadyToSwitchOn, SwitchOnDisabled];
    assert_eq!(rig.states[rig.states.len() - 3..], down);
}

#[test]
fn brake_opens_before_operation_enabled() {
    let mut rig = Rig::new(DriveConfig::default());
    rig.reach(Goal::SwitchedOn);
    rig.word(0x000F);
    rig.run(10);
    assert_eq!(rig.drive.state(), SwitchedOn);
    assert!(rig.drive.motor().braked);
    rig.run(20);
    assert_eq!(rig.drive.state(), OperationEnabled);
    assert!(!rig.drive.motor().braked);
}

#[test]
fn quick_stop_follows_every_option_code() {
    for (option, ends_in, slowest_ms) in [
        (0, SwitchOnDisabled, 2000),
        (1, SwitchOnDisabled, 130),
        (2, SwitchOnDisabled, 40),
        (3, SwitchOnDisabled, 40),
        (4, SwitchOnDisabled, 40),
        (5, QuickStopActive, 130),
        (6, QuickStopActive, 40),
        (7, QuickStopActive, 40),
        (8, QuickStopActive, 40),
    ] {
        let mut rig = moving(&[(0x605A, option)]);
        rig.word(0x0002);
        let (ms, _) = stopping(&mut rig);
        assert!(ms <= slowest_ms, "605Ah = {option}: {ms} ms");
        rig.run(100);
        assert_eq!(rig.drive.state(), ends_in, "605Ah = {option}");
        assert_eq!(rig.drive.motor().braked, ends_in == SwitchOnDisabled);
        // The controlword is unchanged; nothing restarts by itself.
        rig.run(50);
        assert_eq!(rig.drive.state(), ends_in, "605Ah = {option}");
        rig.word(0x000F);
        rig.run(50);
        let expected = if option >= 5 {
            OperationEnabled
        } else {
            SwitchOnDisabled
        };
        assert_eq!(rig.drive.state(), expected, "605Ah = {option}");
    }
}

#[test]
fn shutdown_and_disable_operation_ramp_or_coast() {
    for (index, word, option, to, ramps) in [
        (0x605B, 0x0006, 0, ReadyToSwitchOn, false),
        (0x605B, 0x0006, 1, ReadyToSwitchOn, true),
        (0x605C, 0x0007, 0, SwitchedOn, false),
        (0x605C, 0x0007, 1, SwitchedOn, true),
    ] {
        let mut rig = moving(&[(index, option)]);
        rig.word(word);
        rig.step();
        let at_once = rig.drive.state() == to;
        assert_eq!(at_once, !ramps, "{index:04X}h = {option}");
        let (ms, _) = stopping(&mut rig);
        assert!(!ramps || (80..130).contains(&ms), "{index:04X}h: {ms} ms");
        rig.run(100);
        assert_eq!(rig.drive.state(), to);
    }
}

#[test]
fn disable_in_progress_is_cancelled_or_overruled() {
    let mut rig = moving(&[]);
    rig.word(0x0007);
    rig.run(20);
    assert_eq!(rig.drive.state(), OperationEnabled);
    rig.word(0x000F);
    rig.run(300);
    assert!((rig.velocity() - 40_000).abs() < 400, "{}", rig.velocity());
    rig.word(0x0007);
    rig.run(5);
    rig.word(0x0000);
    rig.step();
    assert_eq!(rig.drive.state(), SwitchOnDisabled);
}

#[test]
fn fault_is_reset_by_edge_once_its_cause_clears() {
    let mut rig = moving(&[]);
    rig.drive.fault(FaultCode::ENCODER);
    rig.run(100);
    assert_eq!(rig.states, [FaultReactionActive, Fault]);
    assert_eq!(rig.emergencies, [FaultCode::ENCODER]);
    assert_eq!(rig.get::<u16>(0x603F), 0x7305);
    rig.word(0x0000);
    rig.run(2);
    rig.word(0x0080);
    rig.run(5);
    assert_eq!(rig.drive.state(), Fault, "the cause is still there");
    rig.drive.clear_cause();
    rig.run(5);
    assert_eq!(rig.drive.state(), Fault, "the bit was high before");
    rig.word(0x0000);
    rig.run(2);
    rig.word(0x0080);
    rig.step();
    assert_eq!(rig.drive.state(), SwitchOnDisabled);
    assert_eq!(rig.emergencies, [FaultCode::ENCODER, FaultCode::NONE]);
    assert_eq!(rig.get::<u16>(0x603F), 0);
}

#[test]
fn fault_without_power_skips_the_reaction() {
    let mut rig = Rig::new(DriveConfig::default());
    rig.reach(Goal::ReadyToSwitchOn);
    rig.states.clear();
    rig.drive.fault(FaultCode::SHORT_CIRCUIT);
    rig.run(5);
    assert_eq!(rig.states, [FaultReactionActive, Fault]);
}

#[test]
fn quirks_level_reset_and_sod_as_0020_apply() {
    let mut rig = Rig::quirky(Quirks::named("ssc-5.11").unwrap());
    rig.run(5);
    assert_eq!(rig.drive.state(), SwitchOnDisabled);
    assert_eq!(rig.status().raw() & 0x006F, 0x0020);
    rig.word(0x0080);
    rig.drive.fault(FaultCode::ENCODER);
    rig.run(5);
    rig.drive.clear_cause();
    rig.run(2);
    assert_eq!(rig.drive.state(), SwitchOnDisabled);
}

#[test]
fn quick_stop_bit_is_ignored_where_unsupported() {
    let mut rig = Rig::quirky(Quirks::named("el7411").unwrap());
    rig.reach(Goal::OperationEnabled);
    rig.word(0x000B);
    rig.run(5);
    assert_eq!(rig.drive.state(), OperationEnabled);
}

#[test]
fn master_lost_triggers_6007h() {
    for (option, ends_in) in [
        (0, OperationEnabled),
        (1, Fault),
        (2, SwitchOnDisabled),
        (3, SwitchOnDisabled),
    ] {
        let mut rig = moving(&[(0x6007, option)]);
        rig.lost = true;
        rig.run(300);
        assert_eq!(rig.drive.state(), ends_in, "6007h = {option}");
        let expected: &[_] = if option == 1 {
            &[FaultCode::HEARTBEAT]
        } else {
            &[]
        };
        assert_eq!(rig.emergencies, expected);
        // The master is back with its stale controlword: nothing moves.
        rig.lost = false;
        rig.run(50);
        assert_eq!(rig.drive.state(), ends_in, "6007h = {option}");
    }
}

#[test]
fn voltage_is_required_and_monitored() {
    let mut rig = Rig::new(DriveConfig::default());
    rig.drive.dc_link = 5.0;
    rig.reach(Goal::ReadyToSwitchOn);
    rig.word(0x0007);
    rig.run(20);
    assert_eq!(rig.drive.state(), ReadyToSwitchOn);
    assert!(!rig.status().voltage_enabled());
    rig.drive.dc_link = 48.0;
    rig.reach(Goal::OperationEnabled);
    rig.drive.dc_link = 70.0;
    rig.run(5);
    assert_eq!(rig.drive.state(), Fault);
    assert_eq!(rig.emergencies, [FaultCode::OVER_VOLTAGE]);
}

#[test]
fn following_error_of_pushed_axis_faults() {
    let mut rig = Rig::enabled(DriveConfig::default(), 8);
    rig.set(0x6065, 100_u32);
    rig.drive.motor_mut().external = 3.0;
    rig.run(200);
    assert_eq!(rig.emergencies, [FaultCode::FOLLOWING_ERROR]);
    let mut rig = Rig::enabled(DriveConfig::default(), 8);
    rig.set(0x6065, u32::MAX);
    rig.drive.motor_mut().external = 3.0;
    rig.run(200);
    assert_eq!(rig.emergencies, []);
}

#[test]
fn motor_overload_warns_then_faults() {
    let config = DriveConfig {
        motor: MotorConfig {
            thermal_time: 0.5,
            ..MotorConfig::default()
        },
        ..DriveConfig::default()
    };
    let mut rig = Rig::enabled(config, 8);
    rig.set(0x6065, u32::MAX);
    rig.drive.motor_mut().external = 1.0;
    let mut warned = false;
    for _ in 0..2000 {
        rig.step();
        warned |= rig.status().warning() && rig.drive.state() == OperationEnabled;
    }
    assert!(warned);
    assert_eq!(rig.emergencies[0], FaultCode::TEMPERATURE);
}

#[test]
fn power_on_starts_in_not_ready_to_switch_on() {
    let rig = Rig::new(DriveConfig::default());
    assert_eq!(rig.drive.state(), NotReadyToSwitchOn);
}
