//! The mailbox header and the content of a CoE mailbox (ETG.1000.6, clauses 5.6 and 5.7): SDO, SDO information,
//! emergency. Client and server are not here.

use std::fmt;

/// Type of a mailbox message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MailboxKind {
    /// Error: the slave could not process the last message.
    Error,
    /// ADS.
    Aoe,
    /// Ethernet.
    Eoe,
    /// CANopen.
    Coe,
    /// Files.
    Foe,
    /// SERCOS.
    Soe,
    /// Vendor specific.
    Voe,
    /// Any other, as received.
    Other(u8),
}

const KINDS: [(MailboxKind, u8, &str); 7] = [
    (MailboxKind::Error, 0x0, "error"),
    (MailboxKind::Aoe, 0x1, "AoE"),
    (MailboxKind::Eoe, 0x2, "EoE"),
    (MailboxKind::Coe, 0x3, "CoE"),
    (MailboxKind::Foe, 0x4, "FoE"),
    (MailboxKind::Soe, 0x5, "SoE"),
    (MailboxKind::Voe, 0xF, "VoE"),
];

impl MailboxKind {
    /// The four bits on the wire.
    pub fn raw(self) -> u8 {
        if let Self::Other(raw) = self {
            return raw;
        }
        let found = KINDS.iter().find(|(kind, ..)| *kind == self);
        found.map_or(0, |(_, raw, _)| *raw)
    }

    /// The name of the protocol.
    pub(crate) fn name(self) -> &'static str {
        let found = KINDS.iter().find(|(kind, ..)| *kind == self);
        found.map_or("such mailbox protocol", |(.., name)| name)
    }

    /// From the lowest four bits.
    pub fn from_raw(raw: u8) -> Self {
        let raw = raw & 0x0F;
        let found = KINDS.iter().find(|(_, known, _)| *known == raw);
        found.map_or(Self::Other(raw), |(kind, ..)| *kind)
    }
}

impl fmt::Display for MailboxKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match KINDS.iter().find(|(kind, ..)| kind == self) {
            Some((.., name)) => f.write_str(name),
            None => write!(f, "mailbox type {}", self.raw()),
        }
    }
}

/// The header of a mailbox message.
///
/// | bytes | what |
/// |---|---|
/// | 0, 1 | length of what follows the header |
/// | 2, 3 | station address of the sender; 0 is the master |
/// | 4 | channel and priority, zero |
/// | 5 | bits 0 to 3 kind, 4 to 6 counter |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MailboxHeader {
    /// Bytes that follow the header.
    pub len: u16,
    /// Station address of the sender; 0 is the master.
    pub address: u16,
    /// Type of the message.
    pub kind: MailboxKind,
    /// 1 to 7 in turn; 0 disables the detection of repeats.
    pub counter: u8,
}

impl MailboxHeader {
    /// Bytes on the wire.
    pub const LEN: usize = 6;

    /// Decodes the header and the announced bytes; `None` if truncated.
    pub fn decode(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let ([a, b, c, d, _, kind], rest) = bytes.split_first_chunk()?;
        let header = Self {
            len: u16::from_le_bytes([*a, *b]),
            address: u16::from_le_bytes([*c, *d]),
            kind: MailboxKind::from_raw(*kind),
            counter: kind >> 4 & 0x07,
        };
        Some((header, rest.get(..header.len.into())?))
    }

    /// The bytes.
    pub fn encode(&self) -> [u8; Self::LEN] {
        let [a, b] = self.len.to_le_bytes();
        let [c, d] = self.address.to_le_bytes();
        [a, b, c, d, 0, self.kind.raw() | (self.counter & 0x07) << 4]
    }

    /// The next counter: 1 to 7, then 1 again.
    pub(crate) const fn next_counter(counter: u8) -> u8 {
        counter % 7 + 1
    }
}

/// Service of a CoE message: bits 12 to 15 of its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CoeService {
    /// An emergency of the slave.
    Emergency,
    /// An SDO request; an abort in either direction has this service too.
    SdoRequest,
    /// An SDO response.
    SdoResponse,
    /// PDOs by mailbox, in either direction or by remote request: 4 to 7.
    Pdo(u8),
    /// SDO information.
    SdoInformation,
    /// Any other, as received.
    Other(u8),
}

impl CoeService {
    /// Length of a CoE header, bytes.
    pub const LEN: usize = 2;

    /// Decodes the service and the bytes after its header; `None` if truncated.
    pub fn decode(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let ([_, high], rest) = bytes.split_first_chunk()?;
        let service = match high >> 4 {
            1 => Self::Emergency,
            2 => Self::SdoRequest,
            3 => Self::SdoResponse,
            number @ 4..=7 => Self::Pdo(number),
            8 => Self::SdoInformation,
            other => Self::Other(other),
        };
        Some((service, rest))
    }

    /// The header; its number is 0.
    #[must_use]
    pub const fn encode(self) -> [u8; Self::LEN] {
        let service = match self {
            Self::Emergency => 1,
            Self::SdoRequest => 2,
            Self::SdoResponse => 3,
            Self::SdoInformation => 8,
            Self::Pdo(number) | Self::Other(number) => number,
        };
        [0, service << 4]
    }
}

/// A CoE emergency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// Error code, as object 603Fh.
    pub code: u16,
    /// Error register, as object 1001h.
    pub register: u8,
    /// Manufacturer specific.
    pub data: [u8; 5],
}

impl Emergency {
    /// Length after the CoE header, bytes.
    pub const LEN: usize = 8;

    /// From the bytes after the CoE header; `None` if too short.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let [a, b, register, data @ ..] = *bytes.first_chunk::<{ Self::LEN }>()?;
        Some(Self {
            code: u16::from_le_bytes([a, b]),
            register,
            data,
        })
    }

    /// The bytes.
    pub const fn encode(&self) -> [u8; Self::LEN] {
        let [a, b] = self.code.to_le_bytes();
        let [c, d, e, f, g] = self.data;
        [a, b, self.register, c, d, e, f, g]
    }
}

/// Why a slave could not process a mailbox message, from the `Error` kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MailboxError(pub u16);

const ERRORS: [&str; 9] = [
    "no reason",
    "its header is wrong",
    "its protocol is not supported",
    "its channel is wrong",
    "its service is not supported",
    "its header does not fit its protocol",
    "it is too short",
    "out of memory",
    "its size is inconsistent",
];

impl MailboxError {
    /// From the bytes after a mailbox header of the kind `Error`; `None` if they are something else.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let [1, 0, low, high] = *bytes.first_chunk()? else {
            return None;
        };
        Some(Self(u16::from_le_bytes([low, high])))
    }

    /// The bytes.
    pub const fn encode(self) -> [u8; 4] {
        let [low, high] = self.0.to_le_bytes();
        [1, 0, low, high]
    }
}

impl fmt::Display for MailboxError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = ERRORS.get(usize::from(self.0)).unwrap_or(&ERRORS[0]);
        write!(
            f,
            "the slave refused the mailbox message: {text} ({})",
            self.0
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_read_back_and_bound_what_follows() {
        let header = MailboxHeader {
            len: 10,
            address: 0x1001,
            kind: MailboxKind::Coe,
            counter: 5,
        };
        let mut message = header.encode().to_vec();
        assert_eq!(message, [10, 0, 1, 0x10, 0, 0x53]);
        assert_eq!(MailboxHeader::decode(&message), None, "nothing follows");
        message.extend([7; 12]);
        assert_eq!(
            MailboxHeader::decode(&message),
            Some((header, &[7; 10][..]))
        );
        for raw in 0..16 {
            assert_eq!(MailboxKind::from_raw(raw).raw(), raw);
            let bytes = [0, raw << 4, 9];
            let (service, rest) = CoeService::decode(&bytes).unwrap();
            assert_eq!((service.encode(), rest), ([0, raw << 4], &[9][..]));
        }
    }

    #[test]
    fn counters_go_round_without_zero() {
        let mut counter = 0;
        let mut seen = vec![];
        for _ in 0..9 {
            counter = MailboxHeader::next_counter(counter);
            seen.push(counter);
        }
        assert_eq!(seen, [1, 2, 3, 4, 5, 6, 7, 1, 2]);
    }

    #[test]
    fn emergencies_and_errors() {
        let bytes = [0x11, 0x86, 0x21, 1, 2, 3, 4, 5];
        let emergency = Emergency::decode(&bytes).unwrap();
        assert_eq!((emergency.code, emergency.register), (0x8611, 0x21));
        assert_eq!(emergency.encode(), bytes);
        assert_eq!(Emergency::decode(&bytes[..7]), None);
        let error = MailboxError::decode(&[1, 0, 8, 0]).unwrap();
        assert_eq!(
            error.to_string(),
            "the slave refused the mailbox message: its size is inconsistent (8)"
        );
        assert_eq!(MailboxError::decode(&error.encode()), Some(error));
        assert_eq!(
            MailboxError(900).to_string().matches("no reason").count(),
            1
        );
    }
}
