#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod assembly;
mod cell;
mod embedded;
mod error;
mod faults;
mod machines;
mod surroundings;
mod watch;

pub use cell::{EmulatedCell, NAMES};
pub use embedded::{Embedded, simulate_time};
pub use error::Error;
pub use faults::{Fault, Faults};
pub use machines::Machines;
pub use surroundings::{CellWorld, Mounted};
pub use takt_core::CellConfig;
pub use takt_world as world;
pub use watch::{Figures, Moment, Record, set_points, watch};
