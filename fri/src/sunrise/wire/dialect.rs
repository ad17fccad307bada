//! The three wire formats of Sunrise FRI by name, as errors state them. Detection and framing are in `framing`.

use std::fmt;

/// Wire format of a controller, by the version of its FRI option.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Dialect {
    /// FRI 1.7 to 1.17: the datagram is the message; measurements carry commandedJointPosition, commands in monitor mode
    /// mirror it.
    V1,
    /// FRI 2.0 to 2.5: the datagram is the message; poses, no commandedJointPosition, commands in monitor mode are empty.
    V2,
    /// FRI 2.7, sold as 3.0: as 2.x, in a frame of length and checksum.
    V3,
}

impl fmt::Display for Dialect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::V1 => "FRI 1.x",
            Self::V2 => "FRI 2.0 to 2.5",
            Self::V3 => "FRI 2.7 (3.0)",
        })
    }
}
