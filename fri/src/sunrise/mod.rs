//! FRI of Sunrise, the generation of the LBR iiwa and LBR Med: protobuf messages in UDP, in three dialects.

#[cfg(feature = "emulator")]
pub mod emulator;
mod session;
pub mod wire;

pub use crate::counters::Counters;
pub use crate::error::AnswerError;
pub use crate::sequence::Order;
pub(crate) use session::PERIOD_MS;
pub use session::{
    Answer, Demand, Event, FrameError, IoError, IoLevel, Phase, Reception, Session, SessionConfig,
    Withheld,
};

/// Number of axes.
pub const AXES: usize = 7;

/// Names of the axes in the order of every joint array.
pub const JOINT_NAMES: [&str; AXES] = ["A1", "A2", "A3", "A4", "A5", "A6", "A7"];

/// UDP port of both sides by default; 30200 to 30209 are allowed by controllers.
pub const DEFAULT_PORT: u16 = 30200;
