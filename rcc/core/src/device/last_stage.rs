//! The last stage before the wire: its output keeps position, velocity and acceleration limits, whatever a net, a
//! merge or a stall of the host produced. It knows no net, no net period and no clock; a driver steps it once per
//! cycle of its own.
//!
//! The state of the output is private to the stage. [`LastStage::track`], [`LastStage::drive`] and
//! [`LastStage::steer`] change it to the nearest velocity within the limits, and [`LastStage::rest_at`] sets it while
//! the driver does not control the device; earlier stages cannot widen the limits. Limits conflict only for a joint
//! that starts beyond them; then acceleration has priority over velocity (a joint that is too fast brakes as hard as
//! allowed), and the range over acceleration.
//!
//! Two laws were rejected. Clamping the velocity alone overshoots without end behind a target that was ahead for a
//! while; a filter of fixed bandwidth delays every motion. Here a target within the limits passes bit by bit, and one
//! beyond them is caught up with by constant braking relative to its speed.

mod planar;

use std::fmt;

use takt_net::JointLimits;

pub use planar::{PlanarLimits, PlanarStage, Twist3};

/// Share of a joint's acceleration for catching up; the rest is for following set-points that accelerate meanwhile.
const APPROACH_SHARE: f64 = 0.5;
/// Share of its largest speed at which a joint beyond its range is moved back.
const RETURN_SHARE: f64 = 0.1;
/// Rounding tolerance of an admissible velocity, as a share of its change in a cycle.
const ROUNDING_SHARE: f64 = 1e-9;
/// Rounding tolerance of a position, as a share of it.
const ROUNDING: f64 = 4.0 * f64::EPSILON;
/// A smaller deviation from the target is not reported: clock drift is of that size, rad or m.
const REPORTED_FROM: f64 = 1e-4;
/// A smaller deviation counts as none, rad or m.
const CAUGHT_UP: f64 = 1e-5;

/// A limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// The range, or that the joint can stop within it.
    Position,
    /// The largest speed.
    Velocity,
    /// The largest acceleration.
    Acceleration,
    /// The command is not finite.
    Finite,
}

/// A command beyond a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// The limit.
    pub bound: Bound,
    /// The commanded value; SI.
    pub wanted: f64,
    /// The allowed value; SI.
    pub limit: f64,
}

/// Unit names of position, velocity and acceleration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Of a joint, or of a base that turns.
    Angle,
    /// Of a base along the floor.
    Length,
}

impl Excess {
    /// Text with its remedy.
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

/// Limit reports of a stage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limited {
    /// Number of limited cycles.
    pub cycles: u64,
    /// Number of limited phases above the report threshold: each is reported once.
    pub onsets: u64,
    /// The command at the start of the last reported phase.
    pub last: Option<Excess>,
    /// The command at the start of the current phase, and whether it is reported.
    present: Option<(Excess, bool)>,
    /// Whether the output followed the command beyond the limit all the same.
    pub is_exceeded: bool,
}

impl Limited {
    /// Counts a cycle in which the output deviates from the command by `off`, and why.
    fn note(&mut self, excess: Excess, off: f64) {
        self.cycles += 1;
        let (first, is_reported) = self.present.get_or_insert((excess, false));
        if !*is_reported && off > REPORTED_FROM {
            *is_reported = true;
            self.onsets += 1;
            self.last = Some(*first);
        }
    }

    /// Counts a cycle in which the output is the command.
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
    /// Report threshold for deviations, larger while approaching a nearby start of set-points.
    quiet_up_to: f64,
}

impl LastStage {
    /// A joint at rest at zero. Its largest speed and acceleration are above zero.
    #[must_use]
    pub const fn new(limits: JointLimits) -> Self {
        Self::moving(limits, 0.0, 0.0)
    }

    /// A moving joint.
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
                is_exceeded: false,
            },
            quiet_up_to: 0.0,
        }
    }

    /// The same, with the limit reports of another stage.
    #[must_use]
    pub const fn counting_on(mut self, limited: Limited) -> Self {
        self.limited = limited;
        self
    }

    /// Sets a rest position while the driver does not control the device.
    pub const fn rest_at(&mut self, position: f64) {
        (self.position, self.velocity, self.acceleration) = (position, 0.0, 0.0);
        self.limited.present = None;
        self.quiet_up_to = 0.0;
    }

    /// Suppresses reports of targets no farther away than this until the joint caught up: the approach is intended.
    pub const fn begin_quietly(&mut self, distance: f64) {
        self.quiet_up_to = distance;
    }

    /// Its limits.
    #[must_use]
    pub const fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// The last output: position, velocity and acceleration.
    #[must_use]
    pub const fn motion(&self) -> (f64, f64, f64) {
        (self.position, self.velocity, self.acceleration)
    }

    /// Limit reports.
    #[must_use]
    pub const fn limited(&self) -> &Limited {
        &self.limited
    }

    /// One cycle of `dt_s` towards a target that moves at `speed`. A target that can be reached within all limits,
    /// and whose speed can be matched in the next cycle, passes unchanged. With `dt_s` zero nothing changes.
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
        // A target that can be reached now, but not followed in the next cycle, exceeds the acceleration too.
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
            // Relative to the target, which has moved since the last cycle.
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

    /// One cycle of `dt_s` to a position in the range, whatever the speed; one beyond the limit is reported.
    pub fn jump_to(&mut self, target: f64, dt_s: f64) {
        let within = self.within(target);
        let speed = (within - self.position).abs() / dt_s;
        if speed > self.limits.velocity_max {
            self.limited.is_exceeded = true;
            let excess = Excess {
                bound: Bound::Velocity,
                wanted: speed,
                limit: self.limits.velocity_max,
            };
            self.limited.note(excess, f64::INFINITY);
        } else {
            self.limited.clear();
        }
        self.set(within, (within - self.position) / dt_s, dt_s);
    }

    /// One cycle of `dt_s` towards a velocity.
    pub fn drive(&mut self, velocity: f64, dt_s: f64) -> f64 {
        if dt_s > 0.0 {
            self.advance(if velocity.is_finite() { velocity } else { 0.0 }, dt_s);
        }
        self.position
    }

    /// One cycle of `dt_s` of braking at the joint's limit. Counts as no limitation.
    pub fn brake(&mut self, dt_s: f64) -> f64 {
        self.drive(0.0, dt_s)
    }

    /// One cycle of `dt_s` towards a velocity, for a joint that is commanded by velocity and measured at that
    /// position; returns the output velocity. The position is not under control of this stage, so only speed and its
    /// change are limited, and the speed by the distance to the end of the range.
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

    /// The step of all motion.
    fn advance(&mut self, wanted: f64, dt_s: f64) {
        let velocity = self.admissible(wanted, dt_s);
        let [low, high] = self.range();
        let position = (self.position + velocity * dt_s).max(low).min(high);
        self.set(position, velocity, dt_s);
    }

    /// The nearest velocity within all limits except the range.
    fn admissible(&self, wanted: f64, dt_s: f64) -> f64 {
        let change = self.change(dt_s);
        let [lowest, highest] = self.speeds(dt_s);
        // Not `clamp`, which panics if a bound is NaN.
        wanted
            .max(lowest)
            .min(highest)
            .max(self.velocity - change)
            .min(self.velocity + change)
    }

    /// The same to a position that is known to be admissible.
    fn arrive(&mut self, position: f64, dt_s: f64) {
        self.set(position, (position - self.position) / dt_s, dt_s);
    }

    fn set(&mut self, position: f64, velocity: f64, dt_s: f64) {
        // At the end of the range it rests, whatever the target.
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

    /// Rounding tolerance of a velocity.
    fn slack(&self, dt_s: f64) -> f64 {
        ROUNDING_SHARE * self.change(dt_s) + ROUNDING * (1.0 + self.position.abs()) / dt_s
    }

    /// The range, extended to the current position: a joint beyond its range stays there or comes back.
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

    /// The nearest position to a target in the range, or on the path back into it: a joint beyond its range is moved
    /// back only by targets in that direction.
    #[must_use]
    pub fn within(&self, target: f64) -> f64 {
        let [low, high] = self.range();
        target.max(low).min(high)
    }

    /// Lowest and highest velocity of the next cycle: within the joint's limits, and such that it can still stop in
    /// its range. A joint beyond its range moves only back, and slowly.
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

    /// The limit that a target exceeds, and by how much.
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

    /// Counts limited cycles.
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

/// The speed for the next step towards a target at `distance`, such that steps of constant braking end at it exactly:
/// with n steps left the k-th last is k brakings fast, on average between two such plans. The continuous law, a
/// square root, would overshoot and chatter at the end.
pub(crate) fn closing_speed(distance: f64, acceleration: f64, dt_s: f64) -> f64 {
    let change = acceleration * dt_s;
    let brakings = distance.abs() / (change * dt_s);
    let steps = (((1.0 + 8.0 * brakings).sqrt() - 1.0) / 2.0)
        .ceil()
        .max(1.0);
    let speed = distance.abs() / (steps * dt_s) + (steps - 1.0) / 2.0 * change;
    speed.copysign(distance)
}

/// The speed for the next step from which braking ends within `distance`: v·dt + v²/2a is that far. Unlike the
/// closing speed it is valid for any lengths of later steps, because the rest always suffices to stop.
fn stopping_speed(distance: f64, acceleration: f64, dt_s: f64) -> f64 {
    // Avoids the difference of nearly equal numbers.
    2.0 * distance / (dt_s + (dt_s * dt_s + 2.0 * distance / acceleration).sqrt())
}

#[cfg(test)]
mod tests;
