#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod codes;
#[cfg(feature = "emulator")]
mod emulator;
pub mod error;
pub mod generation;
pub mod guard;
pub mod link;
#[cfg(target_os = "linux")]
pub mod linux;
pub mod lwr;
mod sequence;
pub mod sunrise;
