//! The content of a FoE mailbox (ETG.1000.6, clause 5.8): files in packets. The order of the packets is up to client and
//! server.

use std::fmt;

/// Longest file name, bytes: a job is handed over by value.
const NAME_MAX: usize = 48;

/// The name of a file on a slave, up to 48 bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct FileName {
    bytes: [u8; NAME_MAX],
    len: u8,
}

impl FileName {
    /// The name; `None` if it is empty, longer than 48 bytes, or contains a zero.
    pub fn new(name: &str) -> Option<Self> {
        let is_valid = !name.is_empty() && !name.contains('\0');
        let mut bytes = [0; NAME_MAX];
        bytes
            .get_mut(..name.len())
            .filter(|_| is_valid)?
            .copy_from_slice(name.as_bytes());
        let len = u8::try_from(name.len()).ok()?;
        Some(Self { bytes, len })
    }

    /// Its bytes.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.len.into()).unwrap_or_default()
    }
}

impl fmt::Debug for FileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&String::from_utf8_lossy(self.as_bytes()), f)
    }
}

/// Why a file was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FoeError(pub u32);

impl FoeError {
    /// There is no such file.
    pub const NOT_FOUND: Self = Self(0x8001);
    /// Access denied, as with a wrong password.
    pub const DENIED: Self = Self(0x8002);
    /// The file is longer than the memory.
    pub const DISK_FULL: Self = Self(0x8003);
    /// An operation that makes no sense here.
    pub const ILLEGAL: Self = Self(0x8004);
    /// A packet number out of order.
    pub const PACKET_NUMBER: Self = Self(0x8005);
    /// Files are accepted in BOOT only.
    pub const BOOT_ONLY: Self = Self(0x8008);
    /// Nothing fits: the file is not for this device.
    pub const ILLEGAL_FILE: Self = Self(0x800B);
}

const ERRORS: [&str; 18] = [
    "not defined",
    "file not found",
    "access denied: wrong password or state",
    "its memory is full",
    "illegal operation",
    "packet number out of order",
    "the file exists already",
    "no user",
    "in BOOT only",
    "not in BOOT",
    "no rights",
    "the file is not for this device",
    "a wrong checksum",
    "the firmware does not fit this hardware",
    "no file to read",
    "the file has no header",
    "flash problem",
    "the file is incompatible",
];

impl fmt::Display for FoeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let known = self.0.checked_sub(0x8000);
        let known = known.and_then(|number| ERRORS.get(usize::try_from(number).ok()?));
        let text = known.unwrap_or(&"a code of its vendor");
        write!(f, "{text} (FoE {:04X}h)", self.0)
    }
}

/// A FoE message.
///
/// | bytes | field |
/// |---|---|
/// | 0 | operation: 1 read, 2 write, 3 data, 4 acknowledgement, 5 error, 6 busy |
/// | 1 | reserved |
/// | 2 to 5 | password, packet number or error code; of busy: amount done and in all, 16 bits each |
/// | from 6 | file name, data or text |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Foe<'a> {
    /// Read a file.
    Read {
        /// 0 for none.
        password: u32,
        /// The file.
        name: &'a [u8],
    },
    /// Write a file.
    Write {
        /// 0 for none.
        password: u32,
        /// The file.
        name: &'a [u8],
    },
    /// A packet. One that does not fill the mailbox is the last.
    Data {
        /// Counted from 1.
        packet: u32,
        /// Its bytes.
        data: &'a [u8],
    },
    /// A packet was received; 0 accepts a write request.
    Acknowledge {
        /// The packet.
        packet: u32,
    },
    /// The transfer ends.
    Error {
        /// Its cause.
        code: FoeError,
        /// A text of the slave, possibly empty.
        text: &'a [u8],
    },
    /// The packet cannot be handled yet; its sender repeats it.
    Busy {
        /// Amount done, of [`Self::Busy::all`]; no unit.
        done: u16,
        /// Amount in all; 0 for unknown.
        all: u16,
    },
}

impl<'a> Foe<'a> {
    /// Bytes before the name, data or text.
    pub const HEAD: usize = 6;

    /// Decodes a message; `None` if it is truncated or its operation is unknown.
    pub fn decode(bytes: &'a [u8]) -> Option<Self> {
        let ([operation, _, number @ ..], rest) = bytes.split_first_chunk::<6>()?;
        let [a, b, c, d] = *number;
        let number = u32::from_le_bytes([a, b, c, d]);
        Some(match operation {
            1 => Self::Read {
                password: number,
                name: rest,
            },
            2 => Self::Write {
                password: number,
                name: rest,
            },
            3 => Self::Data {
                packet: number,
                data: rest,
            },
            4 => Self::Acknowledge { packet: number },
            5 => Self::Error {
                code: FoeError(number),
                text: rest,
            },
            6 => Self::Busy {
                done: u16::from_le_bytes([a, b]),
                all: u16::from_le_bytes([c, d]),
            },
            _ => return None,
        })
    }

    /// Writes the message to `to`; returns its length, `None` if it does not fit.
    pub fn encode(&self, to: &mut [u8]) -> Option<usize> {
        let busy = |done: u16, all: u16| u32::from(done) | u32::from(all) << 16;
        let (operation, number, rest) = match *self {
            Self::Read { password, name } => (1, password, name),
            Self::Write { password, name } => (2, password, name),
            Self::Data { packet, data } => (3, packet, data),
            Self::Acknowledge { packet } => (4, packet, &[][..]),
            Self::Error { code, text } => (5, code.0, text),
            Self::Busy { done, all } => (6, busy(done, all), &[][..]),
        };
        let [a, b, c, d] = number.to_le_bytes();
        let end = Self::HEAD + rest.len();
        let (head, tail) = to.get_mut(..end)?.split_at_mut(Self::HEAD);
        head.copy_from_slice(&[operation, 0, a, b, c, d]);
        tail.copy_from_slice(rest);
        Some(end)
    }
}

impl fmt::Display for Foe<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read { name, .. } => write!(f, "read \"{}\"", String::from_utf8_lossy(name)),
            Self::Write { name, .. } => write!(f, "write \"{}\"", String::from_utf8_lossy(name)),
            Self::Data { packet, data } => write!(f, "data {packet}, {} bytes", data.len()),
            Self::Acknowledge { packet } => write!(f, "acknowledges {packet}"),
            Self::Error { code, text: [] } => write!(f, "error: {code}"),
            Self::Error { code, text } => {
                write!(f, "error: {code}: {}", String::from_utf8_lossy(text))
            }
            Self::Busy { done, all } => write!(f, "busy, {done} of {all}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foe_messages_survive_the_wire() {
        let messages = [
            Foe::Read {
                password: 7,
                name: b"a.bin",
            },
            Foe::Write {
                password: 0x1234_5678,
                name: b"b",
            },
            Foe::Data {
                packet: 3,
                data: &[1, 2, 3],
            },
            Foe::Acknowledge { packet: 3 },
            Foe::Error {
                code: FoeError::BOOT_ONLY,
                text: b"no",
            },
            Foe::Busy { done: 3, all: 10 },
        ];
        for message in messages {
            let mut bytes = [0; 32];
            let len = message.encode(&mut bytes).unwrap();
            assert_eq!(Foe::decode(&bytes[..len]), Some(message));
            assert_eq!(message.encode(&mut [0; 5]), None);
            assert_eq!(Foe::decode(&bytes[..5]), None);
        }
        let write = [2, 0, 0, 0, 0, 0, b'x'];
        let name = b"x";
        assert_eq!(Foe::decode(&write), Some(Foe::Write { password: 0, name }));
        assert_eq!(Foe::decode(&[7, 0, 0, 0, 0, 0]), None);
    }

    #[test]
    fn foe_error_texts_name_the_code() {
        let text = FoeError::BOOT_ONLY.to_string();
        assert_eq!(text, "in BOOT only (FoE 8008h)");
        assert!(FoeError(5).to_string().contains("its vendor (FoE 0005h)"));
        assert!(FileName::new("").is_none());
        assert!(FileName::new(&"x".repeat(65)).is_none());
        assert_eq!(FileName::new("fw").unwrap().as_bytes(), b"fw");
    }
}
