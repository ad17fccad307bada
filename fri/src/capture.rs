//! FRI datagrams in recordings: pcap and pcapng as `tcpdump -i any udp` or Wireshark write them, and pcap of our own. For tools, not
//! for the cycle: it allocates. It captures nothing from a network itself.

use crate::error::DecodeError;
use crate::generation::Kind;
use crate::lwr::wire::{Cmd, Msr};
use crate::sunrise::wire::{Command, Monitoring, unframe};
use std::fmt;
use std::io::{Read, Write};
use std::net::SocketAddrV4;
use std::time::Duration;
use takt_link::capture::{Cut, LinkType};

mod fuzz;
mod packet;
#[cfg(test)]
mod tests;

pub use fuzz::{files, fuzz, fuzz_file};
pub use takt_link::capture::CaptureError;

/// A UDP datagram of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagram {
    /// Time stamp of the recording: usually since 1970.
    pub at: Duration,
    /// Sender.
    pub from: SocketAddrV4,
    /// Receiver.
    pub to: SocketAddrV4,
    /// Payload.
    pub bytes: Vec<u8>,
}

impl Datagram {
    /// The UDP datagram in an IPv4 packet; `None` if it holds no whole one.
    pub fn in_packet(at: Duration, packet: &[u8]) -> Option<Self> {
        let (from, to, bytes) = packet::parse(packet)?;
        let bytes = bytes.to_vec();
        Some(Self {
            at,
            from,
            to,
            bytes,
        })
    }

    /// An IPv4 packet around it. A datagram longer than UDP can carry is cut.
    pub fn to_packet(&self) -> Vec<u8> {
        packet::build(self)
    }
}

/// Writes datagrams as pcap of raw IPv4 with nanoseconds; Wireshark reads it.
#[derive(Debug)]
pub struct Writer<W>(takt_link::capture::Writer<W>);

impl<W: Write> Writer<W> {
    /// Writes the header of the file.
    pub fn new(to: W) -> Result<Self, CaptureError> {
        let writer = takt_link::capture::Writer::new(to, LinkType::RAW)?;
        Ok(Self(writer))
    }

    /// Appends a datagram.
    ///
    /// # Errors
    /// If it cannot be written, or one before could not.
    pub fn write(&mut self, datagram: &Datagram) -> Result<(), CaptureError> {
        Ok(self.0.write(datagram.at, &datagram.to_packet())?)
    }

    /// Returns the inner writer.
    pub fn into_inner(self) -> W {
        self.0.into_inner()
    }
}

/// Reads the UDP datagrams of a recording, one by one; an iterator that ends after an error.
///
/// Other protocols and fragments of datagrams are skipped and counted.
#[derive(Debug)]
pub struct Reader<R> {
    packets: takt_link::capture::Reader<R>,
    skipped: u64,
    is_ended: bool,
}

impl<R: Read> Reader<R> {
    /// Reads the header of the file.
    pub fn new(from: R) -> Result<Self, CaptureError> {
        Ok(Self {
            packets: takt_link::capture::Reader::new(from)?,
            skipped: 0,
            is_ended: false,
        })
    }

    /// Packets skipped because they hold no whole UDP datagram.
    pub const fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Where the recording is cut off; known once reading has ended.
    pub const fn cut(&self) -> Option<Cut> {
        self.packets.cut()
    }

    /// The next datagram; `None` at the end.
    fn read(&mut self) -> Result<Option<Datagram>, CaptureError> {
        for packet in self.packets.by_ref() {
            let packet = packet?;
            let Some(network) = packet::network(packet.link, &packet.data) else {
                return Err(CaptureError::LinkType(packet.link));
            };
            match network.and_then(|bytes| Datagram::in_packet(packet.at, bytes)) {
                Some(datagram) => return Ok(Some(datagram)),
                None => self.skipped += 1,
            }
        }
        Ok(None)
    }
}

impl<R: Read> Iterator for Reader<R> {
    type Item = Result<Datagram, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_ended {
            return None;
        }
        let item = self.read().transpose();
        self.is_ended = !matches!(item, Some(Ok(_)));
        item
    }
}

/// The time of day in UTC of a time stamp since 1970, with microseconds.
pub fn time_of_day(at: Duration) -> String {
    let seconds = at.as_secs() % 86_400;
    let (hours, minutes) = (seconds / 3_600, seconds / 60 % 60);
    let (seconds, micros) = (seconds % 60, at.subsec_micros());
    format!("{hours:02}:{minutes:02}:{seconds:02}.{micros:06}")
}

/// A decoded datagram.
#[derive(Debug, Clone, PartialEq)]
pub enum Decoded {
    /// Measurement of FRI 1.0.
    LwrMeasurement(Box<Msr>),
    /// Command of FRI 1.0.
    LwrCommand(Box<Cmd>),
    /// Monitoring message of Sunrise.
    SunriseMonitoring {
        /// Whether in the frame of 2.7.
        is_framed: bool,
        /// The message.
        message: Box<Monitoring>,
    },
    /// Command message of Sunrise.
    SunriseCommand {
        /// Whether in the frame of 2.7.
        is_framed: bool,
        /// The message.
        message: Box<Command>,
    },
    /// No FRI datagram.
    Foreign {
        /// Bytes in it.
        len: usize,
    },
    /// A damaged FRI datagram.
    Refused(DecodeError),
}

impl Decoded {
    /// Decodes a datagram of any kind.
    pub fn of(bytes: &[u8]) -> Self {
        Self::decode(bytes).unwrap_or_else(Self::Refused)
    }

    fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        Ok(match Kind::of(bytes) {
            Kind::LwrMeasurement => Self::LwrMeasurement(Box::new(Msr::decode(bytes)?)),
            Kind::LwrCommand => Self::LwrCommand(Box::new(Cmd::decode(bytes)?)),
            Kind::SunriseMonitoring { is_framed } => Self::SunriseMonitoring {
                is_framed,
                message: Box::new(Monitoring::decode(unframe(bytes)?.1)?),
            },
            Kind::SunriseCommand { is_framed } => Self::SunriseCommand {
                is_framed,
                message: Box::new(Command::decode(unframe(bytes)?.1)?),
            },
            Kind::Unknown => {
                // A flipped bit: reported as the checksum error it is.
                if let Err(error @ DecodeError::Checksum { .. }) = unframe(bytes) {
                    return Err(error);
                }
                Self::Foreign { len: bytes.len() }
            }
        })
    }
}

impl fmt::Display for Decoded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LwrMeasurement(message) => message.fmt(f),
            Self::LwrCommand(message) => message.fmt(f),
            Self::SunriseMonitoring { message, .. } => message.fmt(f),
            Self::SunriseCommand { message, .. } => message.fmt(f),
            Self::Foreign { len } => write!(f, "no FRI datagram, {len} bytes"),
            Self::Refused(error) => error.fmt(f),
        }
    }
}

impl fmt::Display for Datagram {
    /// One line: time of day in UTC, addresses, content.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} {} > {} {}",
            time_of_day(self.at),
            self.from,
            self.to,
            Decoded::of(&self.bytes)
        )
    }
}
