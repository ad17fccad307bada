//! Proof that the driver threads of all buses allocate nothing once their devices follow commands: nets move them
//! under a counting allocator, and the driver must have run cycles meanwhile. Emulators may allocate.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use common::{Cell, Robot, swing_joint};
use takt_can::bus::{Bus, Config};
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::link::Link;
use takt_can::linux::LivePort;
use takt_can::rmp::Model;
use takt_can::rmp::emulator::{Powerbase, PowerbaseConfig};
use takt_core::device::DeviceStatus;
use takt_core::{CellConfig, Controller};
use takt_devices::canopen::{self, Canopen, CanopenConfig};
use takt_devices::ethercat::{self, Ethercat, EthercatConfig};
use takt_devices::fri::iiwa::Iiwa;
use takt_devices::fri::lwr;
use takt_devices::fri::{IiwaConfig, LwrConfig};
use takt_devices::rmp::RmpConfig;
use takt_devices::rmp::{self, Rmp};
use takt_ethercat::emulator::{Coupler, Segment, Server, ServoConfig, ServoDrive, SharedSegment};
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, CabinetStatus, Control, Faults, Overlay, Program, Timing,
};
use takt_fri::sunrise::wire::{CommandMode, Dialect, Quality};
use takt_rt::alloc::{CountingAllocator, real_time_allocations};
use takt_tests::steady;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The counter covers the whole process: one test at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// An emulator in a thread of its own, until it is dropped.
struct Emulated {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Emulated {
    fn start(body: impl FnOnce(&AtomicBool) + Send + 'static) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        let thread = std::thread::spawn(move || body(&stopping));
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

fn toml(text: &str) -> CellConfig {
    takt_devices::parse_cell(text).unwrap()
}

fn controller() -> Cell {
    Cell {
        controller: Controller::start(&CellConfig::default()).unwrap(),
        robots: Vec::new(),
    }
}

/// Allocations of real-time threads while nets that last a while are run, one after the other, on an operational
/// device.
fn allocations(cell: &Cell, device: &str, nets: &[String]) -> u64 {
    cell.wait_for(device, DeviceStatus::Operational);
    let before = real_time_allocations();
    for text in nets {
        let net = cell.load(text);
        // Those who look at a bus make and free all buffers.
        for bus in cell.controller.buses() {
            bus.report().unwrap();
        }
        // A stall of the host may just have ended the command; allocations after that count too.
        if cell.controller.start_net(net).is_ok() {
            cell.wait_for_end(net);
        }
        cell.wait_for(device, DeviceStatus::Operational);
    }
    real_time_allocations() - before
}

/// There, and back by a second net.
fn swings(device: &str) -> [String; 2] {
    [swing_joint(device, 1, 0.7), swing_joint(device, 0, 0.7)]
}

/// Orders everything that FRI arms accept besides positions, for a second.
fn orders() -> String {
    let joint = |i: usize| {
        format!(
            "k{i}=KUKA::LWR::JointImpParameters(inStiffness=k.outValue,inDamping=d.outValue,
            inAddTorque=half.outValue,Robot='arm',Axis='{i}')"
        )
    };
    let joints: Vec<_> = (0..7).map(joint).collect();
    format!(
        "{{k=Core::DoubleValue(Value='500'),d=Core::DoubleValue(Value='0.7'),
        clock=Core::Clock(),half=Core::DoubleMultiply(inFirst=clock.outValue,Second='0.5'),
        three=Core::IntValue(Value='3'),
        strategy=KUKA::LWR::ControlStrategy(inStrategy=three.outValue,Robot='arm'),
        w=World::WrenchValue(Value='{{force:{{z:1}}}}'),
        cart=KUKA::LWR::CartImpParameters(inStiffness=w.outValue,inAddTorque=w.outValue,Robot='arm'),
        forces=KUKA::LWR::FTMonitor(Robot='arm'),{},
        late=Core::DoubleGreater(inFirst=clock.outValue,Second='1'),outTerminate=late.outValue}}",
        joints.join(",")
    )
}

#[test]
fn lwr_driver_allocates_nothing_for_any_orders() {
    let count = steady(|| {
        let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
        let arm = LwrConfig {
            handshake: Some(takt_fri::lwr::Protocol::Rcc),
            ..LwrConfig::new("arm", anywhere)
        };
        let config = CellConfig {
            devices: vec![Arc::new(arm)],
            ..CellConfig::default()
        };
        let mut cell = Cell {
            controller: Controller::start(&config).unwrap(),
            robots: Vec::new(),
        };
        let address = cell.controller.with_drivers(lwr::Lwr::address)[0];
        cell.robots.push(Robot::start(address));
        let io =
            "{t=Core::BooleanValue(Value='true'),out=IO::OutBool(inIO=t.outValue,DeviceID='arm',
        Port='3'),in=IO::InReal(DeviceID='arm',Port='2'),clock=Core::Clock(),
        late=Core::DoubleGreater(inFirst=clock.outValue,Second='0.5'),outTerminate=late.outValue}";
        let [first, second] = swings("arm");
        let nets = [first, orders(), io.to_owned(), second];
        let count = allocations(&cell, "arm", &nets);
        let figures = cell.controller.with_drivers(lwr::Lwr::figures)[0];
        assert!(figures.datagrams > 50, "{figures:?}");
        count
    });
    assert_eq!(count, 0);
}

#[test]
fn iiwa_driver_allocates_nothing_for_any_orders() {
    let count = steady(|| {
        let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
        let config = CellConfig {
            devices: vec![Arc::new(IiwaConfig::new("arm", anywhere))],
            ..CellConfig::default()
        };
        let cell = Cell {
            controller: Controller::start(&config).unwrap(),
            robots: Vec::new(),
        };
        let address = cell.controller.with_drivers(Iiwa::address)[0];
        let springs = Control::JointImpedance {
            stiffness: [2000.0; 7],
            damping: [0.7; 7],
        };
        let overlay = Overlay {
            control: springs,
            command: CommandMode::Torque,
        };
        let restart = Some(Duration::from_millis(100));
        let config = CabinetConfig {
            dialect: Dialect::V3,
            program: Program::Auto { overlay, restart },
            timing: Timing {
                misses_max: 100,
                bad_from: 0.0,
                ..Timing::default()
            },
            faults: Faults {
                quality: Some(Quality::Excellent),
                ..Faults::default()
            },
            ..CabinetConfig::default()
        };
        let _cabinet = Emulated::start(move |stop| {
            let local = SocketAddr::from(([127, 0, 0, 1], 0));
            let mut link = takt_fri::linux::UdpLink::connect(local, address).unwrap();
            let mut cabinet = Cabinet::new(config, takt_fri::linux::monotonic().unwrap());
            let status = CabinetStatus::new();
            takt_fri::sunrise::emulator::serve(&mut cabinet, &mut link, &status, stop).unwrap();
        });
        let [first, second] = swings("arm");
        let nets = [first, orders(), second];
        let count = allocations(&cell, "arm", &nets);
        let figures = cell.controller.with_drivers(Iiwa::figures)[0];
        assert!(figures.datagrams > 50, "{figures:?}");
        count
    });
    assert_eq!(count, 0);
}

/// The joint of a drive in `cell.toml`.
fn joint(of: &str, drive: &str, axis: usize) -> String {
    format!(
        "[[{of}.arm.joint]]\ndrive = {drive}\naxis = {axis}\nincrements_per_turn = 204800\n\
         range = [-100, 100]\nvelocity_max = 150\nacceleration_max = 500\n"
    )
}

#[test]
fn canopen_driver_allocates_nothing() {
    let count = steady(|| {
        let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let joints: String = ["1", "2"].map(|drive| joint("canopen", drive, 0)).concat();
        let config = toml(&format!(
            "[[canopen]]\nname = \"network\"\ninterface = \"none\"\ncycle = \"4ms\"\n\
         [[canopen.arm]]\nname = \"arm\"\n{joints}"
        ));
        let config = config.of_kind::<CanopenConfig>().next().unwrap();
        let ours = LivePort::first_of(Bus::new(Config::default()));
        let mut ports = [ours.attach(), ours.attach()];
        let _drives = Emulated::start(move |stop| {
            let node = |raw| {
                let mut config = DriveNodeConfig::new(NodeId::new(raw).unwrap());
                // A host without PREEMPT_RT misses SYNC now and then.
                config.axes[0].quirks.missing_set_points = None;
                DriveNode::power_on(config, takt_can::linux::monotonic()).unwrap()
            };
            let mut drives = [node(1), node(2)];
            while !stop.load(Ordering::Relaxed) {
                // The second does not wait.
                let mut wait = Duration::from_micros(300);
                for (port, drive) in ports.iter_mut().zip(&mut drives) {
                    while let Some(received) = port.receive(wait).unwrap() {
                        wait = Duration::ZERO;
                        if let Some(frame) = received.frame.classic() {
                            drive.handle_frame(frame, takt_can::linux::monotonic());
                        }
                    }
                    wait = Duration::ZERO;
                    while let Some(frame) = drive.poll_transmit(takt_can::linux::monotonic()) {
                        let _queue_full = port.send(&frame.into());
                    }
                }
            }
        });
        let cell = controller();
        let devices = canopen::describe(config);
        let added = cell
            .controller
            .add_driver("network", devices, None, |ends| {
                Ok(Box::new(Canopen::start(config, Box::new(ours), ends)?))
            });
        added.unwrap();
        allocations(&cell, "arm", &swings("arm"))
    });
    assert_eq!(count, 0);
}

#[test]
fn ethercat_driver_allocates_nothing() {
    let feed_forward = "model = 'urdf:../../examples/cells/ur5e.urdf'\nfeed_forward = 0.8\npayload = { mass = 3.0 }\n";
    for (of_arm, of_joint) in [("", ""), (feed_forward, "rated_torque = 150\n")] {
        assert_eq!(ethercat_allocations(of_arm, of_joint), 0, "{of_arm}");
    }
}

/// Allocations of a segment with an arm that has these lines, and those of each joint, in `cell.toml`.
fn ethercat_allocations(of_arm: &str, of_joint: &str) -> u64 {
    steady(|| {
        let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let joints = (0..6).map(|axis| joint("ethercat", "\"drives\"", axis) + of_joint);
        let joints: String = joints.collect();
        let config = toml(&format!(
            "[[ethercat]]\nname = \"segment\"\ninterface = \"none\"\ncycle = \"2ms\"\n\
         [[ethercat.slave]]\nname = \"coupler\"\nposition = 0\n\
         [[ethercat.slave]]\nname = \"drives\"\nposition = 1\naxes = 6\nsync0 = true\n\
         [[ethercat.arm]]\nname = \"arm\"\n{of_arm}{joints}"
        ));
        let config = config.of_kind::<EthercatConfig>().next().unwrap();
        let mut tx90 = ServoConfig::tx90();
        // A host without PREEMPT_RT misses SYNC0 now and then.
        for axis in &mut tx90.axes {
            axis.quirks.missing_set_points = None;
        }
        let (drives, _servo) = ServoDrive::slave(tx90).unwrap();
        let segment = SharedSegment::new(Segment::line([Coupler::slave(), drives]));
        let (near, far) = takt_ethercat::linux::cable();
        let _segment = Emulated::start(move |stop| {
            let mut server = Server::new(segment, far);
            while !stop.load(Ordering::Relaxed) {
                let wait = Duration::from_millis(5);
                server
                    .turn(wait, &mut takt_ethercat::linux::monotonic)
                    .unwrap();
            }
        });
        let wire = ethercat::Wire {
            link: Box::new(near),
            source: [2, 0, 0, 0, 0, 1],
        };
        let cell = controller();
        let devices = ethercat::describe(config);
        let added = cell
            .controller
            .add_driver("segment", devices, None, |ends| {
                Ok(Box::new(Ethercat::start(config, wire, ends)?))
            });
        added.unwrap();
        let count = allocations(&cell, "arm", &swings("arm"));
        let figures = cell.controller.with_drivers(Ethercat::figures);
        assert!(figures[0].cycles > 50, "{figures:?}");
        count
    })
}

#[test]
fn rmp_driver_allocates_nothing() {
    let count = steady(|| {
        let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let config = RmpConfig {
            model: Model::Rmp200.name().to_owned(),
            ..RmpConfig::new("base", &["can0"])
        };
        let bus = Config {
            rates: takt_can::bits::Rates::classic(500_000),
            ..Config::default()
        };
        let ours = LivePort::first_of(Bus::new(bus));
        let mut theirs = ours.attach();
        let _base = Emulated::start(move |stop| {
            let mut powerbase = Powerbase::new(PowerbaseConfig {
                model: Model::Rmp200,
                start: takt_can::linux::monotonic(),
                ..PowerbaseConfig::default()
            });
            while !stop.load(Ordering::Relaxed) {
                takt_can::rmp::emulator::serve(
                    &mut powerbase,
                    &mut theirs,
                    takt_can::linux::monotonic,
                )
                .unwrap();
            }
        });
        let cell = controller();
        let devices = vec![rmp::describe(&config)];
        let wires = vec![rmp::Wire::Can(Box::new(ours))];
        let added = cell.controller.add_driver("base", devices, None, |ends| {
            Ok(Box::new(Rmp::start(&config, wires, ends)?))
        });
        added.unwrap();
        let net = "{v=World::TwistValue(Value='{vel:{x:0.3}}'),
        move=RobotBase::BaseVelocity(inVel=v.outValue,Robot='base'),clock=Core::Clock(),
        done=Core::DoubleGreater(inFirst=clock.outValue,Second='1.5'),outTerminate=done.outValue}";
        allocations(&cell, "base", &[net.to_owned()])
    });
    assert_eq!(count, 0);
}
