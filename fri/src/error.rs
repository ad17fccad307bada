//! Why a datagram was refused, in values small enough for the cycle thread. It holds no text: `Display` makes it.

use crate::generation::Kind;
use crate::sunrise::wire::Dialect;

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
    /// The datagram is a sound one of another kind than the one due here.
    #[error("{found}, expected {expected}: {}", found.remedy(*expected))]
    Foreign {
        /// What was due.
        expected: Kind,
        /// What came.
        found: Kind,
    },
    /// The controller speaks another dialect than the one asked for.
    #[error(
        "the controller speaks {actual}, this session was told to speak {expected}: correct the setting or leave it to detection"
    )]
    Dialect {
        /// What the session was told.
        expected: Dialect,
        /// What the controller speaks.
        actual: Dialect,
    },
    /// The datagram begins neither with a message header nor with the length of its message.
    #[error("datagram of {actual} bytes is no message of Sunrise FRI, bare or framed")]
    NoMessage {
        /// Bytes received.
        actual: usize,
    },
    /// The checksum of a framed message is wrong.
    #[error("CRC-32 {stated:#010x} of the message, computed {computed:#010x}: damaged on the way")]
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
        /// Values due.
        expected: usize,
        /// Values received.
        actual: usize,
    },
    /// A repeated field or a name is longer than the schema allows.
    #[error("more than {max} values or bytes of {field}")]
    TooMany {
        /// Its name in the schema.
        field: &'static str,
        /// Largest number allowed.
        max: usize,
    },
    /// The message identifier is another one.
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
