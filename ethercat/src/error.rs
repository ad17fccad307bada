//! Errors of decoding received bytes and of encoding a frame. Faults that a slave reports are not here.

/// Why bytes are not an EtherCAT frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The bytes end within an item.
    #[error("{item} needs {expected} bytes, {actual} are left")]
    Truncated {
        /// The item being decoded.
        item: &'static str,
        /// Bytes required.
        expected: usize,
        /// Bytes available.
        actual: usize,
    },
    /// The last datagram announces another one, but none follows.
    #[error("a datagram announces another one, and the frame ends")]
    MissingDatagram,
    /// The last datagram announces none, but bytes are left within the frame's length.
    #[error("{count} bytes follow the last datagram")]
    TrailingBytes {
        /// Number of bytes.
        count: usize,
    },
    /// The frame holds something else, as network variables (4) or a mailbox (5).
    #[error("a frame of type {kind} holds no datagrams; type 1 does")]
    NoDatagrams {
        /// Bits 12 to 15 of the frame header.
        kind: u8,
    },
}

/// Why a frame cannot be encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The buffer or the longest Ethernet frame is exceeded.
    #[error("{expected} bytes are needed, {actual} are free")]
    Full {
        /// Bytes needed.
        expected: usize,
        /// Bytes free.
        actual: usize,
    },
    /// A length exceeds eleven bits.
    #[error("length {len} does not fit 11 bits")]
    Length {
        /// The given length.
        len: u16,
    },
}
