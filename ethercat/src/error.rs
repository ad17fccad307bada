//! What can be wrong with bytes received and with a frame that is written. What a slave reports of
//! itself is not here.

/// Why bytes are no EtherCAT frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The bytes end inside something.
    #[error("{what} needs {expected} bytes, {actual} are left")]
    Truncated {
        /// What was being read.
        what: &'static str,
        /// Bytes it needs.
        expected: usize,
        /// Bytes there are.
        actual: usize,
    },
    /// The last datagram says that one more follows, and none does.
    #[error("a datagram announces another one, and the frame ends")]
    MissingDatagram,
    /// The last datagram says that none follows, and there are bytes left in the frame's length.
    #[error("{count} bytes follow the last datagram")]
    TrailingBytes {
        /// How many.
        count: usize,
    },
    /// The frame holds something else, as network variables (4) or a mailbox (5).
    #[error("a frame of type {kind} holds no datagrams; type 1 does")]
    NoDatagrams {
        /// Bits 12 to 15 of the frame header.
        kind: u8,
    },
}

/// Why a frame cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The buffer ends, or the longest Ethernet frame does.
    #[error("{expected} bytes are needed, {actual} are free")]
    Full {
        /// Bytes needed.
        expected: usize,
        /// Bytes free.
        actual: usize,
    },
    /// A length has eleven bits.
    #[error("length {len} does not fit 11 bits")]
    Length {
        /// As given.
        len: u16,
    },
}
