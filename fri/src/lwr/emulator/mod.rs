//! An emulated KRC2 lr for tests, examples and demonstrations.
//!
//! It exchanges the real datagrams and checks a client as the real controller is known to, with settings for faults of
//! wires and cabinets. In position control joints follow their set-point with a first-order lag. In impedance control
//! the arm is compliant, with a constant inertia per joint, and reacts to a [`Contact`]; the real dynamics are not
//! modelled. Numbers that KUKA does not publish (quality thresholds, tolerated misses, mirror tolerance) are marked
//! *assumption* in [`KrcConfig`] and can be set.

mod config;
mod exit;
mod krc;
mod krl;
mod parameter;
mod periphery;
mod screwdriver;
mod status;

#[cfg(target_os = "linux")]
pub use crate::emulator::serve;
pub use crate::emulator::{
    Carried, Contact, ControllerCounters, Flange, LineFaults, PowerOff, Sensing, Served, Shape,
    Status, Surroundings, Timing,
};
pub use config::{Faults, KrcConfig, Limits, Script, Stiffness};
pub use exit::ExitReason;
pub use krc::{Exit, Krc, StartError};
pub use parameter::Parameter;
pub use periphery::Periphery;
pub use screwdriver::Screwdriver;
pub use status::KrcStatus;
