#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod base;
mod config;
#[cfg(test)]
#[path = "../../tests/plant/mod.rs"]
mod plant;

pub use base::{Rmp, Wire, check, describe, open};
pub use config::RmpConfig;
