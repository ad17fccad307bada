//! Message decoder. It is strict: text outside the grammar is rejected with its position.
#![warn(clippy::indexing_slicing)]

use std::collections::BTreeMap;

use super::{
    DEPTH_MAX, IDENTIFIER_BYTES_MAX, MESSAGE_BYTES_MAX, Message, VALUES_MAX, Value,
    continues_identifier, starts_identifier,
};

/// Why a text is not a message; `at` counts bytes from 0.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum DecodeError {
    /// The grammar requires something else here.
    #[error("{expected} is expected at byte {at}, not {found}")]
    Expected {
        expected: &'static str,
        found: String,
        at: usize,
    },
    /// A number beyond the protocol's integers.
    #[error("the number at byte {at} is too large: an integer is at most 2147483647")]
    NumberTooLarge { at: usize },
    /// The message is too long.
    #[error("the message has {bytes} bytes; at most {MESSAGE_BYTES_MAX} are taken")]
    TooLong { bytes: usize },
    /// A name is too long. Subscriptions store a tag and repeat it in each push.
    #[error("the name at byte {at} is too long: at most {IDENTIFIER_BYTES_MAX} bytes are taken")]
    NameTooLong { at: usize },
    /// Lists and maps are nested too deep.
    #[error(
        "lists and maps at byte {at} are nested too deep; at most {DEPTH_MAX} levels are taken"
    )]
    TooDeep { at: usize },
    /// The message has too many values.
    #[error("the message has too many values at byte {at}; at most {VALUES_MAX} are taken")]
    TooManyValues { at: usize },
}

impl Message {
    /// Decodes one message.
    pub fn decode(text: &str) -> Result<Self, DecodeError> {
        if text.len() > MESSAGE_BYTES_MAX {
            return Err(DecodeError::TooLong { bytes: text.len() });
        }
        let mut reader = Reader {
            text,
            at: 0,
            values: 0,
        };
        let tag = reader.identifier("a tag")?;
        reader.expect(b'=', "`=`")?;
        let command = reader.identifier("a command")?;
        reader.expect(b'(', "`(`")?;
        let mut args = Vec::new();
        reader.sequence(b')', "`,` or `)`", |r| {
            args.push(r.value(0)?);
            Ok(())
        })?;
        reader.end()?;
        Ok(Self { tag, command, args })
    }
}

struct Reader<'a> {
    text: &'a str,
    at: usize,
    values: usize,
}

impl Reader<'_> {
    /// The next byte that is not a blank. No other white space is permitted between tokens.
    fn peek(&mut self) -> Option<u8> {
        while self.byte() == Some(b' ') {
            self.at += 1;
        }
        self.byte()
    }

    fn byte(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn rest(&self) -> &str {
        self.text.get(self.at..).unwrap_or_default()
    }

    fn expected<T>(&self, expected: &'static str) -> Result<T, DecodeError> {
        let found = match self.rest().chars().next() {
            Some(c) => format!("`{}`", c.escape_debug()),
            None => "the end of the message".to_owned(),
        };
        Err(DecodeError::Expected {
            expected,
            found,
            at: self.at,
        })
    }

    /// Consumes `byte` if it is next.
    fn take(&mut self, byte: u8) -> bool {
        let found = self.peek() == Some(byte);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, byte: u8, name: &'static str) -> Result<(), DecodeError> {
        if self.take(byte) {
            Ok(())
        } else {
            self.expected(name)
        }
    }

    fn end(&mut self) -> Result<(), DecodeError> {
        if self.peek().is_none() {
            Ok(())
        } else {
            self.expected("the end of the message")
        }
    }

    /// Consumes the bytes from here that `belongs` accepts; all of them must be ASCII.
    fn run(&mut self, belongs: impl Fn(u8) -> bool) -> String {
        let length = self.rest().bytes().take_while(|b| belongs(*b)).count();
        let taken = self.rest().get(..length).unwrap_or_default().to_owned();
        self.at += length;
        taken
    }

    fn identifier(&mut self, name: &'static str) -> Result<String, DecodeError> {
        if self.peek().is_some_and(starts_identifier) {
            let at = self.at;
            let name = self.run(continues_identifier);
            if name.len() > IDENTIFIER_BYTES_MAX {
                return Err(DecodeError::NameTooLong { at });
            }
            Ok(name)
        } else {
            self.expected(name)
        }
    }

    /// Comma-separated items up to `close`.
    fn sequence(
        &mut self,
        close: u8,
        separator: &'static str,
        mut item: impl FnMut(&mut Self) -> Result<(), DecodeError>,
    ) -> Result<(), DecodeError> {
        if self.take(close) {
            return Ok(());
        }
        loop {
            item(self)?;
            if self.take(close) {
                return Ok(());
            }
            self.expect(b',', separator)?;
        }
    }

    fn value(&mut self, depth: usize) -> Result<Value, DecodeError> {
        let next = self.peek();
        self.values += 1;
        if self.values > VALUES_MAX {
            return Err(DecodeError::TooManyValues { at: self.at });
        }
        if depth >= DEPTH_MAX && matches!(next, Some(b'[' | b'{')) {
            return Err(DecodeError::TooDeep { at: self.at });
        }
        match next {
            Some(b'"') => self.string().map(Value::String),
            Some(b'[') => self.list(depth),
            Some(b'{') => self.map(depth),
            Some(b'0'..=b'9' | b'.') => self.number(),
            _ => self.expected("a value"),
        }
    }

    fn list(&mut self, depth: usize) -> Result<Value, DecodeError> {
        self.at += 1;
        let mut items = Vec::new();
        self.sequence(b']', "`,` or `]`", |r| {
            items.push(r.value(depth + 1)?);
            Ok(())
        })?;
        Ok(Value::List(items))
    }

    /// If a key occurs twice, the last value wins.
    fn map(&mut self, depth: usize) -> Result<Value, DecodeError> {
        self.at += 1;
        let mut items = BTreeMap::new();
        self.sequence(b'}', "`,` or `}`", |r| {
            let quoted = r.peek() == Some(b'"');
            let key = if quoted {
                r.string()?
            } else {
                r.identifier("a key")?
            };
            r.expect(b':', "`:`")?;
            items.insert(key, r.value(depth + 1)?);
            Ok(())
        })?;
        Ok(Value::Map(items))
    }

    fn string(&mut self) -> Result<String, DecodeError> {
        self.at += 1;
        let mut out = String::new();
        loop {
            let plain = self
                .rest()
                .find(['"', '\\'])
                .unwrap_or_else(|| self.rest().len());
            out.push_str(self.rest().get(..plain).unwrap_or_default());
            self.at += plain;
            match self.byte() {
                Some(b'"') => break,
                Some(_) => out.push(self.escaped()?),
                None => return self.expected("`\"`"),
            }
        }
        self.at += 1;
        Ok(out)
    }

    /// The character after a backslash, which is the current byte.
    fn escaped(&mut self) -> Result<char, DecodeError> {
        self.at += 1;
        let escaped = match self.byte() {
            Some(b'"') => '"',
            Some(b'\\') => '\\',
            _ => return self.expected("`\"` or `\\` after a backslash"),
        };
        self.at += 1;
        Ok(escaped)
    }

    fn number(&mut self) -> Result<Value, DecodeError> {
        let at = self.at;
        let whole = self.run(|b| b.is_ascii_digit());
        if self.byte() != Some(b'.') {
            let number = whole
                .parse()
                .ok()
                .filter(|n| *n <= i32::MAX.cast_unsigned());
            return number
                .map(Value::Integer)
                .ok_or(DecodeError::NumberTooLarge { at });
        }
        self.at += 1;
        let decimals = self.run(|b| b.is_ascii_digit());
        if decimals.is_empty() {
            return self.expected("a digit after the decimal point");
        }
        let number: f64 = format!("{whole}.{decimals}")
            .parse()
            .unwrap_or(f64::INFINITY);
        if number.is_finite() {
            Ok(Value::Float(number))
        } else {
            Err(DecodeError::NumberTooLarge { at })
        }
    }
}
