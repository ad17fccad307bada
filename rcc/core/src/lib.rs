#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate self as takt_core;

pub mod cell;
pub mod controller;
pub mod costs;
pub mod device;
pub mod error;
pub mod executor;
pub mod files;
pub mod ids;
pub mod local_socket;
pub mod memory;
mod primitives;
pub mod probe;
pub mod record;
pub mod span;
pub mod stop_channel;

pub use cell::{CellConfig, Loopback, OnLoss};
pub use controller::Controller;
pub use error::Error;
pub use ids::{NetId, SessionId};
pub use takt_machine as machine;
pub use takt_net as net;
pub use takt_rt::stats::{Snapshot, Summary};
pub use takt_rt::tai;
pub use takt_rt::{Nanos, monotonic, read_tai};

use takt_net::Registry;

/// All primitives of a controller: those of the net language, of motions and of devices.
#[must_use]
pub fn registry() -> Registry {
    let mut registry = Registry::core();
    registry.add(takt_motion::all());
    registry.add(takt_irl::all());
    registry.add(primitives::all());
    registry
}
