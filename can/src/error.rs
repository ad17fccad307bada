//! Errors of frame construction and of log parsing. Bus faults are not errors but states of the bus
//! (see [`crate::fault`]).

/// Why a frame cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// Above 7FFh.
    #[error("identifier {id:#x} does not fit 11 bits; is an extended one meant?")]
    StandardId {
        /// As given.
        id: u16,
    },
    /// Above 1FFF_FFFFh.
    #[error("identifier {id:#x} does not fit 29 bits")]
    ExtendedId {
        /// As given.
        id: u32,
    },
    /// Only eight bytes have alternative length codes, 9 to 15.
    #[error(
        "invalid length code {raw} for {len} bytes; only 9 to 15, and only for 8 bytes, are possible"
    )]
    RawDlc {
        /// As given.
        raw: u8,
        /// Bytes of the frame.
        len: u8,
    },
    /// Not one of the lengths of a CAN FD frame.
    #[error("{len} bytes; a CAN FD frame carries 0 to 8, 12, 16, 20, 24, 32, 48 or 64")]
    FdLength {
        /// As given.
        len: usize,
    },
    /// A classic frame carries eight bytes at most.
    #[error("{len} bytes, a classic frame carries 8 at most")]
    TooLong {
        /// As given.
        len: usize,
    },
}

/// Why a log line cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LogError {
    /// The line does not begin with a time stamp.
    #[error("no time stamp like (1700000000.000125)")]
    Stamp,
    /// The time stamp is beyond the year 9999.
    #[error("a time stamp beyond the year 9999; is the line damaged?")]
    Late,
    /// An interface's name has 1 to 15 bytes.
    #[error("no interface name of 1 to 15 characters")]
    Interface,
    /// There is no `#`, or the identifier before it has not 1 to 3 or 8 hexadecimal digits.
    #[error("no identifier of 3 or 8 hexadecimal digits before `#`")]
    Id,
    /// The text after `#` is neither byte pairs nor `R` and a length.
    #[error("data is not pairs of hexadecimal digits, nor R and a length")]
    Data,
    /// The frame is followed by something other than `R` or `T`, or more text follows.
    #[error("only R (received) or T (transmitted) may follow the frame")]
    Direction,
    /// A kind of frame that the reader does not support.
    #[error("{what} is not supported here")]
    Unsupported {
        /// Its name.
        what: &'static str,
    },
    /// Damaged data where a frame is expected.
    #[error("cannot decode {what}")]
    Event {
        /// Its name.
        what: &'static str,
    },
    /// Unknown file format.
    #[error(
        "no recording of a CAN bus: candump log or text, ASC, BLF, TRC, pcap and pcapng are read"
    )]
    Unknown,
    /// A pcap file with a link type other than CAN.
    #[error("link type {link}; those of CAN (227) and of the \"any\" device (113, 276) are read")]
    LinkType {
        /// As in the file.
        link: u32,
    },
    /// Well-formed, but not a valid frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
}
