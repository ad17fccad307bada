#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod allocations;
pub mod fuzz;
mod simulated;
mod skip;
mod steady;

pub use allocations::{Allocations, CountingAllocator};
pub use simulated::{now, pass, simulate_time};
pub use skip::{skip, vcan};
pub use steady::steady;
pub use takt_link::Random;
