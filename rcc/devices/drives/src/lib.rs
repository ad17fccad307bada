#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod arm;
mod check;
mod config;
mod driven;
mod heavy;
mod homing;
mod torque;

pub use arm::{Arm, Feedback, JointEvent, Order, proven, report_quirks};
pub use check::{check, describe, limits_of, parts};
pub use config::{DriveArm, DriveJoint, Recovery};
pub use homing::{Homing, HomingError, HomingInput, HomingMotion, HomingOutput, HomingStep};
pub use torque::Cut;
