//! Buffer of a transfer, allocated once.

use takt_cia402::dictionary::AbortCode;

use super::{BlockSegment, Bytes, TRANSFER_MAX, crc};

/// A value of bounded length.
#[derive(Clone, Debug)]
pub(super) struct Buffer {
    bytes: Vec<u8>,
    len: usize,
    /// Checksum of the first bytes, computed incrementally with the segments: for a long value at
    /// once it would delay a cycle.
    checked: (usize, u16),
}

/// The last segment of a block is stored whole before its length is known.
const SLACK: usize = 6;
/// Bytes of a segment.
const SEGMENT: usize = 7;

impl Buffer {
    pub(super) fn new(max: usize) -> Self {
        Self {
            bytes: vec![0; max.min(TRANSFER_MAX) + SLACK],
            len: 0,
            checked: (0, 0),
        }
    }

    pub(super) const fn clear(&mut self) {
        (self.len, self.checked) = (0, (0, 0));
    }

    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// The length as in messages.
    pub(super) fn size(&self) -> u32 {
        u32::try_from(self.len).unwrap_or(u32::MAX)
    }

    pub(super) fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }

    /// The segment that starts at a byte, and whether it is the last.
    pub(super) fn segment(&self, at: usize) -> (Bytes, bool) {
        let rest = self.as_slice().get(at..).unwrap_or_default();
        (Bytes::new(rest), rest.len() <= 7)
    }

    /// The segment of a block that starts at a byte.
    pub(super) fn block_segment(&mut self, start: usize, sequence: u8) -> BlockSegment {
        let at = start + 7 * usize::from(sequence - 1);
        self.check_to(at);
        let (data, last) = self.segment(at);
        BlockSegment {
            last,
            sequence,
            data: data.bytes,
        }
    }

    /// Whether a block that starts at byte `start` has more than `sent` segments.
    pub(super) const fn has_segment(&self, start: usize, sent: u8, block: u8) -> bool {
        let at = start + 7 * sent as usize;
        sent < block && (at < self.len || (self.len == 0 && sent == 0))
    }

    /// Replaces the value.
    pub(super) fn set(&mut self, value: &[u8]) -> Result<(), AbortCode> {
        self.clear();
        self.fits(value.len())?;
        self.put(value)
    }

    /// Appends to the value.
    pub(super) fn put(&mut self, data: &[u8]) -> Result<(), AbortCode> {
        let end = self.len + data.len();
        let target = self.bytes.get_mut(self.len..end);
        target.ok_or(AbortCode::OutOfMemory)?.copy_from_slice(data);
        self.len = end;
        // The length of the last segment is not known yet.
        if data.len() <= SEGMENT {
            self.check_to(end.saturating_sub(SEGMENT));
        }
        Ok(())
    }

    fn check_to(&mut self, end: usize) {
        let (from, crc_so_far) = self.checked;
        let end = end.min(self.len);
        if let Some(bytes) = self.bytes.get(from..end) {
            self.checked = (end, crc(crc_so_far, bytes));
        }
    }

    /// Removes the unused bytes of the last segment.
    pub(super) fn drop_last(&mut self, unused: u8) {
        self.len = self.len.saturating_sub(unused.into());
    }

    /// Number of unused bytes of the last segment if the last block ended at byte `end`.
    pub(super) fn unused(&self, end: usize) -> u8 {
        u8::try_from(end.saturating_sub(self.len)).unwrap_or(0)
    }

    pub(super) fn crc(&mut self) -> u16 {
        self.check_to(self.len);
        self.checked.1
    }

    /// Whether a value of that length fits.
    pub(super) fn fits(&self, len: usize) -> Result<(), AbortCode> {
        if len + SLACK > self.bytes.len() {
            return Err(AbortCode::OutOfMemory);
        }
        Ok(())
    }

    /// Checks an indicated size.
    pub(super) fn announced(&self, size: Option<u32>) -> Result<Option<usize>, AbortCode> {
        let size = size.map(|size| usize::try_from(size).unwrap_or(usize::MAX / 2));
        self.fits(size.unwrap_or(0))?;
        Ok(size)
    }
}
