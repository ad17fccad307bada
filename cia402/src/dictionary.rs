//! The object dictionary of CiA 301 (clause 7.4): the objects that a device exposes, by index and sub-index. CANopen
//! and EtherCAT CoE share it; it knows neither bus.
//!
//! It is built once, with all its memory; reading and writing allocate nothing. A read or write from the bus goes
//! through [`Dictionary::upload`] and [`Dictionary::download`], which check access, length and limits and call the
//! owner's [`Hooks`]; the owner itself uses typed [`Key`]s without these checks.

mod abort;
mod address;
mod data_type;
mod mapping;
mod object;
#[cfg(test)]
mod tests;
mod text;

use std::fmt;
use std::marker::PhantomData;
use std::ops::RangeInclusive;

pub use abort::AbortCode;
pub use address::Address;
pub use data_type::{DataType, Number};
pub use mapping::{MAPPED_MAX, Mapped, Mapping};
pub use object::{Access, Entry, Object, ObjectCode, PdoUse};
pub use text::TextError;

/// Maximum length of a value (string or domain), bytes; numbers have at most 8.
pub const VALUE_MAX: usize = 1 << 20;

/// Why a dictionary cannot be built or accessed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DictionaryError {
    /// An object or a sub-index is defined twice.
    #[error("{0} is defined twice; keep one of them")]
    Twice(Address),
    /// A default value does not fit its type or its limits.
    #[error("{address}: the default value is refused ({why})")]
    Default {
        /// The entry.
        address: Address,
        /// The abort code of such a write.
        why: AbortCode,
    },
    /// There is no such entry.
    #[error("there is no {0}")]
    Missing(Address),
    /// The entry has another type than requested.
    #[error("{address} is {actual}, not {wanted}")]
    Type {
        /// The entry.
        address: Address,
        /// Its type.
        actual: DataType,
        /// The requested type.
        wanted: DataType,
    },
}

/// Callbacks of the owner of a dictionary for reads and writes from the bus. `()` accepts everything.
pub trait Hooks {
    /// Before a read: updates the value, or refuses the read.
    ///
    /// # Errors
    /// The abort code is sent to the client.
    fn before_upload(&mut self, _: &mut Dictionary, _: Address) -> Result<(), AbortCode> {
        Ok(())
    }

    /// Before a write that passed the checks of access, length and limits: a final check.
    ///
    /// # Errors
    /// The abort code is sent to the client; nothing is written.
    fn before_download(&mut self, _: &Dictionary, _: Address, _: &[u8]) -> Result<(), AbortCode> {
        Ok(())
    }

    /// After a write: applies it.
    fn after_download(&mut self, _: &mut Dictionary, _: Address) {}
}

impl Hooks for () {}

/// Location of a number in one dictionary: looked up once, then read and written without a search.
pub struct Key<T> {
    offset: usize,
    number: PhantomData<fn() -> T>,
}

impl<T> Clone for Key<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Key<T> {}

impl<T> fmt::Debug for Key<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Key({})", self.offset)
    }
}

/// Storage of a value.
#[derive(Clone, Copy, Debug)]
struct Slot {
    offset: usize,
    /// Present length, bytes; variable for strings and domains.
    len: usize,
    capacity: usize,
}

/// An object dictionary with its values.
#[derive(Clone, Debug, Default)]
pub struct Dictionary {
    /// By ascending index.
    objects: Vec<Object>,
    /// The slot of each entry of each object, in their order.
    slots: Vec<Slot>,
    /// Number of the first slot of each object.
    firsts: Vec<usize>,
    values: Vec<u8>,
}

impl Dictionary {
    /// A dictionary of these objects, in any order, each entry with its default value.
    ///
    /// # Errors
    /// If an object is defined twice, or a default value does not fit.
    pub fn new(mut objects: Vec<Object>) -> Result<Self, DictionaryError> {
        objects.sort_by_key(|object| object.index);
        for pair in objects.windows(2) {
            if pair[0].index == pair[1].index {
                return Err(DictionaryError::Twice(Address::new(pair[1].index, 0)));
            }
        }
        let mut dictionary = Self::default();
        for mut object in objects {
            object.entries.sort_by_key(|(sub, _)| *sub);
            dictionary.firsts.push(dictionary.slots.len());
            for (number, (sub, entry)) in object.entries.iter().enumerate() {
                let address = Address::new(object.index, *sub);
                if number > 0 && object.entries[number - 1].0 == *sub {
                    return Err(DictionaryError::Twice(address));
                }
                let why = |why| DictionaryError::Default { address, why };
                entry.check(&entry.default).map_err(why)?;
                dictionary.slot(entry);
            }
            dictionary.objects.push(object);
        }
        Ok(dictionary)
    }

    fn slot(&mut self, entry: &Entry) {
        let capacity = entry.capacity();
        self.slots.push(Slot {
            offset: self.values.len(),
            len: entry.default.len(),
            capacity,
        });
        self.values.extend_from_slice(&entry.default);
        let rest = capacity - entry.default.len();
        self.values.extend(std::iter::repeat_n(0, rest));
    }

    /// All objects by ascending index.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The object of an index.
    pub fn object(&self, index: u16) -> Option<&Object> {
        let at = self
            .objects
            .binary_search_by_key(&index, |o| o.index)
            .ok()?;
        self.objects.get(at)
    }

    /// The definition of an entry.
    pub fn entry(&self, address: Address) -> Option<&Entry> {
        self.find(address).ok().map(|(entry, _)| entry)
    }

    /// The entry and the number of its slot.
    fn find(&self, address: Address) -> Result<(&Entry, usize), AbortCode> {
        let at = self
            .objects
            .binary_search_by_key(&address.index, |object| object.index)
            .map_err(|_| AbortCode::NoObject)?;
        let entries = &self.objects[at].entries;
        let sub = entries
            .binary_search_by_key(&address.sub, |(sub, _)| *sub)
            .map_err(|_| AbortCode::NoSubIndex)?;
        Ok((&entries[sub].1, self.firsts[at] + sub))
    }

    /// The stored value of an entry, little-endian; nothing is checked.
    pub fn bytes(&self, address: Address) -> Option<&[u8]> {
        let (_, slot) = self.find(address).ok()?;
        let Slot { offset, len, .. } = self.slots[slot];
        self.values.get(offset..offset + len)
    }

    /// Handles a read from the bus.
    ///
    /// # Errors
    /// If there is no such entry, it is not readable, or the hooks refuse.
    pub fn upload<H: Hooks>(
        &mut self,
        address: Address,
        hooks: &mut H,
    ) -> Result<&[u8], AbortCode> {
        let (entry, slot) = self.find(address)?;
        if !entry.access.is_readable() {
            return Err(AbortCode::WriteOnly);
        }
        hooks.before_upload(self, address)?;
        let Slot { offset, len, .. } = self.slots[slot];
        Ok(&self.values[offset..offset + len])
    }

    /// Whether the dictionary allows a write from the bus.
    ///
    /// # Errors
    /// If there is no such entry, it is not writable, or length or value do not fit.
    pub fn check_download(&self, address: Address, data: &[u8]) -> Result<(), AbortCode> {
        let (entry, _) = self.find(address)?;
        if !entry.access.is_writable() {
            return Err(AbortCode::ReadOnly);
        }
        entry.check(data)
    }

    /// Handles a write from the bus.
    ///
    /// # Errors
    /// As [`Self::check_download`], and if the hooks refuse; the value is then unchanged.
    pub fn download<H: Hooks>(
        &mut self,
        address: Address,
        data: &[u8],
        hooks: &mut H,
    ) -> Result<(), AbortCode> {
        self.check_download(address, data)?;
        hooks.before_download(self, address, data)?;
        self.store(address, data)?;
        hooks.after_download(self, address);
        Ok(())
    }

    /// Sets a value on behalf of the owner: checks the length, but neither access nor limits.
    ///
    /// # Errors
    /// If there is no such entry, or the value exceeds its capacity.
    pub fn store(&mut self, address: Address, data: &[u8]) -> Result<(), AbortCode> {
        let (entry, slot) = self.find(address)?;
        entry.check_length(data.len())?;
        let slot = &mut self.slots[slot];
        slot.len = data.len();
        debug_assert!(data.len() <= slot.capacity);
        self.values[slot.offset..slot.offset + data.len()].copy_from_slice(data);
        Ok(())
    }

    /// Sets all values to their defaults, as a reset of the application does.
    pub fn restore_defaults(&mut self) {
        self.restore_defaults_of(0..=u16::MAX);
    }

    /// Sets the values of the objects of these indices to their defaults: a reset of communication
    /// does so for 1000h to 1FFFh.
    pub fn restore_defaults_of(&mut self, indices: RangeInclusive<u16>) {
        let entries = self.objects.iter().flat_map(|object| {
            let within = indices.contains(&object.index);
            object.entries.iter().map(move |(_, entry)| (within, entry))
        });
        for ((within, entry), slot) in entries.zip(&mut self.slots) {
            if !within {
                continue;
            }
            slot.len = entry.default.len();
            let value = &mut self.values[slot.offset..slot.offset + slot.len];
            value.copy_from_slice(&entry.default);
        }
    }

    /// The key of a number.
    pub fn key<T: Number>(&self, address: Address) -> Result<Key<T>, DictionaryError> {
        let found = self.find(address);
        let (entry, slot) = found.map_err(|_| DictionaryError::Missing(address))?;
        if entry.data_type != T::TYPE {
            return Err(DictionaryError::Type {
                address,
                actual: entry.data_type,
                wanted: T::TYPE,
            });
        }
        Ok(Key {
            offset: self.slots[slot].offset,
            number: PhantomData,
        })
    }

    /// The number at a key of this dictionary.
    pub fn get<T: Number>(&self, key: Key<T>) -> T {
        T::from_le(&self.values[key.offset..])
    }

    /// Sets the number at a key of this dictionary; access and limits are not checked.
    pub fn set<T: Number>(&mut self, key: Key<T>, value: T) {
        value.to_le(&mut self.values[key.offset..]);
    }
}
