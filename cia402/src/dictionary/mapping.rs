//! Which entries a PDO carries, bit by bit (CiA 301, 1600h and 1A00h; ETG.1000.6 alike). The transmission of PDOs is
//! not handled here.

use super::{AbortCode, Address, DataType, Dictionary, PdoUse};

/// Maximum number of entries of one PDO.
pub const MAPPED_MAX: usize = 64;

/// One mapped entry, as sub-indices of 1600h and 1A00h hold it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mapped {
    /// The mapped entry. Index 0 is a gap; 1h to 1Fh are gaps named by a data type (CiA 301 dummy mapping).
    pub address: Address,
    /// Number of mapped bits.
    pub bits: u8,
}

impl Mapped {
    /// From the number in a mapping object.
    pub const fn from_raw(raw: u32) -> Self {
        let [bits, sub, low, high] = raw.to_le_bytes();
        Self {
            address: Address::new(u16::from_le_bytes([low, high]), sub),
            bits,
        }
    }

    /// The number in a mapping object.
    pub const fn raw(self) -> u32 {
        let [low, high] = self.address.index.to_le_bytes();
        u32::from_le_bytes([self.bits, self.address.sub, low, high])
    }

    /// Whether it is a gap.
    pub const fn is_gap(self) -> bool {
        self.address.index < 0x20
    }
}

/// A mapped entry and the offset of its value.
#[derive(Clone, Copy, Debug, Default)]
struct Item {
    mapped: Mapped,
    offset: usize,
}

/// The entries of one PDO, found in a dictionary and checked.
#[derive(Clone, Debug)]
pub struct Mapping {
    items: [Item; MAPPED_MAX],
    count: usize,
    bits: usize,
}

impl Default for Mapping {
    fn default() -> Self {
        Self {
            items: [Item::default(); MAPPED_MAX],
            count: 0,
            bits: 0,
        }
    }
}

impl Mapping {
    /// Finds the entries of a PDO that carries at most `bits_max` bits and is received by the
    /// device, or else transmitted.
    ///
    /// # Errors
    /// If an entry does not exist or is not mappable, a length does not match, or there are too many bits or entries.
    pub fn new(
        dictionary: &Dictionary,
        entries: &[Mapped],
        received: bool,
        bits_max: usize,
    ) -> Result<Self, AbortCode> {
        let mut mapping = Self::default();
        for mapped in entries {
            mapping.push(dictionary, *mapped, received)?;
            if mapping.bits > bits_max {
                return Err(AbortCode::PdoTooLong);
            }
        }
        Ok(mapping)
    }

    fn push(
        &mut self,
        dictionary: &Dictionary,
        mapped: Mapped,
        received: bool,
    ) -> Result<(), AbortCode> {
        let item = self
            .items
            .get_mut(self.count)
            .ok_or(AbortCode::PdoTooLong)?;
        item.mapped = mapped;
        if mapped.is_gap() {
            let named = DataType::from_raw(mapped.address.index).bits();
            let other = mapped.address.index != 0 && named != Some(mapped.bits.into());
            // A gap named by a type makes no sense in a transmitted PDO; EtherCAT uses index 0 for gaps.
            if other || (mapped.address.index != 0 && !received) {
                return Err(AbortCode::NotMappable);
            }
        } else {
            item.offset = Self::find(dictionary, mapped, received)?;
        }
        self.count += 1;
        self.bits += usize::from(mapped.bits);
        Ok(())
    }

    fn find(dictionary: &Dictionary, mapped: Mapped, received: bool) -> Result<usize, AbortCode> {
        let (entry, slot) = dictionary.find(mapped.address)?;
        let allowed = match entry.pdo {
            PdoUse::Both => true,
            PdoUse::Receive => received,
            PdoUse::Transmit => !received,
            PdoUse::None => false,
        };
        let slot = dictionary.slots[slot];
        let bits = usize::from(mapped.bits);
        // A BOOLEAN may take a whole byte; strings take their capacity.
        let fits = entry.data_type.bits() == Some(bits) || bits == 8 * slot.capacity;
        if allowed && fits && bits > 0 {
            Ok(slot.offset)
        } else {
            Err(AbortCode::NotMappable)
        }
    }

    /// Length of the PDO, bits.
    pub const fn bits(&self) -> usize {
        self.bits
    }

    /// Length of the PDO, bytes.
    pub const fn len(&self) -> usize {
        self.bits.div_ceil(8)
    }

    /// Whether the PDO is empty.
    pub const fn is_empty(&self) -> bool {
        self.bits == 0
    }

    /// The mapped entries.
    pub fn entries(&self) -> impl Iterator<Item = Mapped> + '_ {
        self.items[..self.count].iter().map(|item| item.mapped)
    }

    /// Writes the values of the dictionary that the mapping was made for into a PDO, gaps as zero; excess bytes are
    /// dropped.
    pub fn pack(&self, dictionary: &Dictionary, pdo: &mut [u8]) {
        let mut at = 0;
        for item in &self.items[..self.count] {
            let bits = usize::from(item.mapped.bits);
            if item.mapped.is_gap() {
                (at..at + bits).for_each(|to| set_bit(pdo, to, false));
            } else {
                copy_bits(&dictionary.values, 8 * item.offset, pdo, at, bits);
            }
            at += bits;
        }
    }

    /// Copies the values of a received PDO into the dictionary that the mapping was made for. Limits are not checked:
    /// the device decides how to handle a value beyond them.
    pub fn unpack(&self, dictionary: &mut Dictionary, pdo: &[u8]) {
        let mut at = 0;
        for item in &self.items[..self.count] {
            let bits = usize::from(item.mapped.bits);
            if !item.mapped.is_gap() {
                copy_bits(pdo, at, &mut dictionary.values, 8 * item.offset, bits);
            }
            at += bits;
        }
    }
}

fn set_bit(bytes: &mut [u8], at: usize, value: bool) {
    if let Some(byte) = bytes.get_mut(at / 8) {
        *byte = *byte & !(1 << (at % 8)) | u8::from(value) << (at % 8);
    }
}

/// Copies bits, the lowest of a byte first; bits beyond either end are dropped.
fn copy_bits(from: &[u8], from_bit: usize, to: &mut [u8], to_bit: usize, bits: usize) {
    if [from_bit, to_bit, bits]
        .iter()
        .all(|at| at.is_multiple_of(8))
    {
        let bytes = from.get(from_bit / 8..).unwrap_or_default().iter();
        let value = to.get_mut(to_bit / 8..).unwrap_or_default();
        for (to, from) in value.iter_mut().zip(bytes.take(bits / 8)) {
            *to = *from;
        }
        return;
    }
    for bit in 0..bits {
        if let Some(byte) = from.get((from_bit + bit) / 8) {
            set_bit(to, to_bit + bit, byte >> ((from_bit + bit) % 8) & 1 == 1);
        }
    }
}
