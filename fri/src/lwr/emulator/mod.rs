//! The other end of the wire: an emulated KRC2 lr for tests, examples and demonstrations.
//!
//! It speaks the real datagrams and judges a client as the real controller is known to, with knobs for what goes wrong on
//! wires and in cabinets. In position control joints follow their set-point with a first-order lag; in impedance
//! control the arm gives way, with a constant inertia per joint, and feels a [`Contact`]: no model of the real dynamics. Numbers that KUKA does not publish (thresholds of quality, tolerated misses,
//! tolerance of the mirror) are marked *assumption* in [`KrcConfig`] and can be set.

mod config;
mod krc;
mod krl;
mod leave;
mod parameter;
mod status;

#[cfg(target_os = "linux")]
pub use crate::emulator::serve;
pub use crate::emulator::{Contact, LineFaults, PowerOff, Served, Shape, Status, Timing};
pub use config::{Faults, KrcConfig, Limits, Script, Stiffness};
pub use krc::{Krc, KrcCounters, Left, StartRefused};
pub use leave::Leave;
pub use parameter::Parameter;
pub use status::KrcStatus;
