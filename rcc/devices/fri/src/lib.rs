#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod config;
mod driver;
pub mod emulator;
mod fri;
pub mod iiwa;
mod kinematics;
pub mod lwr;
mod payload;
#[cfg(test)]
#[path = "../../tests/plant/mod.rs"]
mod plant;

pub use config::{IiwaConfig, IiwaIo, IiwaModel, LwrConfig};
pub use fri::{
    AXES, FriArm, FriFigures, Joints, Orders, Protocol, Reception, RefusedOutput, Totals,
};
pub use iiwa::Iiwa;
pub use lwr::Lwr;
