#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod command;
pub mod config;
pub mod keys;
pub mod ros;
#[cfg(feature = "zenoh")]
pub mod session;
pub mod start;
pub mod telemetry;
