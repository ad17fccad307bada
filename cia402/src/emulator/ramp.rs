//! A ramp towards a position or a velocity, limited in velocity, acceleration and optionally jerk; re-planned in every
//! step, so that targets and bounds may change at any time. It supports the trapezoidal and the jerk-limited profile
//! types of 6086h.

/// Bounds of a motion, in user units per second, per second squared and per second cubed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
    pub(super) deceleration: f64,
    /// `None`: the acceleration may jump.
    pub(super) jerk: Option<f64>,
}

/// The demand values, in user units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Ramp {
    pub(super) position: f64,
    pub(super) velocity: f64,
    /// Acceleration of the last step.
    pub(super) acceleration: f64,
}

/// Bisection steps of the search for the next acceleration.
const HALVINGS: u32 = 40;

/// The largest rate from which `remaining` is enough to stop with a deceleration of `fall` per second, in steps of `dt`
/// s.
fn stoppable(remaining: f64, fall: f64, dt: f64) -> f64 {
    let half = fall * dt / 2.0;
    (half * half + 2.0 * fall * remaining).sqrt() - half
}

impl Ramp {
    /// One step of `dt` s towards a velocity.
    pub(super) fn toward_velocity(&mut self, velocity: f64, bounds: &Bounds, dt: f64) {
        let velocity = velocity.clamp(-bounds.velocity, bounds.velocity);
        if let Some(jerk) = bounds.jerk {
            let acceleration = self.acceleration_toward(velocity, bounds, jerk, dt);
            return self.go(acceleration, dt);
        }
        let slower = velocity.abs() < self.velocity.abs() || velocity * self.velocity < 0.0;
        let rate = if slower {
            bounds.deceleration
        } else {
            bounds.acceleration
        };
        let change = (velocity - self.velocity).clamp(-rate * dt, rate * dt);
        self.change(change, dt);
    }

    /// One step of `dt` s towards a position, to pass it at `end_velocity` (its magnitude; 0 to stop).
    pub(super) fn toward_position(
        &mut self,
        target: f64,
        end_velocity: f64,
        bounds: &Bounds,
        dt: f64,
    ) {
        if let Some(jerk) = bounds.jerk {
            return self.glide(target, end_velocity, bounds, jerk, dt);
        }
        let distance = target - self.position;
        let remaining = distance.abs();
        let d = bounds.deceleration.max(f64::MIN_POSITIVE);
        // The largest velocity from which stopping in steps of dt still ends at the target.
        let half = d * dt / 2.0;
        let stoppable =
            (half * half + 2.0 * d * remaining + end_velocity * end_velocity).sqrt() - half;
        let wanted = stoppable.min(bounds.velocity).min(remaining / dt);
        let step = distance.signum() * wanted;
        let slower = step.abs() < self.velocity.abs() || step * self.velocity < 0.0;
        let rate = if slower { d } else { bounds.acceleration };
        // Slightly more, so that rounding does not make the last step miss.
        let most = rate * dt * (1.0 + 1e-9);
        self.change((step - self.velocity).clamp(-most, most), dt);
    }

    /// Changes the velocity at once.
    fn change(&mut self, by: f64, dt: f64) {
        self.velocity += by;
        self.acceleration = by / dt;
        self.position += self.velocity * dt;
    }

    /// The ramp after a step in which the acceleration changes linearly.
    fn after(&self, acceleration: f64, dt: f64) -> Self {
        let mean = (self.acceleration + acceleration) / 2.0;
        let early = (2.0 * self.acceleration + acceleration) / 6.0;
        Self {
            position: self.position + self.velocity * dt + early * dt * dt,
            velocity: self.velocity + mean * dt,
            acceleration,
        }
    }

    fn go(&mut self, acceleration: f64, dt: f64) {
        *self = self.after(acceleration, dt);
    }

    /// The acceleration at the end of the next step of a jerk-limited ramp to a velocity.
    fn acceleration_toward(&self, velocity: f64, bounds: &Bounds, jerk: f64, dt: f64) -> f64 {
        // The change that remains after this step with the present acceleration.
        let left = velocity - self.velocity - self.acceleration * dt / 2.0;
        // The remainder is covered in two steps.
        let most = left.abs() / dt;
        let wanted = stoppable(left.abs(), jerk, dt).min(most).copysign(left);
        let slower = wanted * self.velocity < 0.0;
        let most = if slower {
            bounds.deceleration
        } else {
            bounds.acceleration
        };
        let wanted = wanted.clamp(-most, most);
        let change = (wanted - self.acceleration).clamp(-jerk * dt, jerk * dt);
        self.acceleration + change
    }

    /// One step of a jerk-limited ramp to a position.
    fn glide(&mut self, target: f64, end_velocity: f64, bounds: &Bounds, jerk: f64, dt: f64) {
        let sign = if target < self.position { -1.0 } else { 1.0 };
        // Transformed so that the target lies ahead in positive direction, at zero.
        let mut seen = Self {
            position: sign * (self.position - target),
            velocity: sign * self.velocity,
            acceleration: sign * self.acceleration,
        };
        let still = jerk * dt * dt;
        if seen.position.abs() <= 4.0 * still * dt
            && seen.velocity.abs() <= 4.0 * still
            && end_velocity <= 0.0
        {
            (self.position, self.velocity, self.acceleration) = (target, 0.0, 0.0);
            return;
        }
        if seen.velocity < -still {
            // Moving away from the target or past it: stop first.
            return self.toward_velocity(0.0, bounds, dt);
        }
        let stops = |acceleration| {
            let then = seen.after(acceleration, dt);
            let remaining = then.distance_to(end_velocity, bounds.deceleration, jerk);
            then.position + remaining <= 0.0
        };
        let mut high = seen.acceleration_toward(bounds.velocity, bounds, jerk, dt);
        if !stops(high) {
            // Within what the deceleration allows, unless already beyond it.
            let least = (-bounds.deceleration).min(seen.acceleration);
            let mut low = (seen.acceleration - jerk * dt).max(least).min(high);
            for _ in 0..HALVINGS {
                let middle = f64::midpoint(low, high);
                if stops(middle) {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            high = low;
        }
        seen.go(high, dt);
        self.position = target + sign * seen.position;
        self.velocity = sign * seen.velocity;
        self.acceleration = sign * seen.acceleration;
    }

    /// Distance in positive direction until the velocity is `end` and the acceleration zero.
    fn distance_to(&self, end: f64, deceleration: f64, jerk: f64) -> f64 {
        let (v, a) = (self.velocity, self.acceleration);
        // A full deceleration starts at the velocity from which this acceleration came or to which it leads.
        let top = v + a * a / (2.0 * jerk);
        let excess = top - end;
        let time = a.abs() / jerk;
        if a < 0.0 && v - a * a / (2.0 * jerk) <= end {
            // It brakes harder than necessary: the deceleration can be reduced at once.
            return v * time + a * time * time / 2.0 + jerk * time.powi(3) / 6.0;
        }
        if excess <= 0.0 {
            return 0.0;
        }
        let span = if excess <= deceleration * deceleration / jerk {
            2.0 * (excess / jerk).sqrt()
        } else {
            excess / deceleration + deceleration / jerk
        };
        let whole = f64::midpoint(top, end) * span;
        if a >= 0.0 {
            // Until then the velocity still increases.
            whole + v * time + a * time * time / 3.0
        } else {
            whole - (top * time - jerk * time.powi(3) / 6.0)
        }
    }

    /// Whether it is at rest at the target.
    pub(super) fn is_at(&self, target: f64) -> bool {
        (self.position - target).abs() < 1e-6 * target.abs().max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds {
        velocity: 1000.0,
        acceleration: 5000.0,
        deceleration: 8000.0,
        jerk: None,
    };
    const JERK: f64 = 200_000.0;
    const SMOOTH: Bounds = Bounds {
        jerk: Some(JERK),
        ..BOUNDS
    };

    #[test]
    fn ramp_to_position_stays_within_bounds_without_overshoot() {
        for target in [0.01, 3.0, 700.0, -12_345.0] {
            let mut ramp = Ramp::default();
            let mut last = 0.0_f64;
            for _ in 0..40_000 {
                ramp.toward_position(target, 0.0, &BOUNDS, 1e-3);
                let change = ramp.velocity.abs() - last.abs();
                let limit = if change > 0.0 { 5000.0 } else { 8000.0 };
                assert!(change.abs() <= limit * 1.001e-3, "{target}: {change}");
                assert!(ramp.velocity.abs() <= 1000.0);
                let beyond = (ramp.position - target) * target.signum();
                // Less than one step of the deceleration.
                assert!(beyond <= 8000.0 * 1e-6, "{target}: {beyond}");
                last = ramp.velocity;
            }
            assert!(ramp.is_at(target), "{target}: {}", ramp.position);
        }
    }

    /// All bounds hold in every step, jerk from difference quotients, and no profile is much slower than the fastest
    /// one.
    #[test]
    fn ramp_to_position_with_jerk_limit_is_smooth() {
        // Distance, and seconds of the fastest profile with these bounds: only jerk; jerk and acceleration; all of
        // them.
        for (target, fastest) in [
            (0.05, 0.0200),
            (20.0, 0.1508),
            (700.0, 0.895),
            (-12_345.0, 12.54),
        ] {
            for dt in [1e-3, 250e-6] {
                let mut ramp = Ramp::default();
                let mut steps = 0_u32;
                while !(ramp.is_at(target) && ramp.velocity.abs() < 1e-9) {
                    let before = ramp;
                    ramp.toward_position(target, 0.0, &SMOOTH, dt);
                    steps += 1;
                    let why = format!("{target} in steps of {dt} s, {ramp:?}");
                    assert!(f64::from(steps) * dt < fastest + 0.1, "late: {why}");
                    assert!(ramp.velocity.abs() <= 1000.0 * 1.001, "{why}");
                    assert!(ramp.acceleration.abs() <= 8000.0 * 1.001, "{why}");
                    let jerk = (ramp.acceleration - before.acceleration) / dt;
                    // The last step ends all motion, which by then is rounding error.
                    let ends = ramp.is_at(target) && ramp.velocity.abs() < 1e-9;
                    assert!(ends || jerk.abs() <= JERK * 1.001, "{jerk}: {why}");
                    let beyond = (ramp.position - target) * target.signum();
                    assert!(beyond <= 20.0 * JERK * dt.powi(3), "{beyond}: {why}");
                }
                let span = f64::from(steps) * dt;
                assert!(span >= fastest * 0.99 - dt, "{target}: too fast, {span} s");
                assert!(span <= fastest * 1.05 + 10.0 * dt, "{target}: {span} s");
            }
        }
    }

    #[test]
    fn ramp_reverses_to_a_target_behind() {
        for bounds in [BOUNDS, SMOOTH] {
            let mut ramp = Ramp {
                velocity: 900.0,
                ..Ramp::default()
            };
            for _ in 0..5000 {
                let before = ramp;
                ramp.toward_position(-50.0, 0.0, &bounds, 1e-3);
                let rest = ramp.is_at(-50.0);
                let jerk = (ramp.acceleration - before.acceleration).abs() / 1e-3;
                assert!(bounds.jerk.is_none_or(|most| rest || jerk <= most * 1.001));
            }
            assert!(ramp.is_at(-50.0), "{}", ramp.position);
        }
    }

    #[test]
    fn ramp_to_velocity_keeps_its_rates() {
        let mut ramp = Ramp::default();
        (0..100).for_each(|_| ramp.toward_velocity(2000.0, &BOUNDS, 1e-3));
        assert!((ramp.velocity - 500.0).abs() < 1e-6);
        (0..1000).for_each(|_| ramp.toward_velocity(2000.0, &BOUNDS, 1e-3));
        assert!((ramp.velocity - 1000.0).abs() < 1e-6);
        (0..50).for_each(|_| ramp.toward_velocity(-1.0, &BOUNDS, 1e-3));
        assert!((ramp.velocity - 600.0).abs() < 1e-6);
    }

    #[test]
    fn ramp_to_velocity_with_jerk_limit_is_smooth() {
        let mut ramp = Ramp::default();
        for (velocity, steps) in [(700.0, 170), (-300.0, 270), (-299.9, 10), (0.0, 90)] {
            for _ in 0..steps {
                let before = ramp;
                ramp.toward_velocity(velocity, &SMOOTH, 1e-3);
                let jerk = (ramp.acceleration - before.acceleration) / 1e-3;
                assert!(jerk.abs() <= JERK * 1.001, "{jerk}");
                assert!(ramp.acceleration.abs() <= 8000.0 * 1.001);
            }
            let off = (ramp.velocity - velocity).abs();
            assert!(off < 1e-6 && ramp.acceleration.abs() < 1e-3, "{ramp:?}");
        }
    }
}
