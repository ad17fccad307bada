//! Shared by the emulated controllers of both generations: an unreliable wire, repeatable randomness, the controller's
//! time grid and timing statistics, the arm and its contact. No protocol.

mod arm;
mod body;
mod chain;
mod contact;
mod counters;
mod faults;
mod grid;
mod history;
mod line;
#[cfg(target_os = "linux")]
mod serve;
mod served;
mod status;
mod surroundings;
mod window;

pub(crate) use arm::Arm;
pub(crate) use body::{Body, INERTIA, Law};
pub(crate) use chain::{Chain, Pose};
pub use contact::{Contact, Shape};
pub use counters::ControllerCounters;
pub use faults::{LineFaults, PowerOff};
pub(crate) use grid::Grid;
pub(crate) use history::{History, Sent};
pub(crate) use line::Line;
#[cfg(target_os = "linux")]
pub use serve::serve;
pub(crate) use served::served;
pub(crate) use status::Snapshot;
pub use status::{Served, Status};
pub(crate) use surroundings::Sensor;
pub use surroundings::{Carried, Flange, Sensing, Surroundings};
pub use window::Timing;
pub(crate) use window::Window;

/// Number of axes of both generations.
pub(crate) const AXES: usize = 7;
