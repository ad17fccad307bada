//! The controller with emulated arms on the real wire: nets that move them, and what happens when
//! a robot, a net or the wire fails. Figures of timing are not looked at.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_core::cell::{ControllerConfig, DeviceConfig, LwrConfig};
use takt_core::controller::{LoadRequest, NetInfo, NetState};
use takt_core::device::DeviceStatus;
use takt_core::{CellConfig, Controller, NetId, SessionId};
use takt_fri::lwr::emulator::{Krc, KrcConfig, KrcStatus, serve};
use takt_rt::thread::{Thread, ThreadConfig, spawn};

struct Robot {
    status: Arc<KrcStatus>,
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

impl Robot {
    fn start(target: SocketAddr) -> Self {
        let (status, stop) = (Arc::new(KrcStatus::new()), Arc::new(AtomicBool::new(false)));
        let (shared, stopping) = (Arc::clone(&status), Arc::clone(&stop));
        let config = ThreadConfig { priority: Some(88), ..ThreadConfig::new("krc") };
        let thread = spawn(config, move || {
            let local = SocketAddr::from(([127, 0, 0, 1], 0));
            let mut link = takt_fri::linux::UdpLink::connect(local, target).unwrap();
            let joints = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
            let config =
                KrcConfig { period: Duration::from_millis(1), joints, ..KrcConfig::default() };
            let mut krc = Krc::new(config, takt_fri::linux::monotonic().unwrap());
            serve(&mut krc, &mut link, &shared, &stopping).unwrap();
        });
        Self { status, stop, thread: Some(thread.unwrap()) }
    }

    fn kill(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A controller with arms of these names and their robots.
struct Cell {
    controller: Controller,
    robots: Vec<Robot>,
}

impl Cell {
    fn new(names: &[&str]) -> Self {
        let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
        let lwr = |name: &&str| DeviceConfig::Lwr(LwrConfig::new(*name, anywhere));
        let config = CellConfig {
            controller: ControllerConfig::default(),
            devices: names.iter().map(lwr).collect(),
        };
        let controller = Controller::start(&config).unwrap();
        let robots = controller.with_arms(takt_core::device::lwr::Lwr::address);
        let robots = robots.into_iter().map(Robot::start).collect();
        let cell = Self { controller, robots };
        cell.wait("all arms operational", |c| {
            c.devices().iter().all(|d| d.status == DeviceStatus::Operational)
        });
        cell
    }

    fn wait(&self, what: &str, done: impl Fn(&Controller) -> bool) {
        let until = Instant::now() + Duration::from_secs(30);
        while !done(&self.controller) {
            assert!(Instant::now() < until, "waited in vain for: {what}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn load(&self, text: &str) -> NetId {
        let request = LoadRequest {
            text: text.to_owned(),
            session: SessionId::NONE,
            description: String::new(),
            period: None,
        };
        let id = self.controller.load(request).unwrap();
        let net = self.controller.net(id).unwrap();
        let faults = net.rejection.map(|r| r.render("net", text));
        assert_eq!(net.states.last(), Some(&NetState::Ready), "{}", faults.unwrap_or_default());
        id
    }

    fn wait_for_end(&self, id: NetId) -> NetInfo {
        self.wait("the end of the net", |c| {
            c.net(id).is_some_and(|net| net.state() == NetState::Terminated)
        });
        self.controller.net(id).unwrap()
    }
}

/// Moves joint 6 of an arm by half a radian within `seconds`.
fn swing(robot: &str, seconds: f64) -> String {
    format!(
        "{{true=Core::BooleanValue(Value='true'),past=Core::BooleanPre(inValue=true.outValue),
        first=Core::BooleanIsNull(inValue=past.outValue),
        monitor=RobotArm::JointMonitor(Robot='{robot}',Axis='6'),
        start=Core::DoubleSnapshot(inSnapshot=first.outValue,inValue=monitor.outCommandedPosition),
        clock=Core::Clock(),part=Core::Interval(inValue=clock.outValue,Max='{seconds}'),
        smooth=Core::DoubleBezier(inValue=part.outValue,To='0.5'),
        target=Core::DoubleAdd(inFirst=start.outValue,inSecond=smooth.outValue),
        joint=RobotArm::JointPosition(inPosition=target.outValue,Robot='{robot}',Axis='6'),
        error=Core::IntNetcommOut(inValue=joint.outError,Key='error'),
        cancel=Cancel(),done=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
        end=Core::BooleanOr(inFirst=cancel.outCancel,inSecond=done.outValue),
        outTerminate=end.outValue}}"
    )
}

#[test]
fn a_net_moves_an_arm_and_ends() {
    let cell = Cell::new(&["left"]);
    let before = cell.robots[0].status.measured()[6];
    let net = cell.load(&swing("left", 1.0));
    cell.controller.start_net(net).unwrap();
    let info = cell.wait_for_end(net);
    assert_eq!(info.end, None, "{:?}", cell.robots[0].status.last_fall().map(|f| f.to_string()));
    assert_eq!(
        info.states,
        [NetState::Loading, NetState::Ready, NetState::Running, NetState::Terminated]
    );
    cell.wait("the arm at its goal", |_| {
        (cell.robots[0].status.measured()[6] - before - 0.5).abs() < 1e-3
    });
    assert_eq!(cell.controller.out_values(net), [("outerror".to_owned(), "0".to_owned())]);
}

#[test]
fn a_robot_that_vanishes_ends_its_net_and_no_other() {
    let mut cell = Cell::new(&["left", "right"]);
    let (left, right) = (cell.load(&swing("left", 3.0)), cell.load(&swing("right", 3.0)));
    cell.controller.start_net(left).unwrap();
    cell.controller.start_net(right).unwrap();
    cell.robots[0].kill();
    let ended = cell.wait_for_end(left).end.unwrap();
    assert!(ended.contains("left ceased to follow commands"), "{ended}");
    assert_eq!(cell.wait_for_end(right).end, None);
}

#[test]
fn drives_that_lose_power_end_the_net_and_nothing_moves_when_they_come_back() {
    let cell = Cell::new(&["left"]);
    let net = cell.load(&swing("left", 3.0));
    cell.controller.start_net(net).unwrap();
    cell.robots[0].status.set_power(false);
    assert!(cell.wait_for_end(net).end.unwrap().contains("ceased to follow"));
    cell.robots[0].status.set_power(true);
    cell.wait("the arm operational again", |c| {
        c.devices()[0].status == DeviceStatus::Operational
    });
    let rested = cell.robots[0].status.commanded();
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(cell.robots[0].status.commanded(), rested);
}

#[test]
fn a_joint_belongs_to_one_running_net() {
    let cell = Cell::new(&["left"]);
    let (first, second) = (cell.load(&swing("left", 2.0)), cell.load(&swing("left", 2.0)));
    cell.controller.start_net(first).unwrap();
    let error = cell.controller.start_net(second).unwrap_err().to_string();
    assert!(error.contains("left_Joint_6, which another running net holds"), "{error}");
    cell.controller.cancel(first).unwrap();
    cell.wait_for_end(first);
    cell.controller.start_net(second).unwrap();
    cell.controller.abort(second).unwrap();
    assert_eq!(cell.wait_for_end(second).end.as_deref(), Some("aborted"));
}

#[test]
fn an_arm_that_is_not_ready_cannot_be_commanded() {
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let config = CellConfig {
        controller: ControllerConfig::default(),
        devices: vec![DeviceConfig::Lwr(LwrConfig::new("left", anywhere))],
    };
    let cell = Cell { controller: Controller::start(&config).unwrap(), robots: Vec::new() };
    let net = cell.load(&swing("left", 1.0));
    let error = cell.controller.start_net(net).unwrap_err().to_string();
    assert!(error.contains("commands left, which is offline"), "{error}");
}
