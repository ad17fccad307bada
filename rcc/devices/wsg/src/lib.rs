#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod config;
mod driver;
pub mod emulator;
pub mod session;
pub mod wire;

pub use config::WsgConfig;
pub use driver::{Wsg, describe};
