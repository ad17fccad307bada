//! Converts set-points to the command of a joint in each cycle of its own clock: interpolates, applies the joint's
//! limits, and brakes when set-points end. No clock is read here.
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
//! All transitions are in [`Joint::sample`]: 1 and 5 in `begin`, 2, 3 and 5 in `track`, 4 and 6 at the top. One
//! sample may make several: a first set-point exactly at the joint's position leads from Held to Follow, one that is
//! too far away from Held or Follow to Refused.
//!
//! Every output passes the joint's [`LastStage`], which keeps range, speed and acceleration in every cycle. A stream
//! within them passes unchanged; clock drift may hold it back by microradians, and the joint still follows. Targets
//! farther away, of a stream beyond the limits or after a clock step, are approached. A joint brakes before the end
//! of its range in time, whatever its set-points, and reaches the very end within its acceleration limit, or gives up
//! on set-points that get too far ahead meanwhile (5).
//!
//! Set-points no farther apart than the joint's cycles are joined by straight lines. Between sparser ones the
//! velocity would step at each of them, by the acceleration of the stream times its period; there, parabolas of half
//! a period on either side cut the corners (a quadratic B-spline if periods are equal). That path keeps every limit
//! of position, velocity and acceleration that the set-points keep by their differences, and needs no set-point later
//! than one and a half periods. It passes the corners at an eighth of the second difference: 0.2 mrad at 4 rad/s² and
//! 20 ms. Cubics through the set-points were rejected: where a stream begins to accelerate they need up to three
//! times its acceleration.

use takt_net::JointLimits;
use takt_net::device::JointError;
use takt_rt::Nanos;

use crate::device::last_stage::{LastStage, Limited};
use crate::device::rejected::{Cause, Rejected, Rejection};
use crate::device::{JointSetPoints, SET_POINTS, SetPoint};

/// A first set-point farther from the joint than this is refused, rad; of a base in poses, m and rad.
pub const START_DISTANCE: f64 = 0.02;
/// A joint farther behind its set-points than this gives up, rad; a base in poses, m and rad.
pub const LOST_DISTANCE: f64 = 0.2;
/// Share of the largest speed that a joint uses: a robot's own guard sees it rounded to single precision, and in some
/// of its cycles slightly above the interpolated value.
const SPEED_SHARE: f64 = 0.998;
/// A target nearer than this is reached, rad: below the resolution of a single-precision datagram.
const ARRIVED_RAD: f64 = 1e-7;
/// A joint slower than this is at rest, rad/s.
const RESTING_RAD_PER_S: f64 = 1e-7;
/// Drift of the playback clock per cycle, as a share of a step. Clocks of robots and buses are followed to a few
/// microseconds per period. A joint held back by no more than that follows.
const WANDER_SHARE: f64 = 0.01;
/// Set-points more than this number of the joint's cycles apart are sparse.
const SPARSE_FROM: f64 = 1.02;

/// State of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// At rest, or braking to rest.
    Held,
    /// Moving to its set-points within its limits.
    Approach,
    /// At its set-points.
    Follow,
    /// Resting, because its set-points are out of reach, until they end.
    Refused,
}

/// One joint.
#[derive(Clone, Copy, Debug)]
pub struct Joint {
    mode: Mode,
    stage: LastStage,
    /// The joint's own cycle: the shortest time between two samples, s.
    cycle_s: f64,
    rejected: Rejected,
    /// Whether set-points beyond its speed are followed all the same, and only reported.
    follows_all: bool,
}

impl Joint {
    /// A joint at rest at zero. Its largest speed and acceleration are above zero.
    #[must_use]
    pub const fn new(limits: JointLimits) -> Self {
        Self {
            mode: Mode::Held,
            stage: LastStage::new(guarded(limits)),
            cycle_s: f64::INFINITY,
            rejected: Rejected::NONE,
            follows_all: false,
        }
    }

    /// This joint as one that is wherever its set-points are within its range. Speeds beyond its limit are reported.
    #[must_use]
    pub const fn following_all(mut self) -> Self {
        let limits = *self.stage.limits();
        // Nothing guards it but its range.
        let velocity_max = limits.velocity_max / SPEED_SHARE;
        self.stage = LastStage::new(JointLimits {
            velocity_max,
            ..limits
        });
        self.follows_all = true;
        self
    }

    /// This joint in its current motion, braking within these limits: set-points are refused until they end.
    #[must_use]
    pub const fn refused(&self, limits: JointLimits, position: f64, velocity: f64) -> Self {
        let stage = LastStage::moving(guarded(limits), position, velocity);
        let mut rejected = self.rejected;
        rejected.last = Some(Rejection {
            cause: Cause::Guard,
            wanted: self.stage.motion().0,
            actual: position,
            allowed: 0.0,
        });
        Self {
            mode: Mode::Refused,
            stage: stage.counting_on(*self.stage.limited()),
            rejected,
            ..*self
        }
    }

    /// Sets a rest position while the driver does not control the robot. Set-points that arrive meanwhile are refused
    /// until they end, so that nothing moves by itself when the robot recovers.
    pub const fn rest_at(&mut self, position: f64, set_points: &JointSetPoints) {
        self.mode = if set_points.active {
            // Counted only if they still come once the joint is controlled: a net whose device fails has ended by then.
            self.rejected.last = Some(resumed(set_points, position));
            Mode::Refused
        } else {
            Mode::Held
        };
        self.stage.rest_at(position);
    }

    /// Counts a cycle of set-points that began before the joint, at that position, followed commands.
    pub const fn reject_resumed(&mut self, set_points: &JointSetPoints, position: f64) {
        self.rejected.begin(resumed(set_points, position));
    }

    /// Playback delay of set-points: one and a half periods, so that the set-points around that instant have arrived
    /// even if the net is late by half a period or, with sparse ones, by a cycle.
    #[must_use]
    pub fn delay(&self, set_points: &JointSetPoints) -> Nanos {
        let period = set_points.period;
        let late = if self.is_sparse(period) {
            nanos(self.cycle_s).0.min(period.0 / 2)
        } else {
            0
        };
        Nanos(period.0 * 3 / 2 + late)
    }

    /// Whether set-points of that period are so far apart that straight lines between them have corners.
    #[must_use]
    pub fn is_sparse(&self, period: Nanos) -> bool {
        seconds(period) > SPARSE_FROM * self.cycle_s
    }

    /// The position for the instant `at`, `dt_s` after the last one. `fresh` is whether the net thread is alive. With
    /// `dt_s` zero nothing changes.
    pub fn sample(
        &mut self,
        set_points: &JointSetPoints,
        fresh: bool,
        at: Nanos,
        dt_s: f64,
    ) -> f64 {
        if dt_s <= 0.0 {
            return self.stage.motion().0;
        }
        self.cycle_s = self.cycle_s.min(dt_s);
        let (target, speed) = interpolate(set_points, at, self.is_sparse(set_points.period));
        if self.follows_all {
            self.follow_all(set_points, target, dt_s);
            return self.stage.motion().0;
        }
        match self.mode {
            // Also the exit of Refused.
            _ if !set_points.active => self.brake(dt_s, Mode::Held),
            Mode::Refused => {
                self.rejected.repeat();
                self.brake(dt_s, Mode::Refused);
            }
            _ if !fresh => self.brake(dt_s, Mode::Held),
            _ if !target.is_finite() => self.reject(Cause::Finite, target, 0.0, dt_s),
            Mode::Held => self.begin(target, speed, dt_s),
            Mode::Approach | Mode::Follow => self.track(target, speed, dt_s),
        }
        self.stage.motion().0
    }

    fn begin(&mut self, target: f64, speed: f64, dt_s: f64) {
        let (position, velocity, _) = self.stage.motion();
        let near = (self.in_range(target) - position).abs() <= START_DISTANCE;
        let moving = velocity.abs() > RESTING_RAD_PER_S;
        // A joint that braked without set-points resumes them if it can catch up.
        if !near && !moving {
            self.reject(Cause::Start, target, START_DISTANCE, dt_s);
            return;
        }
        if !moving {
            self.stage.begin_quietly(START_DISTANCE);
        }
        self.mode = Mode::Approach;
        self.track(target, speed, dt_s);
    }

    /// One step to its set-points; gives up if they are out of reach.
    fn track(&mut self, target: f64, speed: f64, dt_s: f64) {
        let within = self.in_range(target);
        let (before, velocity_before, _) = self.stage.motion();
        // A distance that the joint can travel in this step is not out of reach, however long the step is.
        let farthest = LOST_DISTANCE.max(self.stage.limits().velocity_max * dt_s);
        if (within - before).abs() > farthest {
            self.reject(Cause::Lost, target, farthest, dt_s);
            return;
        }
        self.stage.track(target, speed, dt_s);
        let (position, velocity, _) = self.stage.motion();
        let off = (within - position).abs();
        let speed = if (within - target).abs() > 0.0 {
            0.0
        } else {
            speed
        };
        let as_fast =
            (velocity - speed).abs() <= self.stage.limits().acceleration_max * dt_s * 1.001;
        let wander = WANDER_SHARE * velocity.abs().max(velocity_before.abs()) * dt_s;
        let arrived = off <= ARRIVED_RAD && as_fast;
        let holds_on = self.mode == Mode::Follow && off <= ARRIVED_RAD + wander;
        self.mode = if arrived || holds_on {
            Mode::Follow
        } else {
            Mode::Approach
        };
    }

    /// One step of a joint that follows all set-points within its range.
    fn follow_all(&mut self, set_points: &JointSetPoints, target: f64, dt_s: f64) {
        if !set_points.active {
            self.mode = Mode::Held;
            self.stage.jump_to(self.stage.motion().0, dt_s);
        } else if target.is_finite() {
            self.mode = Mode::Follow;
            self.stage.jump_to(target, dt_s);
        } else {
            self.reject(Cause::Finite, target, 0.0, dt_s);
        }
    }

    /// Begins to reject set-points.
    fn reject(&mut self, cause: Cause, wanted: f64, allowed: f64, dt_s: f64) {
        self.rejected.begin(Rejection {
            cause,
            wanted,
            actual: self.stage.motion().0,
            allowed,
        });
        self.brake(dt_s, Mode::Refused);
    }

    /// The nearest position in the range, or nearer to it than the joint is.
    fn in_range(&self, position: f64) -> f64 {
        self.stage.within(position)
    }

    /// One step of braking at the joint's limit.
    fn brake(&mut self, dt_s: f64, mode: Mode) {
        self.stage.brake(dt_s);
        self.mode = mode;
    }

    /// Its limits.
    #[must_use]
    pub const fn limits(&self) -> JointLimits {
        *self.stage.limits()
    }

    /// Its state.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// Commanded position (rad), velocity (rad/s) and acceleration (rad/s²).
    #[must_use]
    pub const fn motion(&self) -> (f64, f64, f64) {
        self.stage.motion()
    }

    /// What a motion that begins now goes on from: [`Self::motion`], with an acceleration of 0 unless the joint follows its set-points.
    /// That of a joint that brakes or approaches them is its own and may end in any cycle. A motion that took it over would let it fade
    /// at its jerk instead, and leave its path.
    #[must_use]
    pub const fn continued(&self) -> (f64, f64, f64) {
        let (position, velocity, acceleration) = self.stage.motion();
        let follows = matches!(self.mode, Mode::Follow);
        (position, velocity, if follows { acceleration } else { 0.0 })
    }

    /// Limit reports of its last stage.
    #[must_use]
    pub const fn limited(&self) -> &Limited {
        self.stage.limited()
    }

    /// Rejected set-points.
    #[must_use]
    pub const fn rejected(&self) -> &Rejected {
        &self.rejected
    }

    /// The error that nets see while the robot follows commands.
    #[must_use]
    pub const fn error(&self) -> JointError {
        match self.mode {
            Mode::Held | Mode::Approach | Mode::Follow => JointError::None,
            Mode::Refused => JointError::Refused,
        }
    }
}

/// The rejection of set-points that began before a joint, at that position, followed commands.
const fn resumed(set_points: &JointSetPoints, position: f64) -> Rejection {
    Rejection {
        cause: Cause::Resumed,
        wanted: set_points.points[0].position,
        actual: position,
        allowed: 0.0,
    }
}

/// The limits of the joint, slightly slower than those of its robot.
const fn guarded(limits: JointLimits) -> JointLimits {
    JointLimits {
        velocity_max: limits.velocity_max * SPEED_SHARE,
        ..limits
    }
}

/// Position and speed of the set-points at a time: on straight lines between them, extrapolated beyond the last at
/// the last speed. Before the first one it is the first one, with the speed after it. If they are `sparse`, parabolas
/// cut the corners, also that of the first, which follows rest.
fn interpolate(set_points: &JointSetPoints, at: Nanos, sparse: bool) -> (f64, f64) {
    let points = &set_points.points[..set_points.count.clamp(1, SET_POINTS)];
    let later = points.windows(2).position(|pair| pair[1].time <= at);
    let Some(newer) = later else {
        // A single set-point, or a run that starts later than `at` in motion.
        let first = points[points.len() - 1];
        // With a full history, the set-point before the oldest is unknown.
        let cut =
            (sparse && points.len() < SET_POINTS).then(|| Corner::at(points, points.len() - 1));
        if let Some(corner) = cut {
            return corner
                .and_then(|it| it.motion(at))
                .unwrap_or((first.position, 0.0));
        }
        return (first.position, points.windows(2).last().map_or(0.0, slope));
    };
    if sparse {
        let corners = [newer, newer + 1].map(|number| Corner::at(points, number));
        if let Some(motion) = corners
            .iter()
            .flatten()
            .find_map(|corner| corner.motion(at))
        {
            return motion;
        }
    }
    let (later, speed) = (points[newer], slope(&points[newer..newer + 2]));
    (later.position + speed * seconds(at - later.time), speed)
}

/// A set-point at which the speed of the straight lines changes.
#[derive(Clone, Copy, Debug)]
struct Corner {
    point: SetPoint,
    /// Speed before and behind it, rad/s.
    speeds: [f64; 2],
    /// Half duration of the parabola, s.
    half_s: f64,
}

impl Corner {
    /// The corner at the set-point of that index; `None` if a neighbour is unknown.
    fn at(points: &[SetPoint], number: usize) -> Option<Self> {
        let point = *points.get(number)?;
        let behind = points.get(number.checked_sub(1)?..=number)?;
        let span_s = |pair: &[SetPoint]| seconds(pair[0].time - pair[1].time);
        let (before, half_s) = match points.get(number..number + 2) {
            Some(before) => (slope(before), span_s(before).min(span_s(behind)) / 2.0),
            // The first of its run: the joint rests before it.
            None if points.len() < SET_POINTS => (0.0, span_s(behind) / 2.0),
            None => return None,
        };
        (half_s > 0.0).then_some(Self {
            point,
            speeds: [before, slope(behind)],
            half_s,
        })
    }

    /// Position and speed at a time within the parabola.
    fn motion(&self, at: Nanos) -> Option<(f64, f64)> {
        let [before, behind] = self.speeds;
        let since_s = seconds(at - self.point.time);
        if since_s.abs() > self.half_s {
            return None;
        }
        let (inside_s, acceleration) = (
            since_s + self.half_s,
            (behind - before) / (2.0 * self.half_s),
        );
        let line = self.point.position + before * since_s;
        Some((
            line + acceleration * inside_s * inside_s / 2.0,
            before + acceleration * inside_s,
        ))
    }
}

/// Speed from the second to the first of two set-points; zero if their times are equal.
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

/// A span of seconds; saturates.
#[expect(clippy::cast_possible_truncation, reason = "saturates, which is meant")]
const fn nanos(span_s: f64) -> Nanos {
    Nanos((span_s * 1e9) as i64)
}

#[cfg(test)]
mod sparse_tests;
#[cfg(test)]
mod tests;
