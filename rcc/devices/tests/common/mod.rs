//! Controllers with emulated arms on the real wire, for several test files.

#![allow(
    dead_code,
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    reason = "shared by test files that need different parts"
)]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetInfo, NetState};
use takt_core::device::DeviceStatus;
use takt_core::device::driver::DriverConfig;
use takt_core::record::{Recorder, Tap};
use takt_core::{CellConfig, Controller, NetId, SessionId};
use takt_devices::fri::LwrConfig;
use takt_fri::lwr::emulator::{Krc, KrcConfig, KrcStatus, Timing, serve};
use takt_rt::thread::{Thread, ThreadConfig, spawn};
use takt_tests::now;

/// An emulated KRC in a thread of its own.
pub struct Robot {
    pub status: Arc<KrcStatus>,
    stop: Arc<AtomicBool>,
    thread: Option<Thread<()>>,
}

impl Robot {
    pub fn start(target: SocketAddr) -> Self {
        let (status, stop) = (Arc::new(KrcStatus::new()), Arc::new(AtomicBool::new(false)));
        let (shared, stopping) = (Arc::clone(&status), Arc::clone(&stop));
        let config = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new("krc")
        };
        let thread = spawn(config, move || {
            let local = SocketAddr::from(([127, 0, 0, 1], 0));
            let mut link = takt_fri::linux::UdpLink::connect(local, target).unwrap();
            let joints = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
            // Tolerates stalls of tens of milliseconds, as of a host without PREEMPT_RT.
            let timing = Timing {
                misses_max: 100,
                bad_from: 0.0,
                ..Timing::default()
            };
            let period = Duration::from_millis(1);
            let config = KrcConfig {
                period,
                joints,
                timing,
                ..KrcConfig::default()
            };
            let mut krc = Krc::new(config, takt_fri::linux::monotonic().unwrap());
            serve(&mut krc, &mut link, &shared, &stopping).unwrap();
        });
        Self {
            status,
            stop,
            thread: Some(thread.unwrap()),
        }
    }

    pub fn kill(&mut self) {
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

/// Maximum restarts of a net because of stalls of the host.
const ATTEMPTS: u32 = 10;

/// A controller with arms of these names and their robots.
pub struct Cell {
    pub controller: Controller,
    pub robots: Vec<Robot>,
}

impl Cell {
    pub fn new(names: &[&str]) -> Self {
        Self::recorded(names, None)
    }

    /// The same with a recording.
    pub fn recorded(names: &[&str], recording: Option<(Recorder, Tap)>) -> Self {
        let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
        let lwr =
            |name: &&str| -> Arc<dyn DriverConfig> { Arc::new(LwrConfig::new(*name, anywhere)) };
        let config = CellConfig {
            devices: names.iter().map(lwr).collect(),
            ..CellConfig::default()
        };
        Self::of(&config, recording)
    }

    /// The controller of a cell whose devices are all arms, with their robots.
    pub fn of(config: &CellConfig, recording: Option<(Recorder, Tap)>) -> Self {
        let controller = Controller::start_recording(config, recording).unwrap();
        let robots = controller.with_drivers(takt_devices::fri::lwr::Lwr::address);
        let robots = robots.into_iter().map(Robot::start).collect();
        let cell = Self { controller, robots };
        cell.wait("all arms operational", |c| {
            c.devices()
                .iter()
                .all(|d| d.status == DeviceStatus::Operational)
        });
        cell
    }

    pub fn wait(&self, what: &str, mut done: impl FnMut(&Controller) -> bool) {
        let until = Instant::now() + Duration::from_secs(30);
        while !done(&self.controller) {
            assert!(Instant::now() < until, "waited in vain for: {what}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    pub fn load(&self, text: &str) -> NetId {
        self.load_with(text, None)
    }

    /// Loads a net with a period of its own.
    pub fn load_every(&self, text: &str, period: Duration) -> NetId {
        self.load_with(text, Some(period))
    }

    fn load_with(&self, text: &str, period: Option<Duration>) -> NetId {
        let (text, session) = (text.to_owned(), SessionId::NONE);
        let request = LoadRequest {
            text: text.clone(),
            session,
            description: String::new(),
            period,
        };
        let id = self.controller.load(request).unwrap();
        let net = self.controller.net(id).unwrap();
        let faults = net.rejection.map(|r| r.render("net", &text));
        assert_eq!(
            net.states.last(),
            Some(&NetState::Ready),
            "{}",
            faults.unwrap_or_default()
        );
        id
    }

    pub fn wait_for_end(&self, id: NetId) -> NetInfo {
        self.wait("the end of the net", |c| {
            c.net(id)
                .is_some_and(|net| net.state() == NetState::Terminated)
        });
        self.controller.net(id).unwrap()
    }

    pub fn is_over(&self, id: NetId) -> bool {
        self.controller.net(id).unwrap().state() == NetState::Terminated
    }

    pub fn status(&self, device: &str) -> DeviceStatus {
        self.controller.arm_state(device).unwrap().status
    }

    pub fn wait_for(&self, device: &str, status: DeviceStatus) {
        let what = format!("{device} {status}");
        self.wait(&what, |_| self.status(device) == status);
    }

    /// Measured position of a joint, rad.
    pub fn position(&self, arm: &str, joint: usize) -> f64 {
        let state = self.controller.arm_state(arm).unwrap();
        state.joints[joint].measured_position.unwrap_or(f64::NAN)
    }

    /// Position of a joint after it has been at rest for 250 ms, rad.
    pub fn at_rest(&self, arm: &str, joint: usize) -> f64 {
        let mut rest = (self.position(arm, joint), now());
        let until = rest.1 + Duration::from_secs(5);
        while now() < until.min(rest.1 + Duration::from_millis(250)) {
            std::thread::sleep(Duration::from_millis(5));
            let position = self.position(arm, joint);
            if (position - rest.0).abs() > 1e-4 {
                rest = (position, now());
            }
        }
        rest.0
    }

    /// Runs a net that moves a joint by half a radian within a second; returns the distance moved. Repeats if the
    /// arm was lost meanwhile: a host without `PREEMPT_RT` stalls for longer than a bus tolerates.
    pub fn swung(&self, arm: &str, joint: usize) -> f64 {
        let faults = || self.controller.arm_state(arm).unwrap().faults;
        for _ in 0..ATTEMPTS {
            let before = (self.position(arm, joint), faults());
            let net = self.load(&swing_joint(arm, joint, 1.0));
            // A net that cannot start because the arm was just lost is retried too.
            if self.controller.start_net(net).is_ok() {
                self.wait_for_end(net);
                let moved = self.at_rest(arm, joint) - before.0;
                if faults() == before.1 {
                    return moved;
                }
            }
            self.wait_for(arm, DeviceStatus::Operational);
        }
        panic!("{arm} was lost in each of {ATTEMPTS} attempts");
    }

    /// A running net that moves a joint for twenty seconds.
    pub fn swinging(&self, arm: &str, joint: usize) -> NetId {
        for _ in 0..ATTEMPTS {
            let before = self.position(arm, joint);
            let net = self.load(&swing_joint(arm, joint, 20.0));
            if self.controller.start_net(net).is_ok() {
                self.wait("the arm moving", |_| {
                    (self.position(arm, joint) - before).abs() > 0.001 || self.is_over(net)
                });
                if !self.is_over(net) {
                    return net;
                }
            }
            self.wait_for(arm, DeviceStatus::Operational);
        }
        panic!("{arm} was lost in each of {ATTEMPTS} attempts");
    }
}

/// Moves joint 6 of an arm by half a radian within `seconds`.
pub fn swing(robot: &str, seconds: f64) -> String {
    swing_joint(robot, 6, seconds)
}

/// Moves a joint of an arm by half a radian within `seconds`.
pub fn swing_joint(robot: &str, joint: usize, seconds: f64) -> String {
    format!(
        "{{true=Core::BooleanValue(Value='true'),past=Core::BooleanPre(inValue=true.outValue),
        first=Core::BooleanIsNull(inValue=past.outValue),
        monitor=RobotArm::JointMonitor(Robot='{robot}',Axis='{joint}'),
        start=Core::DoubleSnapshot(inSnapshot=first.outValue,inValue=monitor.outCommandedPosition),
        clock=Core::Clock(),part=Core::Interval(inValue=clock.outValue,Max='{seconds}'),
        smooth=Core::DoubleBezier(inValue=part.outValue,To='0.5'),
        target=Core::DoubleAdd(inFirst=start.outValue,inSecond=smooth.outValue),
        joint=RobotArm::JointPosition(inPosition=target.outValue,Robot='{robot}',Axis='{joint}'),
        error=Core::IntNetcommOut(inValue=joint.outError,Key='error'),
        cancel=Cancel(),done=Core::DoubleGreater(inFirst=clock.outValue,Second='{seconds}'),
        end=Core::BooleanOr(inFirst=cancel.outCancel,inSecond=done.outValue),
        outTerminate=end.outValue}}"
    )
}
