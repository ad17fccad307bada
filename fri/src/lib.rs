#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod error;
pub mod link;
#[cfg(target_os = "linux")]
pub mod linux;
pub mod lwr;
