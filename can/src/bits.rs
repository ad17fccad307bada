//! Number of bits that a frame occupies on the wire, including its stuff bits and the intermission (ISO 11898-1:2015,
//! clause 10). Error frames and retransmissions are not included.

use std::time::Duration;

use crate::{AnyFrame, FdFrame, Frame, Id};

/// Bit rates of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rates {
    /// Nominal bit rate in bit/s, not 0.
    pub nominal: u32,
    /// Data bit rate of CAN FD frames with bit rate switch, in bit/s, not 0.
    pub data: u32,
}

impl Rates {
    /// Rates of a bus without CAN FD.
    pub const fn classic(bitrate: u32) -> Self {
        Self {
            nominal: bitrate,
            data: bitrate,
        }
    }
}

/// Bits of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bits {
    /// At the nominal bit rate.
    pub nominal: u32,
    /// At the data bit rate; 0 without bit rate switch.
    pub data: u32,
}

impl Bits {
    /// Bits of the frame on the wire. An error frame is a report of the kernel and counts 0 bits.
    pub fn of(frame: &AnyFrame) -> Self {
        match frame {
            AnyFrame::Classic(frame) => Self {
                nominal: classic(frame),
                data: 0,
            },
            AnyFrame::Fd(frame) => fd(frame),
            AnyFrame::Error(_) => Self::default(),
        }
    }

    /// Transmission time of these bits. A bit rate of 0 counts as 1 bit/s.
    pub fn time(self, rates: Rates) -> Duration {
        let part = |bits: u32, rate: u32| {
            Duration::from_nanos(u64::from(bits) * 1_000_000_000 / u64::from(rate.max(1)))
        };
        part(self.nominal, rates.nominal) + part(self.data, rates.data)
    }
}

/// Minimum and maximum bits of a classic frame of this kind and length, over all contents.
pub fn bounds(frame: &Frame) -> (u32, u32) {
    let stuffable = header(frame.id()) + data_bits(frame.data()) + CRC_LEN;
    let least = stuffable + TAIL;
    (least, least + (stuffable - 1) / 4)
}

/// Start, identifier and control field.
const fn header(id: Id) -> u32 {
    if id.is_extended() { 39 } else { 19 }
}

const CRC_LEN: u32 = 15;

/// CRC delimiter, acknowledge slot and its delimiter, end of frame (7), intermission (3).
const TAIL: u32 = 13;

fn data_bits(data: &[u8]) -> u32 {
    u32::try_from(data.len()).unwrap_or(u32::MAX / 8) * 8
}

/// Counts bits as they go onto the wire.
#[derive(Clone, Copy, Debug, Default)]
struct Wire {
    bits: u32,
    /// The last bit, and how often it was sent in a row.
    last: bool,
    run: u32,
    crc: u16,
}

impl Wire {
    /// Sends one bit, preceded by a stuff bit after five equal bits.
    fn bit(&mut self, bit: bool) {
        self.stuff();
        self.run = if self.run > 0 && bit == self.last {
            self.run + 1
        } else {
            1
        };
        self.last = bit;
        self.bits += 1;
        self.crc = crc15(self.crc, bit);
    }

    fn stuff(&mut self) {
        if self.run == 5 {
            self.bits += 1;
            self.last = !self.last;
            self.run = 1;
        }
    }

    /// Sends the lowest `len` bits, most significant bit first.
    fn field(&mut self, value: u32, len: u32) {
        for n in (0..len).rev() {
            self.bit(value >> n & 1 != 0);
        }
    }

    /// Start of frame and identifier, up to the RTR and IDE bits.
    fn arbitration(&mut self, id: Id, remote: bool) {
        let remote = u32::from(remote);
        self.field(0, 1);
        if id.is_extended() {
            self.field(id.raw() >> 18, 11);
            self.field(0b11, 2);
            self.field(id.raw(), 18);
            self.field(remote, 1);
        } else {
            self.field(id.raw(), 11);
            self.field(remote << 1, 2);
        }
    }

    fn data(&mut self, data: &[u8]) {
        for byte in data {
            self.field(u32::from(*byte), 8);
        }
    }
}

/// One step of CRC-15/CAN.
fn crc15(crc: u16, bit: bool) -> u16 {
    let carry = (crc >> 14 & 1 != 0) != bit;
    let shifted = crc << 1 & 0x7FFF;
    if carry { shifted ^ 0x4599 } else { shifted }
}

fn classic(frame: &Frame) -> u32 {
    let mut wire = Wire::default();
    wire.arbitration(frame.id(), frame.is_remote());
    let reserved = if frame.id().is_extended() { 2 } else { 1 };
    wire.field(0, reserved);
    let code = frame.raw_dlc().unwrap_or_else(|| frame.dlc());
    wire.field(u32::from(code), 4);
    wire.data(frame.data());
    let crc = u32::from(wire.crc);
    wire.field(crc, CRC_LEN);
    wire.stuff();
    wire.bits + TAIL
}

fn fd(frame: &FdFrame) -> Bits {
    let data = frame.data();
    let mut wire = Wire::default();
    wire.arbitration(frame.id(), false);
    // FDF is recessive, the reserved bit after it dominant.
    wire.field(0b10, 2);
    wire.field(u32::from(frame.bit_rate_switch), 1);
    let nominal = wire.bits;
    wire.field(u32::from(frame.sender_is_passive), 1);
    let code = (0..16).find(|code| FdFrame::len_of_code(*code) == Some(data.len()));
    wire.field(u32::from(code.unwrap_or(0)), 4);
    wire.data(data);
    // Count of stuff bits, checksum of 17 or 21 bits, with a fixed stuff bit before each four of them,
    // and the delimiter.
    let checksum = if data.len() <= 16 { 27 } else { 32 };
    let fast = wire.bits - nominal + checksum + 1;
    if frame.bit_rate_switch {
        Bits {
            nominal: nominal + TAIL - 1,
            data: fast,
        }
    } else {
        Bits {
            nominal: nominal + fast + TAIL - 1,
            data: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn crc15_matches_catalogue_check_value() {
        let mut crc = 0;
        for byte in b"123456789" {
            for n in (0..8).rev() {
                crc = crc15(crc, byte >> n & 1 != 0);
            }
        }
        assert_eq!(crc, 0x059E);
    }

    #[test]
    fn frame_of_eight_bytes_has_111_to_135_bits() {
        let frame = Frame::new(Id::standard(0x181).unwrap(), &[0; 8]).unwrap();
        assert_eq!(bounds(&frame), (111, 135));
        let long = Frame::new(Id::extended(0x181).unwrap(), &[0; 8]).unwrap();
        assert_eq!(bounds(&long), (131, 160));
        let none = Frame::empty(Id::standard(0x80).unwrap());
        assert_eq!(bounds(&none), (47, 55));
        let remote = Frame::remote(Id::standard(0x705).unwrap(), 8).unwrap();
        assert_eq!(bounds(&remote).0, 47, "a remote frame carries nothing");
    }

    #[test]
    fn bus_1_mbit_per_s_carries_about_8000_frames() {
        let data = [0x37, 0x06, 0x10, 0x27, 0xE8, 0x03, 0x55, 0x01];
        let frame = AnyFrame::from(Frame::new(Id::standard(0x181).unwrap(), &data).unwrap());
        let time = Bits::of(&frame).time(Rates::classic(1_000_000));
        assert!((111..=135).contains(&time.as_micros()), "{time:?}");
    }

    #[test]
    fn fd_frame_data_use_data_bit_rate() {
        let id = Id::standard(0x181).unwrap();
        let frame = FdFrame::new(id, &[0x55; 64]).unwrap();
        let slow = Bits::of(&frame.into());
        let fast = Bits::of(&frame.with_flags(1).into());
        assert_eq!(slow.data, 0);
        // ESI, length code, data, count of stuff bits and checksum, delimiter; these data need no stuff bits.
        assert_eq!(fast.data, 1 + 4 + 512 + 32 + 1);
        let rates = Rates {
            nominal: 500_000,
            data: 2_000_000,
        };
        assert!(fast.time(rates) * 3 < slow.time(rates));
        let short = Bits::of(&FdFrame::new(id, &[0x55; 8]).unwrap().into());
        assert!(slow.nominal > short.nominal);
    }

    /// A second implementation: all bits as text first, then the stuff bits.
    fn by_text(frame: &Frame) -> usize {
        let id = frame.id();
        let remote = u8::from(frame.is_remote());
        let mut text = if id.is_extended() {
            let (base, rest) = (id.raw() >> 18, id.raw() & 0x3_FFFF);
            format!("0{base:011b}11{rest:018b}{remote}00")
        } else {
            format!("0{:011b}{remote}00", id.raw())
        };
        text += &format!("{:04b}", frame.dlc());
        for byte in frame.data() {
            text += &format!("{byte:08b}");
        }
        let crc = text.chars().fold(0, |crc, c| crc15(crc, c == '1'));
        text += &format!("{crc:015b}");
        let mut sent = String::new();
        for c in text.chars() {
            sent.push(c);
            for (five, stuffed) in [("00000", '1'), ("11111", '0')] {
                if sent.ends_with(five) {
                    sent.push(stuffed);
                }
            }
        }
        sent.len() + 13
    }

    proptest! {
        #[test]
        fn bit_stuffing_matches_reference_within_bounds(
            raw in any::<u32>(), extended in any::<bool>(), remote in any::<bool>(),
            data in prop::collection::vec(prop_oneof![Just(0), Just(0xFF), any::<u8>()], 0..=8),
        ) {
            let id = if extended { Id::extended(raw & 0x1FFF_FFFF) } else {
                Id::standard((raw & 0x7FF).try_into().unwrap())
            }.unwrap();
            let frame = if remote { Frame::remote(id, data.len()) } else { Frame::new(id, &data) }.unwrap();
            let bits = Bits::of(&frame.into()).nominal;
            let (least, most) = bounds(&frame);
            prop_assert!((least..=most).contains(&bits), "{least} {bits} {most}");
            prop_assert_eq!(usize::try_from(bits).unwrap(), by_text(&frame));
        }
    }
}
