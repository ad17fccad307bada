#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod candump;
pub mod canopen;
mod error;
mod frame;
pub mod rmp;

pub use candump::{Direction, LogLine};
pub use error::{FrameError, LogError};
pub use frame::{Frame, Id};
