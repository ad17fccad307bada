//! Reader of messages in CDR (XCDR1, little-endian), from anyone: every length is checked before memory is taken. The writer is that
//! of recordings, [`Cdr`]. What a message means is in [`messages`](super::messages).

pub use takt_core::record::Cdr;

/// Longest message that is read, bytes.
pub const MESSAGE_MAX: usize = 8 << 20;
/// Longest text in a message, bytes.
pub const TEXT_MAX: usize = 4096;
/// Bytes of padding that may follow a message.
const PADDING_MAX: usize = 3;

/// Why a message is not read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// It is too long as a whole.
    #[error("the message has {0} bytes, and at most {MESSAGE_MAX} are read")]
    Message(usize),
    /// Its header is not that of little-endian XCDR1.
    #[error("the message is not little-endian XCDR1: it begins with {0:02x?}, not with [00, 01]")]
    Encoding([u8; 2]),
    /// It ends before its values do.
    #[error("the message ends within {0}")]
    Short(&'static str),
    /// More of something than is read.
    #[error("{what}: {found}, and at most {most} are read")]
    Bound {
        /// What there is too much of.
        what: &'static str,
        /// How many.
        found: usize,
        /// How many are read.
        most: usize,
    },
    /// A text is none.
    #[error("{0} is no text: it does not end with a zero, or is not UTF-8")]
    Text(&'static str),
    /// A truth value is none.
    #[error("{0} is neither 0 nor 1")]
    Bool(&'static str),
    /// A number is out of its range.
    #[error("{0} is out of its range")]
    Range(&'static str),
    /// Bytes follow.
    #[error("{0} bytes follow the last value: the message is of another type")]
    Rest(usize),
}

/// Reads the values of a message one after the other.
#[derive(Debug)]
pub struct Reader<'a> {
    /// After the header.
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Begins with the header.
    ///
    /// # Errors
    /// If the message is too long, or in another encoding.
    pub fn new(message: &'a [u8]) -> Result<Self, DecodeError> {
        if message.len() > MESSAGE_MAX {
            return Err(DecodeError::Message(message.len()));
        }
        match message.split_first_chunk::<4>() {
            Some(([0, 1, _, _], bytes)) => Ok(Self { bytes, at: 0 }),
            Some(([first, second, _, _], _)) => Err(DecodeError::Encoding([*first, *second])),
            None => Err(DecodeError::Short("its header")),
        }
    }

    /// Ends the message.
    ///
    /// # Errors
    /// If more than padding follows.
    pub fn end(self) -> Result<(), DecodeError> {
        let rest = self.bytes.len().saturating_sub(self.at);
        if rest > PADDING_MAX {
            return Err(DecodeError::Rest(rest));
        }
        Ok(())
    }

    fn aligned<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], DecodeError> {
        self.at = self.at.next_multiple_of(N);
        self.octets(what)
    }

    /// Octets without a length, such as a UUID.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn octets<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], DecodeError> {
        let rest = self.bytes.get(self.at..);
        let found = rest.and_then(|rest| rest.first_chunk::<N>());
        let found = found.ok_or(DecodeError::Short(what))?;
        self.at += N;
        Ok(*found)
    }

    /// An octet.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn u8(&mut self, what: &'static str) -> Result<u8, DecodeError> {
        Ok(u8::from_le_bytes(self.aligned(what)?))
    }

    /// A truth value.
    ///
    /// # Errors
    /// If it is none, or the message ends before.
    pub fn bool(&mut self, what: &'static str) -> Result<bool, DecodeError> {
        match self.u8(what)? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(DecodeError::Bool(what)),
        }
    }

    /// An unsigned number of 32 bits.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn u32(&mut self, what: &'static str) -> Result<u32, DecodeError> {
        Ok(u32::from_le_bytes(self.aligned(what)?))
    }

    /// A signed number of 32 bits.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn i32(&mut self, what: &'static str) -> Result<i32, DecodeError> {
        Ok(i32::from_le_bytes(self.aligned(what)?))
    }

    /// A double, whatever its value.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn f64(&mut self, what: &'static str) -> Result<f64, DecodeError> {
        Ok(f64::from_le_bytes(self.aligned(what)?))
    }

    /// The length of a sequence of at most `most` elements, each of which takes at least `size` bytes.
    ///
    /// # Errors
    /// If there are more, or the message is too short for them.
    pub fn count(
        &mut self,
        what: &'static str,
        size: usize,
        most: usize,
    ) -> Result<usize, DecodeError> {
        let found = usize::try_from(self.u32(what)?).unwrap_or(usize::MAX);
        if found > most {
            return Err(DecodeError::Bound { what, found, most });
        }
        let rest = self.bytes.len().saturating_sub(self.at);
        if found.saturating_mul(size) > rest {
            return Err(DecodeError::Short(what));
        }
        Ok(found)
    }

    /// A text with its zero.
    ///
    /// # Errors
    /// If it is too long or none, or the message ends before.
    pub fn text(&mut self, what: &'static str) -> Result<&'a str, DecodeError> {
        let length = self.count(what, 1, TEXT_MAX)?;
        let bytes = self.bytes.get(self.at..).and_then(|it| it.get(..length));
        let bytes = bytes.ok_or(DecodeError::Short(what))?;
        self.at += length;
        // Some writers give an empty text no zero.
        let Some((zero, text)) = bytes.split_last() else {
            return Ok("");
        };
        let text = std::str::from_utf8(text).ok().filter(|_| *zero == 0);
        text.ok_or(DecodeError::Text(what))
    }

    /// A sequence of texts.
    ///
    /// # Errors
    /// As [`Self::text`], or if there are more than `most`.
    pub fn texts(&mut self, what: &'static str, most: usize) -> Result<Vec<String>, DecodeError> {
        let count = self.count(what, 4, most)?;
        (0..count)
            .map(|_| Ok(self.text(what)?.to_owned()))
            .collect()
    }

    /// A sequence of at most `most` doubles.
    ///
    /// # Errors
    /// If there are more, or the message ends before.
    pub fn numbers(&mut self, what: &'static str, most: usize) -> Result<Vec<f64>, DecodeError> {
        let count = self.count(what, 8, most)?;
        (0..count).map(|_| self.f64(what)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_as_written() {
        let mut cdr = Cdr::default();
        cdr.begin()
            .bool(true)
            .u32(7)
            .u8(3)
            .f64(-0.5)
            .i32(-2)
            .text("left");
        cdr.texts(&["a".to_owned(), String::new()])
            .numbers([1.0, 2.0].into_iter())
            .octets(&[9; 3]);
        let bytes = cdr.bytes().to_vec();
        let read = |bytes: &[u8]| -> Result<(), DecodeError> {
            let mut reader = Reader::new(bytes)?;
            assert!(reader.bool("")?);
            assert_eq!((reader.u32("")?, reader.u8("")?), (7, 3));
            assert_eq!(reader.f64("")?.to_bits(), (-0.5_f64).to_bits());
            assert_eq!((reader.i32("")?, reader.text("")?), (-2, "left"));
            assert_eq!(reader.texts("", 2)?, ["a", ""]);
            assert_eq!(reader.numbers("", 2)?.len(), 2);
            assert_eq!(reader.octets("")?, [9; 3]);
            reader.end()
        };
        assert_eq!(read(&bytes), Ok(()));
        for end in 0..bytes.len() {
            assert!(read(&bytes[..end]).is_err(), "{end}");
        }
        let mut longer = bytes.clone();
        longer.extend([0; 3]);
        assert_eq!(read(&longer), Ok(()));
        longer.push(0);
        assert_eq!(read(&longer), Err(DecodeError::Rest(4)));
    }

    #[test]
    fn other_encodings_are_named() {
        for header in [[0, 0, 0, 0], [0, 7, 0, 0], [0, 9, 0, 0]] {
            let error = Reader::new(&header).unwrap_err();
            assert_eq!(error, DecodeError::Encoding([header[0], header[1]]));
        }
    }

    #[test]
    fn counts_beyond_message_take_no_memory() {
        let bytes = [0, 1, 0, 0, 255, 255, 255, 255, 0, 0];
        let error = Reader::new(&bytes).unwrap().numbers("positions", 10);
        let found = u32::MAX as usize;
        let bound = DecodeError::Bound {
            what: "positions",
            found,
            most: 10,
        };
        assert_eq!(error, Err(bound));
        let error = Reader::new(&bytes).unwrap().numbers("it", usize::MAX);
        assert_eq!(error, Err(DecodeError::Short("it")));
        let long = vec![0; MESSAGE_MAX + 1];
        assert!(matches!(Reader::new(&long), Err(DecodeError::Message(_))));
    }
}
