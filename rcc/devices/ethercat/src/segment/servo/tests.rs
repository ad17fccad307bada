//! Servo axes on the emulated station, in virtual time: motion, homing, and every fault of motor, encoder, switch and amplifier.

use takt_core::device::homing::{POWERED, TOUCHED};
use takt_core::device::{DeviceState, DeviceStatus};
use takt_ethercat::emulator::{Station, StationFaults, StationMotor};
use takt_net::device::Homing as Interface;
use takt_net::device::JointError;

use super::*;
use crate::segment::wire_tests::{Bench, config};
use takt_core::device::parts;
use takt_net::device::{Layout, Signal};

/// A degree of a joint, increments.
const DEGREE: f64 = 2000.0 * 100.0 / 360.0;
fn faults(names: &[&str]) -> StationFaults {
    let mut faults = StationFaults::default();
    assert!(names.iter().all(|name| faults.add(name)), "{names:?}");
    faults
}

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
    signals: Interface,
    powered: Signal<bool>,
}

impl Cell {
    fn start(motor: StationMotor) -> Self {
        Self::with(motor, &cell(), 0)
    }

    /// Axes that have power while nets request it.
    fn on_request() -> Self {
        let text = cell().replace("brake_time", "power = 'on_request'\nbrake_time");
        let mut cell = Self::with(StationMotor::default(), &text, 1);
        cell.bench.device = 0;
        cell.run(500);
        cell
    }

    /// With that device operational.
    fn with(motor: StationMotor, text: &str, device: usize) -> Self {
        let config = config(text);
        let (segment, station) = Station::segment([motor; 3]);
        let has = parts::lay(&AXIS_PARTS, 0, &mut Layout::default());
        Self {
            bench: Bench::new(&config, segment, device),
            station,
            signals: has.homing.unwrap(),
            powered: has.io.unwrap().bool_in[POWERED],
        }
    }

    fn run(&mut self, cycles: usize) {
        (0..cycles).for_each(|_| self.bench.cycle());
    }

    /// Requests homing, and whether the axis may leave its switch, or withdraws it.
    fn request(&mut self, axis: usize, leave: Option<bool>) {
        let words = &mut self.bench.devices[1 + axis].given.words;
        let every = if leave.is_some() { u64::MAX } else { 0 };
        let leave = u64::from(leave == Some(true));
        words[..4].copy_from_slice(&[1, 1, every, leave]);
    }

    fn home(&mut self, axis: usize, is_on: bool) {
        self.request(axis, is_on.then_some(true));
    }

    fn power(&mut self, is_on: bool) {
        for axis in 0..3 {
            let every = if is_on { u64::MAX } else { 0 };
            self.bench.devices[1 + axis].given.words[4..8].copy_from_slice(&[1, 1, every, 1]);
        }
    }

    fn has_power(&mut self, axis: usize) -> bool {
        self.shows(axis, self.powered)
    }

    /// Runs until the brake of an axis is closed. Gives the largest speed at which it was, degrees per second.
    fn brake(&mut self, axis: usize) -> f64 {
        for _ in 0..3000 {
            let before = self.station.angle(axis);
            self.run(1);
            if self.station.is_braked(axis) {
                return (self.station.angle(axis) - before).abs() * 1000.0;
            }
        }
        panic!("its brake is open at {} degrees", self.station.angle(axis));
    }

    fn state<T>(&mut self, device: usize, read: impl Fn(&DeviceState) -> T) -> T {
        self.bench.devices[device].state.read_with(read)
    }

    fn shows(&mut self, axis: usize, signal: Signal<bool>) -> bool {
        self.state(1 + axis, |state| signal.read(&state.signals)) == Some(true)
    }

    fn is_homed(&mut self, axis: usize) -> bool {
        self.shows(axis, self.signals.homed)
    }

    fn failure(&mut self, axis: usize) -> i32 {
        let signal = self.signals.failure;
        self.state(1 + axis, |state| signal.read(&state.signals))
            .unwrap()
    }

    fn step(&mut self, axis: usize) -> i32 {
        let signal = self.signals.step;
        self.state(1 + axis, |state| signal.read(&state.signals))
            .unwrap()
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
        let servo = &mut self.bench.units.servos[axis];
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

mod nets;

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
    let wide = StationMotor {
        stops_deg: [-500.0, 500.0],
        ..usual
    };
    for (motor, names, error) in [
        (far, &[][..], HomingError::SensorNotFound),
        (wide, &["switch-off"], HomingError::SensorNotFound),
        // Against an end stop.
        (usual, &["switch-off"], HomingError::NotMoving),
        (usual, &["switch-on"], HomingError::NotMoving),
        (wide, &["switch-on"], HomingError::SwitchStuck),
        (usual, &["no-index"], HomingError::IndexNotFound),
        (usual, &["brake-stuck"], HomingError::NotMoving),
        (usual, &["motor-open"], HomingError::NotMoving),
        (usual, &["reversed"], HomingError::WrongDirection),
        (usual, &["open-circuit"], HomingError::PowerLost),
        (usual, &["not-ready"], HomingError::PowerLost),
        (usual, &["power-lost"], HomingError::PowerLost),
    ] {
        let mut cell = Cell::start(motor);
        cell.station.inject(2, faults(names));
        let events = cell.home_for(2, 20_000);
        assert!(!cell.is_homed(2), "{error:?}");
        assert_eq!(cell.failure(2), i32::from(error.number()), "{events}");
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
    cell.station.inject(0, faults(&["reversed"]));
    let events = cell.home_for(0, 3000);
    let error = HomingError::WrongDirection;
    assert_eq!(cell.failure(0), i32::from(error.number()), "{events}");
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
    cell.station.inject(0, StationFaults::default());
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
    for (name, part) in [
        ("open-circuit", "a wire of its encoder is broken"),
        ("not-ready", "amplifier is not ready"),
        ("power-lost", "amplifier is not ready"),
    ] {
        let mut cell = Cell::start(StationMotor::default());
        cell.home_for(1, 12_000);
        cell.station.inject(1, faults(&[name]));
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
        cell.station.inject(1, StationFaults::default());
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
    let mut cell = Cell::start(StationMotor::default());
    cell.station.inject(0, faults(&["offset"]));
    cell.run(5000);
    let events = cell.events(0);
    assert_eq!(
        events.matches("larger offset voltage").count(),
        1,
        "{events}"
    );
    assert!(cell.status() == DeviceStatus::Operational);
}

#[test]
fn servo_homing_power_lost_brakes_and_is_named() {
    for name in ["open-circuit", "not-ready", "power-lost"] {
        let mut cell = Cell::start(StationMotor::default());
        cell.home(0, true);
        cell.run(700);
        let moving = cell.station.angle(0);
        assert!(
            moving < 19.0 && cell.shows(0, cell.signals.homing),
            "{moving}"
        );
        cell.station.inject(0, faults(&[name]));
        cell.run(20);
        let events = cell.events(0);
        assert!(
            events.contains(&format!("homing failed: {}", HomingError::PowerLost)),
            "{events}"
        );
        assert!(cell.station.is_braked(0), "{name}");
        // Once the power is back, it does not move by itself.
        cell.station.inject(0, StationFaults::default());
        let at = cell.station.angle(0);
        cell.run(5000);
        assert!((cell.station.angle(0) - at).abs() < 0.2, "{name}");
        assert!(!cell.is_homed(0) && !cell.shows(0, cell.signals.homing));
        // A new request homes it.
        cell.home(0, false);
        cell.run(10);
        cell.home_for(0, 12_000);
        assert!(cell.is_homed(0), "{name}: {}", cell.events(0));
    }
}

#[test]
fn servo_homing_waits_on_switch_for_others() {
    let mut cell = Cell::start(StationMotor::default());
    cell.request(0, Some(false));
    cell.run(5000);
    assert_eq!(cell.step(0), TOUCHED);
    let at = cell.station.angle(0);
    cell.run(2000);
    assert!(
        (cell.station.angle(0) - at).abs() < 0.05 && at < -80.0,
        "{at}"
    );
    let events = cell.home_for(0, 12_000);
    assert!(cell.is_homed(0), "{events}");
}

#[test]
fn servo_segment_lost_in_homing_does_not_resume() {
    let mut cell = Cell::start(StationMotor::default());
    cell.home(0, true);
    cell.run(700);
    cell.bench.power_cycle();
    let at = cell.station.angle(0);
    cell.run(8000);
    assert!(
        (cell.station.angle(0) - at).abs() < 0.2,
        "{}",
        cell.events(0)
    );
    let failure = i32::from(HomingError::PowerLost.number());
    assert_eq!(cell.failure(0), failure, "{}", cell.events(0));
    assert!(!cell.is_homed(0));
    assert_eq!(cell.status(), DeviceStatus::Operational);
}

#[test]
fn servo_homing_goes_on_through_as_many_lost_frames_as_configured() {
    let text = format!("lost_frames = 20\n{}", cell());
    let home = |frames| {
        let mut cell = Cell::with(StationMotor::default(), &text, 0);
        cell.home(0, true);
        cell.run(700);
        cell.bench.lose(frames);
        let events = cell.home_for(0, 12_000);
        (cell.is_homed(0), cell.failure(0), events)
    };
    let (is_homed, failure, events) = home(19);
    assert!(is_homed && failure == 0, "{events}");
    // The slaves count as absent.
    let (is_homed, failure, events) = home(25);
    let lost = i32::from(HomingError::PowerLost.number());
    assert!(!is_homed && failure == lost, "{failure}: {events}");
}

#[test]
fn servo_power_on_request_follows_its_net() {
    let mut cell = Cell::on_request();
    for _ in 0..2 {
        assert_eq!(cell.status(), DeviceStatus::SafeOperational);
        assert_eq!(cell.error(0), JointError::NotEnabled as i32);
        assert!((0..3).all(|axis| cell.station.is_braked(axis) && !cell.has_power(axis)));
        cell.power(true);
        cell.run(500);
        assert_eq!(cell.status(), DeviceStatus::Operational);
        assert!((0..3).all(|axis| !cell.station.is_braked(axis) && cell.has_power(axis)));
        cell.power(false);
        cell.run(500);
    }
    // One that is not requested keeps the others at rest.
    cell.power(true);
    cell.bench.devices[2].given.words[6] = 0;
    cell.run(500);
    assert_eq!(cell.status(), DeviceStatus::SafeOperational);
    assert!(cell.station.is_braked(1) && !cell.station.is_braked(0));
}

#[test]
fn servo_power_withdrawn_in_motion_brakes_first() {
    let mut cell = Cell::on_request();
    cell.power(true);
    cell.run(500);
    let events = cell.home_for(0, 12_000);
    assert!(cell.is_homed(0), "{events}");
    let start = cell.bench.position(0);
    let mut at = start;
    for n in 0..800 {
        at += f64::from(n.min(300)) / 300.0 * 1e-3;
        cell.bench.want(0, at, 1);
        cell.run(1);
    }
    let before = cell.station.angle(0);
    cell.power(false);
    // Its net may not know yet, and commands on.
    for _ in 0..5 {
        at += 1e-3;
        cell.bench.want(0, at, 1);
        cell.run(1);
    }
    assert!(!cell.station.is_braked(0), "in motion");
    cell.bench.devices[0].given.joints[0].advance(None);
    let speed = cell.brake(0);
    assert!(speed < 1.0, "{speed}");
    // 57 degrees a second at 300 degrees a second squared.
    let way = cell.station.angle(0) - before;
    assert!((4.0..9.0).contains(&way), "{way}");
    assert!(cell.is_homed(0));
    // With power again it stays where it is.
    cell.power(true);
    let rest = cell.station.angle(0);
    cell.run(1000);
    assert_eq!(cell.status(), DeviceStatus::Operational);
    assert!((cell.station.angle(0) - rest).abs() < 0.1);
}

#[test]
fn servo_power_withdrawn_in_homing_brakes_first() {
    let mut cell = Cell::on_request();
    cell.power(true);
    cell.run(500);
    cell.home_for(0, 600);
    cell.power(false);
    let speed = cell.brake(0);
    assert!(speed < 1.0, "{speed}");
    assert!(!cell.is_homed(0));
    assert_eq!(cell.failure(0), i32::from(HomingError::PowerLost.number()));
    // It does not begin again by itself.
    cell.power(true);
    let rest = cell.station.angle(0);
    cell.run(1000);
    assert!((cell.station.angle(0) - rest).abs() < 0.1);
}
