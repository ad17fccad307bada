//! The two ways to a power base: a CAN interface, or its USB port. It knows frames, not what they say.

use std::io;
use std::time::Duration;

use takt_can::Frame;
use takt_can::link::{Link, Origin};
use takt_can::linux::{Options, Serial, SocketCan};
use takt_can::rmp::Channel;

/// A way to one power base.
#[derive(Debug)]
pub enum Wire {
    /// A CAN interface, or a bus inside of this process.
    Can(Box<dyn CanLink>),
    /// A serial port that carries packets.
    Usb(Box<Serial>),
}

/// A link that a driver thread can own.
pub trait CanLink: Link + Send + std::fmt::Debug {}

impl<T: Link + Send + std::fmt::Debug> CanLink for T {}

impl Wire {
    /// Opens `can0`, or `/dev/ttyUSB0`.
    ///
    /// # Errors
    /// Of the operating system.
    pub fn open(name: &str) -> io::Result<Self> {
        if name.starts_with('/') {
            return Ok(Self::Usb(Box::new(Serial::open(name)?)));
        }
        let options = Options {
            errors: false,
            ..Options::default()
        };
        Ok(Self::Can(Box::new(SocketCan::open(name, &options)?)))
    }

    /// Sends a frame; false if it could not be sent.
    pub(super) fn send(&mut self, frame: &Frame) -> bool {
        match self {
            Self::Can(link) => link.send(&(*frame).into()).is_ok(),
            Self::Usb(serial) => serial.send(frame).is_ok(),
        }
    }

    /// Waits at most so long for a frame that another sent. On CAN both boards of a power base are one: which
    /// of them sent is not told.
    pub(super) fn receive(
        &mut self,
        timeout: Duration,
    ) -> Result<Option<(Channel, Frame, Duration)>, Gone> {
        match self {
            Self::Can(link) => Ok(link
                .receive(timeout)
                .map_err(|_| Gone)?
                .and_then(|received| {
                    let frame = received
                        .frame
                        .classic()
                        .filter(|_| received.origin != Origin::Own)?;
                    Some((Channel::A, *frame, received.at))
                })),
            Self::Usb(serial) => serial.receive(timeout).map_err(|_| Gone),
        }
    }
}

/// The way is not there: an adapter was unplugged, or an interface is down.
#[derive(Debug)]
pub(super) struct Gone;
