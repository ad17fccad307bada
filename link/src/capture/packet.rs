//! What a recording consists of, and why it cannot be read: the types that readers of all containers share. No bytes
//! are read here.

use std::fmt;
use std::io;
use std::time::Duration;

use pcap_file::PcapError;

/// Longest packet that is read, bytes; a longer one is treated as damage.
pub const PACKET_MAX: u32 = 1 << 20;

/// Longest block of pcapng that is read, bytes: a packet and its options.
pub(super) const BLOCK_MAX: u32 = PACKET_MAX + (1 << 16);

/// First bytes of a pcapng file, whatever its byte order.
pub(super) const PCAPNG: [u8; 4] = [0x0A, 0x0D, 0x0D, 0x0A];

/// Link type: the outermost header of a packet, as registered by tcpdump.org.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LinkType(pub u32);

impl LinkType {
    /// BSD loopback.
    pub const NULL: Self = Self(0);
    /// Ethernet frames without check sequence.
    pub const ETHERNET: Self = Self(1);
    /// IPv4 or IPv6 packets.
    pub const RAW: Self = Self(101);
    /// `tcpdump -i any`, older.
    pub const LINUX_SLL: Self = Self(113);
    /// Endace's Extensible Record Format, one record for each packet.
    pub const ERF: Self = Self(197);
    /// SocketCAN frames.
    pub const CAN_SOCKETCAN: Self = Self(227);
    /// IPv4 packets.
    pub const IPV4: Self = Self(228);
    /// `tcpdump -i any`.
    pub const LINUX_SLL2: Self = Self(276);
}

impl fmt::Display for LinkType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match *self {
            Self::NULL => "loopback",
            Self::ETHERNET => "Ethernet",
            Self::RAW => "raw IP",
            Self::LINUX_SLL | Self::LINUX_SLL2 => "interface `any`",
            Self::ERF => "ERF",
            Self::CAN_SOCKETCAN => "SocketCAN",
            Self::IPV4 => "IPv4",
            Self(other) => return write!(f, "{other}"),
        };
        write!(f, "{} ({name})", self.0)
    }
}

/// A packet of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Time of the recording, since 1970 unless the recording has another epoch.
    pub at: Duration,
    /// Outermost header of the packet.
    pub link: LinkType,
    /// Index of the recording interface in the file; 0 if there is only one. See [`Reader::interface_name`](super::Reader::interface_name).
    pub interface: u32,
    /// Offset of its record from the beginning of the file, bytes.
    pub offset: u64,
    /// Whether the recording host is big-endian: SocketCAN identifiers have its byte order after a header of `any`.
    pub is_big_endian: bool,
    /// Length on the wire, bytes; more than `data` if the packet was truncated.
    pub original_len: u32,
    /// The recorded bytes.
    pub data: Vec<u8>,
}

/// Why a recording, or a packet of it, cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// The file cannot be read.
    #[error("cannot read the recording: {0}")]
    Io(#[from] io::Error),
    /// The file is shorter than its header.
    #[error("the recording is cut off in its header: {0} bytes")]
    Short(usize),
    /// The file has another format.
    #[error(
        "not a recording: a pcap or pcapng file does not begin with {0:08X}h\nhint: `tshark -r FILE -w OTHER.pcapng` converts what Wireshark reads"
    )]
    Unknown(u32),
    /// The file is compressed.
    #[error("the recording is compressed\nhint: unpack it by `gunzip`")]
    Compressed,
    /// A record contradicts itself.
    #[error("the recording is damaged at byte {offset}: {cause}")]
    Damaged {
        /// Offset from the beginning of the file.
        offset: u64,
        /// Message of the container's parser.
        cause: String,
    },
    /// The link type is not supported.
    #[error("the recording is of link type {0}\nhint: record on the interface itself")]
    LinkType(LinkType),
}

/// Where a recording is cut off: a full disk, or a capture that was killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Number of whole packets before.
    pub packets: u64,
    /// Bytes after the last whole record.
    pub left: u64,
}

impl fmt::Display for Cut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the recording is cut off after {} packets ({} bytes of another are left); it is read up to there",
            self.packets, self.left
        )
    }
}

/// Next item of a file.
pub(super) enum Step {
    Packet(Packet),
    /// A damaged packet; the next record is found by the length of this one.
    Skipped(CaptureError),
    End,
    /// Number of bytes left of an incomplete record.
    Cut(u64),
}

/// A parser error about complete bytes.
pub(super) fn damaged(offset: u64, error: &PcapError) -> CaptureError {
    let cause = match error {
        PcapError::IncompleteBuffer => "a field reaches beyond its record".to_owned(),
        PcapError::IoError(_)
        | PcapError::InvalidField(_)
        | PcapError::Utf8Error(_)
        | PcapError::FromUtf8Error(_)
        | PcapError::InvalidInterfaceId(_) => error.to_string(),
    };
    CaptureError::Damaged { offset, cause }
}

/// A record whose stated length exceeds the limit.
pub(super) fn too_long(offset: u64, len: u32, bound: u32) -> CaptureError {
    let cause = format!("a record announces {len} bytes, at most {bound} are read");
    CaptureError::Damaged { offset, cause }
}
