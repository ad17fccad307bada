#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(feature = "capture")]
pub mod capture;
mod link;
#[cfg(target_os = "linux")]
pub mod linux;
mod pair;
mod random;

pub use link::Link;
pub use pair::{Memory, pair};
pub use random::Random;
