//! The content of an EoE mailbox (ETG.1000.6, clause 5.9): Ethernet frames in fragments, the addresses of a slave, its
//! address filter, time stamps. Fragments are put together in `reassembly`; their order is up to master and slave.

mod filter;
mod reassembly;
mod settings;

use std::fmt;

pub use filter::AddressFilter;
pub use reassembly::{FRAME_MAX, FRAME_MIN, FragmentError, Reassembly};
pub use settings::{HostName, IpSettings};

/// The unit of fragment lengths and offsets, bytes.
pub const UNIT: usize = 32;

/// The result of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct EoeResult(pub u16);

impl EoeResult {
    /// Done.
    pub const SUCCESS: Self = Self(0x0000);
    /// No reason given.
    pub const UNSPECIFIED: Self = Self(0x0001);
    /// The type of the message is not supported.
    pub const UNSUPPORTED: Self = Self(0x0002);
    /// It has no IP.
    pub const NO_IP: Self = Self(0x0201);
    /// It has no DHCP.
    pub const NO_DHCP: Self = Self(0x0202);
    /// It has no address filter.
    pub const NO_FILTER: Self = Self(0x0401);
}

impl fmt::Display for EoeResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match *self {
            Self::SUCCESS => "done",
            Self::UNSPECIFIED => "no reason given",
            Self::UNSUPPORTED => "it does not support this EoE message",
            Self::NO_IP => "it has no IP",
            Self::NO_DHCP => "it has no DHCP",
            Self::NO_FILTER => "it has no address filter",
            Self(_) => "a code of its vendor",
        };
        write!(f, "{text} (EoE {:04X}h)", self.0)
    }
}

/// A part of an Ethernet frame.
///
/// | bits of the second word | field |
/// |---|---|
/// | 0 to 5 | number of the fragment |
/// | 6 to 11 | in the first fragment the length of the frame, in others the offset; in units of 32 bytes |
/// | 12 to 15 | number of the frame |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fragment<'a> {
    /// The port of the slave; 0 for any.
    pub port: u8,
    /// The last of its frame.
    pub last: bool,
    /// The last four bytes of the frame are a time stamp; in the last fragment.
    pub stamped: bool,
    /// A time stamp of the moment of sending is requested.
    pub stamp_requested: bool,
    /// Counted from 0, up to 63.
    pub number: u8,
    /// In the first fragment the length of the frame, rounded up, else the offset; in units of 32 bytes, up to 63.
    pub offset: u8,
    /// The number of the frame, 0 to 15 in turn.
    pub frame: u8,
    /// Its bytes.
    pub data: &'a [u8],
}

/// An EoE message.
///
/// | bytes | field |
/// |---|---|
/// | 0 | bits 0 to 3 type, 4 to 7 port |
/// | 1 | bit 0 last fragment, 1 time stamp appended, 2 time stamp requested |
/// | 2, 3 | of a fragment its numbers; of a response its result |
/// | from 4 | data of the type |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eoe<'a> {
    /// Type 0: a part of an Ethernet frame.
    Fragment(Fragment<'a>),
    /// Type 1: when a frame was sent whose time stamp was requested.
    TimeStamp {
        /// The port.
        port: u8,
        /// System time, ns modulo 2^32.
        time: u32,
    },
    /// Types 2, 4, 6, 8: a request of the master.
    Request {
        /// The port.
        port: u8,
        /// What is requested.
        request: EoeRequest,
        /// Its data: [`IpSettings`] or [`AddressFilter`] to set, else nothing.
        data: &'a [u8],
    },
    /// Types 3, 5, 7, 9: the response to a request.
    Response {
        /// The port.
        port: u8,
        /// What was requested.
        request: EoeRequest,
        /// The result; of a reading response zero.
        result: EoeResult,
        /// [`IpSettings`] or [`AddressFilter`] that were read, else nothing.
        data: &'a [u8],
    },
}

/// A request of the master to the Ethernet port of a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EoeRequest {
    /// Set MAC and IP addresses.
    SetAddress,
    /// Set the address filter.
    SetFilter,
    /// Read MAC and IP addresses.
    GetAddress,
    /// Read the address filter.
    GetFilter,
}

impl EoeRequest {
    const ALL: [Self; 4] = [
        Self::SetAddress,
        Self::SetFilter,
        Self::GetAddress,
        Self::GetFilter,
    ];

    /// The type of the request; that of its response is one more.
    const fn raw(self) -> u8 {
        match self {
            Self::SetAddress => 2,
            Self::SetFilter => 4,
            Self::GetAddress => 6,
            Self::GetFilter => 8,
        }
    }
}

const LAST: u8 = 0x01;
const STAMPED: u8 = 0x02;
const STAMP_REQUESTED: u8 = 0x04;

impl<'a> Eoe<'a> {
    /// Bytes before the data.
    pub const HEAD: usize = 4;

    /// Decodes a message; `None` if it is truncated or its type is unknown.
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        let ([kind, flags, low, high], data) = bytes.split_first_chunk::<4>()?;
        let (port, kind) = (kind >> 4, kind & 0x0F);
        let word = u16::from_le_bytes([*low, *high]);
        match kind {
            0 => {
                let [number, offset] = [word & 0x3F, word >> 6 & 0x3F].map(u16::to_le_bytes);
                return Some(Self::Fragment(Fragment {
                    port,
                    last: flags & LAST != 0,
                    stamped: flags & STAMPED != 0,
                    stamp_requested: flags & STAMP_REQUESTED != 0,
                    number: number[0],
                    offset: offset[0],
                    frame: high >> 4,
                    data,
                }));
            }
            1 => {
                let time = u32::from_le_bytes(*data.first_chunk()?);
                return Some(Self::TimeStamp { port, time });
            }
            _ => {}
        }
        let found = EoeRequest::ALL
            .into_iter()
            .find(|request| request.raw() == kind & !1);
        let request = found?;
        Some(if kind & 1 == 0 {
            Self::Request {
                port,
                request,
                data,
            }
        } else {
            Self::Response {
                port,
                request,
                result: EoeResult(word),
                data,
            }
        })
    }

    /// Writes the message to `to`; returns its length, `None` if it does not fit.
    pub fn encode(&self, to: &mut [u8]) -> Option<usize> {
        let stamp;
        let (port, kind, flags, word, data) = match *self {
            Self::Fragment(fragment) => (
                fragment.port,
                0,
                fragment.flags(),
                fragment.word(),
                fragment.data,
            ),
            Self::TimeStamp { port, time } => {
                stamp = time.to_le_bytes();
                (port, 1, LAST, 0, &stamp[..])
            }
            Self::Request {
                port,
                request,
                data,
            } => (port, request.raw(), LAST, 0, data),
            Self::Response {
                port,
                request,
                result,
                data,
            } => (port, request.raw() + 1, LAST, result.0, data),
        };
        let end = Self::HEAD + data.len();
        let (head, rest) = to.get_mut(..end)?.split_first_chunk_mut()?;
        let [low, high] = word.to_le_bytes();
        *head = [kind | port << 4, flags, low, high];
        rest.copy_from_slice(data);
        Some(end)
    }
}

impl<'a> Fragment<'a> {
    const fn flags(&self) -> u8 {
        (if self.last { LAST } else { 0 })
            | (if self.stamped { STAMPED } else { 0 })
            | (if self.stamp_requested {
                STAMP_REQUESTED
            } else {
                0
            })
    }

    fn word(&self) -> u16 {
        u16::from(self.number & 0x3F)
            | u16::from(self.offset & 0x3F) << 6
            | u16::from(self.frame & 0x0F) << 12
    }

    /// The fragment of a frame that begins at byte `at`, as long as `capacity` bytes of mailbox after its header allow;
    /// `None` behind the end, or if the frame does not fit 63 units, or a unit not the mailbox.
    pub fn of(frame: &'a [u8], at: usize, number: u8, capacity: usize) -> Option<Self> {
        let rest = frame.get(at..).filter(|rest| !rest.is_empty())?;
        let last = rest.len() <= capacity;
        // All but the last are whole units.
        let len = if last {
            rest.len()
        } else {
            capacity / UNIT * UNIT
        };
        let data = rest.get(..len).filter(|data| !data.is_empty())?;
        let units = if at == 0 {
            frame.len().div_ceil(UNIT)
        } else {
            at / UNIT
        };
        let offset = u8::try_from(units).ok().filter(|units| *units <= 0x3F)?;
        Some(Self {
            port: 0,
            last,
            stamped: false,
            stamp_requested: false,
            number,
            offset,
            frame: 0,
            data,
        })
    }
}

impl fmt::Display for Eoe<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fragment(fragment) => {
                let Fragment { number, frame, .. } = fragment;
                let last = if fragment.last { ", last" } else { "" };
                let len = fragment.data.len();
                write!(
                    f,
                    "Ethernet frame {frame}, fragment {number}{last}, {len} bytes"
                )?;
                if fragment.stamped {
                    f.write_str(", time stamp appended")?;
                }
                if fragment.stamp_requested {
                    f.write_str(", time stamp requested")?;
                }
                Ok(())
            }
            Self::TimeStamp { time, .. } => write!(f, "time stamp {time} ns"),
            Self::Request { request, data, .. } => match request {
                EoeRequest::SetAddress => match IpSettings::decode(data) {
                    Some(settings) => write!(f, "set address: {settings}"),
                    None => f.write_str("set address: truncated"),
                },
                EoeRequest::SetFilter => match AddressFilter::decode(data) {
                    Some(filter) => write!(f, "set filter: {filter}"),
                    None => f.write_str("set filter: truncated"),
                },
                EoeRequest::GetAddress => f.write_str("read address"),
                EoeRequest::GetFilter => f.write_str("read filter"),
            },
            Self::Response {
                request,
                result,
                data,
                ..
            } => match request {
                EoeRequest::SetAddress => write!(f, "address set: {result}"),
                EoeRequest::SetFilter => write!(f, "filter set: {result}"),
                EoeRequest::GetAddress => match IpSettings::decode(data) {
                    Some(settings) => write!(f, "address: {settings}"),
                    None => write!(f, "no address: {result}"),
                },
                EoeRequest::GetFilter => match AddressFilter::decode(data) {
                    Some(filter) => write!(f, "filter: {filter}"),
                    None => write!(f, "no filter: {result}"),
                },
            },
        }
    }
}

#[cfg(test)]
mod tests;
