//! A simulated gripper with commands of its own, as a Schunk WSG: its fingers move within speed and acceleration and
//! meet a part, if there is one. It needs no homing; the emulator of the real one is in the driver's crate.
//!
//! Parameters: `stroke` (m, 0.11), `max_acc` (m/s², 5), `part` (m, the width of a part between the fingers; none without
//! it).

use takt_net::JointLimits;
use takt_net::device::{Answer, Given, GripperCommand, Layout, ServoGripper};
use takt_rt::Nanos;

use super::{Made, Parameters, Simulated, seconds};
use crate::device::last_stage::LastStage;
use crate::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, Part};
use crate::error::Error;

/// That of a WSG 50-110.
const STROKE: f64 = 0.110;
const ACCELERATION_MAX: f64 = 5.0;
/// Largest relative speed of the fingers, m/s.
const SPEED_MAX: f64 = 0.42;
/// Largest force, and the one after the start, N.
const FORCE_MAX: f64 = 80.0;
const FORCE: f64 = 40.0;
/// A part this much narrower than expected is none, m.
const CLAMPING_TRAVEL: f64 = 0.005;
/// Fingers this near have arrived, m.
const ARRIVED: f64 = 1e-6;

/// Numbers of commands and states, as in the gripper's protocol.
mod protocol {
    pub(super) const HOMING: i32 = 0x20;
    pub(super) const PREPOSITION: i32 = 0x21;
    pub(super) const STOP: i32 = 0x22;
    pub(super) const GRASP: i32 = 0x25;
    pub(super) const RELEASE: i32 = 0x26;
    pub(super) const SET_FORCE_LIMIT: i32 = 0x32;
    pub(super) const SET_SOFT_LIMITS: i32 = 0x34;
    pub(super) const CLEAR_SOFT_LIMITS: i32 = 0x36;

    pub(super) const IDLE: i32 = 0;
    pub(super) const GRASPING: i32 = 1;
    pub(super) const NO_PART: i32 = 2;
    pub(super) const HOLDING: i32 = 4;
    pub(super) const RELEASING: i32 = 5;
    pub(super) const POSITIONING: i32 = 6;

    pub(super) const SUCCESS: i32 = 0;
    pub(super) const CMD_FAILED: i32 = 18;
    pub(super) const CMD_ABORTED: i32 = 19;
    pub(super) const RANGE: i32 = 28;
    pub(super) const AXIS_BLOCKED: i32 = 29;
}

pub(super) fn wsg(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let stroke = parameters.positive("stroke", STROKE)?;
    let limits = JointLimits {
        position_min: 0.0,
        position_max: stroke,
        velocity_max: SPEED_MAX,
        acceleration_max: parameters.positive("max_acc", ACCELERATION_MAX)?,
    };
    let part = match parameters.texts.get("part") {
        Some(_) => Some(parameters.positive("part", stroke)?),
        None => None,
    };
    let description = DeviceDescription {
        name: parameters.name.to_owned(),
        kind,
        limits: Vec::new(),
        model: "".into(),
        parts: vec![Part::ServoGripper],
    };
    let mut layout = Layout::default();
    let gripper = ServoGripper::new(&mut layout);
    let mut state = DeviceState::new(layout.signals);
    state.status = DeviceStatus::Operational;
    let mut stage = LastStage::new(limits);
    stage.rest_at(stroke);
    let mut fingers = Fingers {
        gripper,
        stage,
        stroke,
        part,
        soft_limits: [0.0, stroke],
        force: FORCE,
        grasping: protocol::IDLE,
        given: 0,
        motion: None,
        state,
    };
    fingers.publish();
    Ok((description, Box::new(fingers)))
}

/// A motion to a width.
#[derive(Clone, Copy, Debug)]
struct Motion {
    order: u64,
    id: i32,
    target: f64,
    speed: f64,
}

#[derive(Debug)]
struct Fingers {
    gripper: ServoGripper,
    stage: LastStage,
    stroke: f64,
    part: Option<f64>,
    soft_limits: [f64; 2],
    force: f64,
    grasping: i32,
    /// Number of the last command.
    given: u64,
    motion: Option<Motion>,
    state: DeviceState,
}

impl Simulated for Fingers {
    fn step(&mut self, command: &DeviceCommand, dt: Nanos) {
        self.state.stamp = command.time;
        if let Some(given) = self.gripper.order.command.read(&command.words) {
            self.take(&given);
        }
        self.advance(seconds(dt));
        self.publish();
    }

    fn state(&self) -> &DeviceState {
        &self.state
    }
}

impl Fingers {
    fn take(&mut self, given: &Given<GripperCommand>) {
        let moves = self
            .motion
            .is_some_and(|motion| motion.order == given.cycle);
        if given.is_withdrawn() && moves {
            self.finish(given.cycle, protocol::IDLE, protocol::CMD_ABORTED);
        }
        if given.cycle == self.given || given.is_withdrawn() {
            return;
        }
        self.given = given.cycle;
        if let Some(status) = self.begin(given.cycle, &given.value) {
            self.answer(given.cycle, status);
        }
    }

    /// Executes a command, or begins a motion; the status of what is executed at once.
    fn begin(&mut self, order: u64, command: &GripperCommand) -> Option<i32> {
        let motion = |target: f64, speed: f64| Motion {
            order,
            id: command.id,
            target,
            speed,
        };
        let (first, second) = (command.first, command.second);
        let (width, ..) = self.stage.motion();
        let (motion, grasping) = match command.id {
            protocol::HOMING if command.options == 2 => (motion(0.0, SPEED_MAX), protocol::IDLE),
            protocol::HOMING => (motion(self.stroke, SPEED_MAX), protocol::IDLE),
            protocol::PREPOSITION => {
                let from = if command.options & 1 != 0 { width } else { 0.0 };
                (motion(from + first, second), protocol::POSITIONING)
            }
            protocol::GRASP => {
                let target = (first - CLAMPING_TRAVEL).max(0.0);
                (motion(target, second), protocol::GRASPING)
            }
            protocol::RELEASE => (motion(first, second), protocol::RELEASING),
            protocol::STOP => {
                self.motion = None;
                return Some(protocol::SUCCESS);
            }
            other => return Some(self.set(other, first, second)),
        };
        let [inner, outer] = self.soft_limits;
        let is_homing = command.id == protocol::HOMING;
        let in_range = is_homing || (inner..=outer).contains(&motion.target);
        if !in_range || !(0.0..=SPEED_MAX).contains(&motion.speed) || motion.speed <= 0.0 {
            return Some(protocol::RANGE);
        }
        self.stage.begin_quietly(self.stroke);
        self.grasping = grasping;
        self.motion = Some(motion);
        None
    }

    fn set(&mut self, id: i32, first: f64, second: f64) -> i32 {
        match id {
            protocol::SET_FORCE_LIMIT => self.force = first.clamp(0.0, FORCE_MAX),
            protocol::SET_SOFT_LIMITS if first < second && second <= self.stroke => {
                self.soft_limits = [first, second];
            }
            protocol::SET_SOFT_LIMITS => return protocol::RANGE,
            protocol::CLEAR_SOFT_LIMITS => self.soft_limits = [0.0, self.stroke],
            // The acceleration is that of the parameters.
            _ => {}
        }
        protocol::SUCCESS
    }

    fn advance(&mut self, dt_s: f64) {
        let Some(motion) = self.motion else {
            self.stage.brake(dt_s);
            return;
        };
        let (before, ..) = self.stage.motion();
        let step = motion.speed * dt_s;
        let next = before + (motion.target - before).clamp(-step, step);
        let width = self.stage.track(next, 0.0, dt_s);
        let blocked = self.part.filter(|part| width < *part && before >= *part);
        if let Some(part) = blocked {
            self.stage.rest_at(part);
            let (grasping, status) = if motion.id == protocol::GRASP {
                (protocol::HOLDING, protocol::SUCCESS)
            } else {
                (protocol::IDLE, protocol::AXIS_BLOCKED)
            };
            self.finish(motion.order, grasping, status);
        } else if (width - motion.target).abs() <= ARRIVED {
            let (grasping, status) = if motion.id == protocol::GRASP {
                (protocol::NO_PART, protocol::CMD_FAILED)
            } else {
                (protocol::IDLE, protocol::SUCCESS)
            };
            self.finish(motion.order, grasping, status);
        }
    }

    fn finish(&mut self, order: u64, grasping: i32, status: i32) {
        self.motion = None;
        self.grasping = grasping;
        self.answer(order, status);
    }

    fn answer(&mut self, order: u64, error: i32) {
        let answer = Some(Answer { order, error });
        let signals = &mut self.state.signals;
        self.gripper.order.answer.report(signals, answer);
    }

    fn publish(&mut self) {
        let (width, speed, _) = self.stage.motion();
        let holds = self.grasping == protocol::HOLDING;
        let force = if holds { self.force } else { 0.0 };
        self.state.limited[0] = *self.stage.limited();
        let (gripper, signals) = (self.gripper, &mut self.state.signals);
        gripper.ready.report(signals, Some(true));
        gripper.width.report(signals, Some(width));
        gripper.speed.report(signals, Some(speed));
        gripper.force.report(signals, Some(force));
        gripper.grasping.report(signals, Some(self.grasping));
    }
}
