#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(feature = "pcap")]
pub mod capture;
pub mod client;
mod codes;
mod counters;
pub mod diagnosis;
#[cfg(feature = "emulator")]
mod emulator;
pub mod error;
pub mod generation;
pub mod guard;
#[cfg(target_os = "linux")]
pub mod linux;
pub mod lwr;
mod sequence;
#[cfg(all(target_os = "linux", feature = "pcap"))]
pub mod silence;
pub mod sunrise;

/// The transport of datagrams.
pub mod link {
    pub use takt_link::{Link, Memory, pair};
}
