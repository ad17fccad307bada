//! The last stage before the wire: what it lets through keeps position, velocity and acceleration, whatever a net, a
//! merge or a gap of the host made of the wish. It knows no net, no period of nets and no clock; a driver steps it once
//! for each of its own cycles.
//!
//! What leaves for a joint is kept in here and nowhere else. It changes by [`LastStage::track`], [`LastStage::drive`]
//! and [`LastStage::steer`], which all take the nearest velocity that the limits allow, and, while the device is not ours to
//! move, by [`LastStage::rest_at`]; so nothing that is decided before can widen the limits. The order of precedence where
//! they contradict each other, which they do only for a joint that begins beyond them: acceleration before velocity
//! (what is too fast brakes as hard as it may), the range before acceleration.
//!
//! Two laws were tried before. Cutting the velocity alone overshoots without end behind a target that was ahead for
//! a while; a filter of fixed bandwidth delays every motion. Here a target within the limits is passed on to the bit,
//! and one beyond them is caught up with by constant braking relative to its own speed.

mod planar;

use std::fmt;

use takt_net::JointLimits;

pub use planar::{PlanarLimits, PlanarStage, Twist3};

/// Share of a joint's acceleration that catching up uses by itself; the rest is for following
/// set-points that accelerate meanwhile.
const APPROACH_SHARE: f64 = 0.5;
/// Share of its largest speed at which a joint that stands beyond its range is moved back.
const RETURN_SHARE: f64 = 0.1;
/// What rounding may add to an admissible velocity, as a share of its change in a cycle.
const ROUNDING_SHARE: f64 = 1e-9;
/// What rounding adds to a position, as a share of it.
const ROUNDING: f64 = 4.0 * f64::EPSILON;
/// Held back by no more than this, a target is not reported: what clocks wander is of that size, rad or m.
const REPORTED_FROM: f64 = 1e-4;
/// Nearer than this a target is not held back, or caught up with, rad or m.
const CAUGHT_UP: f64 = 1e-5;

/// What was limited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// The range, or that the joint can stop within it.
    Position,
    /// The largest speed.
    Velocity,
    /// The largest acceleration.
    Acceleration,
    /// It was no number.
    Finite,
}

/// What was asked for beyond a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// Which limit.
    pub bound: Bound,
    /// What was asked for; SI.
    pub wanted: f64,
    /// What is allowed; SI.
    pub limit: f64,
}

/// Names of the units of position, velocity and acceleration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Of a joint, or of a base that turns.
    Angle,
    /// Of a base along the floor.
    Length,
}

impl Excess {
    /// In words, with what to do about it.
    #[must_use]
    pub fn text(&self, unit: Unit) -> String {
        let name = match unit {
            Unit::Angle => "rad",
            Unit::Length => "m",
        };
        let (what, unit) = match self.bound {
            Bound::Position => ("position", name.to_owned()),
            Bound::Velocity => ("velocity", format!("{name}/s")),
            Bound::Acceleration => ("acceleration", format!("{name}/s²")),
            Bound::Finite => return "the command is not a finite number".to_owned(),
        };
        format!(
            "{what} {:.4} {unit} commanded, limit {:.4} {unit}",
            self.wanted, self.limit
        )
    }
}

impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::Finite => "finite",
        })
    }
}

/// How often a stage held something back.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limited {
    /// Cycles in which less left than was asked for.
    pub cycles: u64,
    /// Times that this began and was no trifle: each is reported once.
    pub onsets: u64,
    /// What was asked for when it began the last time.
    pub last: Option<Excess>,
    /// What was asked for when it began this time, and whether that is reported.
    present: Option<(Excess, bool)>,
}

impl Limited {
    /// A cycle in which what leaves is off what was asked for by so much, because of that.
    fn note(&mut self, excess: Excess, off: f64) {
        self.cycles += 1;
        let (first, is_reported) = self.present.get_or_insert((excess, false));
        if !*is_reported && off > REPORTED_FROM {
            *is_reported = true;
            self.onsets += 1;
            self.last = Some(*first);
        }
    }

    /// What leaves is what was asked for.
    fn clear(&mut self) {
        self.present = None;
    }
}

/// The last stage of a joint, or of anything with one position.
#[derive(Clone, Copy, Debug)]
pub struct LastStage {
    limits: JointLimits,
    position: f64,
    velocity: f64,
    acceleration: f64,
    limited: Limited,
    /// Held back by no more than this, a target is not reported: it goes to where a run of set-points begins, nearby.
    quiet_up_to: f64,
}

impl LastStage {
    /// A joint at rest at zero. Its largest speed and acceleration are above zero.
    #[must_use]
    pub const fn new(limits: JointLimits) -> Self {
        Self::moving(limits, 0.0, 0.0)
    }

    /// A joint under way.
    #[must_use]
    pub const fn moving(limits: JointLimits, position: f64, velocity: f64) -> Self {
        Self {
            limits,
            position,
            velocity,
            acceleration: 0.0,
            limited: Limited {
                cycles: 0,
                onsets: 0,
                last: None,
                present: None,
            },
            quiet_up_to: 0.0,
        }
    }

    /// The same, with what was counted before it was.
    #[must_use]
    pub const fn counting_on(mut self, limited: Limited) -> Self {
        self.limited = limited;
        self
    }

    /// The device is not ours to move: it rests there.
    pub const fn rest_at(&mut self, position: f64) {
        (self.position, self.velocity, self.acceleration) = (position, 0.0, 0.0);
        self.limited.present = None;
        self.quiet_up_to = 0.0;
    }

    /// Until it is caught up with, a target that is no farther away than this is not reported: it is meant so.
    pub const fn begin_quietly(&mut self, distance: f64) {
        self.quiet_up_to = distance;
    }

    /// Its limits.
    #[must_use]
    pub const fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// What left last: position, velocity and acceleration.
    #[must_use]
    pub const fn motion(&self) -> (f64, f64, f64) {
        (self.position, self.velocity, self.acceleration)
    }

    /// How often it held something back.
    #[must_use]
    pub const fn limited(&self) -> &Limited {
        &self.limited
    }

    /// One cycle of `dt_s` towards a target that moves at `speed`. A target that can be reached within all limits, and
    /// whose speed can be taken up in the next cycle, is passed on as it is. Without time passing nothing changes.
    pub fn track(&mut self, target: f64, speed: f64, dt_s: f64) -> f64 {
        if !(target.is_finite() && speed.is_finite()) {
            let excess = Excess {
                bound: Bound::Finite,
                wanted: target,
                limit: 0.0,
            };
            self.limited.note(excess, f64::INFINITY);
            return self.brake(dt_s);
        }
        if dt_s <= 0.0 {
            return self.position;
        }
        let within = self.within(target);
        let speed = if (within - target).abs() > 0.0 {
            0.0
        } else {
            speed
        };
        let wanted = (within - self.position) / dt_s;
        let change = self.change(dt_s);
        let can_stay = (wanted - speed).abs() <= change + self.slack(dt_s);
        let excess = self.excess(target, wanted, dt_s);
        // What it could reach now, but not go on from as the target does, takes too much acceleration too.
        let change_wanted = (wanted - self.velocity).abs().max((wanted - speed).abs());
        let too_hard = Excess {
            bound: Bound::Acceleration,
            wanted: change_wanted / dt_s,
            limit: self.limits.acceleration_max,
        };
        let held_back = excess.unwrap_or(too_hard);
        if excess.is_none() && can_stay {
            self.arrive(within, dt_s);
        } else {
            // Seen from the target, which has moved since the last cycle.
            let behind = within - speed * dt_s - self.position;
            let acceleration = APPROACH_SHARE * self.limits.acceleration_max;
            self.advance(speed + closing_speed(behind, acceleration, dt_s), dt_s);
            if (within - self.position).abs() <= self.slack(dt_s) * dt_s {
                self.position = within;
            }
        }
        self.judge(target, held_back);
        self.position
    }

    /// One cycle of `dt_s` towards a velocity.
    pub fn drive(&mut self, velocity: f64, dt_s: f64) -> f64 {
        if dt_s > 0.0 {
            self.advance(if velocity.is_finite() { velocity } else { 0.0 }, dt_s);
        }
        self.position
    }

    /// One cycle of `dt_s` of braking at the joint's limit. Nothing holds that back.
    pub fn brake(&mut self, dt_s: f64) -> f64 {
        self.drive(0.0, dt_s)
    }

    /// One cycle of `dt_s` towards a velocity, of a joint that is commanded by velocity and is measured to be there; gives
    /// the velocity that leaves. Where it is is not for this stage to say, so only its speed and its change are bounded,
    /// and the speed by the way to the end of the range.
    pub fn steer(&mut self, at: f64, velocity: f64, dt_s: f64) -> f64 {
        if dt_s > 0.0 {
            self.position = at;
            let wanted = if velocity.is_finite() { velocity } else { 0.0 };
            let velocity = self.admissible(wanted, dt_s);
            self.acceleration = (velocity - self.velocity) / dt_s;
            self.velocity = velocity;
        }
        self.velocity
    }

    /// The step that all motion takes.
    fn advance(&mut self, wanted: f64, dt_s: f64) {
        let velocity = self.admissible(wanted, dt_s);
        let [low, high] = self.range();
        let position = (self.position + velocity * dt_s).max(low).min(high);
        self.set(position, velocity, dt_s);
    }

    /// The velocity nearest to this one that all limits but the range itself allow.
    fn admissible(&self, wanted: f64, dt_s: f64) -> f64 {
        let change = self.change(dt_s);
        let [lowest, highest] = self.speeds(dt_s);
        // Not `clamp`, which panics where a bound is no number.
        wanted
            .max(lowest)
            .min(highest)
            .max(self.velocity - change)
            .min(self.velocity + change)
    }

    /// The same to a place that is known to be admissible.
    fn arrive(&mut self, position: f64, dt_s: f64) {
        self.set(position, (position - self.position) / dt_s, dt_s);
    }

    fn set(&mut self, position: f64, velocity: f64, dt_s: f64) {
        // At the end of the range it stands, whatever it wanted.
        let went = (position - self.position) / dt_s;
        let is_cut = (went - velocity).abs() > self.slack(dt_s).max(1e-12);
        let velocity = if is_cut { went } else { velocity };
        self.acceleration = (velocity - self.velocity) / dt_s;
        (self.position, self.velocity) = (position, velocity);
    }

    /// Largest change of velocity in a cycle.
    fn change(&self, dt_s: f64) -> f64 {
        self.limits.acceleration_max * dt_s
    }

    /// What rounding makes of a velocity.
    fn slack(&self, dt_s: f64) -> f64 {
        ROUNDING_SHARE * self.change(dt_s) + ROUNDING * (1.0 + self.position.abs()) / dt_s
    }

    /// The range, as wide as to hold where the joint is: one that stands beyond it stays there or comes back.
    fn range(&self) -> [f64; 2] {
        let JointLimits {
            position_min,
            position_max,
            ..
        } = self.limits;
        [
            position_min.min(self.position),
            position_max.max(self.position),
        ]
    }

    /// The nearest to a target in the range, or on the way back to it from where the joint is: one that stands beyond its
    /// range is moved back only by targets that lead there.
    #[must_use]
    pub fn within(&self, target: f64) -> f64 {
        let [low, high] = self.range();
        target.max(low).min(high)
    }

    /// Lowest and highest velocity of the next cycle: within the joint's, and such that it can still stop in its range.
    /// One that stands beyond it moves nowhere but back, and slowly.
    fn speeds(&self, dt_s: f64) -> [f64; 2] {
        let JointLimits {
            position_min,
            position_max,
            velocity_max,
            acceleration_max,
        } = self.limits;
        let before =
            |room: f64| stopping_speed(room.max(0.0), acceleration_max, dt_s).min(velocity_max);
        let back = velocity_max * RETURN_SHARE;
        if self.position > position_max {
            return [-back, 0.0];
        }
        if self.position < position_min {
            return [0.0, back];
        }
        [
            -before(self.position - position_min),
            before(position_max - self.position),
        ]
    }

    /// What of a target is beyond a limit.
    fn excess(&self, target: f64, velocity: f64, dt_s: f64) -> Option<Excess> {
        let slack = self.slack(dt_s);
        let [lowest, highest] = self.speeds(dt_s);
        let JointLimits {
            position_min: low,
            position_max: high,
            velocity_max,
            acceleration_max,
        } = self.limits;
        let change = velocity - self.velocity;
        let (bound, wanted, limit) = if target < low || target > high {
            let end = if target < low { low } else { high };
            (Bound::Position, target, end)
        } else if velocity.abs() > velocity_max + slack {
            (Bound::Velocity, velocity.abs(), velocity_max)
        } else if velocity < lowest - slack || velocity > highest + slack {
            let end = if velocity < 0.0 { low } else { high };
            (Bound::Position, target, end)
        } else if change.abs() > self.change(dt_s) + slack {
            (Bound::Acceleration, change.abs() / dt_s, acceleration_max)
        } else {
            return None;
        };
        Some(Excess {
            bound,
            wanted,
            limit,
        })
    }

    /// Counts what was held back.
    fn judge(&mut self, target: f64, excess: Excess) {
        let off = (target - self.position).abs();
        if off <= CAUGHT_UP {
            self.limited.clear();
            self.quiet_up_to = 0.0;
            return;
        }
        let reported = if off <= self.quiet_up_to { 0.0 } else { off };
        self.limited.note(excess, reported);
    }
}

/// The speed for the next step on the way over `distance` from which steps of constant braking end
/// at its end exactly: with n steps to go the k-th last is k brakings fast, on the average between
/// two such plans. The continuous law, a square root, would overshoot and chatter at the end.
pub(crate) fn closing_speed(distance: f64, acceleration: f64, dt_s: f64) -> f64 {
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

#[cfg(test)]
mod tests;
