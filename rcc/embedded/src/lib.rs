#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod cell;
mod embedded;
mod error;
mod machines;

pub use cell::{EmulatedCell, NAMES};
pub use embedded::Embedded;
pub use error::Error;
pub use machines::Machines;
pub use takt_core::CellConfig;
