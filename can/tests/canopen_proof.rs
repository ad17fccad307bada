//! Process data proof before power-on, on CANopen: drives whose PDOs carry other data than mapped, in virtual time.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that cannot continue ends and prints the state"
)]

#[path = "canopen/bus.rs"]
mod bus;

use std::time::Duration;

use bus::{Bus, Tamper, node};
use takt_can::canopen::emulator::DriveNodeConfig;
use takt_can::canopen::network::{
    AxisCommand, AxisFault, AxisPlan, NetworkConfig, NodePlan, Phase,
};
use takt_cia402::emulator::Distortion;
use takt_cia402::proof::Objects;
use takt_cia402::{DriveFault, Goal, State};

const CSP: i8 = 8;
const SECOND: Duration = Duration::from_secs(1);
/// Lengths of the objects of each PDO of [`NodePlan::drive`].
const RPDO: [&[usize]; 2] = [&[2, 1, 4], &[4, 2]];
const TPDO: [&[usize]; 2] = [&[2, 1, 4], &[4, 2]];

fn running(not_mirrored: Objects) -> Bus {
    let axis = AxisPlan {
        not_mirrored,
        ..AxisPlan::default()
    };
    let mut config = DriveNodeConfig::new(node(1));
    config.axes[0].position = 12.34;
    let plans = vec![NodePlan::drive(node(1), axis)];
    let mut bus = Bus::new(NetworkConfig::default(), plans, vec![config]);
    bus.master.start(bus.now);
    bus.until(20 * SECOND, |bus| {
        (bus.master.phase(node(1)) == Some(Phase::Running)).then_some(())
    });
    bus
}

fn tampered(at: usize, lens: &'static [usize], receives: bool, distortion: Distortion) -> Bus {
    let mut bus = running(Objects::default());
    let first = if receives { 0x201 } else { 0x181 };
    let id = first + 0x100 * u32::try_from(at).unwrap();
    bus.tamper.push(Tamper {
        id,
        lens,
        receives,
        distortion,
    });
    bus
}

fn state(bus: &mut Bus) -> State {
    bus.drive(1).application().axis(0).unwrap().state()
}

/// Requests power until the proof has a result; returns its duration or the fault.
fn prove(bus: &mut Bus) -> Result<Duration, Option<DriveFault>> {
    let axis = bus.master.axis_mut(node(1), 0).unwrap();
    let position = axis.state().position;
    axis.command(AxisCommand {
        position,
        ..AxisCommand::default()
    });
    axis.set_goal(Goal::OperationEnabled, CSP);
    let end = bus.now + 3 * SECOND;
    while bus.now < end {
        bus.run(bus.period);
        let proof = bus.master.axis(node(1), 0).unwrap().proof();
        if proof.fault().is_some() {
            break;
        }
        if let Some(took) = proof.took() {
            bus.run(SECOND);
            return Ok(took);
        }
    }
    bus.run(SECOND / 5);
    match bus.master.axis(node(1), 0).unwrap().fault() {
        Some(AxisFault::Drive(drive_fault)) => Err(Some(drive_fault)),
        Some(_) | None => Err(None),
    }
}

#[track_caller]
fn is_refused(mut bus: Bus) -> String {
    let drive_fault = prove(&mut bus).unwrap_err();
    let state = state(&mut bus);
    let unpowered = [State::SwitchOnDisabled, State::ReadyToSwitchOn];
    assert!(unpowered.contains(&state), "{state} {drive_fault:?}");
    let drive_fault = drive_fault.expect("a reason");
    assert!(
        matches!(drive_fault, DriveFault::NotProven(_)),
        "{drive_fault}"
    );
    drive_fault.to_string()
}

#[test]
fn faithful_node_is_proven_and_enabled() {
    let mut bus = running(Objects::default());
    let took = prove(&mut bus).unwrap();
    println!("one axis, SYNC of 2 ms: {took:?}");
    assert_eq!(state(&mut bus), State::OperationEnabled);
    assert!(took < SECOND, "{took:?}");
}

#[test]
fn node_with_swapped_objects_gets_no_power() {
    let three = [[0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    for order in three {
        is_refused(tampered(0, RPDO[0], true, Distortion::order(order)));
        is_refused(tampered(0, TPDO[0], false, Distortion::order(order)));
    }
    is_refused(tampered(1, RPDO[1], true, Distortion::order([1, 0])));
}

#[test]
fn node_that_shifts_delays_or_freezes_gets_no_power() {
    for distortion in [
        Distortion::shifted(1),
        Distortion::shifted(3),
        Distortion::delayed(200),
        Distortion::frozen(),
    ] {
        for at in [0, 1] {
            is_refused(tampered(at, RPDO[at], true, distortion.clone()));
        }
        is_refused(tampered(0, TPDO[0], false, distortion));
    }
}

#[test]
fn proof_names_differing_object() {
    let why = is_refused(tampered(1, RPDO[1], true, Distortion::shifted(1)));
    assert!(why.starts_with("60FFh by PDO "), "{why}");
    assert!(
        why.contains(": the slave does not use the mapping it acknowledged\nhint: power-cycle it"),
        "{why}"
    );
}

#[test]
fn node_with_unmirrored_object_needs_quirk() {
    let faults = |bus: &mut Bus| {
        let axis = bus.drive(1).application_mut().axis_mut(0).unwrap();
        axis.process_data.unreadable = vec![0x6071];
    };
    let mut bus = running(Objects::default());
    faults(&mut bus);
    let why = is_refused(bus);
    assert!(why.starts_with("6071h cannot be read by SDO"), "{why}");
    let mut bus = running(Objects::of(&[0x6071]).unwrap());
    faults(&mut bus);
    prove(&mut bus).unwrap();
    assert_eq!(state(&mut bus), State::OperationEnabled);
}

#[test]
fn node_that_boots_again_is_proven_again() {
    let mut bus = running(Objects::default());
    prove(&mut bus).unwrap();
    bus.tamper.push(Tamper {
        id: 0x201,
        lens: RPDO[0],
        receives: true,
        distortion: Distortion::order([0, 2, 1]),
    });
    let config = DriveNodeConfig::new(node(1));
    let powered = takt_can::canopen::emulator::DriveNode::power_on(config, bus.now).unwrap();
    bus.drives[0] = Some(powered);
    bus.run(SECOND / 10);
    bus.until(20 * SECOND, |bus| {
        (bus.master.phase(node(1)) == Some(Phase::Running)).then_some(())
    });
    is_refused(bus);
}
