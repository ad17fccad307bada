//! The packets of the power base's USB port: a CAN frame in 18 bytes with a checksum, with the identifier at different
//! offsets in the two directions. The port is an FTDI chip (0403:E729), 460,800 Bd 8N1; the caller opens it.
//!
//! | byte | to the power base | from the power base |
//! |---|---|---|
//! | 0-1 | F0 55 | F0 55 |
//! | 2 | 00 | AA: channel A, BB: channel B |
//! | 3 | 00 | 00 |
//! | 4-5 | 00 00 | identifier × 32, and the length of the data, 8 |
//! | 6-7 | identifier | 00 00 |
//! | 8 | 00 | 00 |
//! | 9-16 | data | data |
//! | 17 | checksum | checksum |

use super::status::standard;
use crate::Frame;

/// One of the two control boards of a power base; each sends all messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Channel {
    /// The first.
    #[default]
    A,
    /// The second.
    B,
}

const HEAD: [u8; 2] = [0xF0, 0x55];

/// A packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet(pub [u8; Self::LEN]);

impl Packet {
    /// Bytes of a packet.
    pub const LEN: usize = 18;

    /// The frame to the power base. Shorter frames are padded with zeros; a power base accepts
    /// eight bytes only.
    pub(crate) fn to_powerbase(frame: &Frame) -> Self {
        let [high, low] = identifier(frame).to_be_bytes();
        Self::new([0, 0, 0, 0, high, low, 0], frame)
    }

    /// The frame from a power base.
    pub fn from_powerbase(channel: Channel, frame: &Frame) -> Self {
        let channel = match channel {
            Channel::A => 0xAA,
            Channel::B => 0xBB,
        };
        let [high, low] = (identifier(frame) << 5 | 8).to_be_bytes();
        Self::new([channel, 0, high, low, 0, 0, 0], frame)
    }

    fn new(middle: [u8; 7], frame: &Frame) -> Self {
        let mut bytes = [0; Self::LEN];
        let parts = HEAD.iter().chain(&middle).chain(frame.data());
        for (to, from) in bytes.iter_mut().zip(parts) {
            *to = *from;
        }
        bytes[17] = checksum(&bytes[..17]);
        Self(bytes)
    }

    /// The frame sent by the power base; `None` for other packets and the old heartbeat.
    pub fn decode(&self) -> Option<(Channel, Frame)> {
        let [f0, id55, channel, _, high, low, ..] = self.0;
        let channel = match channel {
            0xAA => Channel::A,
            0xBB => Channel::B,
            _ => return None,
        };
        let id = u16::from_be_bytes([high, low]) >> 5;
        ([f0, id55] == HEAD && self.is_sound())
            .then(|| (channel, Frame::full(standard(id), self.data())))
    }

    /// The frame sent by a host.
    pub fn decode_host(&self) -> Option<Frame> {
        let [f0, id55, channel, _, _, _, high, low, ..] = self.0;
        let id = u16::from_be_bytes([high, low]);
        ([f0, id55] == HEAD && channel <= 1 && id <= 0x7FF && self.is_sound())
            .then(|| Frame::full(standard(id), self.data()))
    }

    fn data(&self) -> [u8; 8] {
        let [.., a, b, c, d, e, f, g, h, _] = self.0;
        [a, b, c, d, e, f, g, h]
    }

    fn is_sound(&self) -> bool {
        self.0[17] == checksum(&self.0[..17])
    }
}

fn identifier(frame: &Frame) -> u16 {
    u16::try_from(frame.id().raw() & 0x7FF).unwrap_or_default()
}

/// The sum of all bytes, folded twice into eight bits and negated.
fn checksum(bytes: &[u8]) -> u8 {
    let fold = |sum: u16| (sum & 0xFF) + (sum >> 8);
    let sum = bytes.iter().map(|byte| u16::from(*byte)).sum();
    fold(fold(sum)).to_be_bytes()[1].wrapping_neg()
}

/// Finds packets in a byte stream that may start anywhere and lack bytes.
#[derive(Clone, Debug, Default)]
pub struct PacketReader {
    bytes: [u8; Packet::LEN],
    len: usize,
    skipped: u64,
    wrong: u64,
}

impl PacketReader {
    /// Handles a byte; returns the packet that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Packet> {
        if let Some(slot) = self.bytes.get_mut(self.len) {
            *slot = byte;
            self.len += 1;
        }
        self.resynchronize();
        if self.len < Packet::LEN {
            return None;
        }
        let packet = Packet(self.bytes);
        if packet.is_sound() {
            self.len = 0;
            return Some(packet);
        }
        self.wrong += 1;
        self.drop_first();
        self.resynchronize();
        None
    }

    /// Number of bytes outside of packets.
    pub const fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Packets with a wrong checksum.
    pub const fn wrong(&self) -> u64 {
        self.wrong
    }

    fn drop_first(&mut self) {
        self.bytes.rotate_left(1);
        self.len = self.len.saturating_sub(1);
        self.skipped += 1;
    }

    /// Drops bytes until the first may start a packet.
    fn resynchronize(&mut self) {
        while self.len > 0 && !self.begins() {
            self.drop_first();
        }
    }

    fn begins(&self) -> bool {
        let head = self.bytes.iter().zip(&HEAD).take(self.len);
        head.into_iter().all(|(byte, wanted)| byte == wanted)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Command, Config, Gain, Integrators, Message, Mode, SHUTDOWN};
    use super::*;

    fn hex(text: &str) -> Vec<u8> {
        text.split_whitespace()
            .map(|byte| u8::from_str_radix(byte, 16).unwrap())
            .collect()
    }

    fn command(velocity: i16, turn: i16, config: Config) -> Frame {
        Command {
            velocity,
            turn,
            config,
        }
        .frame()
    }

    #[test]
    fn rmp_packets_to_power_base_match_field_recordings() {
        let head = "f0 55 00 00 00 00 04 13 00 ";
        let of = |integrators| command(0, 0, Config::ResetIntegrators(integrators));
        for (frame, tail) in [
            (
                command(166, -156, Config::None),
                "00 a6 ff 64 00 00 00 00 98",
            ),
            (
                command(-300, 100, Config::None),
                "fe d4 00 64 00 00 00 00 6b",
            ),
            (
                command(0, 0, Config::Mode(Mode::Tractor)),
                "00 00 00 00 00 10 00 01 92",
            ),
            (
                command(0, 0, Config::MaxVelocity(8)),
                "00 00 00 00 00 0a 00 08 91",
            ),
            (
                command(0, 0, Config::BalanceLockout(true)),
                "00 00 00 00 00 0f 00 01 93",
            ),
            (
                command(0, 0, Config::Gain(Gain::Heavy)),
                "00 00 00 00 00 0d 00 02 94",
            ),
            (of(Integrators::RIGHT), "00 00 00 00 00 32 00 01 70"),
            (of(Integrators::LEFT), "00 00 00 00 00 32 00 02 6f"),
            (of(Integrators::YAW), "00 00 00 00 00 32 00 04 6d"),
            (of(Integrators::FORE_AFT), "00 00 00 00 00 32 00 08 69"),
        ] {
            let packet = Packet::to_powerbase(&frame);
            assert_eq!(packet.0[..], hex(&format!("{head}{tail}")), "{frame}");
            assert_eq!(packet.decode_host(), Some(frame));
        }
        let shutdown = hex("f0 55 00 00 00 00 04 12 00 00 00 00 00 00 00 00 00 a4");
        assert_eq!(Packet::to_powerbase(&SHUTDOWN).0[..], shutdown);
    }

    #[test]
    fn rmp_packets_of_recorded_power_base_are_read() {
        for (text, expected) in [
            (
                "f0 55 aa 00 80 68 00 00 00 bf 8f ff ff 8f 09 ff ff 3f",
                "displacement left -16497 right -28919 counts",
            ),
            (
                "f0 55 aa 00 80 88 00 00 00 49 c2 00 00 09 9d 00 01 53",
                "displacement forward 18882 yaw 67997 counts",
            ),
            (
                "f0 55 aa 00 80 28 00 00 00 00 07 00 02 00 02 00 08 54",
                "pitch 0.9 roll 0.3 deg",
            ),
            (
                "f0 55 aa 00 80 48 00 00 00 00 00 00 00 ff e0 02 12 52",
                "speed left 0 right 0 counts, yaw rate -4.1 deg/s, 5.30 s",
            ),
            (
                "f0 55 aa 00 80 c8 00 00 00 00 01 00 00 01 8d 01 30 06",
                "tractor, battery 76.00 V",
            ),
            (
                "f0 55 aa 00 80 08 00 00 00 07 f0 05 04 0d 35 04 23 1d",
                "build 2032 counter 1059",
            ),
            (
                "f0 55 aa 00 d0 08 00 00 00 00 05 00 80 00 00 3e 57 1c",
                "control unit tractor, motors enabled",
            ),
            (
                "f0 55 aa 00 d1 08 00 00 00 00 00 00 00 01 8a 00 00 aa",
                "user interface",
            ),
        ] {
            let bytes = hex(text);
            let packet = Packet(bytes.clone().try_into().unwrap());
            let (channel, frame) = packet.decode().unwrap();
            assert_eq!(channel, Channel::A);
            let message = Message::decode(&frame).unwrap();
            assert_eq!(message.to_string(), expected);
            assert_eq!(message.frame(), frame);
            assert_eq!(Packet::from_powerbase(channel, &frame).0[..], bytes);
        }
    }

    #[test]
    fn rmp_packet_stream_resynchronizes() {
        let frame = command(7, 8, Config::None);
        let whole = Packet::from_powerbase(Channel::B, &frame).0;
        let mut stream = whole[5..].to_vec();
        stream.extend([0xF0, 0xF0, 0x55, 0x01]);
        stream.extend(whole);
        let mut damaged = whole;
        damaged[10] ^= 4;
        stream.extend(damaged);
        stream.extend(&whole[..11]);
        stream.extend(whole);
        stream.extend(whole);
        let mut reader = PacketReader::default();
        let found: Vec<_> = stream
            .iter()
            .filter_map(|byte| reader.push(*byte))
            .collect();
        let found = found.iter().filter_map(Packet::decode).count();
        assert!(found >= 2, "{found} found");
        assert!(reader.skipped() > 0 && reader.wrong() > 0);
    }

    proptest! {
        #[test]
        fn rmp_any_stream_second_packet_is_found(
            noise in prop::collection::vec(any::<u8>(), 0..200),
            slots: [u8; 8],
        ) {
            let frame = Frame::full(standard(0x402), slots);
            let packet = Packet::from_powerbase(Channel::A, &frame);
            let mut reader = PacketReader::default();
            let stream = noise.into_iter().chain(packet.0).chain(packet.0).chain(packet.0);
            let found: Vec<_> = stream.filter_map(|byte| reader.push(byte)).collect();
            prop_assert!(found.contains(&packet));
        }

        #[test]
        fn rmp_every_message_survives_usb(id in 0u16..0x800, slots: [u8; 8]) {
            let frame = Frame::full(standard(id), slots);
            if let Some(message) = Message::decode(&frame)
                && !matches!(message, Message::Command(_))
            {
                prop_assert_eq!(message.frame(), frame);
                prop_assert!(!message.to_string().contains('\n'));
            }
        }
    }
}
