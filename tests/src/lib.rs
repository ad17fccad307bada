#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod skip;
mod steady;

pub use skip::skip;
pub use steady::steady;
