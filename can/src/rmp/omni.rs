//! The omnidirectional base of two RMP50 with mecanum wheels, one in front and one, reversed, at the back, each on its
//! own link. They move together: if one is not ready, both rest.
//!
//! With x ahead, y to the left and counter-clockwise rotation, R the radius of the wheels and l half
//! the length plus half the width between them, a wheel turns at
//! FL = (x - y - l w)/R, FR = (x + y + l w)/R, BL = (x + y - l w)/R, BR = (x - y + l w)/R.

use std::time::Duration;

use super::base::{Motion, Ramp, counts, frames_s};
use super::command::{TURN_MAX, VELOCITY_MAX};
use super::odometry::{Counter, Jump};
use super::{Channel, Driver, DriverConfig, Measurement, Odometer};
use crate::Frame;

/// Rates or angles of the four wheels: front left, front right, back left, back right; rad/s or rad.
pub type Wheels = [f64; 4];

/// The geometry of a base on four mecanum wheels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Radius of the wheels, m.
    pub radius: f64,
    /// Half the distance between left and right wheels plus half that between front and back, m.
    pub lever: f64,
}

impl Default for Geometry {
    /// Wheels of 8 inches, 0.622 m apart across and 0.337 m along.
    fn default() -> Self {
        Self {
            radius: 0.1016,
            lever: 0.311_15 + 0.168_275,
        }
    }
}

impl Geometry {
    /// Rates of the wheels for a velocity ahead and to the left, m/s, and a rotation, rad/s.
    pub fn wheels(&self, [x, y, rotation]: [f64; 3]) -> Wheels {
        let turn = self.lever * rotation;
        [x - y - turn, x + y + turn, x + y - turn, x - y + turn].map(|speed| speed / self.radius)
    }

    /// The velocity of the base that best fits these rates.
    pub fn velocity(&self, [fl, fr, bl, br]: Wheels) -> [f64; 3] {
        let quarter = self.radius / 4.0;
        [
            quarter * (fl + fr + bl + br),
            quarter * (-fl + fr + bl - br),
            quarter / self.lever * (-fl + fr - bl + br),
        ]
    }

    /// Deviation of the wheels from a motion without slip, in the unit of the wheels; 0: no slip.
    pub fn slip([fl, fr, bl, br]: Wheels) -> f64 {
        (fl + fr - bl - br) / 4.0
    }
}

/// Configuration of a base of two power bases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OmniConfig {
    /// Configuration of the drivers.
    pub driver: DriverConfig,
    /// Geometry of the wheels.
    pub geometry: Geometry,
    /// Displacement counts of a turn of a wheel by one radian.
    pub counts_per_radian: f64,
    /// Displacement counts per second that a count of velocity makes, at full scale.
    pub velocity_gain: f64,
    /// Displacement counts per second that a count of turn makes, at full scale; left forward,
    /// right backward.
    pub turn_gain: f64,
    /// Maximum acceleration, m/s².
    pub acceleration: f64,
    /// Maximum angular acceleration, rad/s².
    pub angular_acceleration: f64,
}

impl Default for OmniConfig {
    fn default() -> Self {
        let scales = super::Model::Rmp50.scales();
        Self {
            driver: DriverConfig {
                model: super::Model::Rmp50,
                ..DriverConfig::default()
            },
            geometry: Geometry::default(),
            counts_per_radian: 24_372.0 / std::f64::consts::TAU,
            velocity_gain: scales.displacement / scales.velocity,
            turn_gain: 22.0,
            acceleration: 1.0,
            angular_acceleration: 1.5,
        }
    }
}

/// The base.
#[derive(Clone, Debug)]
pub struct Omni {
    config: OmniConfig,
    drivers: [Driver; 2],
    counters: [[Counter; 2]; 2],
    jump: Option<Jump>,
    last: [Option<Measurement>; 2],
    /// Angles of the wheels since the start, as last reported and as last integrated.
    angles: Wheels,
    integrated: Wheels,
    /// Which power bases reported since the last integration.
    fresh: [bool; 2],
    rates: Wheels,
    velocity: [f64; 3],
    odometer: Odometer,
    motion: Motion,
}

/// The power base in front.
pub const FRONT: usize = 0;
/// The power base at the back, mounted reversed.
pub const BACK: usize = 1;

/// Tolerance of a wheel step against the measured speed, rad; larger deviations are rejected.
const JUMP_RAD: f64 = 2.0;

impl Omni {
    /// A base before the first message of its parts.
    pub fn new(config: OmniConfig) -> Self {
        Self {
            config,
            drivers: [(); 2].map(|()| Driver::new(config.driver)),
            counters: [[Counter::default(); 2]; 2],
            jump: None,
            last: [None; 2],
            angles: [0.0; 4],
            integrated: [0.0; 4],
            fresh: [false; 2],
            rates: [0.0; 4],
            velocity: [0.0; 3],
            odometer: Odometer::default(),
            motion: Motion::default(),
        }
    }

    /// The drivers of its power bases: [`FRONT`] and [`BACK`].
    pub const fn drivers(&self) -> &[Driver; 2] {
        &self.drivers
    }

    /// Its measured motion.
    pub const fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Angles of the wheels since the start, rad.
    pub const fn wheels(&self) -> &Wheels {
        &self.angles
    }

    /// Rates of the wheels, rad/s.
    pub const fn rates(&self) -> &Wheels {
        &self.rates
    }

    /// How far the wheels' rates are from a motion without slip, rad/s.
    pub fn slip(&self) -> f64 {
        Geometry::slip(self.rates)
    }

    /// Number of rejected wheel steps.
    pub fn jumps(&self) -> u64 {
        self.counters
            .as_flattened()
            .iter()
            .map(Counter::jumps)
            .sum()
    }

    /// The last of these steps.
    pub const fn jump(&self) -> Option<Jump> {
        self.jump
    }

    /// Whether both power bases follow commands.
    pub fn follows(&self) -> bool {
        self.drivers.iter().all(Driver::follows)
    }

    /// Handles a frame of [`FRONT`] or [`BACK`]; true if the motion was updated, which needs reports of both. Other
    /// parts are ignored.
    pub fn handle_frame(
        &mut self,
        part: usize,
        channel: Channel,
        frame: &Frame,
        now: Duration,
    ) -> bool {
        let driver = self.drivers.get_mut(part);
        let Some(measured) = driver.and_then(|driver| driver.handle_frame(channel, frame, now))
        else {
            return false;
        };
        self.measure(part, &measured);
        if self.fresh != [true; 2] {
            return false;
        }
        self.integrate(measured.stamp);
        true
    }

    /// The two power bases report at different times. Only complete pairs are integrated: one half alone would be a
    /// false turn with slip.
    fn measure(&mut self, part: usize, measured: &Measurement) {
        let config = &self.config;
        let speed_gain = config.driver.model.scales().displacement / config.counts_per_radian;
        let (Some(counters), Some(last)) = (self.counters.get_mut(part), self.last.get_mut(part))
        else {
            return;
        };
        let dt_s = last.map_or(0.0, |last| frames_s(&last, measured));
        *last = Some(*measured);
        let rates = measured.speed.map(|speed| speed * speed_gain);
        let mut steps = [0.0; 2];
        for (side, step) in steps.iter_mut().enumerate() {
            let expected = rates[side] * dt_s;
            let tolerance = JUMP_RAD + 2.0 * expected.abs();
            let scale = config.counts_per_radian;
            *step = counters[side].advance(
                measured.displacement[side],
                expected * scale,
                tolerance * scale,
            ) / scale;
            let jumped = counters[side].jump(scale / config.geometry.radius, false);
            self.jump = jumped.or(self.jump);
        }
        for (wheel, side, sign) in wheels_of(part) {
            self.angles[wheel] += sign * steps[side];
            self.rates[wheel] = sign * rates[side];
        }
        if let Some(fresh) = self.fresh.get_mut(part) {
            *fresh = true;
        }
    }

    fn integrate(&mut self, stamp: Duration) {
        let mut turned = self.angles;
        for (now, before) in turned.iter_mut().zip(&self.integrated) {
            *now -= before;
        }
        (self.integrated, self.fresh) = (self.angles, [false; 2]);
        self.odometer.add(self.config.geometry.velocity(turned));
        self.motion = Motion {
            stamp,
            pose: self.odometer.pose(),
            velocity: self.config.geometry.velocity(self.rates),
        };
    }

    /// Next time at which [`Self::poll_transmit`] has work for a part.
    pub fn poll_timeout(&self) -> Duration {
        let [front, back] = &self.drivers;
        front.poll_timeout().min(back.poll_timeout())
    }

    /// The due commands, towards a velocity ahead and to the left, m/s, and a rotation, rad/s. With `None`, and while a
    /// part is not ready, both rest. Velocities beyond the limit of a wheel are scaled for all four, so that the
    /// direction is kept.
    pub fn poll_transmit(&mut self, wanted: Option<[f64; 3]>, now: Duration) -> [Option<Frame>; 2] {
        if now < self.poll_timeout() {
            return [None; 2];
        }
        let follows = self.follows();
        self.advance(wanted.filter(|_| follows).unwrap_or_default());
        if !follows {
            self.velocity = [0.0; 3];
        }
        let resting = wanted.is_none() && self.velocity.iter().all(|rate| rate.abs() < 1e-9);
        let motions = self.counts();
        let mut frames = [None; 2];
        for ((driver, motion), frame) in self.drivers.iter_mut().zip(motions).zip(&mut frames) {
            driver.drive((!resting).then_some(motion));
            *frame = driver.poll_transmit(now);
        }
        frames
    }

    fn advance(&mut self, wanted: [f64; 3]) {
        let config = &self.config;
        let dt_s = config.driver.period.as_secs_f64();
        let limits = [
            config.acceleration,
            config.acceleration,
            config.angular_acceleration,
        ];
        for ((now, to), limit) in self.velocity.iter_mut().zip(wanted).zip(limits) {
            let to = if to.is_finite() { to } else { 0.0 };
            *now = Ramp::towards(limit, *now, to, dt_s);
        }
    }

    /// Factor, at most 1, by which a velocity must be scaled to be feasible for all wheels.
    pub fn reach(&self, velocity: [f64; 3]) -> f64 {
        1.0 / most(&self.motions(velocity))
    }

    /// Velocity and turn counts of each power base for a velocity.
    fn motions(&self, velocity: [f64; 3]) -> [[f64; 2]; 2] {
        let config = &self.config;
        let wheels = config.geometry.wheels(velocity);
        let mut motions = [[0.0; 2]; 2];
        for (part, motion) in motions.iter_mut().enumerate() {
            let mut sides = [0.0; 2];
            for (wheel, side, sign) in wheels_of(part) {
                sides[side] = sign * wheels[wheel] * config.counts_per_radian;
            }
            let [left, right] = sides;
            *motion = [
                (left + right) / 2.0 / config.velocity_gain,
                (left - right) / 2.0 / config.turn_gain,
            ];
        }
        motions
    }

    /// The same for its current velocity, scaled to the limits of the wheels.
    fn counts(&self) -> [[i16; 2]; 2] {
        let motions = self.motions(self.velocity);
        let most = most(&motions);
        motions.map(|[velocity, turn]| {
            [
                counts(velocity / most, VELOCITY_MAX),
                counts(turn / most, TURN_MAX),
            ]
        })
    }
}

/// Factor by which these counts exceed the limits of a power base; at least 1.
fn most(motions: &[[f64; 2]; 2]) -> f64 {
    let limits = [f64::from(VELOCITY_MAX), f64::from(TURN_MAX)];
    motions
        .iter()
        .flat_map(|motion| motion.iter().zip(&limits))
        .map(|(counts, limit)| counts.abs() / limit)
        .fold(1.0, f64::max)
}

/// The wheels of a power base: index among the four, own side, and counting direction. The one at the back is reversed:
/// its left is on the right, and its forward is backward.
pub(super) const fn wheels_of(part: usize) -> [(usize, usize, f64); 2] {
    match part {
        FRONT => [(0, 0, 1.0), (1, 1, 1.0)],
        _ => [(2, 1, -1.0), (3, 0, -1.0)],
    }
}
