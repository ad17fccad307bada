#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]

// A loom build contains only the two structures that threads share; the rest needs a real kernel.
pub mod latest;
pub mod ring;
mod sync;

#[cfg(not(loom))]
pub mod alloc;
#[cfg(not(loom))]
pub mod cycle;
#[cfg(not(loom))]
pub mod flight;
#[cfg(not(loom))]
mod grant;
#[cfg(not(loom))]
pub mod host;
#[cfg(not(loom))]
mod linux;
#[cfg(not(loom))]
mod nanos;
#[cfg(not(loom))]
pub mod servo;
#[cfg(not(loom))]
pub mod simulated;
#[cfg(not(loom))]
pub mod stats;
#[cfg(not(loom))]
pub mod tai;
#[cfg(not(loom))]
pub mod thread;

#[cfg(not(loom))]
pub use self::{
    grant::{Grant, Outcome},
    linux::{
        clock::{may_wait, monotonic, read_tai, readable, sleep_until},
        ethtool, interface,
        usage::{Usage, thread_usage},
    },
    nanos::Nanos,
};
