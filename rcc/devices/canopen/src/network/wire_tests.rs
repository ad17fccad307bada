//! What leaves for drives on an emulated CANopen network, RPDO by RPDO and in virtual time: while nets give set-points on
//! triangles that no joint can turn on, and when the net that moves a joint ends. All is read from the bytes of 607Ah.

use std::sync::MutexGuard;

use takt_can::AnyFrame;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::cia402::emulator::DriveConfig;
use takt_can::link::{Link, LinkError, Received};
use takt_rt::latest::{LatestReader, LatestWriter, latest};

use super::*;
use crate::plant::{Plant, Row, Wire, joint};
use takt_core::device::driver::DeviceEnd;
use takt_core::device::{ARM_JOINTS_MAX, DeviceCommand, DeviceState, DeviceStatus, SetPoint};
use takt_device_drives::DriveArm;
use takt_net::JointState;

const CYCLE: Duration = Duration::from_millis(4);
/// Increments of a turn of a joint.
const TURN: f64 = 4096.0 * 100.0;
const STEP: f64 = std::f64::consts::TAU / TURN;
const ACCELERATION: f64 = 230.0;
const VELOCITY: f64 = 100.0;
/// RPDO 1 of node 1: 6040h, 6060h, then 607Ah.
const RPDO: u32 = 0x201;
const TARGET: usize = 3;

fn config() -> CanopenConfig {
    let joint = |drive| DriveJoint {
        drive,
        axis: 0,
        increments_per_turn: TURN,
        zero: 0.0,
        range: [-170.0, 170.0],
        velocity_max: VELOCITY,
        acceleration_max: ACCELERATION,
        following_error_max: None,
        rated_torque: None,
        not_mirrored: Vec::new(),
        quirks: Vec::new(),
    };
    CanopenConfig {
        name: "network".to_owned(),
        interface: "none".to_owned(),
        cycle: CYCLE,
        priority: None,
        cpus: Vec::new(),
        thread: None,
        master: 127,
        heartbeat: None,
        on_link_loss: LinkLoss::default(),
        arms: vec![DriveArm {
            name: "arm".to_owned(),
            model: "".into(),
            joints: vec![joint(1), joint(2)],
            recovery: Recovery::default(),
            feed_forward: 0.0,
            down: Default::default(),
            payload: Default::default(),
            tools: Default::default(),
        }],
    }
}

/// Keeps what is sent until the nodes take it.
#[derive(Clone, Debug, Default)]
struct Near(Arc<Mutex<Vec<takt_can::Frame>>>);

impl Near {
    fn frames(&self) -> MutexGuard<'_, Vec<takt_can::Frame>> {
        self.0.lock().unwrap()
    }
}

impl Link for Near {
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError> {
        self.frames().extend(frame.classic());
        Ok(())
    }

    fn receive(&mut self, _timeout: Duration) -> Result<Option<Received>, LinkError> {
        Ok(None)
    }
}

/// The driver, its link and the nodes.
pub(super) struct Bench {
    driver: Driver,
    near: Near,
    pub(super) nodes: Vec<DriveNode>,
    command: LatestWriter<DeviceCommand>,
    state: LatestReader<DeviceState>,
    pub(super) given: DeviceCommand,
    pub(super) now: Nanos,
    tick: u64,
    is_led: bool,
    is_ending: bool,
    /// 607Ah as it left last, increments.
    target: i32,
}

impl Bench {
    fn new() -> Self {
        Self::of(&config(), |_| {})
    }

    /// With the arm of that network, whose joints are axes 0 of nodes 1, 2 and so on, operational.
    pub(super) fn of(config: &CanopenConfig, adapt: impl Fn(&mut DriveConfig)) -> Self {
        let network = network(config).unwrap();
        let count = u8::try_from(config.arms[0].joints.len()).unwrap();
        let (driver_state, state) = latest(1, || DeviceState::new(200));
        let (command, driver_command) = latest(1, DeviceCommand::default);
        let end = DeviceEnd {
            state: driver_state,
            command: driver_command,
            net_period: Duration::from_millis(1),
        };
        let id = |raw| NodeId::new(raw).unwrap();
        let axes = (1..=count).map(|raw| Reached::new(&network, id(raw), 0).unwrap());
        let axes = axes.collect();
        let arm = Arm::new(&config.arms[0], config.cycle, end, bus_figures());
        let (events, _) = ring(EVENTS_MAX);
        let near = Near::default();
        let node = |raw| {
            let mut node = DriveNodeConfig::new(id(raw));
            let axis = &mut node.axes[0];
            axis.quirks.missing_set_points = None;
            (axis.motor.negative_limit, axis.motor.positive_limit) = (-1e3, 1e3);
            axis.motor.stops = (-2e3, 2e3);
            adapt(axis);
            DriveNode::power_on(node, Duration::ZERO).unwrap()
        };
        let (load, of_bus) = LoadMeter::new(&near, "near");
        let mut bench = Self {
            driver: Driver {
                load,
                of_bus: bus::BusLoad::new(of_bus),
                link: Box::new(near.clone()),
                network,
                arms: vec![(arm, axes)],
                events,
                cycle: config.cycle,
                started: false,
                shared: Arc::default(),
                errors: Arc::default(),
                stop_by: None,
            },
            near,
            nodes: (1..=count).map(node).collect(),
            command,
            state,
            given: DeviceCommand::default(),
            now: Nanos(0),
            tick: 0,
            is_led: false,
            is_ending: false,
            target: 0,
        };
        for _ in 0..5_000 {
            bench.cycle();
            if bench.status() == DeviceStatus::Operational {
                return bench;
            }
        }
        panic!("not operational");
    }

    pub(super) fn joints(&mut self) -> [JointState; ARM_JOINTS_MAX] {
        self.state.read_with(|state| state.joints)
    }

    pub(super) fn signals(&mut self) -> Vec<u64> {
        self.state.read_with(|state| state.signals.to_vec())
    }

    pub(super) fn status(&mut self) -> DeviceStatus {
        self.state.read_with(|state| state.status)
    }

    /// Delivers frames and all answers to them until none is left.
    fn exchange(&mut self, now: Duration) {
        for _ in 0..64 {
            let frames = std::mem::take(&mut *self.near.frames());
            let mut is_quiet = frames.is_empty();
            for frame in &frames {
                if frame.id().raw() == RPDO {
                    let target = frame.data()[TARGET..].first_chunk().unwrap();
                    self.target = i32::from_le_bytes(*target);
                }
                for node in &mut self.nodes {
                    node.handle_frame(frame, now);
                }
            }
            for node in &mut self.nodes {
                while let Some(frame) = node.poll_transmit(now) {
                    is_quiet = false;
                    self.driver.network.handle_frame(&frame, now);
                }
            }
            if let Some(frame) = self.driver.network.poll_service(now) {
                is_quiet = false;
                self.driver.send(frame);
            }
            if is_quiet {
                return;
            }
        }
    }

    pub(super) fn cycle(&mut self) {
        let cycle = self.driver.cycle;
        self.tick += 1;
        self.now += cycle.into();
        let now = self.now;
        let tick = Tick {
            index: self.tick,
            missed: 0,
            time: now,
            scheduled: now,
            woken: now,
            phase_error: None,
        };
        if !self.is_led {
            (self.given.time, self.given.cycle) = (now, self.tick);
        }
        let given = &self.given;
        self.command.write_with(|command| command.copy_from(given));
        let begin = since_start(now);
        self.driver.send_cycle(begin);
        self.exchange(begin);
        self.exchange(begin + cycle / 2);
        let _ = self.driver.lead(&tick, self.is_ending);
    }

    fn sent(&self) -> f64 {
        f64::from(self.target) * STEP
    }
}

impl Plant for Bench {
    fn now(&self) -> Nanos {
        self.now
    }

    fn run_to(&mut self, until: Nanos, given: &DeviceCommand, is_ending: bool) {
        (self.is_led, self.is_ending) = (true, is_ending);
        self.given.copy_from(given);
        while self.now + CYCLE.into() <= until {
            self.cycle();
        }
    }

    fn copy_state(&mut self, state: &mut DeviceState) {
        self.state.read_with(|reported| state.copy_from(reported));
    }

    fn sent(&mut self) -> f64 {
        Self::sent(self)
    }

    fn place(&mut self) -> f64 {
        let axis = self.nodes[0].application().axis(0).unwrap();
        axis.motor().position / 100.0
    }

    /// The drive of the other joint has a fault: this one brakes.
    fn fail(&mut self, is_on: bool) {
        let axis = self.nodes[1].application_mut().axis_mut(0).unwrap();
        axis.dc_link = if is_on { 0.0 } else { 48.0 };
    }
}

#[test]
fn canopen_net_ends_rpdos_rest_within_stopping_time() {
    let row = Row {
        name: "CiA 402 over CANopen",
        description: describe(&config()).swap_remove(0),
        children: joint(0, [0.5, -0.5]),
        runs: 260,
        wire: Wire::Positions,
        acceleration: ACCELERATION.to_radians(),
        resolution: 2.0 * STEP,
        latency: CYCLE * 4,
        creep: 1e-3,
        without: |_, _| None,
    };
    row.comes_to_rest(Bench::new);
}

/// Rates between values that left so many cycles apart.
fn rates(values: &[f64], span: usize) -> Vec<f64> {
    #[expect(clippy::cast_precision_loss, reason = "a few cycles")]
    let span_s = span as f64 * CYCLE.as_secs_f64();
    let windows = values.windows(span + 1);
    windows.map(|w| (w[span] - w[0]) / span_s).collect()
}

fn most(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most, one| most.max(one.abs()))
}

#[test]
fn canopen_triangles_leave_in_rpdos_within_limits() {
    let dt_s = CYCLE.as_secs_f64();
    for every in [1_u32, 5, 25, 250] {
        let mut bench = Bench::new();
        let start = bench.sent();
        let mut left = Vec::new();
        for n in 0..2_000 {
            if n % every == 0 {
                let phase = f64::from(n) * dt_s % 4.0;
                let profile = if phase < 2.0 { phase } else { 4.0 - phase };
                let time = bench.now + CYCLE.into();
                let set_points = &mut bench.given.joints[0];
                set_points.period = Nanos(Nanos::from(CYCLE).0 * i64::from(every));
                let position = start + 0.7 * profile;
                set_points.advance(Some(SetPoint { time, position }));
            }
            bench.cycle();
            left.push(bench.sent());
        }
        assert_eq!(bench.status(), DeviceStatus::Operational);
        let limit = ACCELERATION.to_radians() * 1.001;
        for span in [1, 16] {
            // Of targets in whole increments.
            let coarse = 2.0 * STEP / (dt_s * dt_s) / f64::from(span) / f64::from(span);
            let span = usize::try_from(span).unwrap();
            let speeds = rates(&left, span);
            let (fastest, hardest) = (most(&speeds), most(&rates(&speeds, span)));
            assert!(hardest <= limit + coarse, "every {every}: {hardest} rad/s²");
            assert!(
                fastest <= VELOCITY.to_radians() + STEP / dt_s,
                "every {every}: {fastest} rad/s"
            );
            assert!(fastest > 0.2, "every {every}: it moves");
        }
    }
}
