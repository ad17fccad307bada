#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]

mod any;
pub mod bits;
pub mod bus;
pub mod canopen;
mod error;
pub mod fault;
mod fd;
mod frame;
pub mod fuzz;
pub mod link;
pub mod linux;
pub mod load;
pub mod log;
pub mod rmp;
pub mod stat;

pub use takt_cia402 as cia402;

pub use any::AnyFrame;
pub use error::{FrameError, LogError};
pub use fault::{BusState, ErrorFrame};
pub use fd::FdFrame;
pub use frame::{Frame, Id};
pub use log::{Direction, LogLine};
