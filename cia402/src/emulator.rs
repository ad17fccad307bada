//! A drive with a motor behind an object dictionary: the other side of the profile, for tests, labs and demonstrations.
//! It does not know which bus its dictionary is attached to.
//!
//! ```text
//! bus node -> Dictionary <- keys -> Drive: power (state machine, option codes)
//!                                          modes (PP PV TQ HM IP CSP CSV CST: a demand)
//!                                          servo (demand -> torque), guards (faults)
//!                                          Motor (inertia, friction, brake, switches, heat)
//! ```
//!
//! Time is an argument of [`Drive::step`]; nothing happens between two steps.

mod distortion;
mod drive;
mod guards;
mod homing;
mod modes;
mod motor;
mod objects;
mod power;
mod quirks;
mod ramp;
mod servo;
#[cfg(test)]
mod tests;

pub use distortion::{Distortion, ProcessDataFaults};
pub use drive::{Drive, DriveConfig, Step, Stepped};
pub use guards::FaultCode;
pub use homing::Method;
pub use motor::{Motor, MotorConfig, Switches};
pub use quirks::Quirks;
