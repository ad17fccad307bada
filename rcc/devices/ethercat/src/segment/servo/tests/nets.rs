//! `Homing::Axis` in a net thread, on the emulated station: it ends as its axis does, and names each fault.

use super::*;
use crate::plant::fixtures::{Driven, Fixture};
use crate::segment::describe;

/// Shows all outputs.
const HOME: &str = "h=Homing::Axis(Device='axis0'),d=Core::BooleanNetcommOut(inValue=h.outHomed,Key='homed'),\
                    g=Core::BooleanNetcommOut(inValue=h.outHoming,Key='homing'),\
                    f=Core::BooleanNetcommOut(inValue=h.outFailed,Key='failed'),\
                    n=Core::IntNetcommOut(inValue=h.outFailure,Key='failure'),\
                    s=Core::IntNetcommOut(inValue=h.outStep,Key='step')";

/// Near its switch, so that homing takes 2.5 s.
fn near() -> StationMotor {
    StationMotor {
        start_deg: -70.0,
        ..StationMotor::default()
    }
}

/// A net thread that commands the axes of a cell.
struct Rig {
    cell: Cell,
    fixture: Fixture,
    axes: Vec<Driven>,
    state: DeviceState,
}

impl Rig {
    fn start(motor: StationMotor) -> Self {
        let cell = Cell::start(motor);
        let mut fixture = Fixture::default();
        let axes = describe(&config(&super::cell())).split_off(1);
        let axes = axes.into_iter().map(|axis| fixture.add_driven(axis));
        let axes = axes.collect();
        fixture.cycle = cell.bench.tick();
        let mut rig = Self {
            cell,
            fixture,
            axes,
            state: DeviceState::new(200),
        };
        rig.steps(20);
        rig
    }

    /// A cycle of the net thread, then one of the driver.
    fn steps(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.fixture.step();
            let devices = &mut self.cell.bench.devices;
            for (axis, device) in self.axes.iter_mut().zip(devices.iter_mut().skip(1)) {
                let given = &mut device.given;
                axis.command.read_with(|command| given.copy_from(command));
            }
            self.cell.run(1);
            let devices = &mut self.cell.bench.devices;
            for (axis, device) in self.axes.iter_mut().zip(devices.iter_mut().skip(1)) {
                let state = &mut self.state;
                device.state.read_with(|reported| state.copy_from(reported));
                axis.state.write_with(|slot| slot.copy_from(state));
            }
        }
    }

    /// Homes by a net, at most so many cycles; the number of the failure.
    fn home(&mut self, net: u32, cycles: usize) -> Option<i32> {
        self.fixture.start(net, HOME);
        for _ in 0..cycles {
            self.steps(1);
            if self.fixture.out(net, "homed") == "true" {
                return Some(0);
            }
            if self.fixture.out(net, "failed") == "true" {
                return self.fixture.out(net, "failure").parse().ok();
            }
        }
        None
    }
}

#[test]
fn homing_net_finds_zero_and_names_each_fault() {
    let wide = StationMotor {
        stops_deg: [-500.0, 500.0],
        ..near()
    };
    for (names, error) in [
        (&[][..], None),
        (&["switch-off"], Some(HomingError::SensorNotFound)),
        (&["switch-on"], Some(HomingError::SwitchStuck)),
        (&["no-index"], Some(HomingError::IndexNotFound)),
        (&["reversed"], Some(HomingError::WrongDirection)),
        (&["motor-open"], Some(HomingError::NotMoving)),
        (&["brake-stuck"], Some(HomingError::NotMoving)),
        (&["not-ready"], Some(HomingError::PowerLost)),
        (&["power-lost"], Some(HomingError::PowerLost)),
        (&["open-circuit"], Some(HomingError::PowerLost)),
    ] {
        let mut rig = Rig::start(wide);
        rig.cell.station.inject(0, faults(names));
        let expected = error.map_or(0, |error| i32::from(error.number()));
        assert_eq!(rig.home(1, 20_000), Some(expected), "{names:?}");
        let step = if error.is_some() { "8" } else { "7" };
        assert!(rig.fixture.out(1, "step") == step || expected == 7);
        if matches!(names, ["not-ready"] | ["reversed"]) {
            // Repaired, the next net homes it.
            rig.fixture.end(1);
            rig.cell.station.inject(0, StationFaults::default());
            rig.steps(1500);
            assert_eq!(rig.home(2, 10_000), Some(0), "after {names:?}");
        }
    }
}

#[test]
fn homing_net_timeout_and_fault_in_motion_are_named() {
    let far = StationMotor {
        start_deg: 400.0,
        stops_deg: [-500.0, 500.0],
        ..StationMotor::default()
    };
    let mut rig = Rig::start(far);
    let units = &mut rig.cell.bench.units;
    units.servos[0].motion.as_mut().unwrap().timeout = Duration::from_secs(2);
    let timeout = i32::from(HomingError::Timeout.number());
    assert_eq!(rig.home(1, 5000), Some(timeout));
    for name in ["not-ready", "power-lost", "open-circuit"] {
        let mut rig = Rig::start(near());
        rig.fixture.start(1, HOME);
        rig.steps(600);
        assert_eq!(rig.fixture.out(1, "homing"), "true");
        rig.cell.station.inject(0, faults(&[name]));
        rig.steps(50);
        let lost = HomingError::PowerLost.number().to_string();
        assert_eq!(rig.fixture.out(1, "failure"), lost, "{name}");
        assert!(rig.cell.station.is_braked(0), "{name}");
    }
}

#[test]
fn homing_net_ended_brakes_axis_in_any_step() {
    let mut steps = Vec::new();
    for after in [150, 1500, 3350, 4000] {
        let mut rig = Rig::start(near());
        rig.fixture.start(1, HOME);
        rig.steps(after);
        steps.push(rig.fixture.out(1, "step"));
        rig.fixture.lose_client(&[1]);
        rig.steps(600);
        let at = rig.cell.station.angle(0);
        rig.steps(500);
        let moved = (rig.cell.station.angle(0) - at).abs();
        assert!(moved < 0.05, "{after}: {moved}");
        assert!(!rig.cell.is_homed(0));
    }
    assert_eq!(
        steps,
        ["2", "4", "5", "6"],
        "to the switch, off it, to the index pulse, to its start"
    );
}

#[test]
fn homing_net_of_other_device_is_refused() {
    let mut fixture = Fixture::default();
    let all = describe(&config(&cell()));
    all.into_iter()
        .for_each(|device| drop(fixture.add_driven(device)));
    // Inputs and outputs of the same shape are no axis.
    fixture.add(
        "plain",
        "io_sim",
        &crate::plant::fixtures::parameters(&[("bools", "2"), ("reals", "1")]),
    );
    for device in ["arm", "plain", "nothing"] {
        let text =
            format!("{{h=Homing::Axis(Device='{device}'),c=Cancel(),outTerminate=c.outCancel}}");
        let fault = fixture.fault(&text);
        assert!(fault.contains(device), "{fault}");
    }
}
