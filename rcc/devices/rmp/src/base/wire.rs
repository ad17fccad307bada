//! The two connections to a power base: a CAN interface, or its USB port. Frames are not interpreted here.

use std::io;
use std::time::Duration;

use takt_can::Frame;
use takt_can::link::{CanLink, Origin};
use takt_can::linux::{Options, Serial, SocketCan};
use takt_can::load::{LoadMeter, LoadReader};
use takt_can::rmp::Channel;
use takt_rt::interface::Medium;

use takt_core::device::link_watch::{LinkErrors, LinkWatch};

/// A connection to one power base.
#[derive(Debug)]
pub enum Wire {
    /// A CAN interface, or an in-process bus.
    Can(Box<dyn CanLink>),
    /// A serial port that carries packets.
    Usb(Box<Serial>),
}

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

    /// Watches the link; a serial port is reported under its name.
    pub(super) fn watch(&self, name: &str) -> LinkWatch {
        match self {
            Self::Can(link) => LinkWatch::new(name, link.interface(), Medium::Can),
            Self::Usb(_) => LinkWatch::new(name, None, Medium::Serial),
        }
    }

    /// A meter of the load of its bus and its reader; `None` of a serial port.
    pub(super) fn meter(&self, name: &str) -> Option<(LoadMeter, LoadReader)> {
        match self {
            Self::Can(link) => Some(LoadMeter::new(&**link, name)),
            Self::Usb(_) => None,
        }
    }

    /// Sends a frame; false on an error, which is noted.
    pub(super) fn send(&mut self, frame: &Frame, errors: &LinkErrors) -> bool {
        match self {
            Self::Can(link) => match link.send(&(*frame).into()) {
                Ok(()) => true,
                Err(error) => {
                    errors.note(error.errno());
                    false
                }
            },
            Self::Usb(serial) => match serial.send(frame) {
                Ok(_) => true,
                Err(error) => {
                    errors.note_io(&error);
                    false
                }
            },
        }
    }

    /// Waits at most `timeout` for a frame of another sender. On CAN the two boards of a power base are not
    /// distinguished.
    pub(super) fn receive(
        &mut self,
        timeout: Duration,
        errors: &LinkErrors,
    ) -> Result<Option<(Channel, Frame, Duration)>, LinkLost> {
        match self {
            Self::Can(link) => Ok(link
                .receive(timeout)
                .map_err(|error| {
                    errors.note(error.errno());
                    LinkLost
                })?
                .and_then(|received| {
                    let frame = received
                        .frame
                        .classic()
                        .filter(|_| received.origin != Origin::Own)?;
                    Some((Channel::A, *frame, received.at))
                })),
            Self::Usb(serial) => serial.receive(timeout).map_err(|error| {
                errors.note_io(&error);
                LinkLost
            }),
        }
    }
}

/// Whether the connection is missing: an adapter was unplugged, or an interface is down.
#[derive(Debug)]
pub(super) struct LinkLost;
