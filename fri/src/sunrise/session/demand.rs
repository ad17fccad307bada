//! What the owner of a session wants the robot to do, and why that was withheld. It does not build messages.

use super::Session;
use crate::guard::Violation;
use crate::sunrise::Phase;
use crate::sunrise::wire::{CommandMode, Joints, Redundancy};
use std::time::Duration;

/// What the robot shall do in this cycle. Which kinds are possible says the overlay of the robot program: its
/// [`CommandMode`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Demand {
    /// Nothing new: stay where the last command was. A moving robot stops at once, so brake first.
    Hold,
    /// Joint positions, rad.
    Position(Joints),
    /// A wrench on top of Cartesian impedance control.
    Wrench {
        /// Fx, Fy, Fz in N, torques about A, B, C in Nm.
        wrench: [f64; 6],
        /// Centre of the impedance, rad; `None` leaves it.
        joints: Option<Joints>,
    },
    /// Torques on top of joint impedance control.
    Torque {
        /// Nm.
        torque: Joints,
        /// Centre of the impedance, rad; `None` follows the measured positions, see
        /// [`super::SessionConfig::torque_follow`].
        joints: Option<Joints>,
    },
    /// A pose of the tool (2.x).
    Pose {
        /// Translation x, y, z in mm, then the quaternion w, x, y, z.
        pose: [f64; 7],
        /// Redundant axis; `None` leaves it to the controller.
        redundancy: Option<Redundancy>,
    },
}

/// Why a demand was not sent; the answer held the robot instead.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Withheld {
    /// The overlay is not active.
    #[error("the robot does not follow: {phase}")]
    NotCommanding {
        /// Where the connection stands.
        phase: Phase,
    },
    /// Command mode was entered anew and nobody asked for motion since.
    #[error("command mode was entered anew: engage, starting from the mirrored position")]
    NotEngaged,
    /// The overlay of the robot program wants something else.
    #[error("{demanded} commanded, the overlay of the robot program wants {wanted}")]
    Mode {
        /// What the overlay wants.
        wanted: CommandMode,
        /// What was demanded.
        demanded: CommandMode,
    },
    /// A value is beyond its guard.
    #[error(transparent)]
    Guard(Violation),
}

impl Demand {
    /// The command mode it belongs to; none for [`Demand::Hold`].
    #[must_use]
    pub fn mode(&self) -> Option<CommandMode> {
        match self {
            Self::Hold => None,
            Self::Position(_) => Some(CommandMode::Position),
            Self::Wrench { .. } => Some(CommandMode::Wrench),
            Self::Torque { .. } => Some(CommandMode::Torque),
            Self::Pose { .. } => Some(CommandMode::CartesianPose),
        }
    }

    pub(super) fn joints(&self) -> Option<&Joints> {
        match self {
            Self::Position(joints) => Some(joints),
            Self::Wrench { joints, .. } | Self::Torque { joints, .. } => joints.as_ref(),
            Self::Hold | Self::Pose { .. } => None,
        }
    }
}

impl Session {
    /// Whether a demand may go out with the answer that is due.
    pub(super) fn admit(&self, demand: &Demand) -> Result<(), Withheld> {
        let Some(demanded) = demand.mode() else {
            return Ok(());
        };
        if self.phase != Phase::CommandingActive {
            return Err(Withheld::NotCommanding { phase: self.phase });
        }
        if !self.is_engaged {
            return Err(Withheld::NotEngaged);
        }
        let wanted = self.command_mode();
        if demanded != wanted {
            return Err(Withheld::Mode { wanted, demanded });
        }
        self.guard(demand).map_err(Withheld::Guard)
    }

    /// Whether the guard lets these positions into the next answer, rad: it holds what it refuses at once, so ask before and
    /// brake. Compares with what was commanded last; the controller counts its own cycles, so the time between is theirs.
    pub fn check_joints(&self, wanted: &Joints) -> Result<(), Violation> {
        if !self.is_engaged {
            return Ok(());
        }
        let guard = &self.config.guard;
        guard.check_joints(&self.held, wanted, self.span())
    }

    fn guard(&self, demand: &Demand) -> Result<(), Violation> {
        let guard = &self.config.guard;
        if let Some(joints) = demand.joints() {
            self.check_joints(joints)?;
        }
        match demand {
            Demand::Hold | Demand::Position(_) => Ok(()),
            Demand::Wrench { wrench, .. } => guard.check_wrench(wrench),
            Demand::Torque { torque, .. } => guard.check_torque(torque),
            Demand::Pose { pose, .. } => check_pose(pose),
        }
    }

    /// Time between the measurement answered last and the one to be answered now.
    fn span(&self) -> Duration {
        let period = self.period().unwrap_or_default();
        let sequence = self.message.header.sequence;
        let cycles = self.answered.map_or(1, |last| sequence.wrapping_sub(last));
        period * cycles.clamp(1, u32::from(self.config.offline_after.max(1)))
    }
}

fn check_pose(pose: &[f64; 7]) -> Result<(), Violation> {
    const NAMES: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];
    let bad = pose.iter().position(|value| !value.is_finite());
    bad.map_or(Ok(()), |joint| {
        Err(Violation {
            joint,
            name: NAMES[joint],
            breach: crate::guard::Breach::NotFinite,
        })
    })
}
