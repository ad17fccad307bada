//! SDO over CoE (ETG.1000.6, clause 5.6.2): expedited, normal, in segments, complete access, and
//! the SDO information service. It differs from CANopen's SDO in its lengths: a message is as long
//! as the mailbox allows.

use std::fmt;

use takt_cia402::dictionary::{AbortCode, Address};

/// The part of an object that is transferred.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Whole {
    /// One entry.
    Entry,
    /// All entries from the sub-index on; sub-index 0 takes two bytes.
    Object,
}

/// An SDO message behind its CoE header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields have the names of the clause")]
pub enum Sdo<'a> {
    /// Request: write; `size` bytes in total; if `data` is shorter, segments follow.
    Download {
        address: Address,
        whole: Whole,
        size: u32,
        data: &'a [u8],
    },
    /// Request: write, next segment.
    DownloadSegment {
        toggle: bool,
        last: bool,
        data: &'a [u8],
    },
    /// Request: read.
    Upload { address: Address, whole: Whole },
    /// Request: read, next segment.
    UploadSegment { toggle: bool },
    /// Response: written, or ready for segments.
    Downloaded { address: Address, whole: Whole },
    /// Response: segment accepted.
    DownloadedSegment { toggle: bool },
    /// Response: `size` bytes in total; if `data` is shorter, segments follow.
    Uploaded {
        address: Address,
        whole: Whole,
        size: u32,
        data: &'a [u8],
    },
    /// Response: next segment.
    UploadedSegment {
        toggle: bool,
        last: bool,
        data: &'a [u8],
    },
    /// Abort from either side.
    Abort { address: Address, code: AbortCode },
}

/// Length of an SDO message without data, bytes: command, address, four bytes.
pub(crate) const SDO_LEN: usize = 8;

impl<'a> Sdo<'a> {
    /// Decodes a request from the bytes after the CoE header; `None` if it is not one.
    pub fn decode_request(bytes: &'a [u8]) -> Option<Self> {
        let (first, address, rest) = split(bytes)?;
        Some(match first >> 5 {
            0 => {
                let (toggle, last, data) = segment(bytes)?;
                Self::DownloadSegment { toggle, last, data }
            }
            1 => {
                let (size, data) = initiated(first, rest)?;
                let whole = whole(first);
                Self::Download {
                    address,
                    whole,
                    size,
                    data,
                }
            }
            2 => Self::Upload {
                address,
                whole: whole(first),
            },
            3 => Self::UploadSegment {
                toggle: first & 0x10 != 0,
            },
            4 => abort(address, rest)?,
            _ => return None,
        })
    }

    /// Decodes a response from the bytes after the CoE header; `None` if it is not one.
    pub fn decode_response(bytes: &'a [u8]) -> Option<Self> {
        let (first, address, rest) = split(bytes)?;
        Some(match first >> 5 {
            0 => {
                let (toggle, last, data) = segment(bytes)?;
                Self::UploadedSegment { toggle, last, data }
            }
            1 => Self::DownloadedSegment {
                toggle: first & 0x10 != 0,
            },
            2 => {
                let (size, data) = initiated(first, rest)?;
                let whole = whole(first);
                Self::Uploaded {
                    address,
                    whole,
                    size,
                    data,
                }
            }
            3 => Self::Downloaded {
                address,
                whole: whole(first),
            },
            4 => abort(address, rest)?,
            _ => return None,
        })
    }

    /// Writes the message; returns its length, or `None` if `to` is too short. Data beyond the size of a first message,
    /// and all data of a segment, is written.
    pub fn encode(&self, to: &mut [u8]) -> Option<usize> {
        match *self {
            Self::Download {
                address,
                whole,
                size,
                data,
            } => initiate(0x20, address, whole, size, data, to),
            Self::Uploaded {
                address,
                whole,
                size,
                data,
            } => initiate(0x40, address, whole, size, data, to),
            Self::DownloadSegment { toggle, last, data }
            | Self::UploadedSegment { toggle, last, data } => {
                let padding = [0; 7];
                let padding = padding.get(data.len()..).unwrap_or_default();
                let unused = u8::try_from(padding.len()).ok()?;
                let flags = u8::from(toggle) << 4 | unused << 1 | u8::from(last);
                put(flags, data, padding, to)
            }
            Self::Upload { address, whole } => plain(0x40 | complete(whole), address, 0, to),
            Self::Downloaded { address, whole } => plain(0x60 | complete(whole), address, 0, to),
            Self::UploadSegment { toggle } => {
                plain(0x60 | u8::from(toggle) << 4, Address::default(), 0, to)
            }
            Self::DownloadedSegment { toggle } => {
                plain(0x20 | u8::from(toggle) << 4, Address::default(), 0, to)
            }
            Self::Abort { address, code } => plain(0x80, address, code.raw(), to),
        }
    }
}

const fn complete(whole: Whole) -> u8 {
    match whole {
        Whole::Entry => 0,
        Whole::Object => 0x10,
    }
}

const fn whole(first: u8) -> Whole {
    if first & 0x10 == 0 {
        Whole::Entry
    } else {
        Whole::Object
    }
}

fn split(bytes: &[u8]) -> Option<(u8, Address, &[u8])> {
    let ([first, low, high, sub], rest) = bytes.split_first_chunk()?;
    let address = Address::new(u16::from_le_bytes([*low, *high]), *sub);
    Some((*first, address, rest))
}

fn abort<'a>(address: Address, rest: &[u8]) -> Option<Sdo<'a>> {
    let code = AbortCode::from_raw(u32::from_le_bytes(*rest.first_chunk()?));
    Some(Sdo::Abort { address, code })
}

/// Toggle, last, data of a segment. Beyond seven bytes only the length of the mailbox counts.
fn segment(bytes: &[u8]) -> Option<(bool, bool, &[u8])> {
    let (first, data) = bytes.split_first()?;
    let unused = if data.len() > 7 {
        0
    } else {
        usize::from(first >> 1 & 0x07)
    };
    let data = data.get(..data.len().checked_sub(unused)?)?;
    Some((first & 0x10 != 0, first & 0x01 != 0, data))
}

/// Size and data of a first message.
fn initiated(first: u8, rest: &[u8]) -> Option<(u32, &[u8])> {
    let (four, data) = rest.split_first_chunk::<4>()?;
    if first & 0x02 == 0 {
        return Some((u32::from_le_bytes(*four), data));
    }
    let unused = if first & 0x01 == 0 {
        0
    } else {
        first >> 2 & 0x03
    };
    let data = rest.get(..usize::from(4 - unused))?;
    Some((u32::from(4 - unused), data))
}

fn put(first: u8, data: &[u8], padding: &[u8], to: &mut [u8]) -> Option<usize> {
    let len = 1 + data.len() + padding.len();
    let (command, rest) = to.get_mut(..len)?.split_first_mut()?;
    *command = first;
    rest.get_mut(..data.len())?.copy_from_slice(data);
    rest.get_mut(data.len()..)?.copy_from_slice(padding);
    Some(len)
}

fn plain(first: u8, address: Address, number: u32, to: &mut [u8]) -> Option<usize> {
    let [low, high] = address.index.to_le_bytes();
    let [a, b, c, d] = number.to_le_bytes();
    put(first, &[low, high, address.sub, a, b, c, d], &[], to)
}

fn initiate(
    first: u8,
    address: Address,
    whole: Whole,
    size: u32,
    data: &[u8],
    to: &mut [u8],
) -> Option<usize> {
    let first = first | complete(whole) | 0x01;
    let fits = usize::try_from(size).is_ok_and(|size| size == data.len());
    if fits && (1..=4).contains(&data.len()) {
        let mut four = [0; 4];
        four.get_mut(..data.len())?.copy_from_slice(data);
        let unused = u8::try_from(4 - data.len()).ok()?;
        return plain(
            first | 0x02 | unused << 2,
            address,
            u32::from_le_bytes(four),
            to,
        );
    }
    plain(first, address, size, to)?;
    to.get_mut(SDO_LEN..SDO_LEN + data.len())?
        .copy_from_slice(data);
    Some(SDO_LEN + data.len())
}

impl fmt::Display for Sdo<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Download { address, size, .. } => write!(f, "write {address}, {size} bytes"),
            Self::DownloadSegment { data, .. } => write!(f, "write.. {} bytes", data.len()),
            Self::Upload { address, .. } => write!(f, "read {address}"),
            Self::UploadSegment { .. } => f.write_str("read.."),
            Self::Downloaded { address, .. } => write!(f, "{address} ok"),
            Self::DownloadedSegment { .. } => f.write_str("ok.."),
            Self::Uploaded { address, size, .. } => write!(f, "{address}, {size} bytes"),
            Self::UploadedSegment { data, .. } => write!(f, ".. {} bytes", data.len()),
            Self::Abort { address, code } => write!(f, "abort {address}: {code}"),
        }
    }
}

/// The header of an SDO information message.
///
/// | bytes | what |
/// |---|---|
/// | 0 | bits 0 to 6 operation, 7 more fragments follow |
/// | 1 | zero |
/// | 2, 3 | fragments left |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Information {
    /// 1 list, 3 object, 5 entry; the next number is its response; 7 an error.
    pub operation: u8,
    /// More fragments follow.
    pub incomplete: bool,
    /// Number of fragments left.
    pub left: u16,
}

impl Information {
    /// Bytes on the wire.
    pub const LEN: usize = 4;
    /// Request: list of indices.
    pub const LIST: u8 = 1;
    /// Request: object description.
    pub const OBJECT: u8 = 3;
    /// Request: entry description.
    pub(crate) const ENTRY: u8 = 5;
    /// Error, with an abort code.
    pub const ERROR: u8 = 7;

    /// Decodes the header and the bytes after it; `None` if truncated.
    pub fn decode(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let ([operation, _, low, high], rest) = bytes.split_first_chunk()?;
        let header = Self {
            operation: operation & 0x7F,
            incomplete: operation & 0x80 != 0,
            left: u16::from_le_bytes([*low, *high]),
        };
        Some((header, rest))
    }

    /// The encoded bytes.
    pub fn encode(&self) -> [u8; Self::LEN] {
        let [low, high] = self.left.to_le_bytes();
        let operation = self.operation & 0x7F | u8::from(self.incomplete) << 7;
        [operation, 0, low, high]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const ADDRESS: Address = Address::new(0x6041, 2);

    fn encoded(sdo: &Sdo<'_>) -> Vec<u8> {
        let mut to = [0xEE; 64];
        let len = sdo.encode(&mut to).unwrap();
        to[..len].to_vec()
    }

    #[test]
    #[expect(clippy::too_many_lines, reason = "a table of bytes")]
    fn golden_messages() {
        let (address, whole) = (ADDRESS, Whole::Entry);
        let data: &[u8] = &[1, 2, 3, 4, 5];
        for (sdo, bytes) in [
            (
                Sdo::Upload { address, whole },
                vec![0x40, 0x41, 0x60, 2, 0, 0, 0, 0],
            ),
            (
                Sdo::Upload {
                    address,
                    whole: Whole::Object,
                },
                vec![0x50, 0x41, 0x60, 2, 0, 0, 0, 0],
            ),
            (
                Sdo::Download {
                    address,
                    whole,
                    size: 2,
                    data: &data[..2],
                },
                vec![0x2B, 0x41, 0x60, 2, 1, 2, 0, 0],
            ),
            (
                Sdo::Download {
                    address,
                    whole,
                    size: 5,
                    data,
                },
                vec![0x21, 0x41, 0x60, 2, 5, 0, 0, 0, 1, 2, 3, 4, 5],
            ),
            (
                Sdo::DownloadSegment {
                    toggle: true,
                    last: true,
                    data,
                },
                vec![0x15, 1, 2, 3, 4, 5, 0, 0],
            ),
            (
                Sdo::UploadSegment { toggle: true },
                vec![0x70, 0, 0, 0, 0, 0, 0, 0],
            ),
            (
                Sdo::Abort {
                    address,
                    code: AbortCode::ReadOnly,
                },
                vec![0x80, 0x41, 0x60, 2, 2, 0, 1, 6],
            ),
        ] {
            assert_eq!(encoded(&sdo), bytes);
            assert_eq!(Sdo::decode_request(&bytes), Some(sdo));
        }
        for (sdo, bytes) in [
            (
                Sdo::Uploaded {
                    address,
                    whole,
                    size: 2,
                    data: &data[..2],
                },
                vec![0x4B, 0x41, 0x60, 2, 1, 2, 0, 0],
            ),
            (
                Sdo::Uploaded {
                    address,
                    whole,
                    size: 9,
                    data,
                },
                vec![0x41, 0x41, 0x60, 2, 9, 0, 0, 0, 1, 2, 3, 4, 5],
            ),
            (
                Sdo::Downloaded { address, whole },
                vec![0x60, 0x41, 0x60, 2, 0, 0, 0, 0],
            ),
            (
                Sdo::DownloadedSegment { toggle: false },
                vec![0x20, 0, 0, 0, 0, 0, 0, 0],
            ),
        ] {
            assert_eq!(encoded(&sdo), bytes);
            assert_eq!(Sdo::decode_response(&bytes), Some(sdo));
        }
    }

    #[test]
    fn long_segments_have_no_unused_bytes() {
        let data = [9; 20];
        let sdo = Sdo::UploadedSegment {
            toggle: false,
            last: false,
            data: &data,
        };
        let bytes = encoded(&sdo);
        assert_eq!((bytes.len(), bytes[0]), (21, 0));
        assert_eq!(Sdo::decode_response(&bytes), Some(sdo));
        assert_eq!(sdo.encode(&mut [0; 20]), None);
    }

    #[test]
    fn information_headers() {
        let bytes = [0x82, 0, 3, 1];
        let (header, rest) = Information::decode(&bytes).unwrap();
        assert_eq!(
            (header.operation, header.incomplete, header.left),
            (2, true, 0x103)
        );
        assert_eq!((header.encode(), rest), (bytes, &[][..]));
    }

    proptest! {
        #[test]
        fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..40)) {
            for sdo in [Sdo::decode_request(&bytes), Sdo::decode_response(&bytes)].into_iter().flatten() {
                let again = encoded(&sdo);
                prop_assert!(again.len() <= 64);
                let _ = sdo.to_string();
            }
        }
    }
}
