//! The owner's demand on the robot for one cycle, and why it was withheld. It does not build messages.

use super::Session;
use crate::guard::Violation;
use crate::sunrise::Phase;
use crate::sunrise::wire::{CommandMode, Joints, Redundancy};
use std::time::Duration;

/// Motion demanded in this cycle. The overlay of the robot program determines the possible kinds: its [`CommandMode`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Demand {
    /// No new command: stay at the last one. A moving robot stops at once, so brake first.
    Hold,
    /// Joint positions, rad.
    Position(Joints),
    /// A wrench on top of Cartesian impedance control.
    Wrench {
        /// Fx, Fy, Fz in N, torques about A, B, C in Nm.
        wrench: [f64; 6],
        /// Centre of the impedance, rad; `None` keeps it.
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
        /// Phase of the connection.
        phase: Phase,
    },
    /// Command mode was entered again, and the program has not engaged since.
    #[error("command mode was entered again: engage, starting from the mirrored position")]
    NotEngaged,
    /// The overlay of the robot program expects other values.
    #[error("{demanded} commanded, the overlay of the robot program expects {wanted}")]
    Mode {
        /// Mode of the overlay.
        wanted: CommandMode,
        /// Mode of the demand.
        demanded: CommandMode,
    },
    /// A value exceeds a limit of the guard.
    #[error(transparent)]
    Guard(Violation),
}

impl Demand {
    /// The command mode it belongs to; none for [`Demand::Hold`].
    pub fn mode(&self) -> Option<CommandMode> {
        match self {
            Self::Hold => None,
            Self::Position(_) => Some(CommandMode::Position),
            Self::Wrench { .. } => Some(CommandMode::Wrench),
            Self::Torque { .. } => Some(CommandMode::Torque),
            Self::Pose { .. } => Some(CommandMode::CartesianPose),
        }
    }

    /// The same demand with other joint positions.
    pub(super) fn with_joints(self, joints: Joints) -> Self {
        match self {
            Self::Position(_) => Self::Position(joints),
            Self::Wrench { wrench, .. } => Self::Wrench {
                wrench,
                joints: Some(joints),
            },
            Self::Torque { torque, .. } => Self::Torque {
                torque,
                joints: Some(joints),
            },
            other @ (Self::Hold | Self::Pose { .. }) => other,
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
    /// Checks whether the due answer may carry a demand; `checked` is what the guard says of its positions.
    pub(super) fn admit(
        &self,
        demand: &Demand,
        checked: Result<(), Violation>,
    ) -> Result<(), Withheld> {
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
        let checked = checked.and_then(|()| self.check_added(demand));
        checked.map_err(Withheld::Guard)
    }

    /// Checks the positions of a demand against the guard. The reference is the last command and the controller's cycle
    /// count since.
    pub(super) fn check_joints(&self, demand: &Demand) -> Result<(), Violation> {
        let guard = &self.config.guard;
        match demand.joints().filter(|_| self.is_engaged) {
            Some(joints) => guard.check_joints(&self.held, joints, self.span()),
            None => Ok(()),
        }
    }

    fn check_added(&self, demand: &Demand) -> Result<(), Violation> {
        let guard = &self.config.guard;
        match demand {
            Demand::Hold | Demand::Position(_) => Ok(()),
            Demand::Wrench { wrench, .. } => guard.check_wrench(wrench),
            Demand::Torque { torque, .. } => guard.check_torque(torque),
            Demand::Pose { pose, .. } => check_pose(pose),
        }
    }

    /// Time between the message answered last and the current one.
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
