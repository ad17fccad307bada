//! Lists and names of bounded length in place of the schema's repeated fields and strings. They do not allocate.

use crate::error::DecodeError;
use std::fmt;
use std::ops::Deref;

/// Up to `N` values, stored in place.
#[derive(Clone, Copy)]
pub struct List<T, const N: usize> {
    items: [T; N],
    len: usize,
}

impl<T: Copy + Default, const N: usize> List<T, N> {
    /// An empty list.
    pub fn new() -> Self {
        Self {
            items: [T::default(); N],
            len: 0,
        }
    }

    /// Appends a value; returns it if the list is full.
    pub fn push(&mut self, item: T) -> Result<(), T> {
        let Some(slot) = self.items.get_mut(self.len) else {
            return Err(item);
        };
        *slot = item;
        self.len += 1;
        Ok(())
    }

    /// Removes all values.
    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Mutable iterator over the values.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.items.iter_mut().take(self.len)
    }
}

impl<T: Copy + Default, const N: usize> Default for List<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T, const N: usize> Deref for List<T, N> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        self.items.get(..self.len).unwrap_or_default()
    }
}

impl<T: PartialEq, const N: usize> PartialEq for List<T, N> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T: fmt::Debug, const N: usize> fmt::Debug for List<T, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

/// A name of at most 63 bytes, kept as received; KUKA's are ASCII.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Name {
    bytes: [u8; Self::LEN_MAX],
    len: u8,
}

impl Name {
    /// Longest name, bytes.
    pub const LEN_MAX: usize = 63;

    /// `None` when the name is longer than [`Name::LEN_MAX`] bytes.
    pub fn new(name: &str) -> Option<Self> {
        Self::from_bytes(name.as_bytes())
    }

    fn from_bytes(name: &[u8]) -> Option<Self> {
        let mut bytes = [0; Self::LEN_MAX];
        bytes.get_mut(..name.len())?.copy_from_slice(name);
        let len = u8::try_from(name.len()).ok()?;
        Some(Self { bytes, len })
    }

    pub(super) fn read(name: &[u8], field: &'static str) -> Result<Self, DecodeError> {
        Self::from_bytes(name).ok_or(DecodeError::TooMany {
            field,
            max: Self::LEN_MAX,
        })
    }

    /// The bytes as received.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or_default()
    }

    /// Whether it is `name`.
    pub fn is(&self, name: &str) -> bool {
        self.as_bytes() == name.as_bytes()
    }
}

impl Default for Name {
    fn default() -> Self {
        Self {
            bytes: [0; Self::LEN_MAX],
            len: 0,
        }
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_bytes().escape_ascii().fmt(f)
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{self}\"")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn list_full_returns_value() {
        let mut list = List::<u8, 2>::new();
        assert_eq!(
            (list.push(1), list.push(2), list.push(3)),
            (Ok(()), Ok(()), Err(3))
        );
        assert_eq!(*list, [1, 2]);
        list.clear();
        assert!(list.is_empty());
    }

    #[test]
    fn name_is_limited_to_63_bytes() {
        assert!(Name::new(&"x".repeat(63)).is_some());
        assert!(Name::new(&"x".repeat(64)).is_none());
        assert_eq!(
            Name::from_bytes(b"a\n\xff").unwrap().to_string(),
            "a\\n\\xff"
        );
    }
}
