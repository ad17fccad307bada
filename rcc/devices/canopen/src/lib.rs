#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod config;
mod network;
#[cfg(test)]
#[path = "../../tests/plant/mod.rs"]
mod plant;

// The plant of the tests uses it, whose file belongs to all drivers.
#[cfg(test)]
use takt_net as _;

pub use config::{CanopenConfig, LinkLoss};
pub use network::{Canopen, check, describe, open};
