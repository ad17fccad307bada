//! Where a power base is: on a CAN bus, where both its boards are heard as one, or at a serial port, whose packets tell
//! which board they are of.

use std::time::Duration;

use anyhow::Context as _;
use takt_can::Frame;
use takt_can::linux::{Serial, monotonic};
use takt_can::rmp::Channel;

use crate::can::wire::Wire;
use crate::signal::Stop;

/// A way to a power base.
pub(super) trait Port {
    /// On a clock that does not go back.
    fn now(&self) -> Duration;

    /// Sends a frame.
    ///
    /// # Errors
    /// If the way is gone.
    fn send(&mut self, frame: &Frame) -> anyhow::Result<()>;

    /// Waits at most so long for a frame, and of which board it is.
    ///
    /// # Errors
    /// If the way is gone.
    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<(Channel, Frame)>>;

    /// Whether somebody asked to end.
    fn is_stopped(&self) -> bool;
}

impl<W: Wire> Port for W {
    fn now(&self) -> Duration {
        Wire::now(self)
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        Wire::send(self, frame)
    }

    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<(Channel, Frame)>> {
        let frame = Wire::receive(self, timeout)?;
        Ok(frame.map(|frame| (Channel::A, frame)))
    }

    fn is_stopped(&self) -> bool {
        Wire::is_stopped(self)
    }
}

/// A serial port of this host.
#[derive(Debug)]
pub(super) struct SerialPort {
    name: String,
    serial: Serial,
    stop: Stop,
}

impl SerialPort {
    pub(super) fn open(name: &str) -> anyhow::Result<Self> {
        let serial = Serial::open(name).with_context(|| {
            format!("cannot open serial port {name}: is the USB cable plugged, and may you use it (group dialout)?")
        })?;
        Ok(Self {
            name: name.to_owned(),
            serial,
            stop: Stop::listen()?,
        })
    }
}

impl Port for SerialPort {
    fn now(&self) -> Duration {
        monotonic()
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        let sent = self.serial.send(frame);
        sent.with_context(|| format!("{} does not take a packet; is it unplugged?", self.name))
    }

    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<(Channel, Frame)>> {
        let received = self.serial.receive(timeout);
        let received =
            received.with_context(|| format!("{} is gone; is it unplugged?", self.name))?;
        Ok(received.map(|(channel, frame, _)| (channel, frame)))
    }

    fn is_stopped(&self) -> bool {
        self.stop.is_requested()
    }
}
