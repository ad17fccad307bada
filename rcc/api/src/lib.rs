#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod activity;
pub mod arm;
pub mod base;
pub mod cell;
pub mod compose;
pub mod coupled;
mod description;
#[cfg(feature = "embedded")]
mod embedded;
pub mod engine;
pub mod error;
pub mod expression;
pub mod gripper;
pub mod handle;
pub mod io;
pub mod live;
pub mod motion;
mod net;
mod order;
pub mod outcome;
pub mod plan;
pub mod pose;
mod preparation;
mod program;
mod session;
pub mod world;

pub use activity::Activity;
pub use arm::Arm;
pub use base::Base;
pub use cell::Cell;
pub use compose::{Composite, Event, either, together, when};
pub use coupled::{Coupled, coupled};
pub use error::{Error, ErrorKind};
pub use expression::{Condition, Number};
pub use gripper::Gripper;
pub use handle::Handle;
pub use io::{Io, IoState};
pub use live::{JointGoal, JointVelocities, Live, LiveHandle, Twist};
pub use outcome::Outcome;
pub use plan::Plan;
pub use pose::{Pose, deg};
pub use takt_client::{Token, TokenError};
pub use world::{Frame, Goal};
