//! FRI 1.0, the generation of the LWR 4 and 4+ (KRC2 lr). [`Session`] answers measurements, [`Dialog`] exchanges user
//! data with the KRL program.

mod dialog;
#[cfg(feature = "emulator")]
pub mod emulator;
mod protocol;
mod session;
pub mod wire;

pub use crate::counters::Counters;
pub use crate::error::AnswerError;
pub use crate::sequence::Order;
pub use dialog::{Dialog, DialogError, Progress, Request, Settings};
pub use protocol::{Load, Protocol};
pub(crate) use session::stated_period;
pub use session::{ChooseError, Event, Fields, Phase, Reception, Session, SessionConfig};

/// Number of axes.
pub const AXES: usize = 7;

/// Names of the axes in the order of every joint array; the redundant axis E1 is third.
pub const JOINT_NAMES: [&str; AXES] = ["A1", "A2", "E1", "A3", "A4", "A5", "A6"];

/// UDP port on which a PC listens by default.
pub const DEFAULT_PORT: u16 = 49938;
