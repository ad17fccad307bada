//! The bytes of a file as a window that grows to the size of a record. It knows no format; its callers limit the size of
//! records.

use std::io::{self, Read};

/// Bytes per read.
const CHUNK: usize = 1 << 16;

pub(super) struct Input<R> {
    from: R,
    buffer: Vec<u8>,
    /// Number of consumed bytes in the buffer.
    taken: usize,
    /// File offset of the first unconsumed byte.
    offset: u64,
    is_ended: bool,
}

impl<R: Read> Input<R> {
    pub(super) const fn new(from: R) -> Self {
        Self {
            from,
            buffer: Vec::new(),
            taken: 0,
            offset: 0,
            is_ended: false,
        }
    }

    pub(super) const fn offset(&self) -> u64 {
        self.offset
    }

    /// Returns at least `wanted` bytes, fewer only at the end of the file.
    pub(super) fn fill(&mut self, wanted: usize) -> io::Result<&[u8]> {
        while self.buffer.len() - self.taken < wanted && !self.is_ended {
            self.buffer.drain(..self.taken);
            self.taken = 0;
            let more = u64::try_from(wanted.max(CHUNK)).unwrap_or(u64::MAX);
            let before = self.buffer.len();
            let read = self.from.by_ref().take(more).read_to_end(&mut self.buffer);
            // Bytes before an error are returned first; the next call reads again.
            if self.buffer.len() == before {
                read?;
                self.is_ended = true;
            }
        }
        Ok(self.buffer.get(self.taken..).unwrap_or_default())
    }

    /// Consumes `count` bytes of what [`Self::fill`] returned.
    pub(super) fn take(&mut self, count: usize) {
        let count = count.min(self.buffer.len() - self.taken);
        self.taken += count;
        self.offset += u64::try_from(count).unwrap_or(0);
    }
}
