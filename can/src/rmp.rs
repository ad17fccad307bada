//! The Segway Robotic Mobility Platform on CAN and on its USB port: messages, the driver of one power base, the
//! omnidirectional base of two, and (feature `emulator`) emulated power bases. No sockets and no clock; frames and time
//! are arguments.
//!
//! The manufacturer's interface guide is not public. This module follows what the public drivers and a recorded log
//! have in common; where they differ, the value is a parameter.

mod base;
mod command;
mod cycle;
mod driver;
#[cfg(feature = "emulator")]
pub mod emulator;
mod model;
mod odometry;
mod omni;
mod status;
mod usb;

pub use base::{ACCELERATION, Base, Motion};
pub use command::{Command, Config, Gain, Integrators, Mode, SHUTDOWN};
pub use cycle::{Cycles, Measurement};
pub use driver::{Driver, DriverConfig, Hindrance, State};
pub use model::{Model, Scales, YawSign};
pub use odometry::{Jump, Odometer, Pose};
pub use omni::{BACK, FRONT, Geometry, Omni, OmniConfig, Wheels};
pub use status::{ControlUnit, Message, StatusWord1, StatusWord2};
pub use usb::{Channel, Packet, PacketReader};
