//! The drive's control loops: position P, velocity PI, ideal current. All in motor units; where the demand comes from
//! is not known here.

use super::motor::Motor;

/// The demand at the motor shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Demand {
    /// No torque.
    Off,
    /// Position (rad) at a velocity (rad/s), with an additional torque (N m).
    Position(f64, f64, f64),
    /// Velocity (rad/s), with an additional torque (N m).
    Velocity(f64, f64),
    /// Torque (N m).
    Torque(f64),
}

/// Largest torques, both positive, N m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub(super) positive: f64,
    pub(super) negative: f64,
    /// Largest speed, rad/s.
    pub(super) speed: f64,
}

/// Gains: position 1/s, velocity 1/s, integral 1/s². A stiff loop, stable at [`super::drive::TICK`].
const POSITION_GAIN: f64 = 80.0;
const VELOCITY_GAIN: f64 = 800.0;
const INTEGRAL_GAIN: f64 = 40_000.0;

/// State of the control loops.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Servo {
    /// Torque of the integral part, N m.
    integral: f64,
    /// Whether the last torque was at its limit.
    pub(super) limited: bool,
}

impl Servo {
    /// The torque for the next `dt` s.
    pub(super) fn torque(
        &mut self,
        demand: Demand,
        motor: &Motor,
        limits: &Limits,
        dt: f64,
    ) -> f64 {
        let (velocity, on_top) = match demand {
            Demand::Off => {
                *self = Self::default();
                return 0.0;
            }
            Demand::Torque(torque) => {
                self.integral = 0.0;
                // Beyond the largest speed only braking torque is applied.
                let over = motor.velocity.abs() > limits.speed;
                let torque = if over && torque * motor.velocity > 0.0 {
                    0.0
                } else {
                    torque
                };
                return self.limit(torque, limits);
            }
            Demand::Velocity(velocity, torque) => (velocity, torque),
            Demand::Position(position, velocity, torque) => {
                let correction = POSITION_GAIN * (position - motor.position);
                (velocity + correction, torque)
            }
        };
        let inertia = motor.config().inertia;
        let error = velocity.clamp(-limits.speed, limits.speed) - motor.velocity;
        let proportional = inertia * VELOCITY_GAIN * error;
        let wanted = proportional + self.integral + on_top;
        let torque = self.limit(wanted, limits);
        // Anti-windup: the integral part is held while the torque is limited.
        if !self.limited || wanted * error < 0.0 {
            self.integral += inertia * INTEGRAL_GAIN * error * dt;
        }
        torque
    }

    fn limit(&mut self, wanted: f64, limits: &Limits) -> f64 {
        let torque = wanted.clamp(-limits.negative, limits.positive);
        self.limited = torque.total_cmp(&wanted).is_ne();
        torque
    }
}
