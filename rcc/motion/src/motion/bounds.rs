//! Limits and states of one coordinate, and how far it moves until it rests. Nothing is planned here.

use super::planner::ROUNDING;

/// Limits of a coordinate, in its unit per s, s² and s³.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Largest speed, per s.
    pub velocity: f64,
    /// Largest acceleration, per s².
    pub acceleration: f64,
    /// Largest jerk, per s³.
    pub jerk: f64,
}

impl Bounds {
    /// The limits of a coordinate that moves `factor` times as far in the same time.
    pub(super) fn scaled(self, factor: f64) -> Self {
        Self {
            velocity: self.velocity * factor,
            acceleration: self.acceleration * factor,
            jerk: self.jerk * factor,
        }
    }

    /// The same limits with parts of acceleration and jerk.
    pub(super) fn slower(self, [acceleration, jerk]: [f64; 2]) -> Self {
        Self {
            velocity: self.velocity,
            acceleration: self.acceleration * acceleration,
            jerk: self.jerk * jerk,
        }
    }

    /// The same limits for a motion that takes its time at a part of the speed: the path in time is the same, but longer.
    pub(super) fn at_speed(self, speed: f64) -> Self {
        Self {
            velocity: self.velocity * speed,
            ..self.gentle(speed)
        }
    }

    /// What a motion at a part of the speed brakes with: acceleration and jerk of the whole limits.
    pub(super) fn braking(self, speed: f64) -> Self {
        Self {
            velocity: self.velocity,
            acceleration: self.acceleration / (speed * speed),
            jerk: self.jerk / (speed * speed * speed),
        }
    }

    /// The reverse of [`Self::braking`].
    pub(super) fn gentle(self, speed: f64) -> Self {
        Self {
            velocity: self.velocity,
            acceleration: self.acceleration * speed * speed,
            jerk: self.jerk * speed * speed * speed,
        }
    }

    /// Whether a state exceeds the limits by more than rounding.
    pub(super) fn are_exceeded(self, state: State) -> bool {
        let beyond = |value: f64, limit: f64| value.abs() > limit * (1.0 + ROUNDING);
        beyond(state.velocity, self.velocity) || beyond(state.acceleration, self.acceleration)
    }

    /// The lower limit of each pair.
    pub(super) fn and(self, other: Self) -> Self {
        Self {
            velocity: self.velocity.min(other.velocity),
            acceleration: self.acceleration.min(other.acceleration),
            jerk: self.jerk.min(other.jerk),
        }
    }
}

/// Position, velocity and acceleration of a coordinate, in its unit, per s and per s².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Position, m or rad.
    pub position: f64,
    /// Velocity, per s.
    pub velocity: f64,
    /// Acceleration, per s².
    pub acceleration: f64,
}

impl State {
    /// At rest at this position.
    pub const fn at_rest(position: f64) -> Self {
        Self {
            position,
            velocity: 0.0,
            acceleration: 0.0,
        }
    }

    /// Whether these are plausible numbers.
    pub(super) fn is_sensible(self) -> bool {
        let Self {
            position,
            velocity,
            acceleration,
        } = self;
        [position, velocity, acceleration]
            .into_iter()
            .all(super::is_sensible)
    }

    pub(super) fn is_finite(self) -> bool {
        self.position.is_finite() && self.velocity.is_finite() && self.acceleration.is_finite()
    }
}

/// Distance to standstill: from the present acceleration to the strongest deceleration, some time at it, and back.
pub(super) fn stopping(state: State, bounds: Bounds) -> f64 {
    let jerk = bounds.jerk;
    // The velocity when the acceleration has ended decides: a strong deceleration turns the coordinate back.
    let gained = state.acceleration * state.acceleration.abs() / (2.0 * jerk);
    let direction = 1.0_f64.copysign(state.velocity + gained);
    let (speed, acceleration) = (state.velocity * direction, state.acceleration * direction);
    // Speed to be taken by deceleration.
    let whole = speed + acceleration * acceleration / (2.0 * jerk);
    let peak = (jerk * whole)
        .sqrt()
        .min(bounds.acceleration)
        .max(-acceleration);
    let times = [
        (acceleration + peak) / jerk,
        if peak > 0.0 {
            (whole / peak - peak / jerk).max(0.0)
        } else {
            0.0
        },
        peak / jerk,
    ];
    let starts = [(acceleration, -jerk), (-peak, 0.0), (-peak, jerk)];
    let (mut distance, mut now) = (0.0, speed);
    for (time, (acceleration, jerk)) in times.into_iter().zip(starts) {
        let square = time * time;
        distance += now * time + acceleration * square / 2.0 + jerk * square * time / 6.0;
        now += acceleration * time + jerk * square / 2.0;
    }
    distance * direction
}
