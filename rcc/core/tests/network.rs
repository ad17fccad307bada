//! An arm on a CANopen network, moved by nets: emulated drives on a CAN bus inside of this process.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use takt_can::bus::{Bus, Config};
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::cia402::emulator::FaultCode;
use takt_can::link::{Link, LinkError};
use takt_can::linux::{LivePort, monotonic};
use takt_core::cell::{CanopenConfig, DriveArm, DriveJoint};
use takt_core::device::DeviceStatus;
use takt_core::device::canopen::{Canopen, check, describe};
use takt_core::{CellConfig, Controller};
use takt_rt::thread::{Thread, ThreadConfig, spawn};

use common::Cell;

const JOINTS: u8 = 3;

fn config() -> CanopenConfig {
    let joint = |node| DriveJoint {
        drive: node,
        axis: 0,
        increments_per_turn: 4096.0 * 50.0,
        zero: 0.0,
        range: [-170.0, 170.0],
        velocity_max: 100.0,
        acceleration_max: 300.0,
    };
    CanopenConfig {
        name: "network".to_owned(),
        interface: "none".to_owned(),
        cycle: Duration::from_millis(4),
        priority: Some(85),
        cpus: Vec::new(),
        thread: None,
        arms: vec![DriveArm {
            name: "arm".to_owned(),
            model: String::new(),
            joints: (1..=JOINTS).map(joint).collect(),
        }],
    }
}

/// Drives in a thread of their own, and a controller that leads them.
struct Hall {
    cell: Option<Cell>,
    drives: Arc<Mutex<Vec<DriveNode>>>,
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

impl Hall {
    fn new() -> Self {
        let config = config();
        let ours = LivePort::first_of(Bus::new(Config::default()));
        let mut ports: Vec<_> = (1..=JOINTS).map(|_| ours.attach()).collect();
        let node = |raw| {
            let mut config = DriveNodeConfig::new(NodeId::new(raw).unwrap());
            // A host without PREEMPT_RT misses SYNC now and then.
            config.axes[0].quirks.missing_set_points = None;
            DriveNode::power_on(config, monotonic()).unwrap()
        };
        let drives = Arc::new(Mutex::new((1..=JOINTS).map(node).collect::<Vec<_>>()));
        let stop = Arc::new(AtomicBool::new(false));
        let (stopping, served) = (Arc::clone(&stop), Arc::clone(&drives));
        let of_thread = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new("drives")
        };
        let thread = spawn(of_thread, move || {
            while !stopping.load(Ordering::Relaxed) {
                // All but the first wait for nothing.
                let mut wait = Duration::from_micros(300);
                for (at, port) in ports.iter_mut().enumerate() {
                    while let Some(received) = port.receive(wait).unwrap() {
                        wait = Duration::ZERO;
                        if let Some(frame) = received.frame.classic() {
                            served.lock().unwrap()[at].handle_frame(frame, monotonic());
                        }
                    }
                    wait = Duration::ZERO;
                    let mut drives = served.lock().unwrap();
                    while let Some(frame) = drives[at].poll_transmit(monotonic()) {
                        match port.send(&frame.into()) {
                            Err(LinkError::QueueFull) => {}
                            sent => sent.unwrap(),
                        }
                    }
                }
            }
        });
        let controller = Controller::start(&CellConfig::default()).unwrap();
        let added = controller.add_driver("network", describe(&config), None, |ends| {
            Ok(Box::new(Canopen::start(&config, Box::new(ours), ends)?))
        });
        added.unwrap();
        let robots = Vec::new();
        let cell = Cell { controller, robots };
        cell.wait_for("arm", DeviceStatus::Operational);
        Self {
            cell: Some(cell),
            drives,
            stop,
            thread: Some(thread.unwrap()),
        }
    }

    fn cell(&self) -> &Cell {
        self.cell.as_ref().unwrap()
    }
}

impl Drop for Hall {
    fn drop(&mut self) {
        self.cell = None;
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

#[test]
fn a_net_moves_an_arm_over_canopen() {
    let hall = Hall::new();
    let moved = hall.cell().swung("arm", 1);
    assert!((moved - 0.5).abs() < 0.01, "moved {moved} rad");
    assert!(
        hall.cell().position("arm", 0).abs() < 1e-3,
        "nobody moved it"
    );
}

#[test]
fn a_drive_that_faults_ends_the_net_and_the_arm_comes_back_at_rest() {
    let hall = Hall::new();
    let net = hall.cell().swinging("arm", 0);
    let with = |change: &dyn Fn(&mut takt_can::cia402::emulator::Drive)| {
        let mut drives = hall.drives.lock().unwrap();
        change(drives[2].application_mut().axis_mut(0).unwrap());
    };
    with(&|drive| drive.fault(FaultCode::TEMPERATURE));
    hall.cell().wait_for_end(net);
    with(&|drive| drive.mend());
    hall.cell().wait_for("arm", DeviceStatus::Operational);
    let rest = hall.cell().position("arm", 0);
    std::thread::sleep(Duration::from_millis(300));
    assert!((hall.cell().position("arm", 0) - rest).abs() < 1e-3);
}

#[test]
fn what_a_network_cannot_be_is_told() {
    let mut twice = config();
    twice.arms[0].joints[1].drive = 1;
    let mut node = config();
    node.arms[0].joints[0].drive = 200;
    let mut range = config();
    range.arms[0].joints[2].range = [10.0, -10.0];
    for (config, wanted) in [
        (twice, "drives two joints"),
        (node, "200"),
        (
            range,
            "joint 2: increments_per_turn must not be 0, range must go up",
        ),
    ] {
        let told = check(&config).unwrap_err();
        assert!(told.contains(wanted), "{told}");
    }
}
