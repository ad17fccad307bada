//! Messages on a plain byte stream: one after another, each ended by a newline. A string may hold
//! newlines, so a message ends at the first newline *outside* quotes; inside quotes a backslash
//! hides the character after it. A lost quote therefore swallows what follows, up to the bound
//! on length: this reader does not guess where the next message may begin.

use super::MESSAGE_BYTES_MAX;

/// Cuts a stream into messages.
#[derive(Debug)]
pub struct LineReader {
    bytes: Vec<u8>,
    /// First byte of the message in progress.
    start: usize,
    /// First byte not looked at yet.
    scanned: usize,
    place: Place,
    bound: usize,
}

impl Default for LineReader {
    fn default() -> Self {
        Self::bounded(MESSAGE_BYTES_MAX)
    }
}

#[derive(Clone, Copy, Debug, Default)]
enum Place {
    #[default]
    Outside,
    Quoted,
    Escaped,
}

/// A message longer than the reader's bound, [`MESSAGE_BYTES_MAX`] or less; the stream cannot be read on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message has more than {bound} bytes (is a quotation mark missing?)")]
pub struct LineTooLong {
    /// The bound.
    pub bound: usize,
}

impl LineReader {
    /// Cuts a stream into messages of at most so many bytes.
    #[must_use]
    pub fn bounded(bound: usize) -> Self {
        Self {
            bytes: Vec::new(),
            start: 0,
            scanned: 0,
            place: Place::default(),
            bound: bound.min(MESSAGE_BYTES_MAX),
        }
    }

    /// Takes messages of at most [`MESSAGE_BYTES_MAX`] bytes from now on.
    pub const fn unbind(&mut self) {
        self.bound = MESSAGE_BYTES_MAX;
    }

    /// Adds received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.start);
        self.scanned -= self.start;
        self.start = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next whole message without its newline. Empty lines are skipped, and a carriage return
    /// before the newline is dropped.
    ///
    /// # Errors
    /// If the message in progress is too long.
    pub fn poll_message(&mut self) -> Result<Option<String>, LineTooLong> {
        while let Some(end) = self.find_end() {
            let line = self.bytes.get(self.start..end).unwrap_or_default();
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            self.start = end + 1;
            if line.len() > self.bound {
                return Err(LineTooLong { bound: self.bound });
            }
            if !line.is_empty() {
                return Ok(Some(String::from_utf8_lossy(line).into_owned()));
            }
        }
        if self.bytes.len() - self.start > self.bound {
            return Err(LineTooLong { bound: self.bound });
        }
        Ok(None)
    }

    /// Place of the newline that ends the message in progress, if it has come.
    fn find_end(&mut self) -> Option<usize> {
        while let Some(byte) = self.bytes.get(self.scanned) {
            let at = self.scanned;
            self.scanned += 1;
            self.place = match (self.place, byte) {
                (Place::Outside, b'\n') => return Some(at),
                (Place::Outside, b'"') | (Place::Escaped, _) => Place::Quoted,
                (Place::Outside, _) | (Place::Quoted, b'"') => Place::Outside,
                (Place::Quoted, b'\\') => Place::Escaped,
                (Place::Quoted, _) => Place::Quoted,
            };
        }
        None
    }
}
