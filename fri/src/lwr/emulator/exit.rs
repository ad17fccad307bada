//! Why the emulated controller left command mode, with joint, value and limit.

use super::parameter::Parameter;
use crate::lwr::JOINT_NAMES;
use crate::lwr::wire::CmdFlags;
use std::fmt;

/// A reason to leave command mode. All but [`ExitReason::FriStop`] are faults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ExitReason {
    /// The KRL program called friStop.
    FriStop,
    /// Quality fell to UNACCEPTABLE.
    Quality {
        /// Share of answers in time, 0..=1.
        answer_rate: f64,
    },
    /// Too many consecutive cycles without answer.
    Misses {
        /// Number of cycles.
        cycles: u32,
        /// Their duration, ms.
        span_ms: f64,
    },
    /// Commanded speed of a joint too large.
    Speed {
        /// Joint, 0..=6.
        joint: usize,
        /// Commanded speed, rad/s, signed.
        speed: f64,
        /// Limit in force, rad/s.
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
    /// A position that must mirror the set-point does not: the FRI interpolation error of the real controller.
    Interpolation {
        /// Joint, 0..=6.
        joint: usize,
        /// Commanded position, rad.
        commanded: f64,
        /// Set-point in the measurement that the answer reflects, rad.
        expected: f64,
    },
    /// A commanded position is infinite or NaN.
    NotFinite {
        /// Joint, 0..=6.
        joint: usize,
    },
    /// The command flags changed outside monitor mode.
    FlagsChanged {
        /// Flags of the first command in command mode.
        from: CmdFlags,
        /// Flags of this command.
        to: CmdFlags,
    },
    /// A commanded frame is out of reach.
    OutOfReach,
    /// Another field that flags declare valid is NaN or out of range.
    Parameter {
        /// Which field.
        parameter: Parameter,
        /// Joint, 0..=6, or component, 0..=5.
        index: usize,
        /// Commanded value, in the field's unit.
        value: f64,
    },
}

fn name(joint: usize) -> &'static str {
    JOINT_NAMES.get(joint).copied().unwrap_or("?")
}

impl fmt::Display for ExitReason {
    #[expect(clippy::too_many_lines, reason = "a table of texts")]
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::FriStop => write!(f, "friStop"),
            Self::Quality { answer_rate } => {
                write!(
                    f,
                    "quality UNACCEPTABLE: {:.0} % of answers in time",
                    answer_rate * 100.0
                )
            }
            Self::Misses { cycles, span_ms } => {
                write!(f, "no answer for {cycles} cycles ({span_ms:.1} ms)")
            }
            Self::Speed {
                joint,
                speed,
                limit,
            } => {
                write!(
                    f,
                    "{} commanded {speed:.2} rad/s, limit {limit:.2} rad/s",
                    name(joint)
                )
            }
            Self::Position {
                joint,
                position,
                limit,
            } => {
                write!(
                    f,
                    "{} commanded {position:.3} rad, limit {limit:.3} rad",
                    name(joint)
                )
            }
            Self::Interpolation {
                joint,
                commanded,
                expected,
            } => {
                write!(f, "FRI interpolation error: {} ", name(joint))?;
                write!(
                    f,
                    "commanded {commanded:.4} rad, set-point {expected:.4} rad"
                )
            }
            Self::NotFinite { joint } => {
                write!(
                    f,
                    "{} commanded a position that is not a number",
                    name(joint)
                )
            }
            Self::FlagsChanged { from, to } => {
                write!(
                    f,
                    "command flags changed from {from} to {to} in command mode"
                )
            }
            Self::OutOfReach => write!(f, "the commanded frame is out of reach"),
            Self::Parameter {
                parameter,
                index,
                value,
            } => {
                write!(
                    f,
                    "{} commanded {parameter} ",
                    parameter.component_name(index)
                )?;
                write!(f, "{value:.3} {}", parameter.bounds())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_reason_names_joint() {
        let flags = CmdFlags::JNTPOS;
        for (reason, text) in [
            (ExitReason::FriStop, "friStop"),
            (
                ExitReason::Quality { answer_rate: 0.49 },
                "quality UNACCEPTABLE: 49 % of answers in time",
            ),
            (
                ExitReason::Misses {
                    cycles: 10,
                    span_ms: 20.0,
                },
                "no answer for 10 cycles (20.0 ms)",
            ),
            (
                ExitReason::Speed {
                    joint: 3,
                    speed: 2.31,
                    limit: 1.9635,
                },
                "A3 commanded 2.31 rad/s, limit 1.96 rad/s",
            ),
            (
                ExitReason::Position {
                    joint: 2,
                    position: -3.0,
                    limit: 2.967,
                },
                "E1 commanded -3.000 rad, limit 2.967 rad",
            ),
            (
                ExitReason::Interpolation {
                    joint: 0,
                    commanded: 0.0,
                    expected: 0.5,
                },
                "FRI interpolation error: A1 commanded 0.0000 rad, set-point 0.5000 rad",
            ),
            (
                ExitReason::NotFinite { joint: 6 },
                "A6 commanded a position that is not a number",
            ),
            (
                ExitReason::OutOfReach,
                "the commanded frame is out of reach",
            ),
            (
                ExitReason::Parameter {
                    parameter: Parameter::JointDamping,
                    index: 2,
                    value: 1.5,
                },
                "E1 commanded damping 1.500 (0 to 1)",
            ),
            (
                ExitReason::FlagsChanged {
                    from: flags,
                    to: CmdFlags::NONE,
                },
                "command flags changed from JNTPOS to none in command mode",
            ),
        ] {
            assert_eq!(reason.to_string(), text);
        }
    }
}
