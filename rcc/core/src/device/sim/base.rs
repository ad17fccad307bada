//! A simulated base on four mecanum wheels. It follows velocities within its speed and
//! acceleration, or poses within its speed, and measures exactly what it does: wheels do not slip. When
//! commands stop it brakes to rest at its acceleration.
//!
//! Parameters: `max_vel` (m/s, 0.8), `max_rot_vel` (rad/s, 0.8), `max_acc` (m/s², 1.6) and
//! `max_rot_acc` (rad/s², 1.6).

use takt_net::device::{Base, CartesianPosition, Interfaces, JointError, Layout};
use takt_net::value::{Frame, Rotation, Twist, Vector};
use takt_rt::Nanos;

use super::{Made, Parameters, Simulated, seconds};
use crate::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, Part, parts};
use crate::error::Error;

const WHEELS: usize = 4;
/// Radius of a wheel, m.
const RADIUS: f64 = 0.0475;
/// Half of length and width between wheels, m.
const LEVER: f64 = (0.47 + 0.30) / 2.0;
/// Farther from the base than this a first pose is refused, m and rad.
const START_DISTANCE: f64 = 0.02;
/// What rounding may add to a speed, as a factor.
const SPEED_SLACK: f64 = 1.001;

pub(super) fn youbot(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let limits = Limits {
        velocity: Planar {
            translation: parameters.positive("max_vel", 0.8)?,
            rotation: parameters.positive("max_rot_vel", 0.8)?,
        },
        acceleration: Planar {
            translation: parameters.positive("max_acc", 1.6)?,
            rotation: parameters.positive("max_rot_acc", 1.6)?,
        },
    };
    let base = Part::Base {
        wheels: WHEELS,
        velocity_max: limits.velocity.translation,
        rotation_max: limits.velocity.rotation,
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
        limits,
        interfaces,
        mode: Mode::Resting,
        pose: [0.0; 3],
        velocity: [0.0; 3],
        wheels: [0.0; WHEELS],
        state,
    };
    mecanum.tell();
    Ok((description, Box::new(mecanum)))
}

/// One bound for the plane and one for the rotation in it.
#[derive(Clone, Copy, Debug)]
struct Planar {
    translation: f64,
    rotation: f64,
}

#[derive(Clone, Copy, Debug)]
struct Limits {
    velocity: Planar,
    acceleration: Planar,
}

/// What moves it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// Nothing: it rests or brakes.
    Resting,
    /// A net gives velocities.
    Velocity,
    /// A net gives poses.
    Pose,
    /// Poses that it cannot follow, until they end.
    Refused,
}

#[derive(Debug)]
struct Mecanum {
    limits: Limits,
    interfaces: Interfaces,
    mode: Mode,
    /// x and y, m, and heading, rad, in the frame in which it started.
    pose: [f64; 3],
    /// In its own frame.
    velocity: [f64; 3],
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
            .filter(|given| given.stands(command.cycle))
            .map(|given| planar(&given.value));
        let cartesian = self.interfaces.cartesian.as_ref();
        let pose = cartesian
            .and_then(|cartesian| cartesian.command.read(&command.words))
            .filter(|given| given.stands(command.cycle))
            .map(|given| {
                let age = command.cycle.saturating_sub(given.cycle);
                let left = given.every.max(1).saturating_sub(age);
                (flat(&given.value), left)
            });
        match (velocity, pose) {
            (Some(velocity), _) => {
                self.mode = Mode::Velocity;
                self.accelerate(velocity, dt_s);
            }
            #[expect(clippy::cast_precision_loss, reason = "a count of a few cycles")]
            (None, Some((pose, left))) => self.follow(pose, dt_s, left.max(1) as f64),
            (None, None) => {
                self.mode = Mode::Resting;
                self.accelerate([0.0; 3], dt_s);
            }
        }
        self.advance(dt_s);
        self.tell();
    }

    fn state(&self) -> &DeviceState {
        &self.state
    }
}

impl Mecanum {
    /// Changes the velocity towards this one.
    fn accelerate(&mut self, wanted: [f64; 3], dt_s: f64) {
        let Planar {
            translation,
            rotation,
        } = self.limits.acceleration;
        let change = [0, 1, 2].map(|i| wanted[i] - self.velocity[i]);
        let planar = (translation * dt_s / change[0].hypot(change[1])).min(1.0);
        let turn = (rotation * dt_s / change[2].abs()).min(1.0);
        for (i, share) in [planar, planar, turn].into_iter().enumerate() {
            // No change at all makes the share no number or more than one.
            if share < 1.0 {
                self.velocity[i] += share * change[i];
            } else {
                self.velocity[i] = wanted[i];
            }
        }
    }

    /// Takes the speed that leads to a pose in the cycles left until the next one comes; refuses one
    /// that is too far away.
    fn follow(&mut self, pose: [f64; 3], dt_s: f64, left: f64) {
        let [x, y] = [pose[0] - self.pose[0], pose[1] - self.pose[1]];
        let turn = nearest_turn(pose[2] - self.pose[2]);
        let first = self.mode != Mode::Pose;
        let far = x.hypot(y) > START_DISTANCE || turn.abs() > START_DISTANCE;
        let span_s = dt_s * left;
        let Planar {
            translation,
            rotation,
        } = self.limits.velocity;
        let fast = x.hypot(y) > translation * span_s * SPEED_SLACK
            || turn.abs() > rotation * span_s * SPEED_SLACK;
        if self.mode == Mode::Refused || (far && (first || fast)) {
            self.mode = Mode::Refused;
            self.accelerate([0.0; 3], dt_s);
            return;
        }
        self.mode = Mode::Pose;
        // In the frame that the base has half-way, as it is moved on.
        let (sin, cos) = (self.pose[2] + turn / 2.0).sin_cos();
        let share = (translation * span_s / x.hypot(y)).min(1.0);
        let share = if share.is_nan() { 1.0 } else { share };
        self.velocity = [
            share * (cos * x + sin * y) / span_s,
            share * (cos * y - sin * x) / span_s,
            turn.clamp(-rotation * span_s, rotation * span_s) / span_s,
        ];
    }

    /// Moves on at its velocity, the heading taken in the middle of the step.
    fn advance(&mut self, dt_s: f64) {
        let [x, y, turn] = self.velocity;
        let (sin, cos) = (self.pose[2] + turn * dt_s / 2.0).sin_cos();
        self.pose[0] += (cos * x - sin * y) * dt_s;
        self.pose[1] += (sin * x + cos * y) * dt_s;
        self.pose[2] += turn * dt_s;
        for (angle, rate) in self.wheels.iter_mut().zip(wheel_rates(self.velocity)) {
            *angle += rate * dt_s;
        }
    }

    fn tell(&mut self) {
        let signals = &mut self.state.signals;
        let velocity = Twist {
            vel: Vector::new(self.velocity[0], self.velocity[1], 0.0),
            rot: Vector::new(0.0, 0.0, self.velocity[2]),
        };
        let rotation = Rotation::from_axis_angle(&Vector::z_axis(), self.pose[2]);
        let pose = Frame::from_parts([self.pose[0], self.pose[1], 0.0].into(), rotation);
        let (sin, cos) = self.pose[2].sin_cos();
        let [x, y, _] = self.velocity;
        let in_place = Twist {
            vel: Vector::new(cos * x - sin * y, sin * x + cos * y, 0.0),
            rot: velocity.rot,
        };
        let error = match self.mode {
            Mode::Refused => JointError::Refused as i32,
            Mode::Resting | Mode::Velocity | Mode::Pose => JointError::None as i32,
        };
        if let Some(base) = &self.interfaces.base {
            tell_base(base, signals, pose, velocity);
            for ((wheel, angle), rate) in base
                .wheels
                .iter()
                .zip(self.wheels)
                .zip(wheel_rates(self.velocity))
            {
                wheel.position.tell(signals, Some(angle));
                wheel.velocity.tell(signals, Some(rate));
            }
        }
        if let Some(cartesian) = &self.interfaces.cartesian {
            tell_cartesian(cartesian, signals, pose, in_place, error);
        }
    }
}

fn tell_base(base: &Base, signals: &mut [u64], pose: Frame, velocity: Twist) {
    // A pose that it refuses is no fault of velocities.
    base.error.tell(signals, Some(0));
    base.commanded.tell(signals, Some(velocity));
    base.velocity.tell(signals, Some(velocity));
    base.pose.tell(signals, Some(pose));
}

fn tell_cartesian(
    cartesian: &CartesianPosition,
    signals: &mut [u64],
    pose: Frame,
    velocity: Twist,
    error: i32,
) {
    cartesian.error.tell(signals, Some(error));
    cartesian.commanded_position.tell(signals, Some(pose));
    cartesian.measured_position.tell(signals, Some(pose));
    cartesian.commanded_velocity.tell(signals, Some(velocity));
    cartesian.measured_velocity.tell(signals, Some(velocity));
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

fn nearest_turn(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}
