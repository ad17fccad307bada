//! What can be wrong with a frame that is built and with a line that is read. Faults of a bus are
//! not here; they are states of the bus.

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
    /// Only eight bytes can be told by another length code, and only by 9 to 15.
    #[error("length code {raw} for {len} bytes; only 9 to 15, and only for 8 bytes, are possible")]
    RawDlc {
        /// As given.
        raw: u8,
        /// Bytes of the frame.
        len: u8,
    },
    /// A CAN FD frame carries certain lengths only.
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
    /// There is no `#`, or before it are not 1 to 3 or 8 hexadecimal digits.
    #[error("no identifier of 3 or 8 hexadecimal digits before `#`")]
    Id,
    /// After the `#` stand neither byte pairs nor `R` and a length.
    #[error("data is not pairs of hexadecimal digits, nor R and a length")]
    Data,
    /// What follows the frame is neither `R` nor `T`, or something follows that.
    #[error("after the frame only R (received) or T (transmitted) may stand")]
    Direction,
    /// A kind of frame that is no classic data or remote frame.
    #[error("{what} is not read here")]
    Unsupported {
        /// Its name.
        what: &'static str,
    },
    /// Something that should hold a frame and does not.
    #[error("{what} that cannot be understood")]
    Event {
        /// Its name.
        what: &'static str,
    },
    /// It is none of the kinds of recordings that are read.
    #[error(
        "no recording of a CAN bus: candump log or text, ASC, BLF, TRC, pcap and pcapng are read"
    )]
    Unknown,
    /// A pcap file of something else than CAN.
    #[error("link type {link}; those of CAN (227) and of the \"any\" device (113, 276) are read")]
    LinkType {
        /// As the file says.
        link: u32,
    },
    /// Well written, and no frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
}
