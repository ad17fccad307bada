//! An arm on a CANopen network, moved by nets: emulated drives on a CAN bus inside this process.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use takt_can::AnyFrame;
use takt_can::bits::Bits;
use takt_can::bus::{Bus, Config};
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::cia402::State;
use takt_can::cia402::dictionary::Address;
use takt_can::cia402::emulator::{Drive, FaultCode};
use takt_can::link::{Link, LinkError, Received};
use takt_can::linux::{LivePort, monotonic};
use takt_core::device::driver::{DeviceDriver as _, DeviceEnd, DriverEnds};
use takt_core::device::{DeviceCommand, DeviceState, DeviceStatus};
use takt_core::probe::{Mode, ScopeEvent, ScopeRequest, TriggerKind, TriggerRequest};
use takt_core::{CellConfig, Controller};
use takt_device_drives::{DriveArm, DriveJoint, Recovery};
use takt_devices::canopen::{Canopen, check, describe};
use takt_devices::canopen::{CanopenConfig, LinkLoss};
use takt_rt::latest::latest;
use takt_rt::servo::Estimate;
use takt_rt::thread::{Thread, ThreadConfig, spawn};
use takt_tests::steady;

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
        following_error_max: None,
        rated_torque: None,
        not_mirrored: Vec::new(),
        quirks: Vec::new(),
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
            recovery: Recovery::default(),
            feed_forward: 0.0,
            down: Default::default(),
            payload: Default::default(),
            tools: Default::default(),
            model: "".into(),
            joints: (1..=JOINTS).map(joint).collect(),
        }],
    }
}

/// A link whose owner can be blocked while receiving, as if its thread hangs.
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

    fn bit_rate(&self) -> Option<u32> {
        self.port.bit_rate()
    }
}

/// Drives in a thread of their own, and a controller that commands them.
struct TestBench {
    cell: Option<Cell>,
    drives: Arc<Mutex<Vec<DriveNode>>>,
    /// The identifier of frames of drives that are dropped.
    muted: Arc<AtomicU32>,
    /// Whether the thread of the master hangs.
    held: Arc<AtomicBool>,
    /// A port that nothing else uses.
    listener: LivePort,
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

/// A drive of so many axes. A host without `PREEMPT_RT` misses SYNC now and then.
fn drive(node: u8, axes: usize) -> DriveNode {
    let mut config = DriveNodeConfig::new(NodeId::new(node).unwrap());
    config.axes[0].quirks.missing_set_points = None;
    config.axes = vec![config.axes[0].clone(); axes];
    DriveNode::power_on(config, monotonic()).unwrap()
}

impl TestBench {
    fn new() -> Self {
        let drives = (1..=JOINTS).map(|node| drive(node, 1)).collect();
        Self::of(&config(), drives)
    }

    /// The network of a configuration with these drives on it.
    fn of(config: &CanopenConfig, drives: Vec<DriveNode>) -> Self {
        let ours = LivePort::first_of(Bus::new(Config::default()));
        let mut ports: Vec<_> = drives.iter().map(|_| ours.attach()).collect();
        let listener = ours.attach();
        let drives = Arc::new(Mutex::new(drives));
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
                // Only the first waits.
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
        let added = controller.add_driver("network", describe(config), None, |ends| {
            Ok(Box::new(Canopen::start(config, Box::new(ours), ends)?))
        });
        added.unwrap();
        let robots = Vec::new();
        let cell = Cell { controller, robots };
        for arm in &config.arms {
            cell.wait_for(&arm.name, DeviceStatus::Operational);
        }
        Self {
            cell: Some(cell),
            drives,
            muted,
            held,
            listener,
            stop,
            thread: Some(thread.unwrap()),
        }
    }

    /// Whether all drives satisfy a condition.
    fn all(&self, holds: impl Fn(&Drive) -> bool) -> bool {
        let drives = self.drives.lock().unwrap();
        drives
            .iter()
            .all(|drive| holds(drive.application().axis(0).unwrap()))
    }

    /// Accesses an axis of a drive; drives count from 0.
    fn axis<R>(&self, drive: usize, axis: usize, use_it: impl FnOnce(&mut Drive) -> R) -> R {
        let mut drives = self.drives.lock().unwrap();
        use_it(drives[drive].application_mut().axis_mut(axis).unwrap())
    }

    fn cell(&self) -> &Cell {
        self.cell.as_ref().unwrap()
    }
}

impl Drop for TestBench {
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
fn canopen_net_moves_arm() {
    steady(|| {
        let bench = TestBench::new();
        let moved = bench.cell().swung("arm", 1);
        assert!((moved - 0.5).abs() < 0.01, "moved {moved} rad");
        assert!(
            bench.cell().position("arm", 0).abs() < 1e-3,
            "not commanded"
        );
        for drive in bench.drives.lock().unwrap().iter() {
            let bytes = |index, sub| drive.dictionary().bytes(Address::new(index, sub)).unwrap();
            assert_eq!(bytes(0x60C2, 1), [4], "SYNC every 4");
            assert_eq!(bytes(0x60C2, 2), (-3_i8).to_le_bytes(), "ms");
            assert_eq!(bytes(0x6007, 0), 3_i16.to_le_bytes(), "quick stop");
            // A heartbeat every five cycles, and a timeout of two and a half times that.
            let watched = 50_u32 | 127 << 16;
            assert_eq!(bytes(0x1016, 1), watched.to_le_bytes(), "the master");
        }
    });
}

/// The load that the controller reports is that of the frames which another port of the bus receives.
#[test]
fn canopen_network_reports_load_of_its_bus() {
    let bench = TestBench::new();
    let mut port = bench.listener.clone();
    while port.receive(Duration::ZERO).unwrap().is_some() {}
    let (begin, mut bits) = (monotonic(), 0.0);
    while monotonic() < begin + Duration::from_secs(3) {
        if let Some(received) = port.receive(Duration::from_millis(5)).unwrap() {
            bits += f64::from(Bits::of(&received.frame).nominal);
        }
    }
    let seen = bits / (monotonic() - begin).as_secs_f64();
    let loads = bench.cell().controller.bus_loads();
    let [load] = loads.as_slice() else {
        panic!("{loads:?}");
    };
    assert_eq!(
        (load.bus.as_str(), load.bit_rate),
        ("network", Some(1_000_000))
    );
    let measured = f64::from(load.bits_per_s);
    assert!(seen > 10_000.0, "{seen} bit/s on the bus");
    // Another second of a host that stalls now and then.
    assert!(
        (0.5..2.0).contains(&(measured / seen)),
        "{measured} of {seen}"
    );
    assert!((load.load().unwrap() - measured / 1e6).abs() < 1e-9);
    assert!(load.bits_per_s_max >= load.bits_per_s);
}

/// A capture that an event of the driver starts shows the drive's words before and after its fault.
#[test]
fn canopen_statuswords_and_bus_figures_are_probes() {
    steady(|| {
        let bench = TestBench::new();
        let controller = &bench.cell().controller;
        let states = &controller.probes("arm.joint.1.drive_state").probes[0].states;
        let names: Vec<_> = State::ALL.iter().map(ToString::to_string).collect();
        assert_eq!(states[..], names[..]);
        let request = ScopeRequest {
            trigger: Some(TriggerRequest {
                on: TriggerKind::Event,
                probe: Some("arm".to_owned()),
                level: None,
                hysteresis: None,
                low: None,
                high: None,
                equals: None,
            }),
            mode: Mode::Single,
            pre_s: 0.3,
            post_s: 0.5,
            ..ScopeRequest::of(&[
                "arm.joint.1.statusword",
                "arm.joint.1.drive_state",
                "arm.joint.0.statusword",
                "arm.can.received",
                "arm.can.latency",
                "arm.events",
            ])
        };
        let mut scope = controller.scope(&request).unwrap();
        assert!(scope.rejected().is_empty(), "{:?}", scope.rejected());
        let begin = monotonic();
        let (mut rows, mut cause, mut is_faulty) = (Vec::new(), String::new(), false);
        while !scope.is_done() {
            let passed = monotonic() - begin;
            assert!(passed < Duration::from_secs(60), "no event: {cause}");
            // Time for rows before it.
            if !is_faulty && passed > Duration::from_secs(1) {
                is_faulty = true;
                bench.axis(1, 0, |drive| drive.fault(FaultCode::TEMPERATURE));
            }
            scope.read(passed);
            while let Some(event) = scope.poll_event() {
                match event {
                    ScopeEvent::Triggered { cause: found, .. } => cause = found,
                    ScopeEvent::Frame(frame) => {
                        rows.extend(frame.iter().map(|(_, row)| row.to_vec()));
                    }
                    ScopeEvent::Ended { .. } | ScopeEvent::Lost { .. } => {}
                }
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        assert!(cause.starts_with("arm.events changed to "), "{cause}");
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a statusword is a whole number of 16 bits"
        )]
        let bits = |row: &[f64], column: usize, mask: u64| row[column] as u64 & mask;
        let (first, last) = (&rows[0], &rows[rows.len() - 1]);
        assert_eq!((bits(first, 0, 0x6F), first[1]), (0x27, 4.0), "{first:?}");
        assert_eq!((bits(last, 0, 0x4F), last[1]), (0x08, 7.0), "{last:?}");
        assert_eq!(
            (bits(first, 2, 0x6F), bits(last, 2, 0x4F) == 0x08),
            (0x27, false),
            "the other drive has no fault"
        );
        assert!(last[3] > first[3], "frames are received");
        assert!(rows.iter().all(|row| row[4] >= 0.0), "latencies");
        assert!(last[5] > first[5], "events");
    });
}

#[test]
fn drive_fault_ends_net_arm_recovers_at_rest() {
    steady(|| {
        let bench = TestBench::new();
        let net = bench.cell().swinging("arm", 0);
        bench.axis(2, 0, |drive| drive.fault(FaultCode::TEMPERATURE));
        bench.cell().wait_for_end(net);
        bench.axis(2, 0, Drive::clear_cause);
        bench.cell().wait_for("arm", DeviceStatus::Operational);
        let rest = bench.cell().position("arm", 0);
        std::thread::sleep(Duration::from_millis(300));
        assert!((bench.cell().position("arm", 0) - rest).abs() < 1e-3);
    });
}

/// A loose cable: the node itself keeps running.
#[test]
fn canopen_arm_recovers_after_lost_process_data() {
    steady(|| {
        let bench = TestBench::new();
        for _ in 0..2 {
            bench.muted.store(0x182, Ordering::Relaxed);
            bench.cell().wait_for("arm", DeviceStatus::Offline);
            bench.muted.store(u32::MAX, Ordering::Relaxed);
            bench.cell().wait_for("arm", DeviceStatus::Operational);
        }
    });
}

/// These drives tolerate missing set-points: only the heartbeat stops them.
#[test]
fn canopen_drives_stop_when_master_hangs_then_recover() {
    steady(|| {
        let bench = TestBench::new();
        let net = bench.cell().swinging("arm", 0);
        bench.held.store(true, Ordering::Relaxed);
        bench.cell().wait("drives that stop by themselves", |_| {
            bench.all(|drive| {
                drive.state() != State::OperationEnabled && drive.motor().velocity.abs() < 0.01
            })
        });
        bench.held.store(false, Ordering::Relaxed);
        bench.cell().wait_for_end(net);
        bench.cell().wait_for("arm", DeviceStatus::Operational);
    });
}

/// No controller is needed: events of the driver are checked directly.
#[test]
fn canopen_network_reports_why_arm_not_operational() {
    let mut config = config();
    config.arms[0].joints.truncate(2);
    let ours = LivePort::first_of(Bus::new(Config::default()));
    let mut port = ours.attach();
    let (state, _reported) = latest(1, DeviceState::default);
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
    let mut texts: Vec<String> = Vec::new();
    let mut faulted = false;
    let wanted = [
        "node 1: running",
        "node 2: no boot-up message 5s after reset communication",
        "node 1: EMCY 2320h",
        "node 1, axis 0: the drive is in fault",
    ];
    let until = std::time::Instant::now() + Duration::from_secs(30);
    while !wanted
        .iter()
        .all(|text| texts.iter().any(|h| h.starts_with(text)))
    {
        assert!(std::time::Instant::now() < until, "{texts:#?}");
        if let Some(received) = port.receive(Duration::from_micros(300)).unwrap()
            && let Some(frame) = received.frame.classic()
        {
            drive.handle_frame(frame, monotonic());
        }
        while let Some(frame) = drive.poll_transmit(monotonic()) {
            let _ = port.send(&frame.into());
        }
        texts.extend(network.poll_event().map(|event| event.text));
        if !faulted && texts.iter().any(|h| h == "node 1: running") {
            faulted = true;
            let axis = drive.application_mut().axis_mut(0).unwrap();
            axis.fault(FaultCode::SHORT_CIRCUIT);
        }
    }
    Box::new(network).stop();
}

/// A network as `cell.toml` has it: for each arm, the node and the axis of each joint.
fn cell_of(arms: &[(&str, &[(u8, u8)])]) -> CanopenConfig {
    let mut text =
        "[[canopen]]\nname = \"network\"\ninterface = \"none\"\ncycle = \"4ms\"\n".to_owned();
    for (name, joints) in arms {
        let joint = |(node, axis): &(u8, u8)| {
            format!(
                "{{ node = {node}, axis = {axis}, increments_per_turn = 204800.0, \
                 range = [-170.0, 170.0], velocity_max = 100.0, acceleration_max = 300.0 }}"
            )
        };
        let joints: Vec<_> = joints.iter().map(joint).collect();
        let joints = joints.join(",\n");
        text += &format!("[[canopen.arm]]\nname = \"{name}\"\njoint = [\n{joints}]\n");
    }
    takt_devices::parse_cell(&text)
        .unwrap()
        .of_kind::<CanopenConfig>()
        .next()
        .unwrap()
        .clone()
}

/// Joint 1 is axis 2, and axis 0 has no joint: indices in the arm and in the drive differ.
#[test]
fn canopen_axes_of_one_drive_form_arm() {
    steady(|| {
        let config = cell_of(&[("arm", &[(9, 1), (9, 2), (9, 3)])]);
        let bench = TestBench::of(&config, vec![drive(9, 4)]);
        let turned = |axis| bench.axis(0, axis, |drive| drive.motor().position);
        let before = [0, 1, 2, 3].map(turned);
        let moved = bench.cell().swung("arm", 1);
        assert!((moved - 0.5).abs() < 0.01, "moved {moved} rad");
        for (axis, before) in before.into_iter().enumerate() {
            let turned = (turned(axis) - before).abs() > 1.0;
            assert_eq!(turned, axis == 2, "axis {axis}");
        }
        let unasked = bench.axis(0, 0, |drive| drive.state());
        assert_ne!(unasked, State::OperationEnabled, "not requested");
    });
}

#[test]
fn canopen_six_axis_drive_forms_arm() {
    steady(|| {
        let config = cell_of(&[("arm", &[(9, 0), (9, 1), (9, 2), (9, 3), (9, 4), (9, 5)])]);
        let bench = TestBench::of(&config, vec![drive(9, 6)]);
        for joint in [0, 5] {
            let moved = bench.cell().swung("arm", joint);
            assert!((moved - 0.5).abs() < 0.01, "joint {joint} moved {moved}");
        }
        for joint in 1..5 {
            let stayed = || bench.cell().position("arm", joint).abs() < 1e-3;
            bench.cell().wait("the other joints in place", |_| stayed());
        }
    });
}

/// Both arms have an axis in each of two drives. Repeats if the host stalls and the other arm is lost because
/// of that.
#[test]
fn canopen_axis_fault_spares_other_arm_of_drive() {
    let config = cell_of(&[("left", &[(3, 0), (4, 1)]), ("right", &[(3, 1), (4, 0)])]);
    let bench = TestBench::of(&config, vec![drive(3, 2), drive(4, 2)]);
    let cell = bench.cell();
    let faults = |arm| cell.controller.arm_state(arm).unwrap().faults;
    for _ in 0..10 {
        let (left, right) = (cell.swinging("left", 0), cell.swinging("right", 1));
        let before = faults("right");
        bench.axis(0, 0, |drive| drive.fault(FaultCode::TEMPERATURE));
        cell.wait_for_end(left);
        let place = cell.position("right", 1);
        cell.wait("the other arm to move on", |_| {
            (cell.position("right", 1) - place).abs() > 0.01 || cell.is_over(right)
        });
        let its_axes = [(0, 1), (1, 0)].map(|(at, axis)| bench.axis(at, axis, |d| d.state()));
        let undisturbed = !cell.is_over(right) && faults("right") == before;
        let _ = cell.controller.abort(right);
        cell.wait_for_end(right);
        bench.axis(0, 0, Drive::clear_cause);
        cell.wait_for("left", DeviceStatus::Operational);
        cell.wait_for("right", DeviceStatus::Operational);
        if undisturbed {
            assert_eq!(its_axes, [State::OperationEnabled; 2]);
            return;
        }
    }
    panic!("the other arm was lost in each of ten attempts");
}

#[test]
fn canopen_invalid_configurations_are_reported() {
    let mut twice = config();
    twice.arms[0].joints[1].drive = 1;
    let mut master = config();
    master.master = 3;
    let mut beat = config();
    beat.heartbeat = Some(Duration::from_millis(7));
    let mut node = config();
    node.arms[0].joints[0].drive = 200;
    let mut next = cell_of(&[("arm", &[(9, 0), (9, 1), (9, 2), (9, 3), (9, 4), (11, 0)])]);
    next.arms[0].joints[5].drive = 10;
    let mut last = config();
    last.arms[0].joints = (0..5)
        .map(|axis| DriveJoint {
            drive: 127,
            axis,
            ..last.arms[0].joints[0].clone()
        })
        .collect();
    let mut cycle = config();
    cycle.cycle = Duration::from_micros(3_333);
    let mut number = config();
    (number.master, number.heartbeat) = (200, Some(Duration::ZERO));
    let mut range = config();
    range.arms[0].joints[2].range = [10.0, -10.0];
    for (config, wanted) in [
        (twice, "axis 0 of node 1 drives two joints"),
        (node, "200"),
        (next, "node 10: 18Ah is used already"),
        (last, "node 127 drives 5 joints; the fifth and later ones"),
        (cycle, "cycle is 3.333ms; drives support at most 255 times"),
        (number, "master: 200 is no node number"),
        (master, "node 3 has the master's number"),
        (beat, "heartbeat is 7ms; it must be two cycles to 20s"),
        (
            range,
            "joint 2: increments_per_turn must not be 0, range must go up",
        ),
    ] {
        let reported = check(&config).unwrap_err();
        assert!(reported.contains(wanted), "{reported}");
    }
}
