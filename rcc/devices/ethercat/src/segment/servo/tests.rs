//! Servo axes on the emulated station, in virtual time: motion, homing, and every fault of motor, encoder, switch and amplifier.

use takt_core::device::homing::{FAILURE, HOME, HOMED};
use takt_core::device::{DeviceState, DeviceStatus};
use takt_ethercat::emulator::{Station, StationFaults, StationMotor};
use takt_net::device::JointError;

use super::*;
use crate::segment::wire_tests::{Bench, config};
use takt_core::device::parts;
use takt_net::device::{Interfaces, Layout};

/// A degree of a joint, increments.
const DEGREE: f64 = 2000.0 * 100.0 / 360.0;
const NONE: StationFaults = StationFaults {
    open_circuit: false,
    no_index: false,
    proximity: None,
    brake_stuck: false,
    not_ready: false,
    reversed: false,
};

fn cell() -> String {
    let mut text = "cycle = '1ms'\n".to_owned();
    for (position, name) in ["coupler", "in", "out", "volts", "enc0", "enc1", "enc2"]
        .iter()
        .enumerate()
    {
        text += &format!("[[ethercat.slave]]\nname = '{name}'\nposition = {position}\n");
    }
    text += "[[ethercat.arm]]\nname = 'arm'\n";
    for n in 0..3 {
        text += &format!(
            "[[ethercat.arm.joint]]\nslave = 'axis{n}'\nincrements_per_turn = 200000\nrange = [-100, 100]\n\
             velocity_max = 90\nacceleration_max = 300\n"
        );
    }
    for n in 0..3 {
        text += &format!(
            "[[ethercat.servo]]\nname = 'axis{n}'\nencoder = 'enc{n}'\n\
             output = {{ slave = 'volts', object = [{}, 1] }}\n\
             brake = ['out', {n}]\nenable = ['out', {}]\nproximity = ['in', {n}]\nready = ['in', {}]\n\
             velocity_10v = 100000\nbrake_time = '50ms'\n\
             homing = {{ velocity = -80, index_velocity = 4, index_position = -78, index_every = 2000, start = 0, timeout = '60s' }}\n",
            0x7000 + 0x10 * n,
            n + 3,
            n + 3
        );
    }
    text
}

struct Cell {
    bench: Bench,
    station: Station,
    signals: Interfaces,
}

impl Cell {
    fn start(motor: StationMotor) -> Self {
        let config = config(&cell());
        let (segment, station) = Station::segment([motor; 3]);
        let mut layout = Layout::default();
        Self {
            bench: Bench::new(&config, segment, 0),
            station,
            signals: parts::lay(&[axis_part()], 0, &mut layout),
        }
    }

    fn run(&mut self, cycles: usize) {
        (0..cycles).for_each(|_| self.bench.cycle());
    }

    fn home(&mut self, axis: usize, is_on: bool) {
        assert_eq!(HOME, 0, "its command is the first");
        let given = &mut self.bench.devices[1 + axis].given;
        let every = if is_on { u64::MAX } else { 0 };
        given.words[..4].copy_from_slice(&[1, 1, every, 1]);
    }

    fn state<T>(&mut self, device: usize, read: impl Fn(&DeviceState) -> T) -> T {
        self.bench.devices[device].state.read_with(read)
    }

    fn is_homed(&mut self, axis: usize) -> bool {
        let io = self.signals.io.clone().unwrap();
        self.state(1 + axis, |state| io.bool_in[HOMED].read(&state.signals)) == Some(true)
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a small number of a failure"
    )]
    fn failure(&mut self, axis: usize) -> usize {
        let io = self.signals.io.clone().unwrap();
        let failure = self.state(1 + axis, |state| io.real_in[FAILURE].read(&state.signals));
        failure.unwrap() as usize
    }

    fn error(&mut self, joint: usize) -> i32 {
        self.state(0, |state| state.joints[joint].error)
    }

    fn measured(&mut self, joint: usize) -> f64 {
        self.state(0, |state| state.joints[joint].measured_position)
            .unwrap()
            .to_degrees()
    }

    fn status(&mut self) -> DeviceStatus {
        self.state(0, |state| state.status)
    }

    fn events(&mut self, axis: usize) -> String {
        let servo = &mut self.bench.servos[axis];
        let events = std::iter::from_fn(|| servo.poll_event());
        events
            .map(|event| event.to_string())
            .collect::<Vec<_>>()
            .join("; ")
    }

    /// Homes an axis to its end, at most so many cycles.
    fn home_for(&mut self, axis: usize, cycles: usize) -> String {
        self.home(axis, true);
        let mut events = String::new();
        for _ in 0..cycles {
            self.run(1);
            events += &self.events(axis);
            if self.is_homed(axis) || self.failure(axis) > 0 {
                self.run(300);
                break;
            }
        }
        events + &self.events(axis)
    }
}

#[test]
fn servo_axis_homed_moves_as_any_joint() {
    let mut cell = Cell::start(StationMotor {
        offset_v: 0.03,
        ..StationMotor::default()
    });
    assert_eq!(cell.status(), DeviceStatus::Operational);
    // Before homing, set-points are refused, and the axis holds.
    assert!(!cell.is_homed(0));
    for _ in 0..200 {
        let at = cell.bench.position(0);
        cell.bench.want(0, at + 0.001, 1);
        cell.run(1);
    }
    assert_eq!(cell.error(0), JointError::Refused as i32);
    assert!(
        (cell.station.angle(0) - 20.0).abs() < 0.1,
        "{}",
        cell.station.angle(0)
    );
    cell.bench.devices[0].given.joints[0].advance(None);
    cell.run(50);
    for axis in 0..3 {
        let events = cell.home_for(axis, 12_000);
        assert!(cell.is_homed(axis), "{events}");
        assert!(events.contains("homed: its zero is known"), "{events}");
        assert_eq!(cell.failure(axis), 0);
    }
    // The index pulse of the cell and of the motor: what is measured is off the truth by a constant.
    let off = cell.measured(0) - cell.station.angle(0);
    assert!(cell.measured(0).abs() < 0.3, "{}", cell.measured(0));
    let start = cell.bench.position(0);
    for n in 0..2000 {
        let t = f64::from(n) * 1e-3;
        let smooth = 0.5 - 0.5 * (std::f64::consts::PI * t / 2.0).cos();
        cell.bench.want(0, start + 0.7 * smooth, 1);
        cell.run(1);
        assert_eq!(cell.status(), DeviceStatus::Operational);
    }
    cell.run(300);
    let (measured, truth) = (cell.measured(0), cell.station.angle(0));
    assert!(
        (measured - start.to_degrees() - 0.7_f64.to_degrees()).abs() < 0.1,
        "{measured}"
    );
    assert!((measured - truth - off).abs() < 0.01);
}

#[test]
fn servo_zero_repeats_from_any_start() {
    let mut zeros = Vec::new();
    for start_deg in [60.0, 20.0, -50.0, -85.0] {
        let mut cell = Cell::start(StationMotor {
            start_deg,
            ..StationMotor::default()
        });
        let events = cell.home_for(1, 14_000);
        assert!(cell.is_homed(1), "{start_deg}: {events}");
        zeros.push(cell.measured(1) - cell.station.angle(1));
    }
    let (least, most) = zeros
        .iter()
        .fold((f64::MAX, f64::MIN), |(a, b), at| (a.min(*at), b.max(*at)));
    assert!(most - least < 3.0 / DEGREE, "{zeros:?}");
}

#[test]
fn servo_homing_names_each_fault() {
    let far = StationMotor {
        proximity_deg: -200.0,
        stops_deg: [-500.0, 500.0],
        ..StationMotor::default()
    };
    let usual = StationMotor::default();
    for (motor, faults, error) in [
        (far, NONE, HomingError::SensorNotFound),
        (
            usual,
            StationFaults {
                proximity: Some(false),
                ..NONE
            },
            HomingError::NotMoving,
        ),
        (
            usual,
            StationFaults {
                proximity: Some(true),
                ..NONE
            },
            HomingError::NotMoving,
        ),
        (
            usual,
            StationFaults {
                no_index: true,
                ..NONE
            },
            HomingError::IndexNotFound,
        ),
        (
            usual,
            StationFaults {
                brake_stuck: true,
                ..NONE
            },
            HomingError::NotMoving,
        ),
        (
            StationMotor {
                stops_deg: [-500.0, 500.0],
                ..usual
            },
            StationFaults {
                proximity: Some(true),
                ..NONE
            },
            HomingError::SwitchStuck,
        ),
    ] {
        let mut cell = Cell::start(motor);
        cell.station.inject(2, faults);
        let events = cell.home_for(2, 20_000);
        assert!(!cell.is_homed(2), "{error:?}");
        assert_eq!(cell.failure(2), usize::from(error.number()), "{events}");
        assert!(
            events.contains(&format!("homing failed: {error}")),
            "{events}"
        );
        // At rest, wherever it is.
        let at = cell.station.angle(2);
        cell.run(500);
        assert!((cell.station.angle(2) - at).abs() < 0.1, "{error:?}");
        // Others go on.
        assert!((cell.station.angle(0) - motor.start_deg).abs() < 0.1);
    }
}

#[test]
fn servo_reversed_motor_loses_power_within_limit() {
    let mut cell = Cell::start(StationMotor::default());
    cell.station.inject(
        0,
        StationFaults {
            reversed: true,
            ..NONE
        },
    );
    let events = cell.home_for(0, 3000);
    let error = HomingError::WrongDirection;
    assert_eq!(cell.failure(0), usize::from(error.number()), "{events}");
    assert!(cell.station.is_braked(0), "{events}");
    assert!(
        (cell.station.angle(0) - 20.0).abs() < 30.0,
        "{}",
        cell.station.angle(0)
    );
    assert_ne!(cell.status(), DeviceStatus::Operational);
    // The arm resets faults after a while, but not this one, which would run away again.
    cell.run(4000);
    assert!(cell.station.is_braked(0));
    // Once repaired, a new homing gives it power.
    cell.station.inject(0, NONE);
    cell.home(0, false);
    cell.run(10);
    cell.home_for(0, 8000);
    assert!(cell.is_homed(0), "{}", cell.events(0));
}

#[test]
fn servo_homing_withdrawn_brakes_and_begins_again() {
    let mut cell = Cell::start(StationMotor::default());
    cell.home_for(0, 500);
    cell.home(0, false);
    let at = cell.station.angle(0);
    cell.run(1000);
    let rest = cell.station.angle(0);
    // 80 degrees a second at 300 degrees a second squared: eleven degrees, and the lag.
    assert!((rest - at).abs() < 15.0 && rest < at, "{at} {rest}");
    cell.run(500);
    assert!((cell.station.angle(0) - rest).abs() < 0.05);
    assert!(!cell.is_homed(0) && cell.failure(0) == 0);
    cell.home_for(0, 12_000);
    assert!(cell.is_homed(0));
}

#[test]
fn servo_faults_close_brake_and_are_named() {
    for (faults, part) in [
        (
            StationFaults {
                open_circuit: true,
                ..NONE
            },
            "a wire of its encoder is broken",
        ),
        (
            StationFaults {
                not_ready: true,
                ..NONE
            },
            "amplifier is not ready",
        ),
    ] {
        let mut cell = Cell::start(StationMotor::default());
        cell.home_for(1, 12_000);
        cell.station.inject(1, faults);
        cell.run(20);
        let events = cell.events(1);
        assert!(
            events.contains(part) && events.contains("\nhint: "),
            "{events}"
        );
        assert!(cell.station.is_braked(1), "{events}");
        assert_eq!(cell.status(), DeviceStatus::SafeOperational);
        // Once per onset.
        cell.run(500);
        cell.station.inject(1, NONE);
        cell.home(1, false);
        cell.run(4000);
        assert_eq!(
            cell.status(),
            DeviceStatus::Operational,
            "{}",
            cell.events(1)
        );
        assert!(!cell.station.is_braked(1));
    }
}

#[test]
fn servo_offset_beyond_range_is_reported() {
    let mut cell = Cell::start(StationMotor {
        offset_v: 0.5,
        ..StationMotor::default()
    });
    cell.run(5000);
    let events = cell.events(0);
    assert_eq!(
        events.matches("larger offset voltage").count(),
        1,
        "{events}"
    );
    assert!(cell.status() == DeviceStatus::Operational);
}
