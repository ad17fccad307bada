//! The motor, its load, brake, encoder and switches. It knows neither objects nor control loops.

use std::f64::consts::TAU;

/// Properties of a motor and what it moves, all at the motor's shaft.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorConfig {
    /// Inertia of motor and load, kg m².
    pub inertia: f64,
    /// Viscous friction, N m s/rad.
    pub viscous: f64,
    /// Dry friction, N m.
    pub coulomb: f64,
    /// Torque of the load, positive when it drives towards positive positions, N m.
    pub load: f64,
    /// Continuous (rated) torque of the motor, N m.
    pub rated_torque: f64,
    /// Torque of the closed brake, N m.
    pub brake_torque: f64,
    /// Opening time of the brake, s.
    pub brake_release: f64,
    /// Thermal time constant, s; twice the rated torque overheats a cold motor in roughly a third of it.
    pub thermal_time: f64,
    /// Encoder increments in a revolution.
    pub increments: u32,
    /// Where in a revolution the encoder's index pulse is, 0 to 2 pi, rad.
    pub index: f64,
    /// Below this position the negative limit switch is on, rad.
    pub negative_limit: f64,
    /// Above this position the positive limit switch is on, rad.
    pub positive_limit: f64,
    /// Between these positions the home switch is on, rad.
    pub home: (f64, f64),
    /// Mechanical stops: the axis moves between these positions, rad.
    pub stops: (f64, f64),
}

impl Default for MotorConfig {
    /// A servo motor of some 200 W with 20 revolutions of travel and a short home cam.
    fn default() -> Self {
        Self {
            inertia: 1e-4,
            viscous: 1e-4,
            coulomb: 0.02,
            load: 0.0,
            rated_torque: 0.64,
            brake_torque: 3.0,
            brake_release: 0.02,
            thermal_time: 20.0,
            increments: 4096,
            index: 1.0,
            negative_limit: -10.0 * TAU,
            positive_limit: 10.0 * TAU,
            home: (-0.5, 0.5),
            stops: (-11.0 * TAU, 11.0 * TAU),
        }
    }
}

/// The three switches of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Switches {
    /// At the negative end.
    pub negative: bool,
    /// At the positive end.
    pub positive: bool,
    /// At home.
    pub home: bool,
}

/// A motor in motion.
#[derive(Clone, Debug)]
pub struct Motor {
    config: MotorConfig,
    /// Position since power-on, rad.
    pub position: f64,
    /// Velocity, rad/s.
    pub velocity: f64,
    /// Torque of the motor in the last step, N m.
    pub torque: f64,
    /// External torque in addition to the load, N m.
    pub external: f64,
    /// Whether the brake holds the shaft.
    pub braked: bool,
    /// Temperature of the winding: 0 cold, 1 at the limit.
    pub heat: f64,
}

impl Motor {
    /// A cold motor at rest at that position (rad), braked.
    pub const fn new(config: MotorConfig, position: f64) -> Self {
        Self {
            config,
            position,
            velocity: 0.0,
            torque: 0.0,
            external: 0.0,
            braked: true,
            heat: 0.0,
        }
    }

    /// Its properties.
    pub const fn config(&self) -> &MotorConfig {
        &self.config
    }

    /// Advances by `dt` (s, at most about a millisecond) with this torque (N m).
    pub fn step(&mut self, torque: f64, dt: f64) {
        let c = &self.config;
        self.torque = torque;
        let brake = if self.braked { c.brake_torque } else { 0.0 };
        let driving = torque + c.load + self.external - c.viscous * self.velocity;
        let dry = c.coulomb + brake;
        let free = self.velocity + driving / c.inertia * dt;
        let slowed = dry / c.inertia * dt;
        // Dry friction stops a motion, it never reverses it.
        self.velocity = free.signum() * (free.abs() - slowed).max(0.0);
        self.position += self.velocity * dt;
        let (low, high) = c.stops;
        if self.position < low || self.position > high {
            self.position = self.position.clamp(low, high);
            self.velocity = 0.0;
        }
        // First-order heating: at rated torque it ends at 1.
        let load = (torque / c.rated_torque).powi(2);
        self.heat += (load - self.heat) * (dt / c.thermal_time).min(1.0);
    }

    /// The switches at the present position.
    pub fn switches(&self) -> Switches {
        let c = &self.config;
        Switches {
            negative: self.position <= c.negative_limit,
            positive: self.position >= c.positive_limit,
            home: self.position >= c.home.0 && self.position <= c.home.1,
        }
    }

    /// The first index pulse on the path between two positions, rad.
    pub(crate) fn index_between(&self, from: f64, to: f64) -> Option<f64> {
        let index = self.config.index;
        let turn = |position: f64| (position - index) / TAU;
        let number = if to > from {
            turn(from).floor() + 1.0
        } else {
            turn(from).ceil() - 1.0
        };
        let at = number * TAU + index;
        let within = if to > from { at <= to } else { at >= to };
        (within && to.total_cmp(&from).is_ne()).then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn index_pulses_are_met_once_a_turn_in_either_direction() {
        let motor = Motor::new(MotorConfig::default(), 0.0);
        for (from, to, expected) in [
            (0.0, 0.9, None),
            (0.0, 1.0, Some(1.0)),
            (1.0, 1.1, None),
            (1.1, 0.9, Some(1.0)),
            (1.0, 0.9, None),
            (0.0, 20.0, Some(1.0)),
            (-0.1, -TAU, Some(1.0 - TAU)),
            (0.5, 0.5, None),
        ] {
            assert_eq!(motor.index_between(from, to), expected, "{from} to {to}");
        }
    }

    #[test]
    fn brake_and_friction_hold_against_a_load() {
        let config = MotorConfig {
            load: 0.5,
            ..MotorConfig::default()
        };
        let mut motor = Motor::new(config, 0.0);
        (0..1000).for_each(|_| motor.step(0.0, 1e-4));
        assert!(motor.position.abs() < 1e-12);
        motor.braked = false;
        (0..1000).for_each(|_| motor.step(0.0, 1e-4));
        assert!(motor.position > 1.0, "{}", motor.position);
    }

    #[test]
    fn mechanical_stops_end_motion() {
        let mut motor = Motor::new(MotorConfig::default(), 0.0);
        motor.braked = false;
        (0..100_000).for_each(|_| motor.step(1.0, 1e-4));
        assert_eq!((motor.position, motor.velocity), (11.0 * TAU, 0.0));
    }

    #[test]
    fn rated_torque_heats_exactly_to_the_limit() {
        let mut motor = Motor::new(MotorConfig::default(), 0.0);
        for _ in 0..100_000 {
            motor.step(0.64, 1e-3);
        }
        assert!((0.99..=1.0).contains(&motor.heat), "{}", motor.heat);
    }
}
