//! ROS 2 without ROS, by the format of `rmw_zenoh_cpp`: keys, liveliness tokens, attachments, messages and goals. Everything here
//! is bytes and texts; sessions are in [`node`], and nothing here knows a controller.

pub mod action;
pub mod cdr;
mod fuzz;
pub mod goal;
pub mod keys;
pub mod messages;
#[cfg(feature = "zenoh")]
pub mod node;
pub mod types;

#[doc(hidden)]
pub use fuzz::fuzz;
