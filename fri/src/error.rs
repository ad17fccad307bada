//! Decode and encode errors, small enough for the cycle thread. They hold no text: `Display` formats it.

use crate::generation::Kind;
use crate::sunrise::wire::Dialect;

/// A received datagram is not what its generation of FRI prescribes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The datagram has another length than the one fixed by the layout.
    #[error(
        "datagram of {actual} bytes, expected {expected}: check the FRI generation of the peer"
    )]
    Length {
        /// Length that the layout prescribes.
        expected: usize,
        /// Bytes received.
        actual: usize,
    },
    /// The length field inside the datagram contradicts the layout.
    #[error("packetSize {actual} at offset {offset}, expected {expected}")]
    PacketSize {
        /// Length that the layout prescribes.
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
    /// The datagram is valid, but of another kind than expected.
    #[error("{found}, expected {expected}: {}", found.remedy(*expected))]
    Foreign {
        /// Expected kind.
        expected: Kind,
        /// Received kind.
        found: Kind,
    },
    /// The controller speaks another dialect than configured.
    #[error(
        "the controller speaks {actual}, this session is configured for {expected}: correct the setting or leave it to detection"
    )]
    Dialect {
        /// Configured dialect.
        expected: Dialect,
        /// Dialect of the controller.
        actual: Dialect,
    },
    /// The datagram begins neither with a message header nor with the length of its message.
    #[error("datagram of {actual} bytes is no message of Sunrise FRI, bare or framed")]
    NoMessage {
        /// Bytes received.
        actual: usize,
    },
    /// The checksum of a framed message is wrong.
    #[error("CRC-32 {stated:#010x} of the message, computed {computed:#010x}: damaged in transit")]
    Checksum {
        /// Value in the datagram.
        stated: u32,
        /// Value of the bytes received.
        computed: u32,
    },
    /// A message ends inside a field.
    #[error("the message ends inside a field, at offset {offset}")]
    Truncated {
        /// Byte offset in the message.
        offset: usize,
    },
    /// A field has another wire type than its schema.
    #[error("protobuf wire type {wire_type} at offset {offset} does not fit the schema")]
    WireType {
        /// Byte offset of the field in the message.
        offset: usize,
        /// Type received.
        wire_type: u64,
    },
    /// A required field is missing.
    #[error("required field {field} is missing")]
    Missing {
        /// Its name in the schema.
        field: &'static str,
    },
    /// A repeated field has another number of values than the robot has axes, or its type has components.
    #[error("{actual} values of {field}, expected {expected}")]
    Count {
        /// Its name in the schema.
        field: &'static str,
        /// Expected number.
        expected: usize,
        /// Values received.
        actual: usize,
    },
    /// A repeated field or a name is longer than the schema allows.
    #[error("more than {max} values or bytes of {field}")]
    TooMany {
        /// Its name in the schema.
        field: &'static str,
        /// Largest allowed number.
        max: usize,
    },
    /// The message identifier differs.
    #[error("messageIdentifier {actual:#x}, expected {expected:#x}: another direction or version")]
    MessageId {
        /// Identifier of the expected message.
        expected: u32,
        /// Identifier received.
        actual: u32,
    },
}

/// A datagram could not be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The caller's buffer is too small.
    #[error("buffer of {actual} bytes, the datagram needs {needed}")]
    Buffer {
        /// Length of the datagram.
        needed: usize,
        /// Length of the buffer.
        actual: usize,
    },
}

/// A session cannot build its answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AnswerError {
    /// No answer is due: every measurement gets exactly one.
    #[error("no measurement waits for an answer")]
    NothingToAnswer,
    /// A joint value is infinite or NaN; nothing was written.
    #[error("joint {joint} (0 is A1, 2 is E1) is not a finite number")]
    NotFinite {
        /// Index of the joint, 0..=6, in the order of [`crate::lwr::JOINT_NAMES`].
        joint: usize,
    },
    /// The datagram cannot be written.
    #[error(transparent)]
    Encode(#[from] EncodeError),
}
