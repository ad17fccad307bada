//! The CAN bus for commands that send requests: frames in both directions, and the time. Tests replace it by a bus
//! within the process, in virtual time. It decodes nothing.

use std::time::Duration;

use anyhow::Context as _;
use takt_can::Frame;
use takt_can::link::Link as _;
use takt_can::linux::{Options, QueuePolicy, SocketCan, monotonic};

use super::feed::cannot_open;
use crate::signal::Stop;

/// A bus.
pub(super) trait Wire {
    /// Monotonic time.
    fn now(&self) -> Duration;

    /// Sends a frame; waits while the send queue is full.
    ///
    /// # Errors
    /// If the interface fails.
    fn send(&mut self, frame: &Frame) -> anyhow::Result<()>;

    /// Waits for a frame, at most `timeout`.
    ///
    /// # Errors
    /// If the interface fails.
    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<Frame>>;

    /// Whether a stop was requested (Ctrl-C).
    fn is_stopped(&self) -> bool;

    /// Waits for a frame until `at`; `None` if none was received.
    ///
    /// # Errors
    /// If the interface fails.
    fn receive_until(&mut self, at: Duration) -> anyhow::Result<Option<Frame>> {
        self.receive(at.saturating_sub(self.now()))
    }
}

/// Longest wait for a full send queue: at 10 kbit/s it drains within this time.
const QUEUE_TIMEOUT: Duration = Duration::from_secs(1);

/// An interface of this host.
#[derive(Debug)]
pub(super) struct Live {
    name: String,
    socket: SocketCan,
    stop: Option<Stop>,
}

impl Live {
    /// Opens the interface; Ctrl-C terminates the program.
    pub(super) fn open(name: &str) -> anyhow::Result<Self> {
        let options = Options {
            queue: QueuePolicy::Wait(QUEUE_TIMEOUT),
            errors: false,
            ..Options::default()
        };
        let socket = SocketCan::open(name, &options).map_err(|error| cannot_open(name, &error))?;
        Ok(Self {
            name: name.to_owned(),
            socket,
            stop: None,
        })
    }

    /// Opens the interface for a command that has to stop a machine before it ends: [`Wire::is_stopped`] reports Ctrl-C.
    pub(super) fn open_to_stop(name: &str) -> anyhow::Result<Self> {
        let mut live = Self::open(name)?;
        live.stop = Some(Stop::listen()?);
        Ok(live)
    }
}

impl Wire for Live {
    fn now(&self) -> Duration {
        monotonic()
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        let sent = self.socket.send(&(*frame).into());
        sent.with_context(|| format!("{}: cannot send {frame}", self.name))
    }

    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<Frame>> {
        let received = self.socket.receive(timeout);
        let received = received.with_context(|| self.name.clone())?;
        Ok(received.and_then(|received| received.frame.classic().copied()))
    }

    fn is_stopped(&self) -> bool {
        self.stop.as_ref().is_some_and(Stop::is_requested)
    }
}
