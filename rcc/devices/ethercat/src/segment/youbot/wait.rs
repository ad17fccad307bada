//! What the devices of a youBot wait for before they are operational.

use takt_ethercat::youbot::{DriveFault, GripperError, HomingError};

/// Why a device is not operational.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Wait {
    /// A drive has a fault or does not follow.
    #[error("{0}")]
    Drive(DriveFault),
    /// A joint was not homed since power-on.
    #[error("it was not homed since power-on; `homing = true` lets it home")]
    NotHomed,
    /// A joint is being homed.
    #[error("it is being homed")]
    Homing,
    /// Homing failed.
    #[error("homing failed: {0}")]
    Failed(HomingError),
    /// The gripper was not homed since power-on.
    #[error("its gripper was not homed since power-on; `homing = true` lets it home")]
    GripperNotHomed,
    /// The gripper cannot be used.
    #[error("its gripper: {0}")]
    Gripper(GripperError),
}

/// A drive that a device waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::segment) struct Waiting {
    /// Index of the drive in the master.
    pub(in crate::segment) slave: usize,
    pub(in crate::segment) why: Wait,
}
