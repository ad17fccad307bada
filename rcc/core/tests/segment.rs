//! Devices on an EtherCAT segment, moved by nets: an emulated Stäubli TX90 and terminals at the end of a cable
//! inside of this process.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;
#[path = "common/hall.rs"]
mod hall;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use takt_core::Controller;
use takt_core::cell::{DriveArm, DriveJoint, EthercatConfig, EthercatIo, EthercatSlave, Recovery};
use takt_core::device::DeviceStatus;
use takt_ethercat::emulator::{Coupler, Io, Segment, ServoConfig, ServoDrive};
use takt_rt::thread::{ThreadConfig, spawn};
use takt_tests::steady;

use common::Cell;
use hall::Log;

/// One turn of a joint, increments.
const TURN: f64 = 4096.0 * 50.0;

fn config() -> EthercatConfig {
    let slave = |name: &str, position, axes| EthercatSlave {
        name: name.to_owned(),
        position: Some(position),
        axes,
        sync0: axes > 0,
        ..EthercatSlave::default()
    };
    let ranges = [
        [-180.0, 180.0],
        [-130.0, 147.5],
        [-145.0, 145.0],
        [-270.0, 270.0],
    ];
    let ranges = ranges.into_iter().chain([[-115.0, 140.0], [-270.0, 270.0]]);
    let joint = |(axis, range)| DriveJoint {
        drive: "drives".to_owned(),
        axis,
        increments_per_turn: TURN,
        zero: 0.0,
        range,
        velocity_max: 300.0,
        acceleration_max: 1000.0,
        following_error_max: None,
        not_mirrored: Vec::new(),
        quirks: Vec::new(),
    };
    EthercatConfig {
        name: "segment".to_owned(),
        interface: "none".to_owned(),
        cycle: Duration::from_millis(2),
        slaves: vec![
            slave("coupler", 0, 0),
            slave("terminal", 1, 0),
            slave("drives", 2, 6),
        ],
        arms: vec![DriveArm {
            name: "tx90".to_owned(),
            recovery: Recovery::default(),
            model: "staubli_tx90".to_owned(),
            joints: (0..).zip(ranges).map(joint).collect(),
        }],
        ios: vec![EthercatIo {
            name: "io".to_owned(),
            digital_in: vec![("terminal".to_owned(), 8)],
            digital_out: vec![("terminal".to_owned(), 8)],
            ..EthercatIo::default()
        }],
        ..EthercatConfig::default()
    }
}

/// A hall with a coupler, a terminal and the drives of the arm.
struct Hall {
    hall: hall::Hall,
    drives: ServoDrive,
    io: Io,
}

impl Hall {
    fn new() -> Self {
        let hall = Self::start(&config());
        hall.cell().wait_for("tx90", DeviceStatus::Operational);
        hall
    }

    /// Whose devices are not waited for.
    fn start(config: &EthercatConfig) -> Self {
        let (terminal, io) = Io::digital(8, 8);
        let mut tx90 = ServoConfig::tx90();
        // A host without PREEMPT_RT misses SYNC0 now and then.
        for axis in &mut tx90.axes {
            axis.quirks.missing_set_points = None;
        }
        let (slave, drives) = ServoDrive::slave(tx90).unwrap();
        let segment = Segment::line([Coupler::slave(), terminal, slave]);
        let hall = hall::Hall::start(config, segment);
        Self { hall, drives, io }
    }

    fn cell(&self) -> &Cell {
        self.hall.cell()
    }
}

#[test]
fn what_differs_from_the_configuration_is_told_slave_by_slave() {
    let log = Log::start();
    let mut config = config();
    config.slaves[1].product = Some(0xBAD);
    config.slaves.remove(0);
    let hall = Hall::start(&config);
    for told in [
        "\"terminal\" should have product 00000BADh",
        "is not in the configuration",
    ] {
        hall.cell().wait(told, |_| log.text().contains(told));
    }
    assert_eq!(hall.cell().status("tx90"), DeviceStatus::Offline);
}

#[test]
fn start_up_burst_reads_its_last_answer() {
    steady(|| {
        // An answer takes longer than what a cycle of start-up leaves after the one before.
        let (terminal, _) = Io::digital(8, 8);
        let segment = Segment::line([Coupler::slave(), terminal]);
        let mut config = config();
        config.slaves.truncate(2);
        config.arms.clear();
        let hall = hall::Hall::start_late(&config, segment, Duration::from_micros(800));
        hall.wait_until_operational();
        let figures = hall.figures();
        assert!(figures.lost < 10, "{figures:?}");
    });
}

#[test]
fn a_net_moves_a_tx90_over_ethercat() {
    steady(|| {
        let hall = Hall::new();
        let moved = hall.cell().swung("tx90", 3);
        assert!((moved - 0.5).abs() < 0.01, "moved {moved} rad");
        let figures = hall.hall.figures();
        assert!(figures.operational && figures.cycles > 100, "{figures:?}");
    });
}

#[test]
fn a_net_reads_inputs_and_sets_outputs() {
    steady(|| {
        let hall = Hall::new();
        hall.cell().wait_for("io", DeviceStatus::Operational);
        let net = hall.cell().load(
            "{ in=IO::InBool(DeviceID='io',Port='2'),
           out=IO::OutBool(inIO=in.outIO,DeviceID='io',Port='5'),
           cancel=Cancel(),outTerminate=cancel.outCancel }",
        );
        hall.cell().controller.start_net(net).unwrap();
        let output = || hall.io.outputs().first().map(|byte| byte >> 5 & 1 == 1);
        for value in [true, false, true] {
            hall.io.set_inputs(&[if value { 0b100 } else { 0 }]);
            hall.cell().wait("the output as the input", |_| {
                output() == Some(value) || hall.cell().is_over(net)
            });
            assert!(!hall.cell().is_over(net), "the net was ended");
        }
    });
}

#[test]
fn a_drive_that_faults_ends_the_net_and_the_arm_comes_back_at_rest() {
    steady(|| {
        let hall = Hall::new();
        let net = hall.cell().swinging("tx90", 3);
        let too_hot = takt_can::cia402::emulator::FaultCode::TEMPERATURE;
        hall.drives.axis(1, |drive| drive.fault(too_hot));
        hall.cell().wait_for_end(net);
        assert_ne!(hall.cell().status("tx90"), DeviceStatus::Operational);
        hall.drives
            .axis(1, takt_can::cia402::emulator::Drive::clear_cause);
        hall.cell().wait_for("tx90", DeviceStatus::Operational);
        let rest = hall.cell().position("tx90", 3);
        std::thread::sleep(Duration::from_millis(300));
        assert!((hall.cell().position("tx90", 3) - rest).abs() < 1e-3);
    });
}

#[test]
fn a_cut_cable_takes_the_arm_offline_and_a_mended_one_brings_it_back() {
    steady(|| {
        let hall = Hall::new();
        hall.hall.segment().set_link(2, false);
        hall.cell().wait_for("tx90", DeviceStatus::Offline);
        hall.hall.segment().set_link(2, true);
        hall.cell().wait_for("tx90", DeviceStatus::Operational);
    });
}

#[test]
fn a_joint_takes_no_other_place_under_a_load_when_the_drive_of_another_faults() {
    steady(|| {
        let hall = Hall::new();
        let motor = |number| {
            hall.drives
                .axis(number, |drive| drive.motor().position)
                .unwrap()
        };
        let before = motor(0);
        let too_hot = takt_can::cia402::emulator::FaultCode::TEMPERATURE;
        hall.drives.axis(2, |drive| drive.fault(too_hot));
        hall.cell().wait("the fault", |_| {
            hall.cell().status("tx90") != DeviceStatus::Operational
        });
        hall.drives
            .axis(0, |drive| drive.motor_mut().external = -1.0);
        std::thread::sleep(Duration::from_secs(1));
        let sagged = (motor(0) - before) / 50.0;
        assert!(sagged.abs() < 1e-4, "joint 0 sagged by {sagged} rad");
    });
}

/// A drive at an instant: its state, and the speed of its motor, rad/s.
type Seen = (takt_can::cia402::State, f64);

fn look(drives: &ServoDrive, axis: usize) -> Seen {
    let seen = drives.axis(axis, |drive| (drive.state(), drive.motor().velocity));
    seen.unwrap()
}

#[test]
fn a_controller_that_ends_in_mid_swing_takes_no_power_from_a_motor_that_turns() {
    steady(|| {
        use takt_can::cia402::State;
        let mut hall = Hall::new();
        // Faster than 0.2 rad/s at the joint; again if the host stalled meanwhile.
        let turns = |hall: &Hall| look(&hall.drives, 3).1 > 10.0;
        while !turns(&hall) {
            hall.cell().wait_for("tx90", DeviceStatus::Operational);
            let net = hall.cell().load(&common::swing_joint("tx90", 3, 2.0));
            if hall.cell().controller.start_net(net).is_ok() {
                let moves = |_: &Controller| turns(&hall) || hall.cell().is_over(net);
                hall.cell().wait("the motor turning", moves);
            }
        }
        let seen = Arc::new(Mutex::new(vec![look(&hall.drives, 3)]));
        let ended = Arc::new(AtomicBool::new(false));
        let (drives, until, to) = (hall.drives.clone(), Arc::clone(&ended), Arc::clone(&seen));
        let config = ThreadConfig {
            priority: Some(87),
            ..ThreadConfig::new("watch")
        };
        let watch = spawn(config, move || {
            while !until.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_micros(500));
                to.lock().unwrap().push(look(&drives, 3));
            }
        });
        hall.hall.end_controller();
        ended.store(true, Ordering::Relaxed);
        watch.unwrap().join().unwrap();
        let seen = seen.lock().unwrap();
        assert!(seen[0].1 > 5.0, "it turned: {:?}", seen[0]);
        let enabled = seen.iter().take_while(|s| s.0 == State::OperationEnabled);
        let (_, last) = enabled.last().unwrap();
        assert!(last.abs() < 0.5, "{last} rad/s when power went off");
        assert_eq!(seen[seen.len() - 1].0, State::SwitchOnDisabled);
    });
}
