//! Axes against the emulated drive on the emulated segment, in virtual time.

use super::layout::Bits;
use super::*;
use crate::config::{Location, MasterConfig, SlaveSpec, SyncSpec};
use crate::emulator::{Segment, ServoConfig, ServoDrive, Slave};
use crate::master::tests::Rig;
use takt_cia402::emulator::FaultCode;

mod proof;

const OVERCURRENT: FaultCode = FaultCode(0x2310);

/// A segment of one drive with its axes, in OP.
struct Fixture {
    rig: Rig,
    drive: ServoDrive,
    axes: Vec<Axis>,
    states: Vec<AxisState>,
}

impl Fixture {
    fn new((slave, drive): (Slave, ServoDrive), count: u8, cycle: Duration, sync: bool) -> Self {
        let (outputs, inputs) = pdos(count);
        let mut startup: Vec<_> = (0..count)
            .flat_map(|axis| interpolation(axis, cycle))
            .collect();
        startup.extend((0..count).flat_map(|axis| homing(axis, 35, (1000, 100))));
        let spec = SlaveSpec {
            outputs: Some(outputs),
            inputs: Some(inputs),
            startup,
            sync: sync.then(|| SyncSpec::sync0(cycle)),
            ..SlaveSpec::new("drive", Location::Position(0))
        };
        let config = MasterConfig {
            slaves: vec![spec],
            cycle,
            ..MasterConfig::default()
        };
        let mut rig = Rig::new(config, Segment::line([slave]));
        rig.until(20_000, Master::is_operational);
        rig.cycles(10);
        let process = rig.master.slave(0).unwrap().process().clone();
        let axis = |number| Axis::new(0, &process, number, MasterOptions::default()).unwrap();
        let axes: Vec<_> = (0..count).map(axis).collect();
        Self {
            rig,
            drive,
            axes,
            states: Vec::new(),
        }
    }

    fn one() -> Self {
        let drive = ServoDrive::slave(ServoConfig::default()).unwrap();
        Self::new(drive, 1, Duration::from_millis(1), false)
    }

    fn cycle(&mut self, target: impl Fn(usize, &Option<AxisState>) -> Target) {
        let before: Vec<_> = self.states.drain(..).map(Some).collect();
        for (number, axis) in self.axes.iter_mut().enumerate() {
            let last = before.get(number).copied().flatten();
            let state = axis.cycle(&mut self.rig.master, target(number, &last), self.rig.now);
            self.states.push(state);
        }
        self.rig.cycle();
        while let Some(reply) = self.rig.master.poll_reply() {
            let mut axes = self.axes.iter_mut();
            let now = self.rig.now;
            let other = axes.try_fold(reply, |reply, axis| axis.handle_reply(reply, now).err());
            assert_eq!(other, None);
        }
    }

    #[track_caller]
    fn until(&mut self, most: usize, target: Target, holds: impl Fn(&AxisState) -> bool) {
        for _ in 0..most {
            self.cycle(|_, _| target);
            if self.states.iter().all(&holds) {
                return;
            }
        }
        let texts: Vec<_> = self.states.iter().map(ToString::to_string).collect();
        let proofs: Vec<_> = self.axes.iter().map(Axis::proof).collect();
        panic!("{texts:?} {:?} {proofs:?}", self.rig.events);
    }

    #[track_caller]
    fn enable(&mut self, target: Target) {
        for axis in &mut self.axes {
            axis.set_goal(Goal::OperationEnabled);
        }
        self.until(4000, target, |state| state.follows);
    }
}

#[test]
fn axis_is_enabled_and_follows_positions() {
    let mut fixture = Fixture::one();
    let start = fixture.axes[0]
        .cycle(&mut fixture.rig.master, Target::Hold, fixture.rig.now)
        .position;
    fixture.enable(Target::Hold);
    assert_eq!(fixture.states[0].state, Some(State::OperationEnabled));
    for n in 0..1000 {
        fixture.cycle(|_, _| Target::Position(start + n));
    }
    let there = start + 999;
    fixture.until(500, Target::Position(there), |state| {
        (state.position - there).abs() <= 2
    });
    fixture.axes[0].set_goal(Goal::SwitchOnDisabled);
    fixture.until(2000, Target::Hold, |state| {
        state.state == Some(State::SwitchOnDisabled)
    });
}

#[test]
fn velocity_and_torque_modes_require_6061h() {
    let mut fixture = Fixture::one();
    fixture.enable(Target::Velocity(0));
    fixture.until(2000, Target::Velocity(2000), |state| {
        state.velocity.unwrap().abs_diff(2000) < 100
    });
    fixture.until(2000, Target::Velocity(0), |state| {
        state.velocity.unwrap().abs() < 20
    });
    fixture.cycle(|_, _| Target::Torque(50));
    assert!(!fixture.states[0].follows, "6061h shows CSV still");
    fixture.until(500, Target::Torque(50), |state| {
        state.follows && state.torque.unwrap() >= 49
    });
}

#[test]
fn homing_follows_its_status_bits() {
    let mut fixture = Fixture::one();
    fixture.axes[0].set_goal(Goal::OperationEnabled);
    fixture.until(4000, Target::Home, |state| state.homing == Homing::Running);
    // Method 35: home is here, and now zero.
    fixture.until(4000, Target::Home, |state| state.homing == Homing::Done);
    assert_eq!(fixture.states[0].position, 0);
}

#[test]
fn fault_is_reported_and_reset_on_request_only() {
    let mut fixture = Fixture::one();
    fixture.enable(Target::Hold);
    fixture.drive.axis(0, |axis| axis.fault(OVERCURRENT));
    fixture.until(1000, Target::Hold, |state| {
        state.state == Some(State::Fault)
    });
    fixture.until(10, Target::Hold, |state| {
        state.error_code == Some(OVERCURRENT.0)
    });
    let emergency = (0..100).find_map(|_| {
        fixture.cycle(|_, _| Target::Hold);
        fixture.rig.master.poll_emergency()
    });
    assert_eq!(emergency.unwrap().emergency.code, OVERCURRENT.0);
    assert_eq!(fixture.states[0].drive_fault, Some(DriveFault::Fault));
    fixture
        .drive
        .axis(0, takt_cia402::emulator::Drive::clear_cause);
    for _ in 0..500 {
        fixture.cycle(|_, _| Target::Hold);
    }
    assert_eq!(
        fixture.states[0].state,
        Some(State::Fault),
        "no reset requested"
    );
    fixture.axes[0].reset_fault();
    fixture.until(4000, Target::Hold, |state| state.follows);
}

#[test]
fn axis_after_loss_does_not_move_by_itself() {
    let mut fixture = Fixture::one();
    fixture.enable(Target::Hold);
    fixture.rig.segment.set_link(0, false);
    for _ in 0..300 {
        fixture.cycle(|_, _| Target::Hold);
    }
    assert!(!fixture.states[0].online);
    assert_eq!(fixture.states[0].to_string(), "offline");
    fixture.rig.segment.set_link(0, true);
    fixture.until(6000, Target::Hold, |state| state.online);
    for _ in 0..2000 {
        fixture.cycle(|_, _| Target::Hold);
        assert_ne!(fixture.states[0].state, Some(State::OperationEnabled));
    }
    fixture.axes[0].reset_fault();
    fixture.enable(Target::Hold);
}

#[test]
fn six_axes_in_one_slave_move_in_step_with_sync0() {
    for cycle in [Duration::from_millis(2), Duration::from_millis(1)] {
        let mut fixture = Fixture::new(
            ServoDrive::slave(ServoConfig::tx90()).unwrap(),
            6,
            cycle,
            true,
        );
        fixture.enable(Target::Hold);
        let starts: Vec<_> = fixture.states.iter().map(|state| state.position).collect();
        for n in 0..500 {
            fixture.cycle(|axis, _| {
                Target::Position(starts[axis] + n * (1 + i32::try_from(axis).unwrap()))
            });
        }
        for _ in 0..300 {
            fixture.cycle(|axis, _| {
                Target::Position(starts[axis] + 499 * (1 + i32::try_from(axis).unwrap()))
            });
        }
        for (axis, state) in fixture.states.iter().enumerate() {
            let wanted = starts[axis] + 499 * (1 + i32::try_from(axis).unwrap());
            assert!(
                (state.position - wanted).abs() <= 2,
                "axis {axis}: {} for {wanted}",
                state.position
            );
        }
        assert!(
            fixture.rig.master.is_operational(),
            "{:?}",
            fixture.rig.events
        );
    }
}

#[test]
fn missing_mapping_is_named() {
    let process = ProcessData::default();
    let error = Axis::new(0, &process, 2, MasterOptions::default()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "7040h:00 is not in the PDOs; map it, or give the slave the PDOs of `axis::pdos`"
    );
}

#[test]
fn interpolation_time_uses_the_largest_unit() {
    let bytes = |us| -> Vec<u8> {
        interpolation(0, Duration::from_micros(us))
            .iter()
            .map(|sdo| sdo.data[0])
            .collect()
    };
    let exponent = |e: i8| e.cast_unsigned();
    assert_eq!(bytes(1000), [1, exponent(-3)]);
    assert_eq!(bytes(250), [25, exponent(-5)]);
    assert_eq!(bytes(20_000), [2, exponent(-2)]);
    assert!(bytes(333).is_empty(), "no 8 bits hold it");
}

#[test]
fn objects_are_read_at_any_bit_offset() {
    let bits = Bits {
        first: 3,
        count: 16,
    };
    let mut bytes = [0xFF, 0x00, 0xFF, 0x55];
    bits.write(&mut bytes, 0xA5C3);
    assert_eq!(bits.read(&bytes), 0xA5C3);
    assert_eq!((bytes[0] & 7, bytes[2] >> 3, bytes[3]), (7, 0x1F, 0x55));
    assert_eq!(
        Bits {
            first: 30,
            count: 8
        }
        .read(&bytes),
        0x01,
        "beyond the end there is nothing"
    );
}
