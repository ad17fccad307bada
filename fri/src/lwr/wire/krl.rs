//! User variables exchanged by KRL program and PC. Handshakes interpret them, this module does not.

use super::codec::{Reader, Writer};
use crate::error::{DecodeError, EncodeError};

/// User data: `$FRI_TO_*` in a measurement, `$FRI_FRM_*` in a command.
///
/// | offset | type | field | KRL |
/// |--:|---|---|---|
/// | 0 | f32\[16\] | realData | `$FRI_…_REA[1..16]` |
/// | 64 | i32\[16\] | intData | `$FRI_…_INT[1..16]` |
/// | 128 | u16 | boolData | `$FRI_…_BOOL[1..16]`, bit i is index i + 1 |
/// | 130 | u16 | fill | 0; ignored when received |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Krl {
    /// Real numbers, no unit; element i is KRL index i + 1.
    pub real: [f32; 16],
    /// Integers; element i is KRL index i + 1.
    pub int: [i32; 16],
    /// Booleans, one per bit; bit i is KRL index i + 1.
    pub bools: u16,
}

impl Krl {
    /// The boolean at `index` 0..=15 (KRL index minus one); `false` beyond.
    pub fn bool(&self, index: u32) -> bool {
        1u16.checked_shl(index)
            .is_some_and(|bit| self.bools & bit != 0)
    }

    /// Sets the boolean at `index` 0..=15 (KRL index minus one); no effect beyond.
    pub fn set_bool(&mut self, index: u32, value: bool) {
        let bit = 1u16.checked_shl(index).unwrap_or(0);
        self.bools = if value {
            self.bools | bit
        } else {
            self.bools & !bit
        };
    }

    pub(super) fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let krl = Self {
            real: from.f32s()?,
            int: from.i32s()?,
            bools: from.u16()?,
        };
        from.u16()?;
        Ok(krl)
    }

    pub(super) fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        to.f32s(&self.real)?;
        to.i32s(&self.int)?;
        to.u16(self.bools)?;
        to.u16(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn krl_bool_is_one_bit() {
        let mut krl = Krl::default();
        krl.set_bool(15, true);
        krl.set_bool(0, true);
        krl.set_bool(16, true);
        assert_eq!(krl.bools, 0x8001);
        krl.set_bool(0, false);
        assert!(krl.bool(15) && !krl.bool(0) && !krl.bool(16));
    }
}
