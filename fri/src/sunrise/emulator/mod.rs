//! The other end of the wire: an emulated Sunrise cabinet with an LBR iiwa for tests, examples and demonstrations.
//!
//! It speaks the real datagrams of all three dialects and judges a client as the real controller is known to, with knobs for
//! what goes wrong on wires and in cabinets. The arm gives way in impedance control and feels a [`Contact`], with a constant
//! inertia per joint; it is no model of the dynamics. Numbers that KUKA does not publish (thresholds of quality, tolerated
//! misses, tolerances) are marked *assumption* in [`CabinetConfig`] and can be set.

mod cabinet;
mod config;
mod leave;
mod status;

#[cfg(target_os = "linux")]
pub use crate::emulator::serve;
pub use crate::emulator::{Contact, LineFaults, PowerOff, Served, Shape, Status, Timing};
pub use cabinet::{Cabinet, CabinetCounters, Left, StartRefused};
pub use config::{CabinetConfig, Control, Faults, Io, Limits, Overlay, Program, Robot};
pub use leave::{Lacking, Leave};
pub use status::CabinetStatus;
