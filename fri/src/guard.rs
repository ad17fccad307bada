//! Checks commands against limits: position, speed, step, torque and wrench. A violation names joint and limit. The
//! guard only rejects; stopping the robot is up to the caller and the controller. It is no safety function.

use std::fmt;
use std::time::Duration;

/// Number of axes of both generations.
const AXES: usize = 7;

/// Components of a wrench in the order of [`crate::sunrise`]; the LWR has the torques in reverse order (sic).
const COMPONENTS: [&str; 6] = ["Fx", "Fy", "Fz", "torque 1", "torque 2", "torque 3"];

/// Allowance for the rounding of positions to single precision on the wire of the LWR, rad.
const ROUNDING_RAD: f64 = 1e-6;

/// Command limits. An infinite limit is never exceeded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guard {
    /// Names of the joints, for error texts.
    pub names: [&'static str; AXES],
    /// Lowest and highest position, rad.
    pub position_rad: [[f64; 2]; AXES],
    /// Largest absolute speed between two commands, rad/s, from 0.
    pub speed_rad_per_s: [f64; AXES],
    /// Largest change between two commands, whatever the time between them, rad, from 0.
    pub step_rad: [f64; AXES],
    /// Deceleration with which a joint must be able to stop within its range, rad/s², above 0; infinite disables the check.
    pub deceleration_rad_per_s2: [f64; AXES],
    /// Largest absolute added torque, Nm, from 0.
    pub torque_nm: [f64; AXES],
    /// Largest absolute added force, N, and torque, Nm, from 0.
    pub wrench: [f64; 6],
}

/// An answer whose positions passed the guard, or were replaced.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guarded {
    /// Bytes to send.
    pub len: usize,
    /// Why the guard rejected the positions that were asked for, if so.
    pub refused: Option<Violation>,
    /// Whether the answer holds the robot at the last positions instead.
    pub is_held: bool,
}

impl Guard {
    /// Checks only that values are finite.
    pub const fn open(names: [&'static str; AXES]) -> Self {
        Self {
            names,
            position_rad: [[f64::NEG_INFINITY, f64::INFINITY]; AXES],
            speed_rad_per_s: [f64::INFINITY; AXES],
            step_rad: [f64::INFINITY; AXES],
            deceleration_rad_per_s2: [f64::INFINITY; AXES],
            torque_nm: [f64::INFINITY; AXES],
            wrench: [f64::INFINITY; 6],
        }
    }

    /// Checks positions that follow `from` after `span`.
    pub fn check_joints(
        &self,
        from: &[f64; AXES],
        to: &[f64; AXES],
        span: Duration,
    ) -> Result<(), Violation> {
        let span_s = span.as_secs_f64();
        for (joint, (from, to)) in from.iter().zip(to).enumerate() {
            self.check_joint(joint, *from, *to, span_s)
                .map_err(|breach| self.violation(joint, breach))?;
        }
        Ok(())
    }

    fn check_joint(&self, joint: usize, from: f64, to: f64, span_s: f64) -> Result<(), Breach> {
        if !to.is_finite() {
            return Err(Breach::NotFinite);
        }
        // A joint already beyond its range may stay or return.
        let [low, high] = self.position_rad[joint];
        if to < low.min(from) || to > high.max(from) {
            return Err(Breach::Position {
                position: to,
                low,
                high,
            });
        }
        let (step, limit) = (to - from, self.step_rad[joint]);
        if step.abs() > limit + ROUNDING_RAD {
            return Err(Breach::Step { step, limit });
        }
        let limit = self.speed_rad_per_s[joint];
        if step.abs() > limit * span_s + ROUNDING_RAD {
            let speed = step / span_s;
            return Err(Breach::Speed { speed, limit });
        }
        self.check_stop(joint, from, to, step / span_s)
    }

    /// Whether a joint at `to` with this speed can stop within its range.
    fn check_stop(&self, joint: usize, from: f64, to: f64, speed: f64) -> Result<(), Breach> {
        let [low, high] = self.position_rad[joint];
        let stop = to + speed * speed.abs() / (2.0 * self.deceleration_rad_per_s2[joint]);
        let (lowest, highest) = (low.min(from) - ROUNDING_RAD, high.max(from) + ROUNDING_RAD);
        if stop < lowest || stop > highest {
            return Err(Breach::Stop {
                position: to,
                speed,
                low,
                high,
            });
        }
        Ok(())
    }

    /// Checks added torques.
    pub fn check_torque(&self, torque: &[f64; AXES]) -> Result<(), Violation> {
        let mut torques = torque.iter().enumerate();
        torques.try_for_each(|(joint, torque)| self.check_torque_of(joint, *torque))
    }

    /// Checks the torque added to one joint, 0..=6.
    pub fn check_torque_of(&self, joint: usize, torque: f64) -> Result<(), Violation> {
        let limit = self.torque_nm[joint];
        if !torque.is_finite() {
            return Err(self.violation(joint, Breach::NotFinite));
        }
        if torque.abs() > limit {
            return Err(self.violation(joint, Breach::Torque { torque, limit }));
        }
        Ok(())
    }

    /// Checks an added wrench.
    pub fn check_wrench(&self, wrench: &[f64; 6]) -> Result<(), Violation> {
        for (component, value) in wrench.iter().enumerate() {
            let (value, limit) = (*value, self.wrench[component]);
            let name = COMPONENTS[component];
            let breach = if value.is_finite() {
                Breach::Wrench { value, limit }
            } else {
                Breach::NotFinite
            };
            if value.is_nan() || value.abs() > limit || value.is_infinite() {
                return Err(Violation {
                    joint: component,
                    name,
                    breach,
                });
            }
        }
        Ok(())
    }

    fn violation(&self, joint: usize, breach: Breach) -> Violation {
        let name = self.names[joint];
        Violation {
            joint,
            name,
            breach,
        }
    }
}

/// A command beyond a limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Violation {
    /// Index of the joint, 0..=6, or of the component of a wrench, 0..=5.
    pub joint: usize,
    /// Its name.
    pub name: &'static str,
    /// Violated limit and value.
    pub breach: Breach,
}

/// The violated limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Breach {
    /// Infinite or not a number.
    NotFinite,
    /// Out of the range.
    Position {
        /// Commanded, rad.
        position: f64,
        /// Lowest, rad.
        low: f64,
        /// Highest, rad.
        high: f64,
    },
    /// Too far from the last command.
    Step {
        /// Commanded, rad.
        step: f64,
        /// Limit, rad.
        limit: f64,
    },
    /// Too fast since the last command.
    Speed {
        /// Commanded, rad/s.
        speed: f64,
        /// Limit, rad/s.
        limit: f64,
    },
    /// Too fast to stop in the range.
    Stop {
        /// Commanded, rad.
        position: f64,
        /// Commanded, rad/s.
        speed: f64,
        /// Lowest, rad.
        low: f64,
        /// Highest, rad.
        high: f64,
    },
    /// Torque too large.
    Torque {
        /// Commanded, Nm.
        torque: f64,
        /// Limit, Nm.
        limit: f64,
    },
    /// Force or torque too large.
    Wrench {
        /// Commanded, N or Nm.
        value: f64,
        /// Limit, N or Nm.
        limit: f64,
    },
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} commanded ", self.name)?;
        match self.breach {
            Breach::NotFinite => write!(f, "a value that is not a finite number"),
            Breach::Position {
                position,
                low,
                high,
            } => {
                write!(f, "{position:.4} rad, range {low:.4} to {high:.4} rad")
            }
            Breach::Step { step, limit } => {
                write!(f, "a step of {step:.5} rad, limit {limit:.5} rad")
            }
            Breach::Speed { speed, limit } => {
                write!(f, "{speed:.3} rad/s, limit {limit:.3} rad/s")
            }
            Breach::Stop {
                position,
                speed,
                low,
                high,
            } => {
                write!(f, "{position:.4} rad at {speed:.3} rad/s, too fast to ")?;
                write!(f, "stop in the range {low:.4} to {high:.4} rad")
            }
            Breach::Torque { torque, limit } => {
                write!(f, "{torque:.2} Nm, limit {limit:.2} Nm")
            }
            Breach::Wrench { value, limit } => {
                write!(f, "{value:.2}, limit {limit:.2} (N or Nm)")
            }
        }
    }
}

impl std::error::Error for Violation {}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn guard() -> Guard {
        Guard {
            position_rad: [[-2.0, 1.0]; AXES],
            speed_rad_per_s: [2.0; AXES],
            step_rad: [0.01; AXES],
            deceleration_rad_per_s2: [10.0; AXES],
            torque_nm: [10.0; AXES],
            wrench: [50.0, 50.0, 50.0, 5.0, 5.0, 5.0],
            ..Guard::open(crate::lwr::JOINT_NAMES)
        }
    }

    fn joints(value: f64) -> [f64; AXES] {
        let mut joints = [0.0; AXES];
        joints[2] = value;
        joints
    }

    #[test]
    fn guard_violation_names_joint_value_and_limit() {
        let check = |from, to, span| {
            let verdict = guard().check_joints(&joints(from), &joints(to), span);
            verdict.map_err(|violation| violation.to_string())
        };
        let refused = |text: &str| Err(text.to_owned());
        assert_eq!(check(0.0, 0.002, MS), Ok(()));
        assert_eq!(
            check(0.0, 0.003, MS),
            refused("E1 commanded 3.000 rad/s, limit 2.000 rad/s")
        );
        assert_eq!(check(0.0, -0.008, MS * 4), Ok(()));
        assert_eq!(
            check(0.0, -0.02, MS * 20),
            refused("E1 commanded a step of -0.02000 rad, limit 0.01000 rad")
        );
        assert_eq!(check(0.999, 1.0, MS * 1000), Ok(()));
        assert_eq!(
            check(1.0, 1.001, MS),
            refused("E1 commanded 1.0010 rad, range -2.0000 to 1.0000 rad")
        );
        assert_eq!(check(1.005, 1.005, MS), Ok(()), "the joint stays");
        assert_eq!(check(1.005, 1.004, MS), Ok(()), "the joint returns");
        assert!(check(1.005, 1.006, MS).is_err());
        assert_eq!(
            check(0.0, f64::NAN, MS),
            refused("E1 commanded a value that is not a finite number")
        );
        assert_eq!(check(0.948, 0.949, MS), Ok(()), "stops in 0.05 rad");
        assert_eq!(
            check(0.9495, 0.951, MS),
            refused(
                "E1 commanded 0.9510 rad at 1.500 rad/s, too fast to stop in the range -2.0000 to 1.0000 rad"
            )
        );
        assert_eq!(check(0.952, 0.9505, MS), Ok(()), "moving back");
        let torque = |value| {
            guard()
                .check_torque(&joints(value))
                .map_err(|it| it.to_string())
        };
        assert_eq!(torque(-10.0), Ok(()));
        assert_eq!(
            torque(-10.5),
            refused("E1 commanded -10.50 Nm, limit 10.00 Nm")
        );
        assert!(torque(f64::INFINITY).is_err());
        let wrench = |value| guard().check_wrench(&[0.0, 0.0, 0.0, value, 0.0, 0.0]);
        assert_eq!(wrench(5.0), Ok(()));
        assert_eq!(wrench(6.0).map_err(|it| it.joint), Err(3));
        assert_eq!(
            wrench(f64::NAN).map_err(|it| it.breach),
            Err(Breach::NotFinite)
        );
    }

    #[test]
    fn guard_open_rejects_only_non_finite() {
        let guard = Guard::open(crate::sunrise::JOINT_NAMES);
        assert_eq!(guard.check_joints(&joints(-1e9), &joints(1e9), MS), Ok(()));
        assert_eq!(guard.check_torque(&joints(1e9)), Ok(()));
        assert_eq!(guard.check_wrench(&[1e9; 6]), Ok(()));
        assert!(guard.check_wrench(&[f64::INFINITY; 6]).is_err());
        assert!(
            guard
                .check_joints(&joints(0.0), &joints(f64::INFINITY), MS)
                .is_err()
        );
    }
}
