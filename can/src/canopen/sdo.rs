//! Service data objects (CiA 301, clause 7.2.4): reads and writes of the object dictionary by
//! expedited, segmented and block transfer. Independent of the identifiers.
//!
//! Every SDO message has 8 bytes; byte 0 holds the command (upper three bits) and its flags.
//!
//! | request | byte 0 | | response | byte 0 |
//! |---|---|---|---|---|
//! | download, first | `001_ nnes` | | | `011_ ....` |
//! | download, segment | `000t nnnc` | | | `001t ....` |
//! | upload, first | `010_ ....` | | | `010_ nnes` |
//! | upload, segment | `011t ....` | | | `000t nnnc` |
//! | abort | `100_ ....` | | | the same |
//! | block download, first; end | `110_ _cs0`; `110n nn_1` | | | `101_ _c00`; `101_ __01`; ack `..10` |
//! | block upload, first; end; ack; go | `101_ _c00`; `..01`; `..10`; `..11` | | | `110_ _cs0`; `110n nn_1` |

mod buffer;
mod client;
mod crc;
mod server;
#[cfg(test)]
mod tests;

use std::fmt;

use takt_cia402::dictionary::{AbortCode, Address};

pub use client::{Client, Outcome, Progress};
pub use crc::crc;
pub use server::Server;

/// Data of an SDO message.
pub type Message = [u8; 8];

/// Maximum length of a value, bytes.
pub const TRANSFER_MAX: usize = takt_cia402::dictionary::VALUE_MAX;

/// Maximum segments in a block.
pub const BLOCK_MAX: u8 = 127;

/// Up to seven bytes of a segment, or four of an expedited transfer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bytes {
    bytes: [u8; 7],
    len: u8,
}

impl Bytes {
    /// The first bytes of a slice, up to seven.
    pub fn new(from: &[u8]) -> Self {
        let mut bytes = [0; 7];
        let mut len = 0;
        for (to, from) in bytes.iter_mut().zip(from) {
            *to = *from;
            len += 1;
        }
        Self { bytes, len }
    }

    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or_default()
    }
}

/// Start of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Initiate {
    /// Expedited: all data.
    Expedited(Bytes),
    /// Segments follow; total size if indicated.
    Segmented(Option<u32>),
}

/// Request of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(
    missing_docs,
    reason = "the fields are those of the clause, by their names"
)]
pub enum Request {
    /// Write, first message.
    Download { address: Address, data: Initiate },
    /// Write, next segment.
    DownloadSegment {
        toggle: bool,
        last: bool,
        data: Bytes,
    },
    /// Read, first message.
    Upload { address: Address },
    /// Read, next segment.
    UploadSegment { toggle: bool },
    /// Write in blocks, first message.
    BlockDownload {
        address: Address,
        crc: bool,
        size: Option<u32>,
    },
    /// Write in blocks, last message. `unused` bytes of the last segment are unused.
    BlockDownloadEnd { unused: u8, crc: u16 },
    /// Read in blocks, first message.
    BlockUpload {
        address: Address,
        crc: bool,
        block: u8,
        switch: u8,
    },
    /// Read in blocks: start.
    BlockUploadStart,
    /// Read in blocks: last received segment; number of segments in the next block.
    BlockUploadAck { sequence: u8, block: u8 },
    /// Read in blocks, last message.
    BlockUploadEnd,
    /// Abort by the client.
    Abort { address: Address, code: AbortCode },
}

/// Response of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(
    missing_docs,
    reason = "the fields are those of the clause, by their names"
)]
pub enum Response {
    /// Written, or continue with segments.
    Download { address: Address },
    /// Segment accepted.
    DownloadSegment { toggle: bool },
    /// Read, first message.
    Upload { address: Address, data: Initiate },
    /// Read, next segment.
    UploadSegment {
        toggle: bool,
        last: bool,
        data: Bytes,
    },
    /// Write in blocks: start, with this number of segments per block.
    BlockDownload {
        address: Address,
        crc: bool,
        block: u8,
    },
    /// Write in blocks: last received segment; number of segments in the next block.
    BlockDownloadAck { sequence: u8, block: u8 },
    /// Write in blocks: done.
    BlockDownloadEnd,
    /// Read in blocks, first message.
    BlockUpload {
        address: Address,
        crc: bool,
        size: Option<u32>,
    },
    /// Read in blocks, last message. `unused` bytes of the last segment are unused.
    BlockUploadEnd { unused: u8, crc: u16 },
    /// Abort by the server.
    Abort { address: Address, code: AbortCode },
}

/// A segment of a block in either direction; it has no command and is therefore not part of the
/// enums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockSegment {
    /// It is the last segment of the transfer.
    pub last: bool,
    /// 1 to 127.
    pub sequence: u8,
    /// Seven bytes; the last segment may use fewer.
    pub data: [u8; 7],
}

impl BlockSegment {
    /// The segment in a message; `None` if its sequence number is 0.
    pub const fn decode(message: &Message) -> Option<Self> {
        let [first, data @ ..] = *message;
        if first & 0x7F == 0 {
            return None;
        }
        Some(Self {
            last: first & 0x80 != 0,
            sequence: first & 0x7F,
            data,
        })
    }

    /// The message.
    pub fn encode(self) -> Message {
        let first = u8::from(self.last) << 7 | self.sequence & 0x7F;
        let [a, b, c, d, e, f, g] = self.data;
        [first, a, b, c, d, e, f, g]
    }
}

fn address(message: &Message) -> Address {
    Address::new(u16::from_le_bytes([message[1], message[2]]), message[3])
}

fn number(message: &Message) -> u32 {
    let [.., a, b, c, d] = *message;
    u32::from_le_bytes([a, b, c, d])
}

fn message(first: u8, address: Address, number: u32) -> Message {
    let [low, high] = address.index.to_le_bytes();
    let [a, b, c, d] = number.to_le_bytes();
    [first, low, high, address.sub, a, b, c, d]
}

fn segment(first: u8, toggle: bool, last: bool, data: &Bytes) -> Message {
    let unused = 7 - data.len.min(7);
    let first = first | u8::from(toggle) << 4 | unused << 1 | u8::from(last);
    let [a, b, c, d, e, f, g] = data.bytes;
    [first, a, b, c, d, e, f, g]
}

fn bytes_of_segment(message: &Message) -> Bytes {
    let unused = usize::from(message[0] >> 1 & 0x07);
    Bytes::new(message.get(1..8 - unused).unwrap_or_default())
}

fn initiate(message: &Message) -> Initiate {
    let (expedited, sized) = (message[0] & 0x02 != 0, message[0] & 0x01 != 0);
    let unused = if sized {
        usize::from(message[0] >> 2 & 0x03)
    } else {
        0
    };
    if expedited {
        Initiate::Expedited(Bytes::new(message.get(4..8 - unused).unwrap_or_default()))
    } else {
        Initiate::Segmented(sized.then(|| number(message)))
    }
}

fn initiated(first: u8, address: Address, data: &Initiate) -> Message {
    match data {
        Initiate::Expedited(data) => {
            let len = data.len.clamp(1, 4);
            let [a, b, c, d, ..] = data.bytes;
            let number = u32::from_le_bytes([a, b, c, d]);
            message(first | (4 - len) << 2 | 0x03, address, number)
        }
        Initiate::Segmented(size) => {
            let first = first | u8::from(size.is_some());
            message(first, address, size.unwrap_or(0))
        }
    }
}

fn end_of_block(first: u8, unused: u8, crc: u16) -> Message {
    let [low, high] = crc.to_le_bytes();
    [
        first | (unused & 0x07) << 2 | 0x01,
        low,
        high,
        0,
        0,
        0,
        0,
        0,
    ]
}

const fn crc_of(message: &Message) -> u16 {
    u16::from_le_bytes([message[1], message[2]])
}

impl Request {
    /// The request in a message; `None` for an unknown command.
    pub fn decode(m: &Message) -> Option<Self> {
        let (first, address) = (m[0], address(m));
        Some(match first >> 5 {
            0 => Self::DownloadSegment {
                toggle: first & 0x10 != 0,
                last: first & 0x01 != 0,
                data: bytes_of_segment(m),
            },
            1 => Self::Download {
                address,
                data: initiate(m),
            },
            2 => Self::Upload { address },
            3 => Self::UploadSegment {
                toggle: first & 0x10 != 0,
            },
            4 => Self::Abort {
                address,
                code: AbortCode::from_raw(number(m)),
            },
            5 => match first & 0x03 {
                0 => Self::BlockUpload {
                    address,
                    crc: first & 0x04 != 0,
                    block: m[4],
                    switch: m[5],
                },
                1 => Self::BlockUploadEnd,
                2 => Self::BlockUploadAck {
                    sequence: m[1],
                    block: m[2],
                },
                _ => Self::BlockUploadStart,
            },
            6 if first & 0x01 == 0 => Self::BlockDownload {
                address,
                crc: first & 0x04 != 0,
                size: (first & 0x02 != 0).then(|| number(m)),
            },
            6 => Self::BlockDownloadEnd {
                unused: first >> 2 & 0x07,
                crc: crc_of(m),
            },
            _ => return None,
        })
    }

    /// The message.
    pub fn encode(&self) -> Message {
        match *self {
            Self::Download { address, data } => initiated(0x20, address, &data),
            Self::DownloadSegment { toggle, last, data } => segment(0x00, toggle, last, &data),
            Self::Upload { address } => message(0x40, address, 0),
            Self::UploadSegment { toggle } => [0x60 | u8::from(toggle) << 4, 0, 0, 0, 0, 0, 0, 0],
            Self::BlockDownload { address, crc, size } => {
                let first = 0xC0 | u8::from(crc) << 2 | u8::from(size.is_some()) << 1;
                message(first, address, size.unwrap_or(0))
            }
            Self::BlockDownloadEnd { unused, crc } => end_of_block(0xC0, unused, crc),
            Self::BlockUpload {
                address,
                crc,
                block,
                switch,
            } => {
                let number = u32::from_le_bytes([block, switch, 0, 0]);
                message(0xA0 | u8::from(crc) << 2, address, number)
            }
            Self::BlockUploadStart => [0xA3, 0, 0, 0, 0, 0, 0, 0],
            Self::BlockUploadAck { sequence, block } => [0xA2, sequence, block, 0, 0, 0, 0, 0],
            Self::BlockUploadEnd => [0xA1, 0, 0, 0, 0, 0, 0, 0],
            Self::Abort { address, code } => message(0x80, address, code.raw()),
        }
    }
}

impl Response {
    /// The object; segments and acknowledgements do not contain it.
    pub const fn address(&self) -> Option<Address> {
        match self {
            Self::Download { address }
            | Self::Upload { address, .. }
            | Self::BlockDownload { address, .. }
            | Self::BlockUpload { address, .. }
            | Self::Abort { address, .. } => Some(*address),
            Self::DownloadSegment { .. }
            | Self::UploadSegment { .. }
            | Self::BlockDownloadAck { .. }
            | Self::BlockDownloadEnd
            | Self::BlockUploadEnd { .. } => None,
        }
    }

    /// The response in a message; `None` for an unknown command.
    pub fn decode(m: &Message) -> Option<Self> {
        let (first, address) = (m[0], address(m));
        Some(match first >> 5 {
            0 => Self::UploadSegment {
                toggle: first & 0x10 != 0,
                last: first & 0x01 != 0,
                data: bytes_of_segment(m),
            },
            1 => Self::DownloadSegment {
                toggle: first & 0x10 != 0,
            },
            2 => Self::Upload {
                address,
                data: initiate(m),
            },
            3 => Self::Download { address },
            4 => Self::Abort {
                address,
                code: AbortCode::from_raw(number(m)),
            },
            5 => match first & 0x03 {
                0 => Self::BlockDownload {
                    address,
                    crc: first & 0x04 != 0,
                    block: m[4],
                },
                1 => Self::BlockDownloadEnd,
                2 => Self::BlockDownloadAck {
                    sequence: m[1],
                    block: m[2],
                },
                _ => return None,
            },
            6 if first & 0x01 == 0 => Self::BlockUpload {
                address,
                crc: first & 0x04 != 0,
                size: (first & 0x02 != 0).then(|| number(m)),
            },
            6 => Self::BlockUploadEnd {
                unused: first >> 2 & 0x07,
                crc: crc_of(m),
            },
            _ => return None,
        })
    }

    /// The message.
    pub fn encode(&self) -> Message {
        match *self {
            Self::Download { address } => message(0x60, address, 0),
            Self::DownloadSegment { toggle } => [0x20 | u8::from(toggle) << 4, 0, 0, 0, 0, 0, 0, 0],
            Self::Upload { address, data } => initiated(0x40, address, &data),
            Self::UploadSegment { toggle, last, data } => segment(0x00, toggle, last, &data),
            Self::BlockDownload {
                address,
                crc,
                block,
            } => message(0xA0 | u8::from(crc) << 2, address, block.into()),
            Self::BlockDownloadAck { sequence, block } => [0xA2, sequence, block, 0, 0, 0, 0, 0],
            Self::BlockDownloadEnd => [0xA1, 0, 0, 0, 0, 0, 0, 0],
            Self::BlockUpload { address, crc, size } => {
                let first = 0xC0 | u8::from(crc) << 2 | u8::from(size.is_some()) << 1;
                message(first, address, size.unwrap_or(0))
            }
            Self::BlockUploadEnd { unused, crc } => end_of_block(0xC0, unused, crc),
            Self::Abort { address, code } => message(0x80, address, code.raw()),
        }
    }
}

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, byte) in self.as_slice().iter().enumerate() {
            let space = if i > 0 { " " } else { "" };
            write!(f, "{space}{byte:02X}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Initiate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Expedited(data) => data.fmt(f),
            Self::Segmented(Some(size)) => write!(f, "{size} bytes in segments"),
            Self::Segmented(None) => f.write_str("in segments"),
        }
    }
}

impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Download { address, data } => write!(f, "write {address} = {data}"),
            Self::DownloadSegment { last, data, .. } => {
                write!(f, "write.. {data}{}", if *last { " end" } else { "" })
            }
            Self::Upload { address } => write!(f, "read {address}"),
            Self::UploadSegment { .. } => f.write_str("read.."),
            Self::BlockDownload { address, size, .. } => {
                write!(f, "write {address} in blocks, {} bytes", size.unwrap_or(0))
            }
            Self::BlockDownloadEnd { crc, .. } => write!(f, "blocks end, crc {crc:04X}"),
            Self::BlockUpload { address, block, .. } => {
                write!(f, "read {address} in blocks of {block}")
            }
            Self::BlockUploadStart => f.write_str("blocks start"),
            Self::BlockUploadAck { sequence, block } => {
                write!(f, "block ack {sequence}, next {block}")
            }
            Self::BlockUploadEnd => f.write_str("blocks end"),
            Self::Abort { address, code } => write!(f, "abort {address}: {code}"),
        }
    }
}

impl fmt::Display for Response {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Download { address } => write!(f, "{address} ok"),
            Self::DownloadSegment { .. } => f.write_str("ok.."),
            Self::Upload { address, data } => write!(f, "{address} = {data}"),
            Self::UploadSegment { last, data, .. } => {
                write!(f, ".. {data}{}", if *last { " end" } else { "" })
            }
            Self::BlockDownload { address, block, .. } => {
                write!(f, "{address} go, blocks of {block}")
            }
            Self::BlockDownloadAck { sequence, block } => {
                write!(f, "block ack {sequence}, next {block}")
            }
            Self::BlockDownloadEnd => f.write_str("blocks ok"),
            Self::BlockUpload { address, size, .. } => {
                write!(f, "{address} in blocks, {} bytes", size.unwrap_or(0))
            }
            Self::BlockUploadEnd { crc, .. } => write!(f, "blocks end, crc {crc:04X}"),
            Self::Abort { address, code } => write!(f, "abort {address}: {code}"),
        }
    }
}
