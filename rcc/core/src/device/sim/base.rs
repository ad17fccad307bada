//! A simulated base on four mecanum wheels. It follows velocities or poses within its speed and acceleration limits
//! and measures its motion exactly: wheels do not slip. When commands end it brakes to rest at its acceleration
//! limit.
//!
//! Parameters: `max_vel` (m/s, 0.8), `max_rot_vel` (rad/s, 0.8), `max_acc` (m/s², 1.6) and
//! `max_rot_acc` (rad/s², 1.6).

use takt_net::device::{Base, CartesianPosition, Interfaces, JointError, Layout};
use takt_net::value::{Frame, Rotation, Twist, Vector};
use takt_rt::Nanos;

use super::{Made, Parameters, Simulated, seconds};
use crate::device::last_stage::{PlanarLimits, PlanarStage};
use crate::device::rejected::{Cause, Rejection};
use crate::device::setpoint::{LOST_DISTANCE, START_DISTANCE};
use crate::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, Part, parts};
use crate::error::Error;

const WHEELS: usize = 4;
/// Radius of a wheel, m.
const RADIUS: f64 = 0.0475;
/// Half of length and width between wheels, m.
const LEVER: f64 = (0.47 + 0.30) / 2.0;

pub(super) fn youbot(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let limits = PlanarLimits {
        velocity: [
            parameters.positive("max_vel", 0.8)?,
            parameters.positive("max_rot_vel", 0.8)?,
        ],
        acceleration: [
            parameters.positive("max_acc", 1.6)?,
            parameters.positive("max_rot_acc", 1.6)?,
        ],
    };
    let [velocity_max, rotation_max] = limits.velocity;
    let [acceleration_max, rotation_acceleration_max] = limits.acceleration;
    let base = Part::Base {
        wheels: WHEELS,
        velocity_max,
        rotation_max,
        acceleration_max,
        rotation_acceleration_max,
    };
    let description = DeviceDescription {
        name: parameters.name.to_owned(),
        kind,
        limits: Vec::new(),
        model: "".into(),
        parts: vec![base, Part::CartesianPosition],
    };
    let mut layout = Layout::default();
    let interfaces = parts::lay(&description.parts, 0, &mut layout);
    let mut state = DeviceState::new(layout.signals);
    state.status = DeviceStatus::Operational;
    let mut mecanum = Mecanum {
        stage: PlanarStage::new(limits),
        interfaces,
        mode: Mode::Resting,
        goal: None,
        pose: [0.0; 3],
        wheels: [0.0; WHEELS],
        state,
    };
    mecanum.publish();
    Ok((description, Box::new(mecanum)))
}

/// Source of its motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// None: it rests or brakes.
    Resting,
    /// Velocities of a net.
    Velocity,
    /// Poses of a net.
    Pose,
    /// Poses out of reach, refused until they end.
    Refused,
}

/// A pose that a net commands.
#[derive(Clone, Copy, Debug)]
struct Goal {
    /// The cycle in which it was given.
    cycle: u64,
    pose: [f64; 3],
    /// Rate of the poses.
    speed: [f64; 3],
}

#[derive(Debug)]
struct Mecanum {
    stage: PlanarStage,
    interfaces: Interfaces,
    mode: Mode,
    /// x and y, m, and heading, rad, in the frame in which it started.
    pose: [f64; 3],
    /// The commanded pose.
    goal: Option<Goal>,
    /// Angles of the motors' shafts behind the gear, rad.
    wheels: [f64; WHEELS],
    state: DeviceState,
}

impl Simulated for Mecanum {
    fn step(&mut self, command: &DeviceCommand, dt: Nanos) {
        self.state.stamp = command.time;
        let dt_s = seconds(dt);
        if dt_s <= 0.0 {
            return;
        }
        let base = self.interfaces.base.as_ref();
        let velocity = base
            .and_then(|base| base.command.read(&command.words))
            .filter(|given| given.is_in_force(command.cycle))
            .map(|given| planar(&given.value));
        let cartesian = self.interfaces.cartesian.as_ref();
        let pose = cartesian
            .and_then(|cartesian| cartesian.command.read(&command.words))
            .filter(|given| given.is_in_force(command.cycle))
            .map(|given| {
                let age = command.cycle.saturating_sub(given.cycle);
                let left = given.every.max(1).saturating_sub(age).max(1);
                (given.cycle, flat(&given.value), left)
            });
        if pose.is_none() {
            self.goal = None;
        }
        match (velocity, pose) {
            (Some(velocity), _) => {
                self.mode = Mode::Velocity;
                self.stage.step(Some(velocity), |_| 1.0, dt_s);
            }
            (None, Some((cycle, pose, left))) => self.follow(cycle, pose, left, dt_s),
            (None, None) => {
                self.mode = Mode::Resting;
                self.stage.step(None, |_| 1.0, dt_s);
            }
        }
        self.advance(dt_s);
        self.publish();
    }

    fn state(&self) -> &DeviceState {
        &self.state
    }
}

impl Mecanum {
    /// Moves straight to a pose, to arrive when the next one is due in `left` cycles; refuses one that is too far
    /// away.
    #[expect(clippy::cast_precision_loss, reason = "a count of a few cycles")]
    fn follow(&mut self, cycle: u64, pose: [f64; 3], left: u64, dt_s: f64) {
        let goal = match self.goal {
            Some(last) if last.cycle == cycle => last,
            Some(last) => {
                let span_s = cycle.saturating_sub(last.cycle).max(1) as f64 * dt_s;
                let speed = offset(last.pose, pose).map(|offset| offset / span_s);
                Goal { cycle, pose, speed }
            }
            None => Goal {
                cycle,
                pose,
                // From the current pose.
                speed: offset(self.pose, pose).map(|offset| offset / (left as f64 * dt_s)),
            },
        };
        let first = self.goal.replace(goal).is_none();
        let ahead_s = (left - 1) as f64 * dt_s;
        let target: [f64; 3] = std::array::from_fn(|i| pose[i] - goal.speed[i] * ahead_s);
        let most = if first { START_DISTANCE } else { LOST_DISTANCE };
        let [x, y, turn] = offset(self.pose, if first { pose } else { target });
        let near = x.hypot(y) <= most && turn.abs() <= most;
        if self.mode == Mode::Refused || !near {
            if self.mode == Mode::Refused {
                self.state.rejected[0].repeat();
            } else {
                let cause = if first { Cause::Start } else { Cause::Lost };
                let rejection = Rejection {
                    cause,
                    wanted: x.hypot(y).max(turn.abs()),
                    actual: 0.0,
                    allowed: most,
                };
                self.state.rejected[0].begin(rejection);
            }
            self.mode = Mode::Refused;
            self.stage.step(None, |_| 1.0, dt_s);
            return;
        }
        self.mode = Mode::Pose;
        let offset = offset(self.pose, target);
        // In the frame at half of the turn.
        let (sin, cos) = (self.pose[2] + offset[2] / 2.0).sin_cos();
        let own = |[x, y, turn]: [f64; 3]| [cos * x + sin * y, cos * y - sin * x, turn];
        self.stage.track(own(offset), own(goal.speed), dt_s);
    }

    /// Integrates its velocity, with the heading at half of the step.
    fn advance(&mut self, dt_s: f64) {
        let [x, y, turn] = self.stage.velocity();
        let (sin, cos) = (self.pose[2] + turn * dt_s / 2.0).sin_cos();
        self.pose[0] += (cos * x - sin * y) * dt_s;
        self.pose[1] += (sin * x + cos * y) * dt_s;
        self.pose[2] += turn * dt_s;
        for (angle, rate) in self
            .wheels
            .iter_mut()
            .zip(wheel_rates(self.stage.velocity()))
        {
            *angle += rate * dt_s;
        }
    }

    fn publish(&mut self) {
        for (limited, held_back) in self.state.limited.iter_mut().zip(self.stage.limited()) {
            *limited = *held_back;
        }
        let signals = &mut self.state.signals;
        let [x, y, turn] = self.stage.velocity();
        let velocity = Twist {
            vel: Vector::new(x, y, 0.0),
            rot: Vector::new(0.0, 0.0, turn),
        };
        let rotation = Rotation::from_axis_angle(&Vector::z_axis(), self.pose[2]);
        let pose = Frame::from_parts([self.pose[0], self.pose[1], 0.0].into(), rotation);
        let (sin, cos) = self.pose[2].sin_cos();
        let in_place = Twist {
            vel: Vector::new(cos * x - sin * y, sin * x + cos * y, 0.0),
            rot: velocity.rot,
        };
        let error = match self.mode {
            Mode::Refused => JointError::Refused as i32,
            Mode::Resting | Mode::Velocity | Mode::Pose => JointError::None as i32,
        };
        if let Some(base) = &self.interfaces.base {
            report_base(base, signals, pose, velocity);
            for ((wheel, angle), rate) in base
                .wheels
                .iter()
                .zip(self.wheels)
                .zip(wheel_rates(self.stage.velocity()))
            {
                wheel.position.report(signals, Some(angle));
                wheel.velocity.report(signals, Some(rate));
            }
        }
        if let Some(cartesian) = &self.interfaces.cartesian {
            report_cartesian(cartesian, signals, pose, in_place, error);
        }
    }
}

fn report_base(base: &Base, signals: &mut [u64], pose: Frame, velocity: Twist) {
    // A refused pose is no fault of velocities.
    base.error.report(signals, Some(0));
    base.commanded.report(signals, Some(velocity));
    base.velocity.report(signals, Some(velocity));
    base.pose.report(signals, Some(pose));
}

fn report_cartesian(
    cartesian: &CartesianPosition,
    signals: &mut [u64],
    pose: Frame,
    velocity: Twist,
    error: i32,
) {
    cartesian.error.report(signals, Some(error));
    cartesian.commanded_position.report(signals, Some(pose));
    cartesian.measured_position.report(signals, Some(pose));
    cartesian.commanded_velocity.report(signals, Some(velocity));
    cartesian.measured_velocity.report(signals, Some(velocity));
}

/// Rates of the wheels, rad/s, in the drives' order (left and right in front, then behind) and in
/// their motors' sense: those of the left side are mirrored.
fn wheel_rates([x, y, turn]: [f64; 3]) -> [f64; WHEELS] {
    let turn = LEVER * turn;
    [-x + y + turn, x + y + turn, -x - y + turn, x - y + turn].map(|v| v / RADIUS)
}

fn planar(velocity: &Twist) -> [f64; 3] {
    [velocity.vel.x, velocity.vel.y, velocity.rot.z]
}

/// x, y and heading of a pose.
fn flat(pose: &Frame) -> [f64; 3] {
    let position = pose.translation.vector;
    let ahead = pose.rotation * Vector::x();
    [position.x, position.y, ahead.y.atan2(ahead.x)]
}

/// The offset from one pose to another, by the shorter turn.
fn offset(from: [f64; 3], to: [f64; 3]) -> [f64; 3] {
    [
        to[0] - from[0],
        to[1] - from[1],
        nearest_turn(to[2] - from[2]),
    ]
}

fn nearest_turn(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}
