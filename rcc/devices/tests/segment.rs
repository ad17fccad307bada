//! Devices on an EtherCAT segment, moved by nets: an emulated Stäubli TX90 and terminals on a cable inside
//! this process.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

#[path = "common/bench.rs"]
mod bench;
mod common;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use takt_core::Controller;
use takt_core::device::DeviceStatus;
use takt_device_drives::{DriveArm, DriveJoint, Recovery};
use takt_devices::ethercat::{EthercatConfig, EthercatIo, EthercatSlave};
use takt_ethercat::emulator::{Coupler, Io, Segment, ServoConfig, ServoDrive};
use takt_rt::thread::{ThreadConfig, spawn};
use takt_tests::pass;

use bench::Log;
use common::Cell;

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
        rated_torque: None,
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
            feed_forward: 0.0,
            down: Default::default(),
            payload: Default::default(),
            tools: Default::default(),
            model: "staubli_tx90".into(),
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

/// A test bench with a coupler, a terminal and the drives of the arm.
struct TestBench {
    bench: bench::TestBench,
    drives: ServoDrive,
    io: Io,
}

impl TestBench {
    fn new() -> Self {
        let bench = Self::start(&config());
        bench.cell().wait_for("tx90", DeviceStatus::Operational);
        bench
    }

    /// Without waiting for its devices.
    fn start(config: &EthercatConfig) -> Self {
        let (terminal, io) = Io::digital(8, 8);
        let mut tx90 = ServoConfig::tx90();
        // A host without PREEMPT_RT misses SYNC0 now and then.
        for axis in &mut tx90.axes {
            axis.quirks.missing_set_points = None;
        }
        let (slave, drives) = ServoDrive::slave(tx90).unwrap();
        let segment = Segment::line([Coupler::slave(), terminal, slave]);
        let bench = bench::TestBench::start(config, segment);
        Self { bench, drives, io }
    }

    fn cell(&self) -> &Cell {
        self.bench.cell()
    }
}

#[test]
fn segment_differences_are_reported_per_slave() {
    let log = Log::start();
    let mut config = config();
    config.slaves[1].product = Some(0xBAD);
    config.slaves.remove(0);
    let bench = TestBench::start(&config);
    for text in [
        "\"terminal\" should have product 00000BADh",
        "is not in the configuration",
    ] {
        bench.cell().wait(text, |_| log.text().contains(text));
    }
    assert_eq!(bench.cell().status("tx90"), DeviceStatus::Offline);
}

/// A segment of terminals without drives, operational on a cable that delays every answer.
fn late(latency: Duration) -> bench::TestBench {
    let (terminal, _) = Io::digital(8, 8);
    let segment = Segment::line([Coupler::slave(), terminal]);
    let mut config = config();
    config.slaves.truncate(2);
    config.arms.clear();
    let bench = bench::TestBench::start_late(&config, segment, latency);
    bench.wait_until_operational();
    bench
}

#[test]
fn segment_start_up_burst_reads_last_answer() {
    // An answer takes longer than a cycle of start-up leaves after the previous answer.
    let bench = late(Duration::from_micros(800));
    let figures = bench.figures();
    assert!(figures.lost < 10, "{figures:?}");
}

#[test]
fn segment_answers_late_in_cycle_are_not_lost() {
    // In a cycle of 2 ms the driver waits 1 ms for them; they are there when the next one begins.
    let bench = late(Duration::from_micros(1500));
    let before = bench.figures();
    bench
        .cell()
        .wait("cycles", |_| bench.figures().cycles > before.cycles + 200);
    let after = bench.figures();
    assert!(after.operational, "{after:?}");
    assert!(after.lost < before.lost + 10, "{before:?} {after:?}");
}

#[test]
fn ethercat_net_moves_tx90() {
    let bench = TestBench::new();
    let moved = bench.cell().swung("tx90", 3);
    assert!((moved - 0.5).abs() < 0.01, "moved {moved} rad");
    let figures = bench.bench.figures();
    assert!(figures.operational && figures.cycles > 100, "{figures:?}");
}

#[test]
fn ethercat_net_reads_inputs_sets_outputs() {
    let bench = TestBench::new();
    bench.cell().wait_for("io", DeviceStatus::Operational);
    let net = bench.cell().load(
        "{ in=IO::InBool(DeviceID='io',Port='2'),
       out=IO::OutBool(inIO=in.outIO,DeviceID='io',Port='5'),
       cancel=Cancel(),outTerminate=cancel.outCancel }",
    );
    bench.cell().controller.start_net(net).unwrap();
    let output = || bench.io.outputs().first().map(|byte| byte >> 5 & 1 == 1);
    for value in [true, false, true] {
        bench.io.set_inputs(&[if value { 0b100 } else { 0 }]);
        bench.cell().wait("the output as the input", |_| {
            output() == Some(value) || bench.cell().is_over(net)
        });
        assert!(!bench.cell().is_over(net), "the net was ended");
    }
}

#[test]
fn drive_fault_ends_net_arm_recovers_at_rest() {
    let bench = TestBench::new();
    let net = bench.cell().swinging("tx90", 3);
    let too_hot = takt_can::cia402::emulator::FaultCode::TEMPERATURE;
    bench.drives.axis(1, |drive| drive.fault(too_hot));
    bench.cell().wait_for_end(net);
    assert_ne!(bench.cell().status("tx90"), DeviceStatus::Operational);
    bench
        .drives
        .axis(1, takt_can::cia402::emulator::Drive::clear_cause);
    bench.cell().wait_for("tx90", DeviceStatus::Operational);
    let rest = bench.cell().position("tx90", 3);
    pass(Duration::from_millis(300));
    assert!((bench.cell().position("tx90", 3) - rest).abs() < 1e-3);
}

#[test]
fn ethercat_cut_cable_offline_repaired_cable_recovers() {
    let bench = TestBench::new();
    bench.bench.segment().set_link(2, false);
    bench.cell().wait_for("tx90", DeviceStatus::Offline);
    bench.bench.segment().set_link(2, true);
    bench.cell().wait_for("tx90", DeviceStatus::Operational);
}

#[test]
fn ethercat_joint_holds_under_load_when_other_faults() {
    let bench = TestBench::new();
    let motor = |number| {
        bench
            .drives
            .axis(number, |drive| drive.motor().position)
            .unwrap()
    };
    let before = motor(0);
    let too_hot = takt_can::cia402::emulator::FaultCode::TEMPERATURE;
    bench.drives.axis(2, |drive| drive.fault(too_hot));
    bench.cell().wait("the fault", |_| {
        bench.cell().status("tx90") != DeviceStatus::Operational
    });
    bench
        .drives
        .axis(0, |drive| drive.motor_mut().external = -1.0);
    pass(Duration::from_secs(1));
    let sagged = (motor(0) - before) / 50.0;
    assert!(sagged.abs() < 1e-4, "joint 0 sagged by {sagged} rad");
}

/// A drive at an instant: its state, and the speed of its motor, rad/s.
type Seen = (takt_can::cia402::State, f64);

fn look(drives: &ServoDrive, axis: usize) -> Seen {
    let seen = drives.axis(axis, |drive| (drive.state(), drive.motor().velocity));
    seen.unwrap()
}

#[test]
fn ethercat_shutdown_in_motion_powers_off_at_standstill() {
    use takt_can::cia402::State;
    let mut bench = TestBench::new();
    // Faster than 0.2 rad/s at the joint; repeats if the host stalled meanwhile.
    let turns = |bench: &TestBench| look(&bench.drives, 3).1 > 10.0;
    while !turns(&bench) {
        bench.cell().wait_for("tx90", DeviceStatus::Operational);
        let net = bench.cell().load(&common::swing_joint("tx90", 3, 2.0));
        if bench.cell().controller.start_net(net).is_ok() {
            let moves = |_: &Controller| turns(&bench) || bench.cell().is_over(net);
            bench.cell().wait("the motor turning", moves);
        }
    }
    let seen = Arc::new(Mutex::new(vec![look(&bench.drives, 3)]));
    let ended = Arc::new(AtomicBool::new(false));
    let (drives, until, to) = (bench.drives.clone(), Arc::clone(&ended), Arc::clone(&seen));
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
    bench.bench.end_controller();
    ended.store(true, Ordering::Relaxed);
    watch.unwrap().join().unwrap();
    let seen = seen.lock().unwrap();
    assert!(seen[0].1 > 5.0, "it turned: {:?}", seen[0]);
    let enabled = seen.iter().take_while(|s| s.0 == State::OperationEnabled);
    let (_, last) = enabled.last().unwrap();
    assert!(last.abs() < 0.5, "{last} rad/s when power went off");
    assert_eq!(seen[seen.len() - 1].0, State::SwitchOnDisabled);
}
