//! Acyclic requests to a slave: objects, registers, SII words, raw mailboxes. A job owns the buffer for its answer, so
//! that its execution allocates nothing.

use takt_cia402::dictionary::Address;

use super::event::JobError;
use crate::coe::{Information, Whole};
use crate::eoe::EoeRequest;
use crate::foe::FileName;

/// The kind of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobKind {
    /// Read an object into `data`, as far as its capacity goes.
    Upload {
        /// The object.
        address: Address,
        /// One entry, or all from the sub-index on.
        whole: Whole,
    },
    /// Write an object from `data`.
    Download {
        /// The object.
        address: Address,
        /// One entry, or all from the sub-index on.
        whole: Whole,
    },
    /// List the indices of objects (SDO information): 1 all, 2 for RxPDOs, 3 for TxPDOs, 4 stored, 5 settings; 0 how
    /// many of each. `data` becomes words, little-endian.
    List(u16),
    /// Describe an object: data type, highest sub-index, object code, name; see [`ObjectDescription`].
    DescribeObject(u16),
    /// Describe an entry: data type, bits, access, name; see [`EntryDescription`].
    DescribeEntry(Address),
    /// Write `data` to the mailbox unchanged and return the next message, both without mailbox header.
    RawMailbox,
    /// Read a file (FoE) into `data`, as far as its capacity goes. `data` of a refused request is the slave's text.
    ReadFile {
        /// The file.
        name: FileName,
        /// 0 for none.
        password: u32,
    },
    /// Write `data` to a file (FoE). `data` of a refused request is the slave's text.
    WriteFile {
        /// The file.
        name: FileName,
        /// 0 for none.
        password: u32,
    },
    /// Use the Ethernet port of a slave (EoE).
    Ethernet(EthernetJob),
    /// Read a register of the slave controller.
    ReadRegister {
        /// The register address.
        at: u16,
        /// Length in bytes, up to 128.
        len: u16,
    },
    /// Write `data` (up to 128 bytes) to a register of the slave controller.
    WriteRegister {
        /// The register address.
        at: u16,
    },
    /// Read words of the SII.
    ReadSii {
        /// First word.
        word: u16,
        /// Number of words.
        words: u16,
    },
    /// Write one word of the SII, the first two bytes of `data`.
    WriteSii {
        /// Word address.
        word: u16,
    },
}

impl JobKind {
    /// The operation of the SDO information service for this request; `None` if it is not one of this service.
    pub(super) const fn information(self) -> Option<u8> {
        match self {
            Self::List(_) => Some(Information::LIST),
            Self::DescribeObject(_) => Some(Information::OBJECT),
            Self::DescribeEntry(_) => Some(Information::ENTRY),
            Self::Upload { .. }
            | Self::Download { .. }
            | Self::RawMailbox
            | Self::ReadFile { .. }
            | Self::WriteFile { .. }
            | Self::Ethernet(_)
            | Self::ReadRegister { .. }
            | Self::WriteRegister { .. }
            | Self::ReadSii { .. }
            | Self::WriteSii { .. } => None,
        }
    }

    /// Whether it uses the mailbox.
    pub(super) const fn is_mailbox(self) -> bool {
        match self {
            Self::Upload { .. }
            | Self::Download { .. }
            | Self::List(_)
            | Self::DescribeObject(_)
            | Self::DescribeEntry(_)
            | Self::RawMailbox
            | Self::ReadFile { .. }
            | Self::WriteFile { .. }
            | Self::Ethernet(_) => true,
            Self::ReadRegister { .. }
            | Self::WriteRegister { .. }
            | Self::ReadSii { .. }
            | Self::WriteSii { .. } => false,
        }
    }
}

/// What is done with the Ethernet port of a slave (EoE).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EthernetJob {
    /// Set what `data` contains, [`IpSettings`](crate::eoe::IpSettings) or an [`AddressFilter`](crate::eoe::AddressFilter), or
    /// read it into `data`.
    Request {
        /// The port; 0 for a slave with one.
        port: u8,
        /// What is requested.
        request: EoeRequest,
    },
    /// Send the Ethernet frame in `data`, 14 to 1518 bytes without checksum. Received frames are fetched by
    /// [`Master::poll_ethernet`](crate::master::Master::poll_ethernet).
    Send {
        /// The port; 0 for a slave with one.
        port: u8,
    },
}

/// A request to a slave.
#[derive(Debug, PartialEq, Eq)]
pub struct Job {
    /// Number of the slave.
    pub slave: usize,
    /// The request.
    pub kind: JobKind,
    /// Data to write, or the buffer for data to read, limited by its capacity.
    pub data: Vec<u8>,
    /// A tag of the caller, returned with the reply.
    pub token: u64,
}

/// The reply to a job.
#[derive(Debug, PartialEq, Eq)]
pub struct Reply {
    /// The job with its data.
    pub job: Job,
    /// Its result.
    pub result: Result<(), JobError>,
}

/// Description of an object, from the answer to [`JobKind::DescribeObject`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObjectDescription<'a> {
    /// Its index.
    pub index: u16,
    /// Data type as CiA 301 numbers them.
    pub data_type: u16,
    /// Highest sub-index.
    pub highest: u8,
    /// Object code: 7 variable, 8 array, 9 record.
    pub code: u8,
    /// Its name; bytes that are not text are skipped.
    pub name: &'a str,
}

impl<'a> ObjectDescription<'a> {
    /// From the bytes; `None` if they are too few.
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        let ([a, b, c, d, highest, code], name) = bytes.split_first_chunk()?;
        Some(Self {
            index: u16::from_le_bytes([*a, *b]),
            data_type: u16::from_le_bytes([*c, *d]),
            highest: *highest,
            code: *code,
            name: text(name),
        })
    }
}

/// Description of an entry, from the answer to [`JobKind::DescribeEntry`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EntryDescription<'a> {
    /// Its address.
    pub address: Address,
    /// Data type as CiA 301 numbers them.
    pub data_type: u16,
    /// Its length, bits.
    pub bits: u16,
    /// Bits 0 to 2 readable, 3 to 5 writable in PRE-OP, SAFE-OP, OP; 6 RxPDO, 7 TxPDO.
    pub access: u16,
    /// Its name; bytes that are not text are skipped.
    pub name: &'a str,
}

impl<'a> EntryDescription<'a> {
    /// From the bytes; `None` if they are too few.
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        let ([a, b, sub, _, c, d, e, f, g, h], name) = bytes.split_first_chunk()?;
        Some(Self {
            address: Address::new(u16::from_le_bytes([*a, *b]), *sub),
            data_type: u16::from_le_bytes([*c, *d]),
            bits: u16::from_le_bytes([*e, *f]),
            access: u16::from_le_bytes([*g, *h]),
            name: text(name),
        })
    }
}

/// The valid text, without the trailing zeros that some slaves send.
fn text(bytes: &[u8]) -> &str {
    let good = match std::str::from_utf8(bytes) {
        Ok(text) => text,
        Err(error) => {
            let valid = bytes.get(..error.valid_up_to()).unwrap_or_default();
            std::str::from_utf8(valid).unwrap_or_default()
        }
    };
    good.trim_end_matches('\0')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptions_are_read_as_far_as_they_are_text() {
        let bytes = [0x41, 0x60, 6, 0, 0, 7, b'S', b't', 0, 0];
        let object = ObjectDescription::decode(&bytes).unwrap();
        assert_eq!(
            (object.index, object.data_type, object.code),
            (0x6041, 6, 7)
        );
        assert_eq!(object.name, "St");
        let bytes = [0x41, 0x60, 2, 0, 6, 0, 16, 0, 0x87, 0, b'a', 0xFF, b'b'];
        let entry = EntryDescription::decode(&bytes).unwrap();
        assert_eq!((entry.address, entry.bits), (Address::new(0x6041, 2), 16));
        assert_eq!((entry.access, entry.name), (0x87, "a"));
        assert_eq!(ObjectDescription::decode(&bytes[..5]), None);
        assert_eq!(EntryDescription::decode(&bytes[..9]), None);
    }
}
