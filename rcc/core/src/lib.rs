#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod cell;
pub mod controller;
pub mod device;
pub mod error;
pub mod executor;
mod primitives;
pub mod record;
pub mod span;

pub use cell::CellConfig;
pub use controller::{Controller, NetId, SessionId};
pub use error::Error;
pub use takt_net as net;

use takt_net::Registry;

/// All primitives a controller knows: those of the net language, of motions and of devices.
#[must_use]
pub fn registry() -> Registry {
    let mut registry = Registry::core();
    registry.add(takt_motion::all());
    registry.add(primitives::all());
    registry
}
