//! FRI datagrams in recordings: pcap and pcapng as `tcpdump -i any udp` or Wireshark write them, and pcap of our own. For tools, not
//! for the cycle: it allocates. It captures nothing from a network itself.

use crate::error::DecodeError;
use crate::generation::Kind;
use crate::lwr::wire::{Cmd, Msr};
use crate::sunrise::wire::{Command, Monitoring, unframe};
use pcap_file::pcap::{PcapHeader, PcapPacket, PcapReader, PcapWriter};
use pcap_file::pcapng::blocks::interface_description::InterfaceDescriptionOption;
use pcap_file::pcapng::{Block, PcapNgReader};
use pcap_file::{DataLink, PcapError, TsResolution};
use std::fmt;
use std::io::{Cursor, Read, Write};
use std::net::SocketAddrV4;
use std::time::Duration;

mod fuzz;
mod packet;
#[cfg(test)]
mod tests;

pub use fuzz::{files, fuzz, fuzz_file};

/// First bytes of a pcapng file, whatever its byte order.
const PCAPNG: [u8; 4] = [0x0a, 0x0d, 0x0d, 0x0a];

/// A UDP datagram of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagram {
    /// When it was seen, as the recording counts: usually since 1970.
    pub at: Duration,
    /// Who sent it.
    pub from: SocketAddrV4,
    /// To whom.
    pub to: SocketAddrV4,
    /// What was in it.
    pub bytes: Vec<u8>,
}

impl Datagram {
    /// The UDP datagram in an IPv4 packet; `None` if it holds no whole one.
    #[must_use]
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
    #[must_use]
    pub fn to_packet(&self) -> Vec<u8> {
        packet::build(self)
    }
}

/// Why a recording could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// The file could not be read or written.
    #[error("recording: {0}")]
    Io(#[from] std::io::Error),
    /// It is neither pcap nor pcapng, or damaged.
    #[error("recording is no sound pcap or pcapng file: {0}")]
    Format(PcapError),
    /// Its link layer is none of those known here.
    #[error(
        "recording of link type {0:?}: record with tcpdump on an Ethernet interface, on `any`, or as raw IP"
    )]
    LinkType(DataLink),
}

impl From<PcapError> for CaptureError {
    fn from(error: PcapError) -> Self {
        if let PcapError::IoError(error) = error {
            Self::Io(error)
        } else {
            Self::Format(error)
        }
    }
}

/// Writes datagrams as pcap of raw IPv4 with nanoseconds; Wireshark reads it.
pub struct Writer<W: Write>(PcapWriter<W>);

impl<W: Write> Writer<W> {
    /// Writes the header of the file.
    pub fn new(to: W) -> Result<Self, CaptureError> {
        let header = PcapHeader {
            datalink: DataLink::RAW,
            ts_resolution: TsResolution::NanoSecond,
            ..PcapHeader::default()
        };
        Ok(Self(PcapWriter::with_header(to, header)?))
    }

    /// Appends a datagram.
    pub fn write(&mut self, datagram: &Datagram) -> Result<(), CaptureError> {
        let packet = datagram.to_packet();
        let len = u32::try_from(packet.len()).unwrap_or(u32::MAX);
        self.0
            .write_packet(&PcapPacket::new(datagram.at, len, &packet))?;
        Ok(())
    }

    /// Gives back what was written to.
    #[must_use]
    pub fn into_inner(self) -> W {
        self.0.into_writer()
    }
}

impl<W: Write> fmt::Debug for Writer<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Writer").finish_non_exhaustive()
    }
}

/// Time, link layer and frame.
type Packet = (Duration, DataLink, Vec<u8>);
type Source<R> = std::io::Chain<Cursor<[u8; 4]>, R>;

enum Format<R: Read> {
    Pcap(PcapReader<Source<R>>),
    PcapNg(PcapNgReader<Source<R>>),
}

/// Reads the UDP datagrams of a recording, one by one; an iterator.
///
/// Other protocols and fragments of datagrams are skipped and counted.
pub struct Reader<R: Read> {
    format: Format<R>,
    skipped: u64,
}

impl<R: Read> Reader<R> {
    /// Reads the header of the file.
    pub fn new(mut from: R) -> Result<Self, CaptureError> {
        let mut head = [0; 4];
        from.read_exact(&mut head)?;
        let source = Cursor::new(head).chain(from);
        let format = if head == PCAPNG {
            Format::PcapNg(PcapNgReader::new(source)?)
        } else {
            Format::Pcap(PcapReader::new(source)?)
        };
        Ok(Self { format, skipped: 0 })
    }

    /// Packets passed over because they hold no whole UDP datagram.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    fn packet(&mut self) -> Option<Result<Packet, CaptureError>> {
        match &mut self.format {
            Format::Pcap(reader) => {
                let link = reader.header().datalink;
                let packet = reader.next_packet()?;
                let packet = packet.map(|it| (it.timestamp, link, it.data.into_owned()));
                Some(packet.map_err(CaptureError::from))
            }
            Format::PcapNg(reader) => next_of_pcapng(reader),
        }
    }
}

fn next_of_pcapng<R: Read>(reader: &mut PcapNgReader<R>) -> Option<Result<Packet, CaptureError>> {
    loop {
        let packet = match reader.next_block()? {
            Ok(Block::EnhancedPacket(packet)) => packet.into_owned(),
            Ok(_) => continue,
            Err(error) => return Some(Err(error.into())),
        };
        let interface = reader.packet_interface(&packet)?;
        let mut options = interface.options.iter();
        let resolution = options.find_map(|option| {
            if let InterfaceDescriptionOption::IfTsResol(resolution) = option {
                Some(*resolution)
            } else {
                None
            }
        });
        // The library takes the number in the file for nanoseconds whatever the interface says.
        let ticks = u64::try_from(packet.timestamp.as_nanos()).unwrap_or(u64::MAX);
        let at = time(ticks, resolution.unwrap_or(6));
        return Some(Ok((at, interface.linktype, packet.data.into_owned())));
    }
}

/// Ticks of an interface as a time: 10^-n s, or 2^-n s with the highest bit set.
fn time(ticks: u64, resolution: u8) -> Duration {
    let exponent = u32::from(resolution & 0x7f);
    let base: u128 = if resolution & 0x80 == 0 { 10 } else { 2 };
    let per_second = base.checked_pow(exponent).unwrap_or(u128::MAX);
    let nanos = u128::from(ticks).saturating_mul(1_000_000_000) / per_second;
    Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX))
}

impl<R: Read> Iterator for Reader<R> {
    type Item = Result<Datagram, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let (at, link, data) = match self.packet()? {
                Ok(packet) => packet,
                Err(error) => return Some(Err(error)),
            };
            let Some(network) = packet::network(link, &data) else {
                return Some(Err(CaptureError::LinkType(link)));
            };
            match network.and_then(|packet| Datagram::in_packet(at, packet)) {
                Some(datagram) => return Some(Ok(datagram)),
                None => self.skipped += 1,
            }
        }
    }
}

impl<R: Read> fmt::Debug for Reader<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reader")
            .field("skipped", &self.skipped)
            .finish_non_exhaustive()
    }
}

/// A datagram as a value.
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
    /// Reads a datagram of any kind.
    #[must_use]
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
                // Damaged by a bit: told as what is wrong with it.
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
        let seconds = self.at.as_secs() % 86_400;
        let (hours, minutes) = (seconds / 3_600, seconds / 60 % 60);
        let (seconds, micros) = (seconds % 60, self.at.subsec_micros());
        write!(f, "{hours:02}:{minutes:02}:{seconds:02}.{micros:06} ")?;
        write!(
            f,
            "{} > {} {}",
            self.from,
            self.to,
            Decoded::of(&self.bytes)
        )
    }
}
