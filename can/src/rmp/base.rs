//! One power base as a mobile base: velocities in, pose and measured velocity out, in SI units. Its
//! [`Driver`] handles the frames.

use std::time::Duration;

use super::command::{TURN_MAX, VELOCITY_MAX};
use super::model::COUNTS_PER_DEGREE;
use super::odometry::{Counter, Jump};
use super::{Channel, Driver, DriverConfig, Measurement, Odometer, Pose};
use crate::Frame;

/// Measured motion of a base.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Time of the measurement.
    pub stamp: Duration,
    /// Pose by wheel odometry.
    pub pose: Pose,
    /// Forward and left, m/s, and rotation, rad/s, counter-clockwise.
    pub velocity: [f64; 3],
}

/// A differential drive on one power base.
#[derive(Clone, Debug)]
pub struct Base {
    driver: Driver,
    config: DriverConfig,
    /// Current commanded velocity, m/s and rad/s, ramped towards the target.
    velocity: [f64; 2],
    ramp: Ramp,
    odometer: Odometer,
    counters: [Counter; 3],
    jump: Option<Jump>,
    last: Option<Measurement>,
    /// Distances travelled by the left and the right wheel, m.
    rolled: [f64; 2],
    motion: Motion,
    /// Rotation since the start by the yaw rate and by the integrated yaw, rad.
    turned: [f64; 2],
}

/// Acceleration limits of power bases, m/s² and rad/s². No manual of a power base states one; riders regard these as
/// gentle.
pub const ACCELERATION: [f64; 2] = [1.0, 1.5];

/// Acceleration limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ramp {
    /// Linear, m/s².
    pub(super) acceleration: f64,
    /// Angular, rad/s².
    pub(super) rotation: f64,
}

impl Ramp {
    /// Ramps a rate towards another within a time step.
    pub(super) fn towards(limit: f64, from: f64, to: f64, dt_s: f64) -> f64 {
        from + (to - from).clamp(-limit * dt_s, limit * dt_s)
    }
}

/// Tolerance of a displacement step against the measured speed, m; larger deviations are rejected.
const JUMP_M: f64 = 0.2;
/// Like [`JUMP_M`], for the heading, turns.
const JUMP_TURNS: f64 = 0.15;

/// A turn after which both measurements of it can be compared, rad.
const TURN_MIN: f64 = 1.0;

impl Base {
    /// A base with these limits of `acceleration`, m/s², and `angular_acceleration`, rad/s².
    pub fn new(config: DriverConfig, acceleration: f64, angular_acceleration: f64) -> Self {
        Self {
            driver: Driver::new(config),
            config,
            velocity: [0.0; 2],
            ramp: Ramp {
                acceleration,
                rotation: angular_acceleration,
            },
            odometer: Odometer::default(),
            counters: [Counter::default(); 3],
            jump: None,
            last: None,
            rolled: [0.0; 2],
            motion: Motion::default(),
            turned: [0.0; 2],
        }
    }

    /// The driver of its power base.
    pub const fn driver(&self) -> &Driver {
        &self.driver
    }

    /// Switches the power base off.
    pub const fn shut_down(&mut self) {
        self.driver.shut_down();
    }

    /// Its measured motion.
    pub const fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Angles of the left and the right wheel since the start, rad, and their rates, rad/s; the other two elements,
    /// used by the platform, are zero.
    pub fn wheels(&self) -> ([f64; 4], [f64; 4]) {
        let radius = self.config.model.wheel_radius();
        let [left, right] = self.rolled.map(|distance| distance / radius);
        let speed = self.last.map(|last| last.speed).unwrap_or_default();
        let [left_rate, right_rate] = speed.map(|speed| speed / radius);
        ([left, right, 0.0, 0.0], [left_rate, right_rate, 0.0, 0.0])
    }

    /// Number of rejected displacement steps: after reset integrators, or a power cycle of the power base.
    pub const fn jumps(&self) -> u64 {
        let [left, right, yaw] = &self.counters;
        left.jumps() + right.jumps() + yaw.jumps()
    }

    /// Whether the integrated yaw (404h) turned against the yaw rate (402h) so far: [`DriverConfig::yaw_integral`] is
    /// wrong for this base. Known after a turn of about a sixth of a revolution one way.
    pub fn yaw_contradicts(&self) -> bool {
        let [by_rate, by_integral] = self.turned;
        by_rate.abs() >= TURN_MIN
            && by_rate * by_integral < 0.0
            && by_integral.abs() > TURN_MIN / 2.0
    }

    /// The last of these steps.
    pub const fn jump(&self) -> Option<Jump> {
        self.jump
    }

    /// Handles a frame; true if the motion was updated.
    pub fn handle_frame(&mut self, channel: Channel, frame: &Frame, now: Duration) -> bool {
        let Some(measured) = self.driver.handle_frame(channel, frame, now) else {
            return false;
        };
        self.measure(&measured);
        true
    }

    fn measure(&mut self, measured: &Measurement) {
        let scales = self.config.model.scales();
        let dt_s = self.last.map_or(0.0, |last| frames_s(&last, measured));
        let [left, right] = measured.speed;
        let [l, r, yaw] = &mut self.counters;
        let wheel = |counter: &mut Counter, value: i32, speed: f64| {
            let expected = speed * dt_s * scales.displacement;
            let tolerance =
                (JUMP_M + 2.0 * expected.abs() / scales.displacement) * scales.displacement;
            counter.advance(value, expected, tolerance) / scales.displacement
        };
        let [at_left, at_right] = measured.displacement;
        let distances = [wheel(l, at_left, left), wheel(r, at_right, right)];
        for (rolled, distance) in self.rolled.iter_mut().zip(distances) {
            *rolled += distance;
        }
        let ahead = f64::midpoint(distances[0], distances[1]);
        let turns = -measured.yaw_rate * dt_s / std::f64::consts::TAU;
        let tolerance = (JUMP_TURNS + 2.0 * turns.abs()) * scales.yaw;
        let count = self.config.yaw_integral.clockwise(measured.travel[1]);
        let turned = yaw.advance(count, turns * scales.yaw, tolerance);
        let rotation = -turned / scales.yaw * std::f64::consts::TAU;
        self.turned[0] -= turns * std::f64::consts::TAU;
        self.turned[1] += rotation;
        let jumped = [
            l.jump(scales.displacement, false),
            r.jump(scales.displacement, false),
            yaw.jump(scales.yaw / std::f64::consts::TAU, true),
        ];
        self.jump = jumped.into_iter().flatten().next().or(self.jump);
        self.odometer.add([ahead, 0.0, rotation]);
        self.motion = Motion {
            stamp: measured.stamp,
            pose: self.odometer.pose(),
            velocity: [f64::midpoint(left, right), 0.0, measured.yaw_rate],
        };
        self.last = Some(*measured);
    }

    /// Next time at which [`Self::poll_transmit`] has work.
    pub const fn poll_timeout(&self) -> Duration {
        self.driver.poll_timeout()
    }

    /// The due command, towards a forward velocity, m/s, and a rotation, rad/s; with `None` the base decelerates to
    /// standstill.
    pub fn poll_transmit(&mut self, wanted: Option<[f64; 2]>, now: Duration) -> Option<Frame> {
        if now < self.driver.poll_timeout() {
            return None;
        }
        let dt_s = self.config.period.as_secs_f64();
        let [ahead, turn] = wanted
            .filter(|_| self.driver.follows())
            .unwrap_or_default()
            .map(|rate| if rate.is_finite() { rate } else { 0.0 });
        self.velocity = [
            Ramp::towards(self.ramp.acceleration, self.velocity[0], ahead, dt_s),
            Ramp::towards(self.ramp.rotation, self.velocity[1], turn, dt_s),
        ];
        if !self.driver.follows() {
            self.velocity = [0.0; 2];
        }
        let resting = wanted.is_none() && self.velocity.iter().all(|rate| rate.abs() < 1e-9);
        self.driver.drive((!resting).then(|| self.counts()));
        self.driver.poll_transmit(now)
    }

    /// Factor, at most 1, by which a forward velocity, m/s, and a rotation, rad/s, must be scaled to be feasible.
    pub fn reach(&self, velocity: [f64; 2]) -> f64 {
        let [ahead, turn] = self.exact_counts(velocity).map(f64::abs);
        let most = (ahead / f64::from(VELOCITY_MAX)).max(turn / f64::from(TURN_MAX));
        1.0 / most.max(1.0)
    }

    fn exact_counts(&self, [ahead, turn]: [f64; 2]) -> [f64; 2] {
        let velocity = ahead * self.config.model.scales().velocity;
        [velocity, -turn.to_degrees() * COUNTS_PER_DEGREE]
    }

    fn counts(&self) -> [i16; 2] {
        let [velocity, turn] = self.exact_counts(self.velocity);
        [counts(velocity, VELOCITY_MAX), counts(turn, TURN_MAX)]
    }
}

/// Time between two measurements by the clock of the device, s.
pub(super) fn frames_s(from: &Measurement, to: &Measurement) -> f64 {
    f64::from(to.frames.wrapping_sub(from.frames)) / 100.0
}

/// Rounds to counts and clamps to a limit.
pub(super) fn counts(value: f64, max: i16) -> i16 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "within the limit, which fits; NaN becomes 0"
    )]
    let counts = value.round().clamp(f64::from(-max), f64::from(max)) as i16;
    counts
}
