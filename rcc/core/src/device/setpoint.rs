//! From set-points to what a joint is told in each cycle of its own clock: interpolated between
//! set-points, within the joint's limits, and braked when they stop coming. No clock is read here.
//!
//! ```text
//!            (1) first set-point, near                (2) caught up
//!   Held ─────────────────────────────▶ Approach ──────────────────────▶ Follow
//!    ▲ ▲                                 │  │  ▲ (3) a step beyond the limits │
//!    │ └─(4) none or stale ──────────────┘  │  └────────────────────────────┘ │
//!    └───(4)────────────────────────────────┼─────────────────────────────────┘
//!            (5) too far away               ▼
//!   Refused ◀───────────────────────────────┘     Refused ──(6) set-points end──▶ Held
//! ```
//! All transitions are made in [`Joint::sample`]: 1 and 5 in `begin`, 2, 3 and 5 in `approach` and
//! `follow`, 4 and 6 at the top. One sample may make several: a first set-point right where the
//! joint is leads from Held to Follow, one that is too far away from Held or Follow to Refused.
//!
//! Speed and range are kept in all modes. Acceleration is limited in all; in Follow, where set-points are taken as they
//! are, by what a stream within the joint's acceleration may look like: set-points lie a period of their net apart,
//! fall anywhere into the joint's cycles, and the clock by which they are played wanders. A stream beyond that, or a
//! clock that is set anew, is approached. Before the end of its range a joint brakes in time, whatever its set-points
//! want: it never moves faster than it can still stop, so that it comes to the very end within its acceleration, or
//! gives up on set-points that get too far ahead of it meanwhile (5).

use takt_net::JointLimits;
use takt_net::device::JointError;
use takt_rt::Nanos;

use crate::device::{JointSetPoints, SetPoint};

/// Farther from the joint than this, a first set-point is refused, rad.
const START_DISTANCE_RAD: f64 = 0.02;
/// Farther behind its set-points than this, a joint gives up, rad.
const LOST_DISTANCE_RAD: f64 = 0.2;
/// Part of the largest speed that a joint takes: a robot's own guard sees it rounded to single precision, and
/// in some of its cycles a little more than interpolation meant.
const SPEED_SHARE: f64 = 0.998;
/// Nearer than this is arrived, rad: below the resolution of a single-precision datagram.
const ARRIVED_RAD: f64 = 1e-7;
/// Slower than this is at rest, rad/s.
const RESTING_RAD_PER_S: f64 = 1e-7;
/// Share of a joint's acceleration that catching up uses by itself; the rest is for following
/// set-points that accelerate meanwhile.
const APPROACH_SHARE: f64 = 0.5;

/// How much of the joint's acceleration a stream may show over a cycle and a period: nets that keep the limit do so by
/// their own differences, which are others than those of the joint's cycles.
const FOLLOW_SHARE: f64 = 1.25;
/// By how much of a step the clock by which set-points are played may wander from one cycle to the next. Clocks of
/// robots and buses are followed to a few microseconds a period.
const WANDER_SHARE: f64 = 0.01;

/// What a joint does at the moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// It rests, or brakes to rest.
    Held,
    /// It moves to its set-points within its limits.
    Approach,
    /// It is where its set-points say.
    Follow,
    /// It rests because its set-points are out of reach, until they end.
    Refused,
}

/// One joint.
#[derive(Clone, Copy, Debug)]
pub struct Joint {
    limits: JointLimits,
    mode: Mode,
    position: f64,
    velocity: f64,
    acceleration: f64,
}

impl Joint {
    /// A joint at rest at zero. Its largest speed and acceleration are above zero.
    #[must_use]
    pub const fn new(limits: JointLimits) -> Self {
        Self {
            limits,
            mode: Mode::Held,
            position: 0.0,
            velocity: 0.0,
            acceleration: 0.0,
        }
    }

    /// A joint that moves, and brakes: its set-points are refused until they end.
    #[must_use]
    pub const fn refused(limits: JointLimits, position: f64, velocity: f64) -> Self {
        Self {
            mode: Mode::Refused,
            position,
            velocity,
            ..Self::new(limits)
        }
    }

    /// The robot is not ours to move: it rests at `position`. Set-points that come meanwhile are
    /// refused until they end, so that nothing moves by itself when the robot comes back.
    pub const fn rest_at(&mut self, position: f64, set_points: &JointSetPoints) {
        self.mode = if set_points.active {
            Mode::Refused
        } else {
            Mode::Held
        };
        self.position = position;
        self.velocity = 0.0;
        self.acceleration = 0.0;
    }

    /// The position for the instant `at`, `dt_s` after the last one. `fresh` is whether the net
    /// thread is alive. Without time passing nothing changes.
    pub fn sample(
        &mut self,
        set_points: &JointSetPoints,
        fresh: bool,
        at: Nanos,
        dt_s: f64,
    ) -> f64 {
        if dt_s <= 0.0 {
            return self.position;
        }
        let before = (self.position, self.velocity);
        let (wanted, speed) = interpolate(set_points, at);
        // What lies beyond the last set-point may be out of range even if that is not; nothing goes on there.
        let target = wanted
            .max(self.limits.position_min)
            .min(self.limits.position_max);
        let speed = if (target - wanted).abs() > 0.0 {
            0.0
        } else {
            speed
        };
        match self.mode {
            // Also the way out of Refused.
            _ if !set_points.active => self.brake(dt_s, Mode::Held),
            Mode::Refused => self.brake(dt_s, Mode::Refused),
            _ if !fresh => self.brake(dt_s, Mode::Held),
            Mode::Held => self.begin(target, speed, dt_s),
            Mode::Approach => self.approach(target, speed, dt_s),
            Mode::Follow => self.follow(target, speed, set_points.period, dt_s),
        }
        self.position = self.in_range(self.position, before.0);
        self.velocity = (self.position - before.0) / dt_s;
        self.acceleration = (self.velocity - before.1) / dt_s;
        self.position
    }

    /// Lowest and highest speed of the next step: within the joint's, and such that it can still stop in its range.
    fn speeds(&self, dt_s: f64) -> [f64; 2] {
        let JointLimits {
            position_min,
            position_max,
            velocity_max,
            acceleration_max,
        } = self.limits;
        let fastest = velocity_max * SPEED_SHARE;
        let before = |room: f64| stopping_speed(room.max(0.0), acceleration_max, dt_s).min(fastest);
        [
            -before(self.position - position_min),
            before(position_max - self.position),
        ]
    }

    /// The nearest to `position` in the range, which is as wide as to hold `present` too: a joint that stands beyond its
    /// range stays there or comes back.
    fn in_range(&self, position: f64, present: f64) -> f64 {
        let JointLimits {
            position_min,
            position_max,
            ..
        } = self.limits;
        position
            .max(position_min.min(present))
            .min(position_max.max(present))
    }

    fn begin(&mut self, target: f64, speed: f64, dt_s: f64) {
        let near = (target - self.position).abs() <= START_DISTANCE_RAD;
        let moving = self.velocity.abs() > RESTING_RAD_PER_S;
        // One that was stopped for want of set-points takes them up again if it can catch up.
        if near || moving {
            self.approach(target, speed, dt_s);
        } else {
            self.brake(dt_s, Mode::Refused);
        }
    }

    /// Takes the set-point as it is if the joint can; else goes over to approaching it.
    fn follow(&mut self, target: f64, speed: f64, period: Nanos, dt_s: f64) {
        let velocity = (target - self.position) / dt_s;
        let [lowest, highest] = self.speeds(dt_s);
        let is_slow = (lowest..=highest).contains(&velocity);
        let change = (velocity - self.velocity).abs();
        let allowed = FOLLOW_SHARE * self.limits.acceleration_max * (dt_s + seconds(period))
            + WANDER_SHARE * self.velocity.abs().max(velocity.abs());
        if is_slow && change <= allowed {
            self.position = target;
            self.mode = Mode::Follow;
        } else {
            self.approach(target, speed, dt_s);
        }
    }

    /// One step towards a target that itself moves at `speed`: as fast as the joint can still brake
    /// to that speed over the distance left.
    fn approach(&mut self, target: f64, speed: f64, dt_s: f64) {
        if (target - self.position).abs() > LOST_DISTANCE_RAD {
            self.brake(dt_s, Mode::Refused);
            return;
        }
        let acceleration_max = self.limits.acceleration_max;
        // Seen from the target, which has moved since the last sample.
        let behind = target - speed * dt_s - self.position;
        let wanted = speed + closing_speed(behind, APPROACH_SHARE * acceleration_max, dt_s);
        let change = acceleration_max * dt_s;
        let [lowest, highest] = self.speeds(dt_s);
        let velocity = wanted
            .clamp(lowest, highest)
            .clamp(self.velocity - change, self.velocity + change);
        self.position += velocity * dt_s;
        let arrived = (target - self.position).abs() <= ARRIVED_RAD;
        let as_fast = (velocity - speed).abs() <= change;
        self.mode = if arrived && as_fast {
            Mode::Follow
        } else {
            Mode::Approach
        };
    }

    /// One step of braking at the joint's limit.
    fn brake(&mut self, dt_s: f64, mode: Mode) {
        let loss = self.limits.acceleration_max * dt_s;
        let speed = (self.velocity.abs() - loss).max(0.0);
        self.position += speed.copysign(self.velocity) * dt_s;
        self.mode = mode;
    }

    /// What it does.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Commanded position (rad), velocity (rad/s) and acceleration (rad/s²).
    #[must_use]
    pub const fn motion(&self) -> (f64, f64, f64) {
        (self.position, self.velocity, self.acceleration)
    }

    /// The error a net sees of this joint while the robot follows commands.
    #[must_use]
    pub const fn error(&self) -> JointError {
        match self.mode {
            Mode::Held | Mode::Approach | Mode::Follow => JointError::None,
            Mode::Refused => JointError::Refused,
        }
    }
}

/// The speed for the next step on the way over `distance` from which steps of constant braking end
/// at its end exactly: with n steps to go the k-th last is k brakings fast, on the average between
/// two such plans. The continuous law, a square root, would overshoot and chatter at the end.
fn closing_speed(distance: f64, acceleration: f64, dt_s: f64) -> f64 {
    let change = acceleration * dt_s;
    let brakings = distance.abs() / (change * dt_s);
    let steps = (((1.0 + 8.0 * brakings).sqrt() - 1.0) / 2.0)
        .ceil()
        .max(1.0);
    let speed = distance.abs() / (steps * dt_s) + (steps - 1.0) / 2.0 * change;
    speed.copysign(distance)
}

/// The speed for the next step from which braking ends within `distance`: v·dt + v²/2a is that far. Unlike the closing
/// speed it holds whatever the lengths of the steps to come, for what is left always suffices to stop.
fn stopping_speed(distance: f64, acceleration: f64, dt_s: f64) -> f64 {
    // Without a difference of what is nearly equal.
    2.0 * distance / (dt_s + (dt_s * dt_s + 2.0 * distance / acceleration).sqrt())
}

/// Position and speed of the set-points at a time: linear between two of them, and on beyond the
/// last, where the speed of the last two is kept. Before the first of them it is that one, with the speed behind it.
fn interpolate(set_points: &JointSetPoints, at: Nanos) -> (f64, f64) {
    let points = &set_points.points[..set_points.count.clamp(1, set_points.points.len())];
    let mut pairs = points.windows(2);
    let Some(pair) = pairs.find(|pair| pair[1].time <= at) else {
        // A single set-point, or a run of them that begins later than `at`, and already moves.
        let first = points[points.len() - 1];
        return (first.position, points.windows(2).last().map_or(0.0, slope));
    };
    let (later, speed) = (pair[0], slope(pair));
    (later.position + speed * seconds(at - later.time), speed)
}

/// Speed from the second of two set-points to the first; zero if no time lies between.
fn slope(pair: &[SetPoint]) -> f64 {
    let span_s = seconds(pair[0].time - pair[1].time);
    if span_s > 0.0 {
        (pair[0].position - pair[1].position) / span_s
    } else {
        0.0
    }
}

#[expect(
    clippy::cast_precision_loss,
    reason = "spans of milliseconds are exact"
)]
const fn seconds(span: Nanos) -> f64 {
    span.0 as f64 * 1e-9
}

#[cfg(test)]
mod tests;
