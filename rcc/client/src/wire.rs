//! Wire format: one DirectIO message as a line of text, and the separation of messages in a stream. The meaning of
//! commands is not known here.

mod decode;
mod encode;
pub mod lines;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

pub use decode::DecodeError;

/// Most bytes of one message, in either direction.
pub const MESSAGE_BYTES_MAX: usize = 8 << 20;
/// Longest tag or command, bytes.
pub const IDENTIFIER_BYTES_MAX: usize = 256;

/// Deepest nesting of lists and maps.
pub const DEPTH_MAX: usize = 32;

/// Most values in one message, keys of maps not counted.
pub const VALUES_MAX: usize = 65_536;

/// One command, reply or push: `tag=command(value,value)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Message {
    /// Chosen by the client; replies and pushes carry the tag of the command they belong to.
    pub tag: String,
    /// The command, or the kind of reply or push.
    pub command: String,
    /// The values in the parentheses.
    pub args: Vec<Value>,
}

impl Message {
    /// A message without values. Tag and command must be identifiers, or it cannot be decoded.
    pub fn new(tag: impl Into<String>, command: impl Into<String>) -> Self {
        Self {
            tag: tag.into(),
            command: command.into(),
            args: Vec::new(),
        }
    }

    /// Adds a value.
    #[must_use]
    pub fn with(mut self, value: impl Into<Value>) -> Self {
        self.args.push(value.into());
        self
    }
}

/// A value of a message. Integer and float are different types: `1` is never taken for `1.0`.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Text.
    String(String),
    /// 0 to 2³¹-1; the grammar has no sign.
    Integer(u32),
    /// Written with 6 decimals. The grammar has no sign and no exponent: negative and non-finite
    /// values can be written, but no peer can read them.
    Float(f64),
    /// Values in order.
    List(Vec<Value>),
    /// Values by key, written in the order of the keys' bytes.
    Map(BTreeMap<String, Value>),
}

impl Value {
    /// A list of texts.
    pub fn list_of<T: Into<Self>>(items: impl IntoIterator<Item = T>) -> Self {
        Self::List(items.into_iter().map(Into::into).collect())
    }

    /// A map of values.
    pub fn map_of<K: Into<String>, V: Into<Self>>(items: impl IntoIterator<Item = (K, V)>) -> Self {
        Self::Map(
            items
                .into_iter()
                .map(|(k, v)| (k.into(), v.into()))
                .collect(),
        )
    }

    /// The text, if it is one.
    pub fn as_str(&self) -> Option<&str> {
        if let Self::String(text) = self {
            Some(text)
        } else {
            None
        }
    }

    /// The items, if it is a list.
    pub fn as_list(&self) -> Option<&[Self]> {
        if let Self::List(items) = self {
            Some(items)
        } else {
            None
        }
    }

    /// The map, if it is one.
    pub const fn as_map(&self) -> Option<&BTreeMap<String, Self>> {
        if let Self::Map(map) = self {
            Some(map)
        } else {
            None
        }
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::String(text.to_owned())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::String(text)
    }
}

impl From<u32> for Value {
    fn from(number: u32) -> Self {
        Self::Integer(number)
    }
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Self::Float(number)
    }
}

impl From<Vec<Self>> for Value {
    fn from(items: Vec<Self>) -> Self {
        Self::List(items)
    }
}

impl From<BTreeMap<String, Self>> for Value {
    fn from(items: BTreeMap<String, Self>) -> Self {
        Self::Map(items)
    }
}

/// Whether `text` is valid as tag, command or unquoted key.
fn is_identifier(text: &str) -> bool {
    let mut bytes = text.bytes();
    bytes.next().is_some_and(starts_identifier) && bytes.all(continues_identifier)
}

const fn starts_identifier(byte: u8) -> bool {
    byte.is_ascii_alphabetic() || byte == b'_'
}

const fn continues_identifier(byte: u8) -> bool {
    starts_identifier(byte) || byte.is_ascii_digit()
}

/// Feeds any bytes to every reader of this module and checks the results: for fuzzing, and for the tests that
/// replace it in CI.
///
/// # Panics
/// If a reader breaks one of its guarantees.
#[doc(hidden)]
pub fn fuzz(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    if let Ok(message) = Message::decode(&text) {
        let again = Message::decode(&message.to_string());
        let stable = again
            .as_ref()
            .is_ok_and(|m| m.to_string() == message.to_string());
        assert!(
            stable,
            "{message:?} was written as {message} and read as {again:?}"
        );
    }
    let mut lines = lines::LineReader::default();
    lines.push(data);
    while let Ok(Some(_)) = lines.poll_message() {}
}
