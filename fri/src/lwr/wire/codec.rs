//! Checked little-endian cursor over a datagram of fixed layout. It knows no message.

use crate::error::{DecodeError, EncodeError};

/// Reads fields from the front of a received datagram.
#[derive(Debug)]
pub(super) struct Reader<'a> {
    rest: &'a [u8],
    expected: usize,
    actual: usize,
}

impl<'a> Reader<'a> {
    /// A reader for a datagram whose layout is exactly `expected` bytes long.
    pub(super) fn new(bytes: &'a [u8], expected: usize) -> Result<Self, DecodeError> {
        let actual = bytes.len();
        if actual != expected {
            return Err(DecodeError::Length { expected, actual });
        }
        Ok(Self {
            rest: bytes,
            expected,
            actual,
        })
    }

    fn chunk<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let too_short = DecodeError::Length {
            expected: self.expected,
            actual: self.actual,
        };
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or(too_short)?;
        self.rest = rest;
        Ok(*head)
    }

    pub(super) fn u16(&mut self) -> Result<u16, DecodeError> {
        self.chunk().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, DecodeError> {
        self.chunk().map(u32::from_le_bytes)
    }

    pub(super) fn f32(&mut self) -> Result<f32, DecodeError> {
        self.chunk().map(f32::from_le_bytes)
    }

    pub(super) fn i32s<const N: usize>(&mut self) -> Result<[i32; N], DecodeError> {
        let mut values = [0; N];
        for value in &mut values {
            *value = i32::from_le_bytes(self.chunk()?);
        }
        Ok(values)
    }

    pub(super) fn f32s<const N: usize>(&mut self) -> Result<[f32; N], DecodeError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f32()?;
        }
        Ok(values)
    }
}

/// Writes fields to the front of a buffer.
#[derive(Debug)]
pub(super) struct Writer<'a> {
    rest: &'a mut [u8],
    needed: usize,
    actual: usize,
}

impl<'a> Writer<'a> {
    /// A writer for a datagram of `needed` bytes; the buffer may be longer.
    pub(super) fn new(buf: &'a mut [u8], needed: usize) -> Result<Self, EncodeError> {
        let actual = buf.len();
        let rest = buf
            .get_mut(..needed)
            .ok_or(EncodeError::Buffer { needed, actual })?;
        Ok(Self {
            rest,
            needed,
            actual,
        })
    }

    fn chunk<const N: usize>(&mut self, bytes: [u8; N]) -> Result<(), EncodeError> {
        let full = EncodeError::Buffer {
            needed: self.needed,
            actual: self.actual,
        };
        let rest = std::mem::take(&mut self.rest);
        let (head, rest) = rest.split_first_chunk_mut::<N>().ok_or(full)?;
        *head = bytes;
        self.rest = rest;
        Ok(())
    }

    pub(super) fn u16(&mut self, value: u16) -> Result<(), EncodeError> {
        self.chunk(value.to_le_bytes())
    }

    pub(super) fn u32(&mut self, value: u32) -> Result<(), EncodeError> {
        self.chunk(value.to_le_bytes())
    }

    pub(super) fn f32(&mut self, value: f32) -> Result<(), EncodeError> {
        self.chunk(value.to_le_bytes())
    }

    pub(super) fn i32s(&mut self, values: &[i32]) -> Result<(), EncodeError> {
        values
            .iter()
            .try_for_each(|value| self.chunk(value.to_le_bytes()))
    }

    pub(super) fn f32s(&mut self, values: &[f32]) -> Result<(), EncodeError> {
        values.iter().try_for_each(|value| self.f32(*value))
    }
}
