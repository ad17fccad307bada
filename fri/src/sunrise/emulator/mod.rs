//! An emulated Sunrise cabinet with an LBR iiwa for tests, examples and demonstrations.
//!
//! It exchanges the real datagrams of all three dialects and checks a client as the real controller is known to, with
//! settings for faults of wires and cabinets. In impedance control the arm is compliant, with a constant inertia per
//! joint, and reacts to a [`Contact`]; the real dynamics are not modelled. Numbers that KUKA does not publish (quality
//! thresholds, tolerated misses, tolerances) are marked *assumption* in [`CabinetConfig`] and can be set.

mod cabinet;
mod config;
mod exit;
mod status;

#[cfg(target_os = "linux")]
pub use crate::emulator::serve;
pub use crate::emulator::{
    Carried, Contact, ControllerCounters, Flange, LineFaults, PowerOff, Sensing, Served, Shape,
    Status, Surroundings, Timing,
};
pub use cabinet::{Cabinet, Exit, StartError};
pub use config::{CabinetConfig, Control, Faults, Io, Limits, Overlay, Program, Robot};
pub use exit::{ExitReason, MissingValue};
pub use status::CabinetStatus;
