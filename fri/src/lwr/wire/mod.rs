//! Bytes to values and back for FRI 1.0, one file per datagram. No clock, no socket, no allocation.
#![warn(clippy::indexing_slicing)]

mod cmd;
mod codec;
mod codes;
mod flags;
mod fuzz;
mod header;
mod krl;
mod msr;

pub use cmd::Cmd;
pub use codes::{Control, Quality, State};
pub use flags::CmdFlags;
pub use fuzz::fuzz;
pub use header::Header;
pub use krl::Krl;
pub use msr::{Interface, Msr, Robot, Statistics};

use crate::lwr::AXES;
use std::fmt;

/// Formats joint values in one line, four decimals.
struct Joints<'a>(&'a [f32; AXES]);

impl fmt::Display for Joints<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "[";
        for value in self.0 {
            write!(f, "{separator}{value:.4}")?;
            separator = " ";
        }
        f.write_str("]")
    }
}
