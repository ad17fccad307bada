//! What a master sends while it proves its process data: bytes of which no two are equal, and none of which gives power,
//! wherever a drive takes it to lie.
//!
//! Nothing can move by it, for two reasons, each of which suffices:
//!
//! 1. Every byte has bits 1 and 7 low (but for 6060h where the mode itself has them). Whichever byte a drive takes for the
//!    low one of 6040h, it reads *disable voltage* (bit 1 low), and no fault is reset (bit 7 low).
//! 2. The pattern is constant, and a constant word causes at most one transition towards power. From
//!    Switch on disabled, where zeros have brought the drive before, that is *shutdown*, to Ready to switch on, which has no
//!    power: power takes another word after it, and its motor a third. This holds for bits shifted by less than a byte, too.
//!
//! In their proper place the bytes of 6040h are *disable voltage* with halt, and 6060h is the mode that will be wanted.

use super::objects::{Object, Objects, Values};

/// Bits that no byte has: enable voltage, fault reset.
const NEVER: u8 = 0x82;
/// How many bytes have neither of them and are not zero.
const BYTES: usize = 63;

/// Distinct bytes in an order that depends on `seed`, so that what a drive kept of a proof before is seen.
fn shuffled(seed: u32) -> [u8; BYTES] {
    let mut all = [0; BYTES];
    let allowed = (1..=u8::MAX).filter(|byte| byte & NEVER == 0);
    all.iter_mut()
        .zip(allowed)
        .for_each(|(to, byte)| *to = byte);
    let mut state = seed | 1;
    for end in (1..BYTES).rev() {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        all.swap(end, state as usize % (end + 1));
    }
    all
}

/// The pattern for these objects, with the mode that will be wanted in 6060h.
pub(super) fn pattern(carried: Objects, mode: i8, seed: u32) -> Values {
    let mode = mode.cast_unsigned();
    let low = if mode == 0x04 { 0x08 } else { 0x04 };
    let high = if mode == 0x01 { 0x05 } else { 0x01 };
    let taken = [low, high, mode];
    let mut bytes = shuffled(seed)
        .into_iter()
        .filter(|byte| !taken.contains(byte));
    let mut values = Values::default();
    for object in Object::all().filter(|object| object.is_sent() && carried.contains(*object)) {
        let raw = match object {
            Object::CONTROL => u32::from(u16::from_le_bytes([low, high])),
            Object::MODE => mode.into(),
            _ => {
                let mut raw = [0; 4];
                raw.iter_mut()
                    .take(object.bytes())
                    .for_each(|byte| *byte = bytes.next().unwrap_or(0));
                u32::from_le_bytes(raw)
            }
        };
        values.set(object, raw);
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ControlWord, State, Trigger, transition};

    fn all_sent() -> Objects {
        let mut all = Objects::default();
        Object::all().for_each(|object| all.insert(object));
        all
    }

    /// The bytes that go out, object by object.
    fn bytes(values: &Values) -> Vec<u8> {
        let sent = Object::all().filter(|object| object.is_sent());
        sent.flat_map(|object| values.get(object).to_le_bytes()[..object.bytes()].to_vec())
            .collect()
    }

    const MODES: [i8; 9] = [1, 2, 3, 4, 6, 7, 8, 9, 10];

    #[test]
    fn pattern_bytes_are_distinct_and_not_zero() {
        for seed in 0..100 {
            for mode in MODES {
                let mut bytes = bytes(&pattern(all_sent(), mode, seed));
                let count = bytes.len();
                bytes.sort_unstable();
                bytes.dedup();
                assert_eq!((bytes.len(), bytes[0] > 0), (count, true), "{seed} {mode}");
            }
        }
    }

    #[test]
    fn pattern_bytes_never_enable_voltage_nor_reset_a_fault() {
        for seed in 0..100 {
            let bytes = bytes(&pattern(all_sent(), 8, seed));
            assert!(bytes.iter().all(|byte| byte & NEVER == 0), "{bytes:02X?}");
        }
    }

    /// Whatever 16 neighbouring bits are taken for 6040h, for as long as one likes.
    #[test]
    fn pattern_at_any_bit_never_gives_power() {
        for (seed, mode) in (0..10).flat_map(|seed| MODES.map(|mode| (seed, mode))) {
            let bytes = bytes(&pattern(all_sent(), mode, seed));
            let bit = |at: usize| u16::from(bytes[at / 8 % bytes.len()] >> (at % 8) & 1);
            for first in 0..8 * bytes.len() {
                let raw = (0..16).fold(0, |word, n| word | bit(first + n) << n);
                let word = ControlWord::new(raw);
                for from in [State::SwitchOnDisabled, State::Fault] {
                    let (mut state, mut previous) = (from, ControlWord::DISABLE_VOLTAGE);
                    for _ in 0..4 {
                        let command = word.command(previous).map(Trigger::Command);
                        let arrow = command.and_then(|trigger| transition(state, trigger));
                        state = arrow.map_or(state, |arrow| arrow.to);
                        previous = word;
                    }
                    let powered = matches!(state, State::SwitchedOn | State::OperationEnabled);
                    assert!(!powered, "{word} from {from}, seed {seed}, mode {mode}");
                }
            }
        }
    }
}
