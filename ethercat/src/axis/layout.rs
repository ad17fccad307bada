//! Locations of the objects of an axis in the process data of its slave, bit by bit. Their meaning is not known here.

use takt_cia402::dictionary::Address;
use takt_cia402::proof::{Object, Objects, Values};

use crate::master::ProcessData;

use super::NotMapped;

/// Location of an object in the process data, bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bits {
    pub(super) first: usize,
    pub(super) count: usize,
}

impl Bits {
    fn find(process: &ProcessData, index: u16, axis: u8, outputs: bool) -> Option<Self> {
        let address = Address::new(index, 0).on_axis(axis)?;
        let location = process.locate(address, outputs)?;
        Some(Self {
            first: location.bit,
            count: usize::from(location.bits).min(32),
        })
    }

    pub(super) fn read(self, bytes: &[u8]) -> u32 {
        let bit = |n: usize| {
            let at = self.first + n;
            let byte = bytes.get(at / 8).copied().unwrap_or(0);
            u32::from(byte >> (at % 8) & 1) << n
        };
        (0..self.count).map(bit).sum()
    }

    pub(super) fn write(self, bytes: &mut [u8], value: u32) {
        for n in 0..self.count {
            let at = self.first + n;
            if let Some(byte) = bytes.get_mut(at / 8) {
                let mask = 1 << (at % 8);
                *byte = if value >> n & 1 == 0 {
                    *byte & !mask
                } else {
                    *byte | mask
                };
            }
        }
    }
}

/// Locations of the objects of an axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    /// By object, in the order of [`Object::all`].
    bits: [Option<Bits>; Object::COUNT],
}

impl Layout {
    pub(super) fn find(process: &ProcessData, axis: u8) -> Result<Self, NotMapped> {
        let mut bits = [None; Object::COUNT];
        for (entry, object) in bits.iter_mut().zip(Object::all()) {
            *entry = Bits::find(process, object.index(), axis, object.is_sent());
        }
        let layout = Self { bits };
        for index in [0x6040, 0x6041, 0x6064] {
            if !layout.has(index) {
                let plain = Address::new(index, 0);
                let address = plain.on_axis(axis).unwrap_or(plain);
                return Err(NotMapped { address });
            }
        }
        Ok(layout)
    }

    /// Whether an object is mapped.
    pub(super) fn has(&self, index: u16) -> bool {
        Object::of(index).is_some_and(|object| self.carried().contains(object))
    }

    /// The objects that are mapped.
    pub(super) fn carried(&self) -> Objects {
        let mut carried = Objects::default();
        for (object, _) in Object::all()
            .zip(&self.bits)
            .filter(|(_, bits)| bits.is_some())
        {
            carried.insert(object);
        }
        carried
    }

    /// The values in the inputs.
    pub(super) fn read(&self, inputs: &[u8]) -> Values {
        let mut values = Values::default();
        for (object, bits) in Object::all().zip(&self.bits) {
            if let Some(bits) = bits.filter(|_| !object.is_sent()) {
                values.set(object, bits.read(inputs));
            }
        }
        values
    }

    pub(super) fn write(&self, outputs: &mut [u8], values: &Values) {
        for (object, bits) in Object::all().zip(&self.bits) {
            if let Some(bits) = bits.filter(|_| object.is_sent()) {
                bits.write(outputs, values.get(object));
            }
        }
    }
}
