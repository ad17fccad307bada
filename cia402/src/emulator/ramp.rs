//! A velocity-limited ramp towards a position or a velocity, re-planned in every step. Jerk is not
//! limited: 6086h offers the trapezoid alone.

/// Bounds of a motion, in user units per second and per second squared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
    pub(super) deceleration: f64,
}

/// A demand in motion, in user units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Ramp {
    pub(super) position: f64,
    pub(super) velocity: f64,
}

impl Ramp {
    /// One step of `dt` s towards a velocity.
    pub(super) fn toward_velocity(&mut self, velocity: f64, bounds: &Bounds, dt: f64) {
        let velocity = velocity.clamp(-bounds.velocity, bounds.velocity);
        let slower = velocity.abs() < self.velocity.abs() || velocity * self.velocity < 0.0;
        let rate = if slower {
            bounds.deceleration
        } else {
            bounds.acceleration
        };
        let change = (velocity - self.velocity).clamp(-rate * dt, rate * dt);
        self.velocity += change;
        self.position += self.velocity * dt;
    }

    /// One step of `dt` s towards a position, to pass it at `end_velocity` (its size; 0 to stand).
    pub(super) fn toward_position(
        &mut self,
        target: f64,
        end_velocity: f64,
        bounds: &Bounds,
        dt: f64,
    ) {
        let distance = target - self.position;
        let way = distance.abs();
        let d = bounds.deceleration.max(f64::MIN_POSITIVE);
        // The largest velocity from which stopping in steps of dt still ends at the target.
        let half = d * dt / 2.0;
        let stoppable = (half * half + 2.0 * d * way + end_velocity * end_velocity).sqrt() - half;
        let wanted = stoppable.min(bounds.velocity).min(way / dt);
        let step = distance.signum() * wanted;
        let slower = step.abs() < self.velocity.abs() || step * self.velocity < 0.0;
        let rate = if slower { d } else { bounds.acceleration };
        // A hair more, so that rounding does not make the last step miss.
        let most = rate * dt * (1.0 + 1e-9);
        self.velocity += (step - self.velocity).clamp(-most, most);
        self.position += self.velocity * dt;
    }

    /// Whether it stands at the target.
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
    };

    #[test]
    fn a_position_is_reached_within_bounds_and_without_overshoot() {
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

    #[test]
    fn a_target_behind_is_reached_after_turning() {
        let mut ramp = Ramp {
            position: 0.0,
            velocity: 900.0,
        };
        for _ in 0..5000 {
            ramp.toward_position(-50.0, 0.0, &BOUNDS, 1e-3);
        }
        assert!(ramp.is_at(-50.0), "{}", ramp.position);
    }

    #[test]
    fn velocities_are_approached_at_their_rates() {
        let mut ramp = Ramp::default();
        (0..100).for_each(|_| ramp.toward_velocity(2000.0, &BOUNDS, 1e-3));
        assert!((ramp.velocity - 500.0).abs() < 1e-6);
        (0..1000).for_each(|_| ramp.toward_velocity(2000.0, &BOUNDS, 1e-3));
        assert!((ramp.velocity - 1000.0).abs() < 1e-6);
        (0..50).for_each(|_| ramp.toward_velocity(-1.0, &BOUNDS, 1e-3));
        assert!((ramp.velocity - 600.0).abs() < 1e-6);
    }
}
