//! The message of a subscription, which all of them send alike.

use takt_client::wire::{Message, Value};

/// A push with one value.
pub(super) fn push(tag: &str, command: &str, value: impl Into<Value>) -> Message {
    Message::new(tag, command).with(value)
}
