//! Messages on a plain byte stream, each terminated by a newline. A string may contain
//! newlines, so a message ends at the first newline *outside* quotation marks; inside them a
//! backslash escapes the next character. After a missing quotation mark, all input up to the bound
//! on length belongs to one message: this reader does not resynchronise.

use super::MESSAGE_BYTES_MAX;

/// Splits a stream into messages.
#[derive(Debug)]
pub struct LineReader {
    bytes: Vec<u8>,
    /// First byte of the message in progress.
    start: usize,
    /// First byte not scanned yet.
    scanned: usize,
    state: QuoteState,
    bound: usize,
}

impl Default for LineReader {
    fn default() -> Self {
        Self::bounded(MESSAGE_BYTES_MAX)
    }
}

#[derive(Clone, Copy, Debug, Default)]
enum QuoteState {
    #[default]
    Outside,
    Quoted,
    Escaped,
}

/// A message longer than the reader's bound, [`MESSAGE_BYTES_MAX`] or less; the stream cannot be decoded further.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message has more than {bound} bytes (is a quotation mark missing?)")]
pub struct LineTooLong {
    /// The bound.
    pub bound: usize,
}

/// Whether the bytes can be the beginning of a first line, `tag=ver(…` or `tag=tok(…`. Other protocols, such as HTTP
/// of a browser or TLS, are recognised by their first bytes, before a whole line is received.
pub fn may_be_first_line(bytes: &[u8]) -> bool {
    let skip_blanks = |bytes: &[u8]| bytes.iter().take_while(|b| **b == b' ').count();
    let after_blanks = |at: usize| bytes.get(at..).map_or(at, |rest| at + skip_blanks(rest));
    let is_name = |b: &u8| b.is_ascii_alphanumeric() || *b == b'_';
    let tag = after_blanks(0);
    let tag_bytes = bytes.get(tag..).unwrap_or_default();
    let length = tag_bytes.iter().take_while(|b| is_name(b)).count();
    if tag_bytes.first().is_some_and(u8::is_ascii_digit) || length > FIRST_TAG_BYTES_MAX {
        return false;
    }
    let equals = after_blanks(tag + length);
    match bytes.get(equals) {
        None => return true,
        Some(b'=') if length > 0 => {}
        Some(_) => return false,
    }
    let command = after_blanks(equals + 1);
    let rest = bytes.get(command..).unwrap_or_default();
    let Some((name, after)) = rest.split_at_checked(FIRST_COMMAND_BYTES) else {
        return FIRST_COMMANDS.iter().any(|c| c.starts_with(rest));
    };
    let parenthesis = after.get(skip_blanks(after));
    FIRST_COMMANDS.contains(&name) && parenthesis.is_none_or(|b| *b == b'(')
}

/// Most bytes of the tag of a first line.
const FIRST_TAG_BYTES_MAX: usize = 64;

/// Commands permitted in a first line.
const FIRST_COMMANDS: [&[u8]; 2] = [b"ver", b"tok"];

/// Length of each of them.
const FIRST_COMMAND_BYTES: usize = 3;

impl LineReader {
    /// The bytes of the message in progress.
    pub fn pending(&self) -> &[u8] {
        self.bytes.get(self.start..).unwrap_or_default()
    }

    /// A reader for messages of at most `bound` bytes.
    pub fn bounded(bound: usize) -> Self {
        Self {
            bytes: Vec::new(),
            start: 0,
            scanned: 0,
            state: QuoteState::default(),
            bound: bound.min(MESSAGE_BYTES_MAX),
        }
    }

    /// Raises the bound to [`MESSAGE_BYTES_MAX`].
    pub const fn raise_bound(&mut self) {
        self.bound = MESSAGE_BYTES_MAX;
    }

    /// Adds received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.start);
        self.scanned -= self.start;
        self.start = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next complete message without its newline. Empty lines are skipped, and a carriage return before the
    /// newline is removed.
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

    /// Position of the newline that ends the message in progress, if received.
    fn find_end(&mut self) -> Option<usize> {
        while let Some(byte) = self.bytes.get(self.scanned) {
            let at = self.scanned;
            self.scanned += 1;
            self.state = match (self.state, byte) {
                (QuoteState::Outside, b'\n') => return Some(at),
                (QuoteState::Outside, b'"') | (QuoteState::Escaped, _) => QuoteState::Quoted,
                (QuoteState::Outside, _) | (QuoteState::Quoted, b'"') => QuoteState::Outside,
                (QuoteState::Quoted, b'\\') => QuoteState::Escaped,
                (QuoteState::Quoted, _) => QuoteState::Quoted,
            };
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_protocols_are_recognised_by_first_bytes() {
        for line in [
            "c0=ver(\"2.0\")",
            "t0=tok(\"0123\")\n",
            " a_1 = ver ( \"2.0\" )",
        ] {
            for end in 0..=line.len() {
                assert!(may_be_first_line(&line.as_bytes()[..end]), "{line} {end}");
            }
        }
        let long = format!("{}=ver(", "a".repeat(65));
        let others: [&[u8]; 12] = [
            b"GET /",
            b"POST /nets/ HTTP/1.1\r\n",
            b"OPTIONS *",
            b"PRI * HTTP/2.0",
            b"\x16\x03\x01\x02\x00\x01",
            b"\r\n",
            b"c0=nene(",
            b"c0=very(",
            b"c0=ver\"2.0\"",
            b"=ver(",
            b"0=ver(",
            long.as_bytes(),
        ];
        for other in others {
            assert!(
                !may_be_first_line(other),
                "{}",
                String::from_utf8_lossy(other)
            );
        }
    }
}
