//! A frame of any kind that a CAN interface delivers: classic frame, CAN FD frame or error frame. CAN XL is not
//! supported.

use std::fmt;

use crate::{ErrorFrame, FdFrame, Frame, Id};

/// Any kind of frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AnyFrame {
    /// A data or remote frame of up to eight bytes.
    Classic(Frame),
    /// A CAN FD frame.
    Fd(FdFrame),
    /// An error frame from the interface's controller.
    Error(ErrorFrame),
}

impl AnyFrame {
    /// The identifier; error frames have none.
    pub const fn id(&self) -> Option<Id> {
        match self {
            Self::Classic(frame) => Some(frame.id()),
            Self::Fd(frame) => Some(frame.id()),
            Self::Error(_) => None,
        }
    }

    /// The payload; for an error frame, its details.
    pub fn data(&self) -> &[u8] {
        match self {
            Self::Classic(frame) => frame.data(),
            Self::Fd(frame) => frame.data(),
            Self::Error(frame) => &frame.data,
        }
    }

    /// The classic frame, if it is one.
    pub const fn classic(&self) -> Option<&Frame> {
        match self {
            Self::Classic(frame) => Some(frame),
            Self::Fd(_) | Self::Error(_) => None,
        }
    }
}

impl From<Frame> for AnyFrame {
    fn from(frame: Frame) -> Self {
        Self::Classic(frame)
    }
}

impl From<FdFrame> for AnyFrame {
    fn from(frame: FdFrame) -> Self {
        Self::Fd(frame)
    }
}

impl From<ErrorFrame> for AnyFrame {
    fn from(frame: ErrorFrame) -> Self {
        Self::Error(frame)
    }
}

impl fmt::Display for AnyFrame {
    /// As candump logs it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Classic(frame) => frame.fmt(f),
            Self::Fd(frame) => frame.fmt(f),
            Self::Error(frame) => frame.fmt(f),
        }
    }
}
