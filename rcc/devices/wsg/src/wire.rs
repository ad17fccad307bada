//! Packets of the gripper's protocol, and the values in them. What they mean for a gripper is not here.
//!
//! | byte | content |
//! |---|---|
//! | 0..3 | preamble AAh AAh AAh |
//! | 3 | command |
//! | 4..6 | size of the payload |
//! | 6.. | payload; of an answer, first the status (2 bytes) |
//! | last 2 | checksum of everything before |
//!
//! Everything is little-endian.
#![warn(clippy::indexing_slicing)]

use std::fmt;

/// First bytes of each packet.
const PREAMBLE: [u8; 3] = [0xaa; 3];
/// Bytes before the payload.
const HEAD: usize = 6;
/// Bytes of the checksum.
const CHECKSUM: usize = 2;
/// Longest payload that is accepted. Those of motion and state have at most 10 bytes.
pub const PAYLOAD_MAX: usize = 64;
/// Longest packet.
pub const PACKET_MAX: usize = HEAD + PAYLOAD_MAX + CHECKSUM;

/// Checksum of bytes after those with checksum `before`; FFFFh at the beginning. Over a whole packet it is 0.
///
/// It is no common variant of CRC-16: the polynomial 1021h is shifted to the left in the table, and the register to
/// the right.
#[must_use]
pub fn checksum(bytes: &[u8], before: u16) -> u16 {
    bytes.iter().fold(before, |crc, byte| {
        let [low, high] = crc.to_le_bytes();
        let shifted = (0..8).fold(u16::from(low ^ byte) << 8, |entry, _| {
            let carry = entry & 0x8000 != 0;
            (entry << 1) ^ if carry { 0x1021 } else { 0 }
        });
        shifted ^ u16::from(high)
    })
}

/// Commands of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// The client is about to disconnect.
    Disconnect,
    /// Finds an end stop.
    Homing,
    /// Moves to a width.
    Preposition,
    /// Stops.
    Stop,
    /// Stops and takes no motion until that is acknowledged.
    FastStop,
    /// Acknowledges a fast stop or a fault.
    Acknowledge,
    /// Grips a part.
    Grasp,
    /// Releases a part.
    Release,
    /// Sets the acceleration.
    SetAcceleration,
    /// Sets the force limit.
    SetForceLimit,
    /// Sets the soft limits.
    SetSoftLimits,
    /// Reads the soft limits.
    GetSoftLimits,
    /// Removes the soft limits.
    ClearSoftLimits,
    /// Reads or subscribes to the flags of the system state.
    SystemState,
    /// Reads or subscribes to the state of grasping.
    GraspingState,
    /// Reads or subscribes to the distance between the fingers.
    Width,
    /// Reads or subscribes to the speed.
    Speed,
    /// Reads or subscribes to the force.
    Force,
    /// Any other.
    Other(u8),
}

impl Command {
    const KNOWN: [(u8, Self); 18] = [
        (0x07, Self::Disconnect),
        (0x20, Self::Homing),
        (0x21, Self::Preposition),
        (0x22, Self::Stop),
        (0x23, Self::FastStop),
        (0x24, Self::Acknowledge),
        (0x25, Self::Grasp),
        (0x26, Self::Release),
        (0x30, Self::SetAcceleration),
        (0x32, Self::SetForceLimit),
        (0x34, Self::SetSoftLimits),
        (0x35, Self::GetSoftLimits),
        (0x36, Self::ClearSoftLimits),
        (0x40, Self::SystemState),
        (0x41, Self::GraspingState),
        (0x43, Self::Width),
        (0x44, Self::Speed),
        (0x45, Self::Force),
    ];

    /// Its number.
    #[must_use]
    pub fn number(self) -> u8 {
        if let Self::Other(number) = self {
            return number;
        }
        let known = Self::KNOWN.iter().find(|(_, command)| *command == self);
        known.map_or(0, |(number, _)| *number)
    }

    /// The command of a number.
    #[must_use]
    pub fn of(number: u8) -> Self {
        let known = Self::KNOWN.iter().find(|(known, _)| *known == number);
        known.map_or(Self::Other(number), |(_, command)| *command)
    }
}

/// The outcome of a command. Names are those of the manual, without `E_`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status(pub u16);

impl Status {
    /// Executed.
    pub const SUCCESS: Self = Self(0);
    /// The gripper was not homed yet.
    pub const NOT_INITIALIZED: Self = Self(3);
    /// The command is already being executed.
    pub const ALREADY_RUNNING: Self = Self(4);
    /// It took too long.
    pub const TIMEOUT: Self = Self(7);
    /// The packet's checksum is wrong.
    pub const CHECKSUM: Self = Self(11);
    /// The payload is too short.
    pub const NOT_ENOUGH_PARAMS: Self = Self(13);
    /// There is no such command.
    pub const CMD_UNKNOWN: Self = Self(14);
    /// The payload is malformed.
    pub const CMD_FORMAT: Self = Self(15);
    /// A fast stop or a fault is not acknowledged.
    pub const ACCESS_DENIED: Self = Self(16);
    /// It failed.
    pub const CMD_FAILED: Self = Self(18);
    /// Another command or a stop ended it.
    pub const CMD_ABORTED: Self = Self(19);
    /// A value is not possible.
    pub const INVALID_PARAMETER: Self = Self(24);
    /// It has begun; another answer follows.
    pub const PENDING: Self = Self(26);
    /// A value is out of range.
    pub const RANGE: Self = Self(28);
    /// The fingers are blocked.
    pub const AXIS_BLOCKED: Self = Self(29);

    /// Its meaning.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self.0 {
            0 => "success",
            1 => "not available",
            2 => "no sensor",
            3 => "not initialized: the gripper needs homing",
            4 => "already running",
            5 => "feature not supported",
            6 => "inconsistent data",
            7 => "timeout",
            8 => "read error",
            9 => "write error",
            10 => "insufficient resources",
            11 => "checksum error",
            12 => "no parameter expected",
            13 => "not enough parameters",
            14 => "unknown command",
            15 => "command format error",
            16 => "access denied: a fast stop or fault is not acknowledged",
            17 => "already open",
            18 => "command failed",
            19 => "command aborted",
            20 => "invalid handle",
            21 => "not found",
            22 => "not open",
            23 => "I/O error",
            24 => "invalid parameter",
            25 => "index out of bounds",
            26 => "pending",
            27 => "overrun",
            28 => "range error",
            29 => "axis blocked",
            30 => "file exists",
            _ => "unknown status",
        }
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.text(), self.0)
    }
}

/// A packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Its command.
    pub command: Command,
    len: usize,
    payload: [u8; PAYLOAD_MAX],
}

impl Packet {
    /// A packet without payload.
    #[must_use]
    pub const fn new(command: Command) -> Self {
        Self {
            command,
            len: 0,
            payload: [0; PAYLOAD_MAX],
        }
    }

    /// Appends bytes to the payload; those beyond [`PAYLOAD_MAX`] are left out.
    #[must_use]
    pub fn with(mut self, bytes: &[u8]) -> Self {
        for (place, byte) in self.payload.iter_mut().skip(self.len).zip(bytes) {
            *place = *byte;
        }
        self.len = (self.len + bytes.len()).min(PAYLOAD_MAX);
        self
    }

    /// Appends a number.
    #[must_use]
    pub fn with_float(self, value: f32) -> Self {
        self.with(&value.to_le_bytes())
    }

    /// Appends a status.
    #[must_use]
    pub fn with_status(self, status: Status) -> Self {
        self.with(&status.0.to_le_bytes())
    }

    /// The payload.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        self.payload.get(..self.len).unwrap_or_default()
    }

    /// Status and values of an answer; `None` if it has no status.
    #[must_use]
    pub fn answer(&self) -> Option<(Status, &[u8])> {
        let (status, values) = self.payload().split_first_chunk()?;
        Some((Status(u16::from_le_bytes(*status)), values))
    }

    /// Writes it; returns its length, at most [`PACKET_MAX`].
    pub fn encode(&self, out: &mut [u8; PACKET_MAX]) -> usize {
        let size = u16::try_from(self.len).unwrap_or(u16::MAX).to_le_bytes();
        let head = PREAMBLE.into_iter().chain([self.command.number()]);
        let bytes = head.chain(size).chain(self.payload().iter().copied());
        for (place, byte) in out.iter_mut().zip(bytes) {
            *place = byte;
        }
        let end = HEAD + self.len;
        let crc = checksum(out.get(..end).unwrap_or_default(), u16::MAX);
        for (place, byte) in out.iter_mut().skip(end).zip(crc.to_le_bytes()) {
            *place = byte;
        }
        end + CHECKSUM
    }
}

impl fmt::Display for Packet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:02x} [{}]", self.command.number(), self.len)?;
        self.payload()
            .iter()
            .try_for_each(|byte| write!(f, " {byte:02x}"))
    }
}

/// A number at the beginning of a payload, and the rest.
#[must_use]
pub fn float(payload: &[u8]) -> Option<(f32, &[u8])> {
    let (bytes, rest) = payload.split_first_chunk()?;
    Some((f32::from_le_bytes(*bytes), rest))
}

/// Why bytes are not a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The checksum does not match.
    #[error("the checksum of a packet {0:02x}h is wrong")]
    Checksum(u8),
    /// The payload is longer than any of this protocol.
    #[error("a packet announces a payload of {0} bytes; at most {PAYLOAD_MAX} are accepted")]
    TooLong(u16),
}

/// Finds packets in a stream. After an error it looks for the next preamble.
#[derive(Clone, Debug)]
pub struct PacketReader {
    bytes: [u8; PACKET_MAX],
    len: usize,
}

impl Default for PacketReader {
    fn default() -> Self {
        Self {
            bytes: [0; PACKET_MAX],
            len: 0,
        }
    }
}

impl PacketReader {
    /// Adds a byte; returns the packet, or the error, that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Result<Packet, DecodeError>> {
        let expected = PREAMBLE.get(self.len);
        if expected.is_some_and(|expected| *expected != byte) {
            self.len = 0;
            return None;
        }
        *self.bytes.get_mut(self.len)? = byte;
        self.len += 1;
        let [_, _, _, command, low, high] = *self.bytes.first_chunk::<HEAD>()?;
        if self.len < HEAD {
            return None;
        }
        let size = u16::from_le_bytes([low, high]);
        let len = usize::from(size);
        if len > PAYLOAD_MAX {
            self.len = 0;
            return Some(Err(DecodeError::TooLong(size)));
        }
        if self.len < HEAD + len + CHECKSUM {
            return None;
        }
        let whole = self.bytes.get(..self.len)?;
        let sound = checksum(whole, u16::MAX) == 0;
        let payload = self.bytes.get(HEAD..HEAD + len)?;
        let packet = Packet::new(Command::of(command)).with(payload);
        self.len = 0;
        Some(if sound {
            Ok(packet)
        } else {
            Err(DecodeError::Checksum(command))
        })
    }
}

/// The property of the packet reader for any bytes: what it accepts is encoded to the same bytes.
#[doc(hidden)]
pub fn fuzz(data: &[u8]) {
    let mut reader = PacketReader::default();
    for (at, byte) in data.iter().enumerate() {
        if let Some(Ok(packet)) = reader.push(*byte) {
            let mut bytes = [0; PACKET_MAX];
            let len = packet.encode(&mut bytes);
            let received = (at + 1)
                .checked_sub(len)
                .and_then(|from| data.get(from..=at));
            assert_eq!(bytes.get(..len), received, "{packet}");
        }
    }
}

#[cfg(test)]
#[expect(clippy::indexing_slicing, reason = "tests fail by panicking")]
mod tests {
    use super::*;
    use takt_tests::Random;

    /// The packets that the manual prints.
    #[test]
    fn packets_of_the_manual_are_encoded_and_decoded() {
        let answer = |command: u8, status: u16| {
            Packet::new(Command::of(command)).with_status(Status(status))
        };
        let cases: [(Packet, &[u8]); 7] = [
            (
                Packet::new(Command::of(1)),
                &[0xaa, 0xaa, 0xaa, 1, 0, 0, 0xe8, 0x10],
            ),
            (
                Packet::new(Command::of(1)).with(&[0x12, 0x34]),
                &[0xaa, 0xaa, 0xaa, 1, 2, 0, 0x12, 0x34, 0x6d, 0x66],
            ),
            (
                answer(0x20, 0),
                &[0xaa, 0xaa, 0xaa, 0x20, 2, 0, 0, 0, 0xb3, 0xfd],
            ),
            (
                answer(0x90, 14),
                &[0xaa, 0xaa, 0xaa, 0x90, 2, 0, 0x0e, 0, 0xfd, 0x02],
            ),
            (
                answer(0x30, 0).with_float(150.0),
                &[
                    0xaa, 0xaa, 0xaa, 0x30, 6, 0, 0, 0, 0, 0, 0x16, 0x43, 0xdc, 0xcb,
                ],
            ),
            (
                answer(0x21, 26),
                &[0xaa, 0xaa, 0xaa, 0x21, 2, 0, 0x1a, 0, 0x67, 0xcb],
            ),
            (
                answer(0x21, 0),
                &[0xaa, 0xaa, 0xaa, 0x21, 2, 0, 0, 0, 0x28, 0x04],
            ),
        ];
        for (packet, bytes) in cases {
            let mut out = [0; PACKET_MAX];
            let len = packet.encode(&mut out);
            assert_eq!(out[..len], *bytes, "{packet}");
            let mut reader = PacketReader::default();
            let mut read = bytes.iter().filter_map(|byte| reader.push(*byte));
            assert_eq!(read.next(), Some(Ok(packet)));
        }
    }

    #[test]
    fn packet_reader_resumes_after_errors() {
        let mut out = [0; PACKET_MAX];
        let len = Packet::new(Command::Stop).encode(&mut out);
        let mut bad = out;
        bad[len - 1] ^= 1;
        let too_long = [0xaa, 0xaa, 0xaa, 0x20, 0xff, 0xff];
        let stream = [&[1, 2, 0xaa, 3], &bad[..len], &too_long, &out[..len]].concat();
        let mut reader = PacketReader::default();
        let read: Vec<_> = stream
            .iter()
            .filter_map(|byte| reader.push(*byte))
            .collect();
        let expected = [
            Err(DecodeError::Checksum(0x22)),
            Err(DecodeError::TooLong(0xffff)),
            Ok(Packet::new(Command::Stop)),
        ];
        assert_eq!(read, expected);
    }

    #[test]
    fn command_numbers_round_trip() {
        for number in 0..=u8::MAX {
            assert_eq!(Command::of(number).number(), number);
        }
    }

    #[test]
    fn random_bytes_keep_reader_property() {
        let mut random = Random::new(5);
        for _ in 0..10_000 {
            let mut bytes: Vec<_> = (0..random.below(40)).map(|_| random.byte()).collect();
            if random.chance(0.7) {
                let command = Command::of(random.byte());
                let packet = Packet::new(command).with(&bytes);
                let mut out = [0; PACKET_MAX];
                let len = packet.encode(&mut out);
                bytes.extend(&out[..len]);
            }
            fuzz(&bytes);
        }
    }
}
