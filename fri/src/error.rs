//! Why a datagram was refused, in values small enough for the cycle thread. It holds no text: `Display` makes it.

/// A received datagram is not what its generation of FRI prescribes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The datagram has another length than the one fixed by the layout.
    #[error(
        "datagram of {actual} bytes, expected {expected}: does the other side speak this generation of FRI?"
    )]
    Length {
        /// Bytes the layout prescribes.
        expected: usize,
        /// Bytes received.
        actual: usize,
    },
    /// The length field inside the datagram contradicts the layout.
    #[error("packetSize {actual} at offset {offset}, expected {expected}")]
    PacketSize {
        /// Bytes the layout prescribes.
        expected: u16,
        /// Value received.
        actual: u16,
        /// Byte offset of the field.
        offset: usize,
    },
    /// The datagram is of another kind or version.
    #[error(
        "datagramId {actual:#06x} at offset {offset}, expected {expected:#06x}: another FRI version or direction"
    )]
    DatagramId {
        /// Id of the expected message.
        expected: u16,
        /// Id received.
        actual: u16,
        /// Byte offset of the field.
        offset: usize,
    },
}

/// A datagram could not be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The caller's buffer is too small.
    #[error("buffer of {actual} bytes, the datagram needs {needed}")]
    Buffer {
        /// Bytes the datagram needs.
        needed: usize,
        /// Bytes the caller gave.
        actual: usize,
    },
}

/// A session could not build its answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AnswerError {
    /// Every measurement gets exactly one answer; the last one has had it, or none has come yet.
    #[error("no measurement waits for an answer")]
    NothingToAnswer,
    /// A joint value is infinite or not a number; nothing was written.
    #[error("joint {joint} (0 is A1, 2 is E1) is not a finite number")]
    NotFinite {
        /// Index of the joint, 0..=6, in the order of [`crate::lwr::JOINT_NAMES`].
        joint: usize,
    },
    /// The datagram could not be written.
    #[error(transparent)]
    Encode(#[from] EncodeError),
}
