//! The smallest thing that the owner of a protocol needs: send a frame, and receive one with its time
//! and what is known of its way. It never retries and opens nothing.

use std::time::Duration;

use crate::AnyFrame;

mod replay;

pub use replay::Replay;

/// Where a frame comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Origin {
    /// From the wire, or, an error frame, from the interface's controller.
    #[default]
    Bus,
    /// Another program of this host sent it.
    Host,
    /// This link sent it; it was on the wire at the time that is given.
    Own,
}

/// A frame that came in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// What came.
    pub frame: AnyFrame,
    /// When, on the link's clock.
    pub at: Duration,
    /// When, on the clock of the interface's hardware, if it has one.
    pub hardware: Option<Duration>,
    /// Where from.
    pub origin: Origin,
    /// Frames that were lost because this link was not read in time: all since it was opened.
    pub dropped: u32,
}

/// Why a link does not do what it should. Small and without text, as real-time threads meet it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// There is no room for the frame. It is not sent, now or later.
    #[error(
        "the send queue is full: the bus is overloaded, off, or nobody acknowledges; see `takt can stat`, \
         and make the queue longer if bursts are longer than it (ip link set IFACE txqueuelen 1000)"
    )]
    QueueFull,
    /// The interface is not up.
    #[error("the interface is down; see `takt can up`")]
    Down,
    /// The interface does not exist any more.
    #[error("the interface is gone; is the adapter unplugged?")]
    Gone,
    /// The interface does not carry such frames.
    #[error(
        "the interface does not carry such frames; CAN FD must be switched on (`takt can up --fd`)"
    )]
    Kind,
    /// Anything else that the operating system says.
    #[error("{}", std::io::Error::from_raw_os_error(*.0))]
    Os(
        /// The error number.
        i32,
    ),
}

/// A way for frames.
pub trait Link {
    /// Hands one frame over for sending; never waits, unless the link was told to.
    ///
    /// # Errors
    /// As [`LinkError`] tells; the frame is then lost.
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError>;

    /// Waits at most `timeout` for one frame; `None` when none came.
    ///
    /// # Errors
    /// As [`LinkError`] tells.
    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, LinkError>;
}
