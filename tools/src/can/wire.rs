//! A CAN bus as the commands use it that ask nodes: frames both ways, and the time. Commands are written
//! against it, so that their tests run on a bus within the process, in virtual time. It decodes nothing.

use std::time::Duration;

use anyhow::Context as _;
use takt_can::Frame;
use takt_can::link::Link as _;
use takt_can::linux::{Options, QueuePolicy, SocketCan, monotonic};

use super::feed::{Stop, cannot_open};

/// A bus.
pub(super) trait Wire {
    /// On a clock that does not go back.
    fn now(&self) -> Duration;

    /// Sends a frame; waits for room if there is none.
    ///
    /// # Errors
    /// If the interface fails.
    fn send(&mut self, frame: &Frame) -> anyhow::Result<()>;

    /// Waits at most so long for a frame.
    ///
    /// # Errors
    /// If the interface fails.
    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<Frame>>;

    /// Whether somebody asked to end.
    fn is_stopped(&self) -> bool;

    /// Waits until then, for a frame. None has come when it gives none.
    ///
    /// # Errors
    /// If the interface fails.
    fn receive_until(&mut self, at: Duration) -> anyhow::Result<Option<Frame>> {
        self.receive(at.saturating_sub(self.now()))
    }
}

/// How long there may be no room for a frame: at 10 kbit/s that of a full queue is over by then.
const ROOM: Duration = Duration::from_secs(1);

/// An interface of this host.
#[derive(Debug)]
pub(super) struct Live {
    name: String,
    socket: SocketCan,
    stop: Option<Stop>,
}

impl Live {
    /// Opens it; Ctrl-C then ends the program.
    pub(super) fn open(name: &str) -> anyhow::Result<Self> {
        let options = Options {
            queue: QueuePolicy::Wait(ROOM),
            errors: false,
            ..Options::default()
        };
        let socket = SocketCan::open(name, &options).with_context(|| cannot_open(name))?;
        Ok(Self {
            name: name.to_owned(),
            socket,
            stop: None,
        })
    }

    /// Opens it; Ctrl-C is told by [`Wire::is_stopped`], for who has something to bring to rest before.
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
        sent.with_context(|| format!("{}: {frame} is not sent", self.name))
    }

    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<Frame>> {
        let received = self.socket.receive(timeout);
        let received = received.with_context(|| self.name.clone())?;
        Ok(received.and_then(|received| received.frame.classic().copied()))
    }

    fn is_stopped(&self) -> bool {
        self.stop.as_ref().is_some_and(Stop::is_asked)
    }
}
