//! The link to a power base: a CAN bus, on which both its boards appear as one, or a serial port, whose packets name
//! their board.

use std::time::Duration;

use anyhow::Context as _;
use takt_can::Frame;
use takt_can::linux::{Serial, monotonic};
use takt_can::rmp::Channel;

use crate::can::wire::Wire;
use crate::signal::Stop;

/// A link to a power base.
pub(super) trait Port {
    /// Time of a clock that does not go back.
    fn now(&self) -> Duration;

    /// Sends a frame.
    ///
    /// # Errors
    /// If the link is lost.
    fn send(&mut self, frame: &Frame) -> anyhow::Result<()>;

    /// Waits for a frame up to a timeout; returns it with its board.
    ///
    /// # Errors
    /// If the link is lost.
    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<(Channel, Frame)>>;

    /// Whether a stop was requested.
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
            format!(
                "cannot open serial port {name} (hint: check the USB cable and the group dialout)"
            )
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
        sent.with_context(|| {
            format!(
                "{} accepts no packet (hint: check the USB cable)",
                self.name
            )
        })
    }

    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<(Channel, Frame)>> {
        let received = self.serial.receive(timeout);
        let received = received
            .with_context(|| format!("{} is lost (hint: check the USB cable)", self.name))?;
        Ok(received.map(|(channel, frame, _)| (channel, frame)))
    }

    fn is_stopped(&self) -> bool {
        self.stop.is_requested()
    }
}
