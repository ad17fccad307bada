#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(feature = "pcap")]
pub mod capture;
pub mod client;
mod codes;
pub mod diagnosis;
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
