//! The driver against an emulated gripper over TCP, led by nets of a controller.

#![expect(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetState};
use takt_core::device::DeviceStatus;
use takt_core::device::driver::DriverConfig as _;
use takt_core::{CellConfig, Controller, NetId, SessionId};
use takt_device_wsg::emulator::{Gripper, GripperConfig, Port};
use takt_device_wsg::{WsgConfig, describe};

/// Far longer than anything here takes.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A gripper that is served in a thread, and a controller that leads it.
struct TestBench {
    gripper: Arc<Mutex<(Port, Gripper)>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    controller: Controller,
}

impl TestBench {
    fn new() -> Self {
        let port = Port::listen(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
        let address = port.address().unwrap();
        let gripper = Gripper::new(GripperConfig::default(), Port::now());
        let gripper = Arc::new(Mutex::new((port, gripper)));
        let stop = Arc::new(AtomicBool::new(false));
        let (served, stopping) = (Arc::clone(&gripper), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            while !stopping.load(Ordering::Relaxed) {
                let (port, gripper) = &mut *served.lock().unwrap();
                port.serve(gripper).unwrap();
            }
        });
        let mut cell = CellConfig::default();
        cell.controller.priority = None;
        let controller = Controller::start(&cell).unwrap();
        let config = WsgConfig::new("hand", address);
        let devices = vec![describe(&config)];
        let added = controller.add_driver("hand", devices, None, |ends| config.start(ends));
        added.unwrap();
        let bench = Self {
            gripper,
            stop,
            thread: Some(thread),
            controller,
        };
        bench.wait_for(DeviceStatus::Operational);
        bench
    }

    fn status(&self) -> DeviceStatus {
        self.controller.arm_state("hand").unwrap().status
    }

    fn wait(&self, what: &str, is: impl Fn() -> bool) {
        let until = Instant::now() + TIMEOUT;
        while !is() {
            assert!(Instant::now() < until, "timed out waiting for {what}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn wait_for(&self, status: DeviceStatus) {
        self.wait(&status.to_string(), || self.status() == status);
    }

    fn with<T>(&self, work: impl FnOnce(&mut Port, &mut Gripper) -> T) -> T {
        let (port, gripper) = &mut *self.gripper.lock().unwrap();
        work(port, gripper)
    }

    /// Starts a net with a command that ends when it is finished.
    fn start(&self, command: &str) -> NetId {
        let text = format!(
            "{{g=schunkwsg::{command},s=Core::IntNetcommOut(inValue=g.outStatusCode,Key='status'),\
             x=Cancel(),e=Core::BooleanOr(inFirst=g.outFinished,inSecond=x.outCancel),outTerminate=e.outValue}}"
        );
        let request = LoadRequest {
            text,
            session: SessionId::NONE,
            description: String::new(),
            period: None,
        };
        let net = self.controller.load(request).unwrap();
        self.controller.start_net(net).unwrap();
        net
    }

    /// The status of a command.
    fn does(&self, command: &str) -> String {
        let net = self.start(command);
        let ended = || self.controller.net(net).unwrap().state() == NetState::Terminated;
        self.wait(command, ended);
        let values = self.controller.out_values(net);
        let status = values.into_iter().find(|(key, _)| key == "outstatus");
        status.map(|(_, text)| text).unwrap_or_default()
    }
}

impl Drop for TestBench {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take();
        thread.into_iter().for_each(|thread| thread.join().unwrap());
    }
}

#[test]
fn wsg_net_homes_grips_and_releases() {
    let bench = TestBench::new();
    assert_eq!(
        bench.does("Grasping(Device='hand',Width='0.03',Speed='0.2')"),
        "3"
    );
    assert_eq!(bench.does("Homing(Device='hand')"), "0");
    bench.with(|_, gripper| gripper.knobs.part = Some(30.0));
    assert_eq!(
        bench.does("Grasping(Device='hand',Width='0.03',Speed='0.4')"),
        "0"
    );
    bench.with(|_, gripper| assert_eq!(gripper.grasping(), 4));
    assert_eq!(
        bench.does("Releasing(Device='hand',OpenWidth='0.09',Speed='0.4')"),
        "0"
    );
    let width = bench.with(|_, gripper| gripper.width());
    assert!((width - 90.0).abs() < 0.1, "{width}");
}

#[test]
fn wsg_motion_ends_with_its_net() {
    let bench = TestBench::new();
    assert_eq!(bench.does("Homing(Device='hand')"), "0");
    let net = bench.start("Releasing(Device='hand',OpenWidth='0.01',Speed='0.01')");
    bench.wait("motion", || bench.with(|_, gripper| !gripper.rests()));
    bench.controller.abort(net).unwrap();
    bench.wait("rest", || bench.with(|_, gripper| gripper.rests()));
    let width = bench.with(|_, gripper| gripper.width());
    assert!(
        width > 10.1,
        "it was stopped on its way, not at its end: {width} mm"
    );
}

#[test]
fn wsg_lost_connection_ends_net_and_is_made_again() {
    let bench = TestBench::new();
    assert_eq!(bench.does("Homing(Device='hand')"), "0");
    let net = bench.start("Releasing(Device='hand',OpenWidth='0.01',Speed='0.01')");
    bench.wait("motion", || bench.with(|_, gripper| !gripper.rests()));
    bench.with(|port, gripper| port.cut(gripper));
    let ended = || bench.controller.net(net).unwrap().state() == NetState::Terminated;
    bench.wait("the end of the net", ended);
    bench.wait_for(DeviceStatus::Operational);
    bench.with(|_, gripper| assert!(gripper.rests() && !gripper.is_stopped()));
}
