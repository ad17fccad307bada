#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod activity;
pub mod arm;
pub mod base;
pub mod cell;
pub mod compose;
pub mod control;
pub mod cost;
pub mod coupled;
mod description;
#[cfg(feature = "embedded")]
mod embedded;
pub mod engine;
pub mod error;
pub mod explain;
pub mod expression;
#[cfg(feature = "fleet")]
pub mod fleet;
pub mod gripper;
pub mod handle;
pub mod io;
pub mod listener;
pub mod live;
pub mod motion;
pub mod moving;
mod net;
mod order;
pub mod outcome;
pub mod picture;
pub mod plan;
pub mod pose;
mod preparation;
pub mod prepared;
mod program;
mod session;
mod slot;
pub mod world;

pub use activity::Activity;
pub use arm::Arm;
pub use base::Base;
pub use cell::Cell;
pub use compose::{Composite, Event, either, together, when};
pub use control::Control;
pub use cost::Cost;
pub use coupled::{Coupled, coupled};
#[cfg(feature = "embedded")]
pub use embedded::simulate_time;
pub use error::{Error, ErrorKind};
pub use explain::Explanation;
pub use expression::{Condition, Number};
#[cfg(feature = "fleet")]
pub use fleet::Fleet;
pub use gripper::Gripper;
pub use handle::Handle;
pub use io::{Io, IoState};
pub use listener::{Expression, Listener};
pub use live::{JointGoal, JointVelocities, Live, LiveHandle, Twist};
pub use motion::{CartesianLimits, ForceLimits, JointTrajectory};
pub use moving::MovingFrame;
pub use outcome::Outcome;
pub use plan::Plan;
pub use pose::{Pose, deg};
pub use prepared::Prepared;
pub use takt_client::{Token, TokenError};
#[cfg(feature = "fleet")]
pub use takt_fleet::config::TlsFiles;
pub use takt_motion::trajectory::Waypoint;
pub use world::{Direction, Frame, Goal};
