#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod fuzz;
mod skip;
mod steady;

pub use skip::{skip, vcan};
pub use steady::steady;
