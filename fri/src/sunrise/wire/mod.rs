//! Bytes to values and back for FRI of Sunrise, one file per message. No clock, no socket, no allocation.
#![warn(clippy::indexing_slicing)]

mod bounded;
mod codes;
mod command;
mod dialect;
mod framing;
mod fuzz;
mod monitoring;
mod parts;
mod proto;
#[cfg(test)]
mod tests;

pub use bounded::{List, Name};
pub use codes::{
    CommandMode, ControlMode, Drive, IoDirection, IoType, OperationMode, Overlay, Quality,
    RedundancyStrategy, Safety, SessionState,
};
pub use command::{Command, CommandData};
pub use dialect::Dialect;
pub use framing::unframe;
pub use fuzz::fuzz;
pub use monitoring::{ConnectionInfo, IpoData, MonitorData, Monitoring, RobotInfo};
pub use parts::{EndOf, Header, IoValue, Joints, Placement, Redundancy, TimeStamp, Transformation};

use std::fmt;

/// Longest datagram of either direction, bytes.
pub const MESSAGE_MAX: usize = 1500;

/// Maximum number of frames in one message.
pub const TRANSFORMATIONS_MAX: usize = 5;

/// Maximum number of inputs and outputs in one message.
pub const IOS_MAX: usize = 10;

/// Formats numbers in one line, four decimals.
struct ShowJoints<'a>(&'a [f64]);

impl fmt::Display for ShowJoints<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "[";
        for value in self.0 {
            write!(f, "{separator}{value:.4}")?;
            separator = " ";
        }
        f.write_str("]")
    }
}
