//! FRI 1.0, the generation of the LWR 4 and 4+ (KRC2 lr). It commands joint positions only: impedance and Cartesian
//! fields exist in the [`wire`] format, no machine here uses them.

#[cfg(feature = "emulator")]
pub mod emulator;
mod session;
pub mod wire;

pub use crate::error::AnswerError;
pub use crate::sequence::Order;
pub use session::{Counters, Event, Phase, Reception, Session, SessionConfig};

/// Number of axes.
pub const AXES: usize = 7;

/// Names of the axes in the order of every joint array; the redundant axis E1 is third.
pub const JOINT_NAMES: [&str; AXES] = ["A1", "A2", "E1", "A3", "A4", "A5", "A6"];

/// UDP port on which a PC listens by default.
pub const DEFAULT_PORT: u16 = 49938;
