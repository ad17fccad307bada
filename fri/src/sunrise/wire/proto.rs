//! The part of protobuf that FRI uses: reads and writes fields, checked and without allocation. It has no groups (wire
//! types 3 and 4), which no FRI schema uses.

use crate::error::{DecodeError, EncodeError};

/// Bytes of the longest varint.
const VARINT_MAX: usize = 10;

/// Content of a field, by its wire type.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Value<'a> {
    /// Wire type 0.
    Varint(u64),
    /// Wire type 1.
    Fixed64([u8; 8]),
    /// Wire type 2: a nested message, a string, or packed numbers.
    Bytes(Reader<'a>),
    /// Wire type 5.
    Fixed32([u8; 4]),
}

/// One field of a message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Field<'a> {
    pub(super) tag: u64,
    pub(super) value: Value<'a>,
    /// Offset of the field in the datagram.
    pub(super) offset: usize,
}

/// Reads fields from the front of a message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reader<'a> {
    rest: &'a [u8],
    /// Offset of `rest` in the datagram.
    offset: usize,
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes,
            offset: 0,
        }
    }

    /// The remaining bytes.
    pub(super) fn bytes(&self) -> &'a [u8] {
        self.rest
    }

    /// The next field; `None` at the end of the message.
    pub(super) fn next(&mut self) -> Result<Option<Field<'a>>, DecodeError> {
        if self.rest.is_empty() {
            return Ok(None);
        }
        let offset = self.offset;
        let key = self.varint()?;
        if key >> 3 == 0 {
            // Field number 0 does not exist; zeros come from padding and damage.
            let wire_type = key & 7;
            return Err(DecodeError::WireType { offset, wire_type });
        }
        let value = match key & 7 {
            0 => Value::Varint(self.varint()?),
            1 => Value::Fixed64(self.chunk()?),
            2 => {
                let len = self.varint()?;
                Value::Bytes(self.split(len)?)
            }
            5 => Value::Fixed32(self.chunk()?),
            wire_type => {
                return Err(DecodeError::WireType { offset, wire_type });
            }
        };
        Ok(Some(Field {
            tag: key >> 3,
            value,
            offset,
        }))
    }

    fn truncated(&self) -> DecodeError {
        DecodeError::Truncated {
            offset: self.offset,
        }
    }

    fn chunk<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let split = self.rest.split_first_chunk::<N>();
        let (head, rest) = split.ok_or_else(|| self.truncated())?;
        self.rest = rest;
        self.offset += N;
        Ok(*head)
    }

    fn split(&mut self, len: u64) -> Result<Self, DecodeError> {
        let len = usize::try_from(len).map_err(|_| self.truncated())?;
        let split = self.rest.split_at_checked(len);
        let (head, rest) = split.ok_or_else(|| self.truncated())?;
        let inner = Self {
            rest: head,
            offset: self.offset,
        };
        self.rest = rest;
        self.offset += len;
        Ok(inner)
    }

    /// Fast path: a double of field 1, if the next field is one. Joint values consist of these.
    pub(super) fn double(&mut self) -> Option<f64> {
        let ([0x09, value @ ..], rest) = self.rest.split_first_chunk::<9>()? else {
            return None;
        };
        let value = f64::from_le_bytes(value.first_chunk().copied()?);
        self.rest = rest;
        self.offset += 9;
        Some(value)
    }

    /// Nearly all varints have one byte.
    #[inline]
    fn varint(&mut self) -> Result<u64, DecodeError> {
        if let [byte @ 0..=0x7f, rest @ ..] = self.rest {
            self.rest = rest;
            self.offset += 1;
            return Ok(u64::from(*byte));
        }
        self.long_varint()
    }

    fn long_varint(&mut self) -> Result<u64, DecodeError> {
        let mut value = 0_u64;
        for (index, byte) in self.rest.iter().take(VARINT_MAX).enumerate() {
            value |= u64::from(byte & 0x7f) << (7 * index);
            if byte & 0x80 == 0 {
                let read = index + 1;
                self.rest = self.rest.get(read..).unwrap_or_default();
                self.offset += read;
                return Ok(value);
            }
        }
        Err(self.truncated())
    }
}

impl<'a> Field<'a> {
    fn wrong(&self, wire_type: u64) -> DecodeError {
        DecodeError::WireType {
            offset: self.offset,
            wire_type,
        }
    }

    fn wire_type(&self) -> u64 {
        match self.value {
            Value::Varint(_) => 0,
            Value::Fixed64(_) => 1,
            Value::Bytes(_) => 2,
            Value::Fixed32(_) => 5,
        }
    }

    pub(super) fn u64(&self) -> Result<u64, DecodeError> {
        match self.value {
            Value::Varint(value) => Ok(value),
            Value::Fixed64(_) | Value::Bytes(_) | Value::Fixed32(_) => {
                Err(self.wrong(self.wire_type()))
            }
        }
    }

    /// A uint32; as in every protobuf decoder, bits above 32 are dropped.
    pub(super) fn u32(&self) -> Result<u32, DecodeError> {
        let [a, b, c, d, ..] = self.u64()?.to_le_bytes();
        Ok(u32::from_le_bytes([a, b, c, d]))
    }

    /// An int32 or an enum, which are sign-extended to 64 bits on the wire.
    pub(super) fn i32(&self) -> Result<i32, DecodeError> {
        self.u32().map(u32::cast_signed)
    }

    pub(super) fn f64(&self) -> Result<f64, DecodeError> {
        match self.value {
            Value::Fixed64(bytes) => Ok(f64::from_le_bytes(bytes)),
            Value::Varint(_) | Value::Bytes(_) | Value::Fixed32(_) => {
                Err(self.wrong(self.wire_type()))
            }
        }
    }

    pub(super) fn message(&self) -> Result<Reader<'a>, DecodeError> {
        match self.value {
            Value::Bytes(inner) => Ok(inner),
            Value::Varint(_) | Value::Fixed64(_) | Value::Fixed32(_) => {
                Err(self.wrong(self.wire_type()))
            }
        }
    }

    /// Passes on the doubles of a repeated field, packed or one field each.
    pub(super) fn f64s(
        &self,
        mut take: impl FnMut(f64) -> Result<(), DecodeError>,
    ) -> Result<(), DecodeError> {
        match self.value {
            Value::Fixed64(bytes) => take(f64::from_le_bytes(bytes)),
            Value::Bytes(mut packed) => {
                while !packed.rest.is_empty() {
                    take(f64::from_le_bytes(packed.chunk()?))?;
                }
                Ok(())
            }
            Value::Varint(_) | Value::Fixed32(_) => Err(self.wrong(self.wire_type())),
        }
    }

    /// Passes on the enum values of a repeated field, packed or one field each.
    pub(super) fn i32s(
        &self,
        mut take: impl FnMut(i32) -> Result<(), DecodeError>,
    ) -> Result<(), DecodeError> {
        match self.value {
            Value::Varint(_) => take(self.i32()?),
            Value::Bytes(mut packed) => {
                while !packed.rest.is_empty() {
                    let value = Value::Varint(packed.varint()?);
                    take(Field { value, ..*self }.i32()?)?;
                }
                Ok(())
            }
            Value::Fixed64(_) | Value::Fixed32(_) => Err(self.wrong(self.wire_type())),
        }
    }
}

/// Writes fields to the front of a buffer.
#[derive(Debug)]
pub(super) struct Writer<'a> {
    buf: &'a mut [u8],
    len: usize,
}

impl<'a> Writer<'a> {
    pub(super) fn new(buf: &'a mut [u8]) -> Self {
        Self { buf, len: 0 }
    }

    /// Bytes written so far.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    fn full(&self, more: usize) -> EncodeError {
        EncodeError::Buffer {
            needed: self.len + more,
            actual: self.buf.len(),
        }
    }

    pub(super) fn raw(&mut self, bytes: &[u8]) -> Result<(), EncodeError> {
        let full = self.full(bytes.len());
        let end = self.len + bytes.len();
        let slot = self.buf.get_mut(self.len..end).ok_or(full)?;
        slot.copy_from_slice(bytes);
        self.len = end;
        Ok(())
    }

    fn varint(&mut self, mut value: u64) -> Result<(), EncodeError> {
        loop {
            let [low, ..] = value.to_le_bytes();
            value >>= 7;
            if value == 0 {
                return self.raw(&[low & 0x7f]);
            }
            self.raw(&[low | 0x80])?;
        }
    }

    fn key(&mut self, tag: u32, wire_type: u32) -> Result<(), EncodeError> {
        self.varint(u64::from(tag << 3 | wire_type))
    }

    pub(super) fn u64(&mut self, tag: u32, value: u64) -> Result<(), EncodeError> {
        self.key(tag, 0)?;
        self.varint(value)
    }

    pub(super) fn u32(&mut self, tag: u32, value: u32) -> Result<(), EncodeError> {
        self.u64(tag, value.into())
    }

    pub(super) fn i32(&mut self, tag: u32, value: i32) -> Result<(), EncodeError> {
        self.u64(tag, i64::from(value).cast_unsigned())
    }

    pub(super) fn f64(&mut self, tag: u32, value: f64) -> Result<(), EncodeError> {
        self.key(tag, 1)?;
        self.raw(&value.to_le_bytes())
    }

    pub(super) fn bytes(&mut self, tag: u32, bytes: &[u8]) -> Result<(), EncodeError> {
        self.nested(tag, |to| to.raw(bytes))
    }

    /// One field per value, as the SDK writes joint values.
    pub(super) fn unpacked(&mut self, tag: u32, values: &[f64]) -> Result<(), EncodeError> {
        values.iter().try_for_each(|value| self.f64(tag, *value))
    }

    /// All values in one field, as the SDK writes wrenches and frames.
    pub(super) fn packed(&mut self, tag: u32, values: &[f64]) -> Result<(), EncodeError> {
        self.nested(tag, |to| {
            values
                .iter()
                .try_for_each(|value| to.raw(&value.to_le_bytes()))
        })
    }

    /// Writes a nested message. Its length is known only afterwards: one byte is reserved for it, and the message is
    /// moved if that is not enough, which only the outermost messages need.
    pub(super) fn nested(
        &mut self,
        tag: u32,
        fill: impl FnOnce(&mut Self) -> Result<(), EncodeError>,
    ) -> Result<(), EncodeError> {
        self.key(tag, 2)?;
        let start = self.len;
        self.raw(&[0])?;
        fill(self)?;
        let end = self.len;
        let len = end - start - 1;
        let mut prefix = [0; VARINT_MAX];
        let mut head = Writer::new(&mut prefix);
        head.varint(len as u64)?;
        let width = head.len;
        self.raw(prefix.get(..width - 1).unwrap_or_default())?;
        self.buf.copy_within(start + 1..end, start + width);
        self.len = start;
        self.raw(prefix.get(..width).unwrap_or_default())?;
        self.len = start + width + len;
        Ok(())
    }
}

#[cfg(test)]
#[expect(clippy::indexing_slicing, reason = "a test may fail anywhere")]
mod tests {
    use super::*;

    #[test]
    fn proto_varints_roundtrip() {
        for bits in 0..64 {
            let value = u64::MAX >> bits;
            let mut buf = [0; 16];
            let mut to = Writer::new(&mut buf);
            to.u64(15, value).unwrap();
            let len = to.len();
            let field = Reader::new(&buf[..len]).next().unwrap().unwrap();
            assert_eq!((field.tag, field.u64()), (15, Ok(value)));
        }
    }

    #[test]
    fn proto_negative_enum_roundtrips_in_ten_bytes() {
        let mut buf = [0; 16];
        let mut to = Writer::new(&mut buf);
        to.i32(1, -2).unwrap();
        assert_eq!(to.len(), 11);
        let field = Reader::new(&buf[..11]).next().unwrap().unwrap();
        assert_eq!(field.i32(), Ok(-2));
    }

    #[test]
    fn proto_nested_length_widens_at_128_bytes() {
        for len in [0, 1, 127, 128, 300] {
            let mut buf = [0xaa; 320];
            let content = vec![7; len];
            let mut to = Writer::new(&mut buf);
            to.bytes(3, &content).unwrap();
            let end = to.len();
            assert_eq!(end, len + if len < 128 { 2 } else { 3 });
            let field = Reader::new(&buf[..end]).next().unwrap().unwrap();
            assert_eq!(field.message().unwrap().bytes(), content);
        }
    }

    #[test]
    fn proto_small_buffer_is_rejected_at_any_offset() {
        let write = |buf: &mut [u8]| {
            let mut to = Writer::new(buf);
            to.bytes(3, &[7; 130])?;
            to.f64(1, 1.0)
        };
        for len in 0..142 {
            let refused = write(&mut vec![0; len]);
            assert!(
                matches!(refused, Err(EncodeError::Buffer { actual, needed }) if actual == len && needed > len)
            );
        }
        assert_eq!(write(&mut [0; 142]), Ok(()));
    }

    #[test]
    fn proto_malformed_field_names_offset() {
        for (bytes, error) in [
            (&[0x80][..], DecodeError::Truncated { offset: 0 }),
            (
                &[0x08, 0x01, 0x12, 0x05, 0],
                DecodeError::Truncated { offset: 4 },
            ),
            (&[0x0d, 1, 2, 3], DecodeError::Truncated { offset: 1 }),
            (
                &[0x0b],
                DecodeError::WireType {
                    offset: 0,
                    wire_type: 3,
                },
            ),
            (
                &[
                    0x08, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1,
                ],
                { DecodeError::Truncated { offset: 1 } },
            ),
        ] {
            let mut from = Reader::new(bytes);
            let end = std::iter::from_fn(|| from.next().transpose()).find_map(Result::err);
            assert_eq!(end, Some(error));
        }
    }
}
