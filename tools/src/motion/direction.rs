//! Directions in which an arm is jogged, as teach pendants label them: `x+`, `rz-`, `j3+`.

use std::fmt;

use takt_api::motion::CartesianLimits;
use takt_api::{Arm, Twist};

/// An axis of a jog.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axis {
    /// Along x, y or z of the base: 0 to 2.
    Along(usize),
    /// About x, y or z of the base: 0 to 2.
    About(usize),
    /// A joint, from 0.
    Joint(usize),
}

/// A direction of a jog.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Direction {
    pub(super) axis: Axis,
    pub(super) is_positive: bool,
}

/// Names of the axes of the base.
const NAMES: [&str; 3] = ["x", "y", "z"];

impl Direction {
    fn sign(self) -> f64 {
        if self.is_positive { 1.0 } else { -1.0 }
    }

    /// The velocity of the flange at these limits; `None` for a joint.
    pub(super) fn twist(self, limits: &CartesianLimits) -> Option<Twist> {
        let along = |axis: usize, speed: f64| {
            let mut vector = [0.0; 3];
            if let Some(component) = vector.get_mut(axis) {
                *component = speed * self.sign();
            }
            vector
        };
        match self.axis {
            Axis::Along(axis) => Some(Twist {
                velocity: along(axis, limits.velocity),
                ..Twist::default()
            }),
            Axis::About(axis) => Some(Twist {
                rotation: along(axis, limits.rot_velocity),
                ..Twist::default()
            }),
            Axis::Joint(_) => None,
        }
    }

    /// The velocities of the joints, rad/s; `None` if it is no joint of the arm.
    pub(super) fn joints(self, arm: &Arm) -> Option<Vec<f64>> {
        let Axis::Joint(joint) = self.axis else {
            return None;
        };
        let limits = &arm.description().joints;
        let mut velocities = vec![0.0; limits.len()];
        *velocities.get_mut(joint)? = limits.get(joint)?.velocity * self.sign();
        Some(velocities)
    }
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |axis: usize| NAMES.get(axis).copied().unwrap_or("?");
        match self.axis {
            Axis::Along(axis) => write!(f, "{}", name(axis))?,
            Axis::About(axis) => write!(f, "r{}", name(axis))?,
            Axis::Joint(joint) => write!(f, "j{joint}")?,
        }
        f.write_str(if self.is_positive { "+" } else { "-" })
    }
}

/// Reads a direction.
pub(super) fn direction(text: &str) -> Result<Direction, String> {
    let wrong = || {
        format!(
            "`{text}` is no direction: write x+, y-, z+ along the axes of the base, rx+, ry-, rz+ about them, or j0- for \
             joint 0"
        )
    };
    let (name, is_positive) = match (text.strip_suffix('+'), text.strip_suffix('-')) {
        (Some(name), _) => (name, true),
        (None, Some(name)) => (name, false),
        (None, None) => return Err(wrong()),
    };
    let of_base = |name: &str| NAMES.iter().position(|known| *known == name);
    let joint = || {
        let number = name.strip_prefix('j')?;
        let is_number = number.bytes().all(|byte| byte.is_ascii_digit());
        number.parse().ok().filter(|_| is_number).map(Axis::Joint)
    };
    let about = || of_base(name.strip_prefix('r')?).map(Axis::About);
    let axis = of_base(name).map(Axis::Along).or_else(about);
    let axis = axis.or_else(joint).ok_or_else(wrong)?;
    Ok(Direction { axis, is_positive })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_read_as_they_are_written() {
        for text in ["x+", "y-", "z+", "rx-", "ry+", "rz-", "j0+", "j6-"] {
            assert_eq!(direction(text).unwrap().to_string(), text);
        }
        for wrong in [
            "", "x", "+x", "w+", "r+", "j+", "j-1+", "j+1+", "rj1+", "1+", "x+ ",
        ] {
            let error = direction(wrong).unwrap_err();
            assert!(error.contains("write x+"), "{wrong}: {error}");
        }
    }

    #[test]
    fn direction_is_as_fast_as_the_limits() {
        let limits = CartesianLimits::default();
        let along = direction("y-").unwrap().twist(&limits).unwrap();
        assert_eq!(along, Twist::xyz(0.0, -limits.velocity, 0.0));
        let about = direction("rz+").unwrap().twist(&limits).unwrap();
        assert_eq!(
            about,
            Twist::default().turning(0.0, 0.0, limits.rot_velocity)
        );
        assert_eq!(direction("j1+").unwrap().twist(&limits), None);
    }
}
