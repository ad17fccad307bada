#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod activity;
pub mod arm;
pub mod cell;
pub mod compose;
#[cfg(feature = "embedded")]
mod embedded;
pub mod engine;
pub mod error;
pub mod expression;
pub mod handle;
pub mod motion;
mod net;
mod order;
pub mod outcome;
pub mod pose;
mod session;

pub use activity::Activity;
pub use arm::Arm;
pub use cell::Cell;
pub use compose::{Composite, Event, either, together, when};
pub use error::Error;
pub use expression::{Condition, Number};
pub use handle::Handle;
pub use outcome::Outcome;
pub use pose::{Pose, deg};
