//! Why the emulated cabinet ended an overlay, with joint, value and limit. Known texts of the controller, from its
//! users' reports, begin the message.

use crate::sunrise::JOINT_NAMES;
use crate::sunrise::wire::Safety;
use std::fmt;

/// A reason to end an overlay, or to stop waiting for one. All but [`ExitReason::Cancelled`] and [`ExitReason::Closed`] are faults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ExitReason {
    /// The robot program cancelled its motion.
    Cancelled,
    /// The robot program closed the session.
    Closed,
    /// Quality did not reach GOOD in 10 s.
    Await {
        /// Share of answers in time, 0..=1.
        answer_rate: f64,
    },
    /// Quality fell below GOOD.
    Quality {
        /// Share of answers in time, 0..=1.
        answer_rate: f64,
    },
    /// Too many consecutive periods without answer.
    Misses {
        /// Number of periods.
        cycles: u32,
        /// Their duration, ms.
        span_ms: f64,
    },
    /// No command agreed with the interpolator in time.
    NotSynchronised {
        /// Joint, 0..=6.
        joint: usize,
        /// Last command, rad; NaN without one.
        commanded: f64,
        /// Position of the interpolator, rad.
        expected: f64,
    },
    /// A command lacks values that the overlay expects.
    Missing {
        /// The missing values.
        value: MissingValue,
    },
    /// Commanded speed of a joint too large.
    Speed {
        /// Joint, 0..=6.
        joint: usize,
        /// Commanded speed, rad/s, signed.
        speed: f64,
        /// Limit, rad/s.
        limit: f64,
    },
    /// Commanded position of a joint out of range.
    Position {
        /// Joint, 0..=6.
        joint: usize,
        /// Commanded position, rad.
        position: f64,
        /// Limit, rad, absolute.
        limit: f64,
    },
    /// A position commanded with torques deviates too far from the measured one.
    AxisDelta {
        /// Joint, 0..=6.
        joint: usize,
        /// Commanded minus measured position, rad.
        delta: f64,
        /// Limit, rad.
        limit: f64,
    },
    /// A commanded value is infinite or NaN.
    NotFinite {
        /// Joint or component.
        joint: usize,
    },
    /// A commanded pose is out of reach.
    OutOfReach,
    /// Flange speed above the limit in T1.
    T1Speed {
        /// m/s.
        speed: f64,
        /// m/s.
        limit: f64,
    },
    /// The drives lost their power.
    Power,
    /// The safety controller stopped the robot.
    Safety(Safety),
}

/// Values missing in a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MissingValue {
    /// Joint positions.
    Joints,
    /// Joint torques.
    Torque,
    /// The wrench.
    Wrench,
    /// The pose.
    Pose,
}

impl fmt::Display for MissingValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Joints => "joint positions",
            Self::Torque => "joint torques",
            Self::Wrench => "the wrench",
            Self::Pose => "the pose",
        })
    }
}

fn name(joint: usize) -> &'static str {
    JOINT_NAMES.get(joint).copied().unwrap_or("?")
}

impl fmt::Display for ExitReason {
    #[expect(clippy::too_many_lines, reason = "one arm per reason")]
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Cancelled => write!(f, "motion cancelled"),
            Self::Closed => write!(f, "session closed"),
            Self::Await { answer_rate } => {
                let percent = answer_rate * 100.0;
                f.write_str("Timeout before FRI connection quality reached GOOD or EXCELLENT")?;
                write!(f, ": {percent:.0} % of answers in time")
            }
            Self::Quality { answer_rate } => {
                let percent = answer_rate * 100.0;
                f.write_str("CK_COMPOUND_RETURN_ERROR: WRONG_SESSION_STATE_MONITORING_WAIT")?;
                write!(f, ": quality below GOOD, {percent:.0} % of answers in time")
            }
            Self::Misses { cycles, span_ms } => {
                f.write_str("CK_COMPOUND_RETURN_ERROR: WRONG_SESSION_STATE_MONITORING_WAIT")?;
                write!(f, ": no answer for {cycles} periods ({span_ms:.1} ms)")
            }
            Self::NotSynchronised {
                joint,
                commanded,
                expected,
            } => {
                write!(
                    f,
                    "commands do not agree with the interpolator: {} ",
                    name(joint)
                )?;
                write!(
                    f,
                    "commanded {commanded:.4} rad, interpolator {expected:.4} rad"
                )
            }
            Self::Missing { value } => {
                write!(f, "a command lacks {value}, which the overlay expects")
            }
            Self::Speed {
                joint,
                speed,
                limit,
            } => {
                let name = name(joint);
                write!(
                    f,
                    "{name} commanded {speed:.2} rad/s, limit {limit:.2} rad/s"
                )
            }
            Self::Position {
                joint,
                position,
                limit,
            } => {
                let name = name(joint);
                write!(
                    f,
                    "{name} commanded {position:.3} rad, limit {limit:.3} rad"
                )
            }
            Self::AxisDelta {
                joint,
                delta,
                limit,
            } => {
                write!(
                    f,
                    "Illegal axis delta: {} commanded {delta:.3} rad ",
                    name(joint)
                )?;
                write!(f, "from the measured position, limit {limit:.3} rad")
            }
            Self::NotFinite { joint } => {
                write!(f, "value {joint} of a command is not a finite number")
            }
            Self::OutOfReach => write!(f, "the commanded pose is out of reach"),
            Self::T1Speed { speed, limit } => {
                write!(f, "flange at {:.0} mm/s in T1, limit ", speed * 1e3)?;
                write!(f, "{:.0} mm/s", limit * 1e3)
            }
            Self::Power => write!(f, "the drives lost their power"),
            Self::Safety(safety) => write!(f, "the safety controller requests {safety}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_reason_displays_cause() {
        let awaited = "Timeout before FRI connection quality reached GOOD or EXCELLENT";
        let wrong_state = "CK_COMPOUND_RETURN_ERROR: WRONG_SESSION_STATE_MONITORING_WAIT";
        for (reason, text) in [
            (ExitReason::Cancelled, "motion cancelled".to_owned()),
            (ExitReason::Closed, "session closed".into()),
            (ExitReason::Await { answer_rate: 0.25 }, format!("{awaited}: 25 % of answers in time")),
            (ExitReason::Quality { answer_rate: 0.5 }, format!("{wrong_state}: quality below GOOD, 50 % of answers in time")),
            (ExitReason::Misses { cycles: 10, span_ms: 20.0 }, format!("{wrong_state}: no answer for 10 periods (20.0 ms)")),
            (
                ExitReason::NotSynchronised { joint: 6, commanded: 0.5, expected: 0.25 },
                "commands do not agree with the interpolator: A7 commanded 0.5000 rad, interpolator 0.2500 rad".into(),
            ),
            (ExitReason::Missing { value: MissingValue::Torque }, "a command lacks joint torques, which the overlay expects".into()),
            (ExitReason::Speed { joint: 3, speed: 2.31, limit: 1.9635 }, "A4 commanded 2.31 rad/s, limit 1.96 rad/s".into()),
            (ExitReason::Position { joint: 2, position: -3.0, limit: 2.967 }, "A3 commanded -3.000 rad, limit 2.967 rad".into()),
            (
                ExitReason::AxisDelta { joint: 0, delta: 0.3, limit: 0.2 },
                "Illegal axis delta: A1 commanded 0.300 rad from the measured position, limit 0.200 rad".into(),
            ),
            (ExitReason::NotFinite { joint: 6 }, "value 6 of a command is not a finite number".into()),
            (ExitReason::OutOfReach, "the commanded pose is out of reach".into()),
            (ExitReason::T1Speed { speed: 0.3, limit: 0.25 }, "flange at 300 mm/s in T1, limit 250 mm/s".into()),
            (ExitReason::Power, "the drives lost their power".into()),
            (ExitReason::Safety(Safety::Stop1), "the safety controller requests stop-1".into()),
        ] {
            assert_eq!(reason.to_string(), text);
        }
    }
}
