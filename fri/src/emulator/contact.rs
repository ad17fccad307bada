//! Something the flange can touch: a wall or a spring. No friction; of the arm, only the flange is considered.

use super::surroundings::{Flange, Surroundings};
use nalgebra::Vector3;
use std::time::Duration;

/// Kind of a [`Contact`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Fills the half-space behind the point; pushes, never pulls.
    Wall,
    /// Ties the flange to the plane through the point; pushes and pulls.
    Spring,
}

/// An object that presses on the flange along one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Wall or spring.
    pub shape: Shape,
    /// A point of its surface in the robot's base frame, m.
    pub point: [f64; 3],
    /// Outward normal of the surface, the direction of the push; any length but zero.
    pub normal: [f64; 3],
    /// N/m, from 0; the emulator limits it to 50,000.
    pub stiffness: f64,
    /// Ns/m, from 0; the emulator limits it to 500.
    pub damping: f64,
}

/// Largest stiffness for which the emulator's integration step is stable, N/m.
const STIFFEST: f64 = 50_000.0;
/// Largest damping for which the emulator's integration step is stable, Ns/m.
const STRONGEST: f64 = 500.0;

impl Contact {
    /// Force on the flange, N, in the base frame.
    pub(crate) fn force(&self, position: &Vector3<f64>, velocity: &Vector3<f64>) -> Vector3<f64> {
        let normal = Vector3::from(self.normal).normalize();
        if !normal.norm().is_finite() {
            return Vector3::zeros();
        }
        let depth = normal.dot(&(Vector3::from(self.point) - position));
        let push = self.stiffness.clamp(0.0, STIFFEST) * depth
            - self.damping.clamp(0.0, STRONGEST) * normal.dot(velocity);
        match self.shape {
            Shape::Spring => normal * push,
            Shape::Wall if depth > 0.0 => normal * push.max(0.0),
            Shape::Wall => Vector3::zeros(),
        }
    }
}

impl Surroundings for Contact {
    fn wrench(&mut self, _at: Duration, flange: &Flange) -> [f64; 6] {
        let tip = Vector3::from(flange.tip);
        let lever = tip - Vector3::from(flange.position);
        let [x, y, z, a, b, c] = flange.velocity;
        let velocity = Vector3::new(x, y, z) + Vector3::new(a, b, c).cross(&lever);
        let force = self.force(&tip, &velocity);
        let moment = lever.cross(&force);
        [force.x, force.y, force.z, moment.x, moment.y, moment.z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn force(shape: Shape, height: f64, speed: f64) -> f64 {
        let contact = Contact {
            shape,
            point: [0.0, 0.0, 0.5],
            normal: [0.0, 0.0, 2.0],
            stiffness: 1000.0,
            damping: 10.0,
        };
        let force = contact.force(&Vector3::new(9.0, 9.0, height), &Vector3::z().scale(speed));
        assert!(force.xy().norm() < 1e-12);
        force.z
    }

    #[test]
    fn contact_wall_pushes_spring_also_pulls() {
        for (shape, height, speed, expected) in [
            (Shape::Wall, 0.51, 0.0, 0.0),
            (Shape::Wall, 0.49, 0.0, 10.0),
            (Shape::Wall, 0.49, -0.1, 11.0),
            (Shape::Wall, 0.49, 2.0, 0.0),
            (Shape::Spring, 0.51, 0.0, -10.0),
            (Shape::Spring, 0.49, 2.0, -10.0),
        ] {
            assert!(
                (force(shape, height, speed) - expected).abs() < 1e-9,
                "{shape:?} {height}"
            );
        }
    }
}
