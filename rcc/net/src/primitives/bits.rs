//! Numbers as bits of fieldbus words. Bit 0 of an array is the least significant one. Signed binary
//! numbers are two's complement; signed BCD numbers have the sign in their last bit.

use crate::definition::{Build, Definition, Primitive, port};
use crate::fault::{Fault, FaultKind};
use crate::plan::Cycle;
use crate::slots::{ArrayIn, ArrayOut, In, Out};

/// The encoding of a number.
#[derive(Clone, Copy, Debug)]
enum Code {
    Binary,
    Bcd,
}

#[derive(Clone, Copy, Debug)]
struct Format {
    code: Code,
    /// Number of bits, sign included; 1 to 64.
    bits: u32,
    signed: bool,
}

/// The lowest `bits` bits.
const fn mask(bits: u32) -> u64 {
    if bits >= 64 {
        u64::MAX
    } else {
        (1 << bits) - 1
    }
}

fn to_digits(mut number: u32) -> u64 {
    let mut digits = 0;
    let mut shift = 0;
    while number > 0 {
        digits |= u64::from(number % 10) << shift;
        number /= 10;
        shift += 4;
    }
    digits
}

fn from_digits(digits: u64) -> Option<i64> {
    (0..16).rev().try_fold(0_i64, |number, digit| {
        let digit = i64::try_from((digits >> (4 * digit)) & 0xf).ok()?;
        (digit <= 9).then_some(())?;
        number.checked_mul(10)?.checked_add(digit)
    })
}

impl Format {
    /// Number of bits of the magnitude.
    const fn amount_bits(self) -> u32 {
        self.bits - if self.signed { 1 } else { 0 }
    }

    /// The word of a number, and whether it overflowed and lost its upper bits.
    fn encode(self, value: i32) -> (u64, bool) {
        let below_zero = value < 0;
        match self.code {
            Code::Binary => {
                let wide = i64::from(value).cast_unsigned();
                // If the number fits, the bits above the magnitude are the repeated sign.
                let above = wide & !mask(self.amount_bits());
                let sign = if below_zero {
                    !mask(self.amount_bits())
                } else {
                    0
                };
                let fits = above == sign && (self.signed || !below_zero);
                (wide & mask(self.bits), !fits)
            }
            Code::Bcd => {
                let digits = to_digits(value.unsigned_abs());
                let amount = digits & mask(self.amount_bits());
                let fits = amount == digits && (self.signed || !below_zero);
                let sign = u64::from(self.signed && below_zero) << (self.bits - 1);
                (amount | sign, !fits)
            }
        }
    }

    /// The number in a word; `None` if it has an invalid decimal digit or exceeds 32 bits.
    fn decode(self, word: u64) -> Option<i32> {
        let amount = word & mask(self.amount_bits());
        let below_zero = self.signed && word >> (self.bits - 1) & 1 == 1;
        let number = match self.code {
            Code::Binary => {
                let sign = if below_zero {
                    !mask(self.amount_bits())
                } else {
                    0
                };
                let number = (amount | sign).cast_signed();
                // Without a sign, the 64th bit is part of the magnitude.
                ((number < 0) == below_zero).then_some(number)?
            }
            Code::Bcd => {
                let number = from_digits(amount)?;
                if below_zero { -number } else { number }
            }
        };
        i32::try_from(number).ok()
    }
}

struct Encode {
    value: In<i32>,
    array: ArrayOut<bool>,
    overflow: Out<bool>,
    format: Format,
}

impl Primitive for Encode {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let coded = self.value.get(cycle).map(|value| self.format.encode(value));
        self.overflow
            .set(cycle, coded.map(|(_, overflow)| overflow));
        match coded {
            Some((word, _)) => {
                let bits = (0..self.format.bits).map(|bit| word >> bit & 1 == 1);
                self.array.set(cycle, bits);
            }
            None => self.array.set_null(cycle),
        }
    }
}

struct Decode {
    array: ArrayIn<bool>,
    value: Out<i32>,
    format: Format,
}

impl Primitive for Decode {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let word = self.array.get(cycle).map(|array| {
            let bits = array.iter().zip(0..self.format.bits);
            bits.fold(0, |word, (bit, i)| word | u64::from(bit.get()) << i)
        });
        let value = word.and_then(|word| self.format.decode(word));
        self.value.set(cycle, value);
    }
}

fn format(b: &Build<'_, '_>, code: Code) -> Result<Format, Fault> {
    let bits = b.number("amountBits", 1..=64)?;
    Ok(Format {
        code,
        bits: u32::try_from(bits).unwrap_or(64),
        signed: b.value("signBit")?,
    })
}

const SIGN: &str = "whether the number is signed";

fn encoder(name: &str, doc: &'static str, code: Code, sign: &'static str) -> Definition {
    let build = move |b: &mut Build<'_, '_>| -> Result<Encode, Fault> {
        let format = format(b, code)?;
        Ok(Encode {
            value: b.input("inValue")?,
            array: b.array_output("outArray", format.bits as usize)?,
            overflow: b.output("overflowBit"),
            format,
        })
    };
    Definition::new(name, doc, build)
        .active()
        .input::<i32>(port("inValue", "the number").required())
        .parameter::<i32>("amountBits", "32", "number of bits, sign included, 1 to 64")
        .parameter::<bool>("signBit", sign, SIGN)
        .array_output::<bool>("outArray", "the bits, least significant first")
        .output::<bool>("overflowBit", "whether the number has more than these bits")
}

fn decoder(name: &str, doc: &'static str, code: Code, sign: &'static str) -> Definition {
    let build = move |b: &mut Build<'_, '_>| -> Result<Decode, Fault> {
        let format = format(b, code)?;
        let array = b.array_input("inArray")?;
        if array.len() < format.bits as usize {
            let (bits, len) = (format.bits, array.len());
            let message = format!("amountBits is {bits}, but the array has only {len} elements");
            return Err(b.fault(FaultKind::ArraySize(message)));
        }
        Ok(Decode {
            array,
            value: b.output("outValue"),
            format,
        })
    };
    Definition::new(name, doc, build)
        .active()
        .array_input::<bool>(port("inArray", "the bits, least significant first").required())
        .parameter::<i32>("amountBits", "32", "number of bits, sign included, 1 to 64")
        .parameter::<bool>("signBit", sign, SIGN)
        .output::<i32>("outValue", "the number")
}

pub(super) fn table() -> Vec<Definition> {
    vec![
        encoder(
            "Core::DecToBin",
            "A number as binary number; with sign as two's complement.",
            Code::Binary,
            "false",
        ),
        encoder(
            "Core::DecToBCD",
            "A number as binary coded decimal, four bits a digit; the sign is the last bit.",
            Code::Bcd,
            "true",
        ),
        decoder(
            "Core::BinToDec",
            "The number of binary bits; null if beyond 32 bits.",
            Code::Binary,
            "false",
        ),
        decoder(
            "Core::BCDToDec",
            "The number of binary coded decimal bits; null if a digit is invalid.",
            Code::Bcd,
            "true",
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn format(code: Code, bits: u32, signed: bool) -> Format {
        Format { code, bits, signed }
    }

    #[test]
    fn words_of_numbers() {
        use Code::{Bcd, Binary};
        for (code, bits, signed, value, expected) in [
            (Binary, 8, false, 200, (200, false)),
            (Binary, 8, false, 256, (0, true)),
            (Binary, 8, false, -1, (0xff, true)),
            (Binary, 8, true, -1, (0xff, false)),
            (Binary, 8, true, -128, (0x80, false)),
            (Binary, 8, true, -129, (0x7f, true)),
            (Binary, 8, true, 127, (0x7f, false)),
            (Binary, 8, true, 128, (0x80, true)),
            (Binary, 64, true, i32::MIN, (0xffff_ffff_8000_0000, false)),
            (Binary, 32, false, i32::MAX, (0x7fff_ffff, false)),
            (Binary, 1, true, -1, (1, false)),
            (Bcd, 16, false, 1234, (0x1234, false)),
            (Bcd, 16, false, 12345, (0x2345, true)),
            (Bcd, 13, true, -999, (0x1999, false)),
            (Bcd, 13, false, -7, (7, true)),
            (Bcd, 41, true, i32::MIN, (0x121_4748_3648, false)),
        ] {
            assert_eq!(
                format(code, bits, signed).encode(value),
                expected,
                "{value} in {bits}"
            );
        }
    }

    #[test]
    fn fitting_numbers_round_trip() {
        for code in [Code::Binary, Code::Bcd] {
            for bits in 1..=64 {
                for signed in [false, true] {
                    let format = format(code, bits, signed);
                    for value in [0, 1, -1, 9, 10, -10, 99, 4711, -4711, i32::MAX, i32::MIN] {
                        let (word, overflow) = format.encode(value);
                        if !overflow {
                            assert_eq!(format.decode(word), Some(value), "{format:?}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn invalid_words_are_rejected() {
        assert_eq!(format(Code::Bcd, 8, false).decode(0x1a), None);
        assert_eq!(format(Code::Bcd, 64, false).decode(u64::MAX), None);
        assert_eq!(format(Code::Bcd, 44, false).decode(0x999_9999_9999), None);
        assert_eq!(format(Code::Binary, 32, false).decode(0xffff_ffff), None);
        assert_eq!(format(Code::Binary, 64, false).decode(u64::MAX), None);
        assert_eq!(format(Code::Binary, 64, true).decode(u64::MAX), Some(-1));
    }
}
