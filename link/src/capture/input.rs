//! The bytes of a file as a window that grows to what a record needs. It knows no format; what records may need is bounded by
//! its callers.

use std::io::{self, Read};

/// Bytes that are asked of the file at once.
const CHUNK: usize = 1 << 16;

pub(super) struct Input<R> {
    from: R,
    buffer: Vec<u8>,
    /// Bytes of the buffer that were taken.
    taken: usize,
    /// Of the first byte that was not taken, in the file.
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

    /// At least so many bytes, fewer only at the end of the file.
    pub(super) fn fill(&mut self, wanted: usize) -> io::Result<&[u8]> {
        while self.buffer.len() - self.taken < wanted && !self.is_ended {
            self.buffer.drain(..self.taken);
            self.taken = 0;
            let more = u64::try_from(wanted.max(CHUNK)).unwrap_or(u64::MAX);
            let before = self.buffer.len();
            let read = self.from.by_ref().take(more).read_to_end(&mut self.buffer);
            // What came before an error is given first; the file is asked again for what follows.
            if self.buffer.len() == before {
                read?;
                self.is_ended = true;
            }
        }
        Ok(self.buffer.get(self.taken..).unwrap_or_default())
    }

    /// Goes on behind so many bytes of what [`Self::fill`] gave.
    pub(super) fn take(&mut self, count: usize) {
        let count = count.min(self.buffer.len() - self.taken);
        self.taken += count;
        self.offset += u64::try_from(count).unwrap_or(0);
    }
}
