//! The interface between a protocol and its bus: send a frame, and receive frames with time stamp and origin. It never
//! retries and opens nothing.

use std::time::Duration;

use crate::AnyFrame;

mod replay;

pub use replay::Replay;

/// Origin of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Origin {
    /// Received from the wire; error frames: from the interface's controller.
    #[default]
    Bus,
    /// Another program of this host sent it.
    Host,
    /// This link sent it; the time stamp is the time of its transmission.
    Own,
}

/// A received frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received {
    /// The frame.
    pub frame: AnyFrame,
    /// Time of reception, on the link's clock.
    pub at: Duration,
    /// Hardware time stamp, if the interface has a clock.
    pub hardware: Option<Duration>,
    /// Its origin.
    pub origin: Origin,
    /// Frames lost since the link was opened because it was not read in time.
    pub dropped: u32,
}

/// Errors of a link. Small and `Copy`, because real-time threads handle them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// The send queue is full. The frame is dropped.
    #[error(
        "No buffer space available (ENOBUFS): the send queue is full, as the bus is overloaded, off, or no node \
         acknowledges\nhint: see `takt can stat`; make the queue longer if bursts are longer than it (`ip link set IFACE \
         txqueuelen 1000`)"
    )]
    QueueFull,
    /// The interface is not up.
    #[error(
        "Network is down (ENETDOWN): the interface is not up\nhint: `ip link set IFACE up type can bitrate BITRATE` with the bit rate of \
         the nodes, or `takt can up`"
    )]
    Down,
    /// The interface was removed.
    #[error(
        "No such device (ENODEV): the interface was removed\nhint: plug the adapter in again, then open it again"
    )]
    Lost,
    /// The interface does not support this kind of frame.
    #[error(
        "the interface does not support this kind of frame; enable CAN FD (`takt can up --fd`)"
    )]
    Kind,
    /// Any other error of the operating system.
    #[error("{}", std::io::Error::from_raw_os_error(*.0))]
    Os(
        /// `errno`.
        i32,
    ),
}

/// A connection that sends and receives frames.
pub trait Link {
    /// Queues one frame for transmission; does not block unless the link is configured to.
    ///
    /// # Errors
    /// See [`LinkError`]; the frame is then lost.
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError>;

    /// Waits at most `timeout` for one frame; `None` after the timeout.
    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, LinkError>;

    /// The network interface of this host that it is at, if it is at one.
    fn interface(&self) -> Option<&str> {
        None
    }

    /// The nominal bit rate, bit/s, if the link knows it; of an interface the system knows it
    /// ([`crate::linux::bit_rate`]).
    fn bit_rate(&self) -> Option<u32> {
        None
    }
}

/// A link that a thread can own.
pub trait CanLink: Link + Send + std::fmt::Debug {}

impl<T: Link + Send + std::fmt::Debug> CanLink for T {}
