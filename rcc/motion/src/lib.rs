#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(test)]
mod bench;
pub mod dynamics;
#[cfg(test)]
mod fixture;
pub mod kinematics;
mod model;
mod motion;
mod otg;
mod pose;
mod shape;
pub mod urdf;

use takt_net::Definition;

pub use model::{Model, TextError, URDF};
pub use motion::{live, plan, trajectory};

/// All definitions of this crate.
pub fn all() -> Vec<Definition> {
    let tables = [
        shape::table(),
        otg::table(),
        pose::table(),
        kinematics::table(),
        motion::table(),
    ];
    tables.into_iter().flatten().collect()
}
