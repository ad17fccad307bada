//! An arm on a CANopen network, moved by nets: emulated drives on a CAN bus inside of this process.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use takt_can::AnyFrame;
use takt_can::bus::{Bus, Config};
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::cia402::State;
use takt_can::cia402::dictionary::Address;
use takt_can::cia402::emulator::{Drive, FaultCode};
use takt_can::link::{Link, LinkError, Received};
use takt_can::linux::{LivePort, monotonic};
use takt_core::cell::{CanopenConfig, DriveArm, DriveJoint, LinkLoss};
use takt_core::device::canopen::{Canopen, check, describe};
use takt_core::device::driver::{DeviceDriver as _, DeviceEnd, DriverEnds};
use takt_core::device::{DeviceCommand, DeviceState, DeviceStatus};
use takt_core::{CellConfig, Controller};
use takt_rt::latest::latest;
use takt_rt::servo::Estimate;
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
        master: 127,
        heartbeat: None,
        on_link_loss: LinkLoss::default(),
        arms: vec![DriveArm {
            name: "arm".to_owned(),
            model: String::new(),
            joints: (1..=JOINTS).map(joint).collect(),
        }],
    }
}

/// A link whose owner can be held in the middle of receiving, as when its thread hangs.
#[derive(Debug)]
struct Gate {
    port: LivePort,
    held: Arc<AtomicBool>,
}

impl Link for Gate {
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError> {
        self.port.send(frame)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, LinkError> {
        while self.held.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.port.receive(timeout)
    }
}

/// Drives in a thread of their own, and a controller that leads them.
struct Hall {
    cell: Option<Cell>,
    drives: Arc<Mutex<Vec<DriveNode>>>,
    /// The identifier of frames that drives send and nobody gets.
    muted: Arc<AtomicU32>,
    /// Whether the thread of the master hangs.
    held: Arc<AtomicBool>,
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
        let muted = Arc::new(AtomicU32::new(u32::MAX));
        let held = Arc::new(AtomicBool::new(false));
        let (stopping, served) = (Arc::clone(&stop), Arc::clone(&drives));
        let of_drives = Arc::clone(&muted);
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
                        if frame.id().raw() == of_drives.load(Ordering::Relaxed) {
                            continue;
                        }
                        match port.send(&frame.into()) {
                            Err(LinkError::QueueFull) => {}
                            sent => sent.unwrap(),
                        }
                    }
                }
            }
        });
        let controller = Controller::start(&CellConfig::default()).unwrap();
        let ours = Gate {
            port: ours,
            held: Arc::clone(&held),
        };
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
            muted,
            held,
            stop,
            thread: Some(thread.unwrap()),
        }
    }

    /// What is so of all drives.
    fn all(&self, holds: impl Fn(&Drive) -> bool) -> bool {
        let drives = self.drives.lock().unwrap();
        drives
            .iter()
            .all(|drive| holds(drive.application().axis(0).unwrap()))
    }

    fn cell(&self) -> &Cell {
        self.cell.as_ref().unwrap()
    }
}

impl Drop for Hall {
    fn drop(&mut self) {
        self.held.store(false, Ordering::Relaxed);
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
    for drive in hall.drives.lock().unwrap().iter() {
        let bytes = |index, sub| drive.dictionary().bytes(Address::new(index, sub)).unwrap();
        assert_eq!(bytes(0x60C2, 1), [4], "SYNC every 4");
        assert_eq!(bytes(0x60C2, 2), (-3_i8).to_le_bytes(), "ms");
        assert_eq!(bytes(0x6007, 0), 3_i16.to_le_bytes(), "quick stop");
        // Five cycles between its heartbeats, and two and a half of those to be patient.
        let watched = 50_u32 | 127 << 16;
        assert_eq!(bytes(0x1016, 1), watched.to_le_bytes(), "the master");
    }
}

#[test]
fn a_drive_that_faults_ends_the_net_and_the_arm_comes_back_at_rest() {
    let hall = Hall::new();
    let net = hall.cell().swinging("arm", 0);
    let with = |change: &dyn Fn(&mut Drive)| {
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

/// A cable that shakes: the node itself is well and goes on running.
#[test]
fn an_arm_whose_process_data_were_gone_for_a_while_comes_back() {
    let hall = Hall::new();
    for _ in 0..2 {
        hall.muted.store(0x182, Ordering::Relaxed);
        hall.cell().wait_for("arm", DeviceStatus::Offline);
        hall.muted.store(u32::MAX, Ordering::Relaxed);
        hall.cell().wait_for("arm", DeviceStatus::Operational);
    }
}

/// These drives do not mind missing set-points: only the heartbeat tells them.
#[test]
fn drives_stop_when_the_thread_of_their_master_hangs_and_follow_it_again() {
    let hall = Hall::new();
    let net = hall.cell().swinging("arm", 0);
    hall.held.store(true, Ordering::Relaxed);
    hall.cell().wait("drives that stop by themselves", |_| {
        hall.all(|drive| {
            drive.state() != State::OperationEnabled && drive.motor().velocity.abs() < 0.01
        })
    });
    hall.held.store(false, Ordering::Relaxed);
    hall.cell().wait_for_end(net);
    hall.cell().wait_for("arm", DeviceStatus::Operational);
}

/// A controller is not needed for that; what a driver tells is what its log then says.
#[test]
fn a_network_tells_why_its_arm_is_not_operational() {
    let mut config = config();
    config.arms[0].joints.truncate(2);
    let ours = LivePort::first_of(Bus::new(Config::default()));
    let mut port = ours.attach();
    let (state, _told) = latest(1, DeviceState::default);
    let (_commands, command) = latest(1, DeviceCommand::default);
    let end = DeviceEnd {
        state,
        command,
        net_period: Duration::from_millis(4),
    };
    let ends = DriverEnds {
        devices: vec![end],
        clock: latest(1, Estimate::default).0,
    };
    let network = Canopen::start(&config, Box::new(ours), ends).unwrap();
    let mut of_drive = DriveNodeConfig::new(NodeId::new(1).unwrap());
    of_drive.axes[0].quirks.missing_set_points = None;
    let mut drive = DriveNode::power_on(of_drive, monotonic()).unwrap();
    let mut heard: Vec<String> = Vec::new();
    let mut faulted = false;
    let wanted = [
        "node 1: it runs",
        "node 2: no boot-up message 5s after reset communication",
        "node 1: EMCY 2320h",
        "node 1, axis 0: the drive is in fault",
    ];
    let until = std::time::Instant::now() + Duration::from_secs(30);
    while !wanted
        .iter()
        .all(|text| heard.iter().any(|h| h.starts_with(text)))
    {
        assert!(std::time::Instant::now() < until, "{heard:#?}");
        if let Some(received) = port.receive(Duration::from_micros(300)).unwrap()
            && let Some(frame) = received.frame.classic()
        {
            drive.handle_frame(frame, monotonic());
        }
        while let Some(frame) = drive.poll_transmit(monotonic()) {
            let _ = port.send(&frame.into());
        }
        heard.extend(network.news());
        if !faulted && heard.iter().any(|h| h == "node 1: it runs") {
            faulted = true;
            let axis = drive.application_mut().axis_mut(0).unwrap();
            axis.fault(FaultCode::SHORT_CIRCUIT);
        }
    }
    Box::new(network).stop();
}

#[test]
fn the_axes_of_one_drive_are_joints_of_one_arm() {
    let mut config = config();
    for (joint, axis) in config.arms[0].joints.iter_mut().zip(0..) {
        (joint.drive, joint.axis) = (9, axis);
    }
    assert_eq!(check(&config), Ok(()));
    let more = config.arms[0].joints[0].clone();
    for axis in 3..5 {
        let joint = DriveJoint {
            axis,
            ..more.clone()
        };
        config.arms[0].joints.push(joint);
    }
    let told = check(&config).unwrap_err();
    assert!(told.contains("node 9 drives 5 joints"), "{told}");
}

#[test]
fn what_a_network_cannot_be_is_told() {
    let mut twice = config();
    twice.arms[0].joints[1].drive = 1;
    let mut master = config();
    master.master = 3;
    let mut beat = config();
    beat.heartbeat = Some(Duration::from_millis(7));
    let mut node = config();
    node.arms[0].joints[0].drive = 200;
    let mut range = config();
    range.arms[0].joints[2].range = [10.0, -10.0];
    for (config, wanted) in [
        (twice, "axis 0 of node 1 drives two joints"),
        (node, "200"),
        (master, "node 3 has the master's number"),
        (beat, "heartbeat is 7ms; it must be two cycles to 20s"),
        (
            range,
            "joint 2: increments_per_turn must not be 0, range must go up",
        ),
    ] {
        let told = check(&config).unwrap_err();
        assert!(told.contains(wanted), "{told}");
    }
}
