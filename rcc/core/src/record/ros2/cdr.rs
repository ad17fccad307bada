//! The encoding of messages: CDR, little-endian, as in the first version of OMG's XTypes (XCDR1), section 7.4: each value at a
//! multiple of its size, counted from after the header of four bytes.

/// Representation identifier `CDR_LE` and options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// A message that is being written. Writing it again reuses its memory.
#[derive(Debug, Default)]
pub struct Cdr(Vec<u8>);

impl Cdr {
    /// Begins a message; the one before is gone.
    pub fn begin(&mut self) -> &mut Self {
        self.0.clear();
        self.0.extend_from_slice(&HEADER);
        self
    }

    /// The message with its header.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Fills up to a multiple of `size` bytes.
    fn align(&mut self, size: usize) -> &mut Vec<u8> {
        let body = self.0.len().saturating_sub(HEADER.len());
        self.0.resize(body.next_multiple_of(size) + HEADER.len(), 0);
        &mut self.0
    }

    fn aligned<const N: usize>(&mut self, bytes: [u8; N]) -> &mut Self {
        self.align(N).extend_from_slice(&bytes);
        self
    }

    /// An octet, or an `int8` as its bits.
    pub fn u8(&mut self, value: u8) -> &mut Self {
        self.aligned([value])
    }

    /// A signed number of 32 bits.
    pub fn i32(&mut self, value: i32) -> &mut Self {
        self.aligned(value.to_le_bytes())
    }

    /// An unsigned number of 32 bits.
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.aligned(value.to_le_bytes())
    }

    /// An unsigned number of 64 bits.
    pub fn u64(&mut self, value: u64) -> &mut Self {
        self.aligned(value.to_le_bytes())
    }

    /// A double.
    pub fn f64(&mut self, value: f64) -> &mut Self {
        self.aligned(value.to_le_bytes())
    }

    /// The number of elements that follow.
    pub fn count(&mut self, elements: usize) -> &mut Self {
        self.u32(u32::try_from(elements).unwrap_or(u32::MAX))
    }

    /// A string with its zero.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.count(text.len() + 1);
        self.0.extend_from_slice(text.as_bytes());
        self.u8(0)
    }

    /// A sequence of strings.
    pub fn texts(&mut self, texts: &[String]) -> &mut Self {
        self.count(texts.len());
        for text in texts {
            self.text(text);
        }
        self
    }

    /// Octets without a length, such as a UUID.
    pub fn octets(&mut self, octets: &[u8]) -> &mut Self {
        self.0.extend_from_slice(octets);
        self
    }

    /// A truth value.
    pub fn bool(&mut self, value: bool) -> &mut Self {
        self.u8(value.into())
    }

    /// A sequence of words.
    pub fn words(&mut self, words: &[u64]) -> &mut Self {
        self.count(words.len());
        if !words.is_empty() {
            let bytes = self.align(size_of::<u64>());
            bytes.reserve(size_of_val(words));
            for word in words {
                bytes.extend_from_slice(&word.to_le_bytes());
            }
        }
        self
    }

    /// A sequence of numbers.
    pub fn numbers(&mut self, numbers: impl ExactSizeIterator<Item = f64>) -> &mut Self {
        self.count(numbers.len());
        for number in numbers {
            self.f64(number);
        }
        self
    }
}

/// The string that a message consists of; `None` if it is something else.
pub(in crate::record) fn string(message: &[u8]) -> Option<&[u8]> {
    let (header, rest) = message.split_first_chunk::<4>()?;
    let (length, text) = rest.split_first_chunk::<4>()?;
    let (zero, text) = text.split_last()?;
    let is_whole = usize::try_from(u32::from_le_bytes(*length)) == Ok(text.len() + 1);
    (*header == HEADER && *zero == 0 && is_whole).then_some(text)
}

/// The sequence of words that a message consists of; `None` if it is something else.
pub(in crate::record) fn words(message: &[u8]) -> Option<Vec<u64>> {
    let (header, rest) = message.split_first_chunk::<4>()?;
    let (count, rest) = rest.split_first_chunk::<4>()?;
    let count = usize::try_from(u32::from_le_bytes(*count)).ok()?;
    // Words begin at a multiple of their size.
    let words = if count == 0 { rest } else { rest.get(4..)? };
    let (words, rest) = words.as_chunks();
    let is_whole = *header == HEADER && rest.is_empty() && words.len() == count;
    is_whole.then(|| words.iter().map(|word| u64::from_le_bytes(*word)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_begin_at_multiples_of_their_size() {
        let mut cdr = Cdr::default();
        cdr.begin().u8(1).u32(2).u8(3).f64(1.0);
        let mut wanted = vec![0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0];
        wanted.extend(1.0_f64.to_le_bytes());
        assert_eq!(cdr.bytes(), wanted);
    }

    #[test]
    fn message_of_words_or_string_is_read_as_written() {
        let mut cdr = Cdr::default();
        for count in 0..4 {
            let written: Vec<_> = (0..count).map(|n| n * 7).collect();
            let bytes = cdr.begin().words(&written).bytes().to_vec();
            assert_eq!(words(&bytes), Some(written));
            for length in 0..bytes.len() {
                assert_eq!(
                    words(&bytes[..length]),
                    None,
                    "{count} words, {length} bytes"
                );
            }
        }
        let bytes = cdr.begin().text("net").bytes().to_vec();
        assert_eq!(string(&bytes), Some(b"net".as_slice()));
        for length in 0..bytes.len() {
            assert_eq!(string(&bytes[..length]), None, "{length} bytes");
        }
    }

    #[test]
    fn strings_have_their_zero_in_their_length() {
        let mut cdr = Cdr::default();
        cdr.begin().text("ab").texts(&["".to_owned()]);
        let wanted = [
            0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0,
        ];
        assert_eq!(cdr.bytes(), wanted);
        cdr.begin().numbers([].into_iter());
        assert_eq!(cdr.bytes(), [0, 1, 0, 0, 0, 0, 0, 0]);
    }
}
