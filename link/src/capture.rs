//! Packets of recordings: reads pcap and pcapng files as a stream of packets, and writes pcap. It does not decode
//! packets; [`Frames`] removes what a probe added to Ethernet frames.

use std::fmt;
use std::io::Read;
use std::time::Duration;

use pcap_file::pcap::PcapParser;
use pcap_file::pcapng::PcapNgParser;

mod ethernet;
mod fuzz;
mod input;
mod packet;
mod pcap;
mod pcapng;
mod replay;
#[cfg(test)]
mod tests;
mod writer;

pub use ethernet::{EthernetFrame, Frames};
pub use fuzz::fuzz;
use input::Input;
use packet::{BLOCK_MAX, PCAPNG, Step, damaged, too_long};
pub use packet::{CaptureError, Cut, LinkType, PACKET_MAX, Packet};
pub use replay::Replay;
pub use writer::Writer;

/// First bytes of a gzip file.
const GZIP: [u8; 2] = [0x1F, 0x8B];

/// File format of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// Older format, with one interface.
    Pcap,
    /// Newer format, with several interfaces and their names.
    PcapNg,
}

impl Container {
    /// Detects the format from the first bytes of a file.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        let magic: [u8; 4] = *bytes.first_chunk()?;
        if magic == PCAPNG {
            return Some(Self::PcapNg);
        }
        let words = [u32::from_be_bytes(magic), u32::from_le_bytes(magic)];
        words
            .iter()
            .any(|word| matches!(word, 0xA1B2_C3D4 | 0xA1B2_3C4D))
            .then_some(Self::Pcap)
    }
}

enum Parser {
    Pcap(PcapParser),
    PcapNg(PcapNgParser),
}

/// Reads the packets of a recording. An iterator: damaged packets of pcapng are errors between the others, any other
/// error is the last item.
pub struct Reader<R> {
    input: Input<R>,
    parser: Parser,
    packets: u64,
    is_ended: bool,
    cut: Option<Cut>,
    /// Time of the previous packet; a simple packet block has none.
    last: Duration,
}

impl<R: Read> Reader<R> {
    /// Reads the header of the file; fails if it is not a recording.
    pub fn new(from: R) -> Result<Self, CaptureError> {
        let mut input = Input::new(from);
        let magic = input.fill(4)?;
        if magic.starts_with(&GZIP) {
            return Err(CaptureError::Compressed);
        }
        let Some(four) = magic.first_chunk::<4>() else {
            return Err(CaptureError::Short(magic.len()));
        };
        let unknown = CaptureError::Unknown(u32::from_be_bytes(*four));
        let parser = match Container::of(magic).ok_or(unknown)? {
            Container::Pcap => Parser::Pcap(pcap::begin(&mut input)?),
            Container::PcapNg => Parser::PcapNg(pcapng::begin(&mut input)?),
        };
        Ok(Self {
            input,
            parser,
            packets: 0,
            is_ended: false,
            cut: None,
            last: Duration::ZERO,
        })
    }
}

impl<R> Reader<R> {
    /// Where the recording is cut off; known once reading has ended.
    pub const fn cut(&self) -> Option<Cut> {
        self.cut
    }

    /// Name of the interface of the latest packet, as `can0`, if it was recorded.
    pub fn interface_name(&self, interface: u32) -> Option<&str> {
        match &self.parser {
            Parser::Pcap(_) => None,
            Parser::PcapNg(parser) => pcapng::name(parser.interfaces(), interface),
        }
    }
}

impl<R: Read> Iterator for Reader<R> {
    type Item = Result<Packet, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_ended {
            return None;
        }
        let step = match &mut self.parser {
            Parser::Pcap(parser) => pcap::next(&mut self.input, parser),
            Parser::PcapNg(parser) => pcapng::next(&mut self.input, parser, self.last),
        };
        self.is_ended = !matches!(step, Ok(Step::Packet(_) | Step::Skipped(_)));
        match step {
            Ok(Step::Packet(packet)) => {
                self.packets += 1;
                self.last = packet.at;
                Some(Ok(packet))
            }
            Ok(Step::Skipped(error)) | Err(error) => Some(Err(error)),
            Ok(Step::Cut(left)) => {
                let packets = self.packets;
                self.cut = Some(Cut { packets, left });
                None
            }
            Ok(Step::End) => None,
        }
    }
}

impl<R> fmt::Debug for Reader<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reader")
            .field("packets", &self.packets)
            .field("cut", &self.cut)
            .finish_non_exhaustive()
    }
}
