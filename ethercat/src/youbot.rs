//! The KUKA youBot from the master's side: process data of its drives, TMCL over the raw mailbox, and state machines
//! for a drive, the homing of an arm, a base and a gripper. Sans-I/O, without allocation; it starts no motion by
//! itself: its owner permits motion.
//!
//! ```text
//! Drive: firmware, time-out and I2t flags, commutation, current clamp      drive.rs
//!   Homing: to the stop, cancellable                                       homing.rs
//! Gripper: two bars behind the last joint                                  gripper.rs
//!   Mailbox: one request at a time, between cycles, repeated               mailbox.rs
//!     Request, Reply                                                       tmcl.rs, parameters.rs
//! Command, Feedback, Flags                                                 wire.rs
//! JointGeometry, Impedance: ticks, rpm and mA <-> rad, rad/s and N m       joint.rs
//! holding: torques that carry the arm's own weight                         weight.rs
//! Mecanum, Odometry: four wheels <-> the base                              base.rs
//! ```

mod base;
mod drive;
mod gripper;
mod homing;
mod joint;
mod mailbox;
pub mod parameters;
mod tmcl;
mod weight;
mod wire;

pub use base::{Mecanum, Odometry, Ramp};
pub use drive::{Counters, Drive, DriveConfig, DriveFault, DriveState};
pub use gripper::{BarConfig, Gripper, GripperError, GripperState};
pub use homing::{Homing, HomingConfig, HomingError, HomingState};
pub use joint::{ARM, CURRENT_MAX_MA, HOMING, Impedance, JointGeometry};
pub use mailbox::{CallError, Mailbox};
pub use tmcl::{Answer, Request, TmclError, Version};
pub use weight::holding;
pub use wire::{Command, Feedback, Flags, Mode, Targets};

/// Vendor number of Trinamic, the manufacturer of the drives.
pub const TRINAMIC: u32 = 0x0000_0286;

/// Firmware of a drive: it determines the process data and the commutation search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Firmware {
    /// 1.48: 20 bytes of inputs; mode 7 finds the commutation.
    V148,
    /// 2.00: 32 bytes of inputs; turning in mode 2 finds the commutation.
    #[default]
    V200,
}

impl Firmware {
    /// Length of the inputs, bytes.
    pub const fn inputs_len(self) -> u16 {
        match self {
            Self::V148 => 20,
            Self::V200 => 32,
        }
    }

    /// The firmware with inputs of this length.
    pub(crate) const fn of_inputs(len: usize) -> Option<Self> {
        match len {
            20 => Some(Self::V148),
            32 => Some(Self::V200),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests;
