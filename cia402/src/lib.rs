#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod codes;
pub mod dictionary;
#[cfg(feature = "emulator")]
pub mod emulator;
mod error;
mod goal;
mod homing;
mod master;
pub mod proof;
mod quirk;
mod runaway;
mod set_point;
mod shutdown;
mod state;
mod transition;
mod words;

pub use codes::error_text;
pub use error::DecodeError;
pub use goal::{Goal, next_control_word};
pub use homing::{HOMING_MODE, HOMING_START, Homing, HomingError, HomingStatus};
pub use master::{DriveCommand, DriveFault, Feedback, Master, MasterOptions};
pub use quirk::{Quirk, UnknownQuirk};
pub use runaway::{Monitor, Runaway, RunawayLimits};
pub use set_point::{Change, HandShake, Offer, SetPoint, SetPointError};
pub use shutdown::{Power, Shutdown, Standstill, axis_goal};
pub use state::State;
pub use transition::{Command, TRANSITIONS, Transition, Trigger, transition};
pub use words::{ControlWord, StatusWord};
