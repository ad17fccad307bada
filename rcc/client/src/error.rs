//! Errors of a client's connection and commands.

use std::io;
use std::time::Duration;

use crate::wire::DecodeError;
use crate::wire::lines::LineTooLong;

/// Why a controller could not be reached, or did not do what was requested.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(clippy::error_impl_error, reason = "the one error type of the crate")]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum Error {
    /// The connection was refused: no controller listens there.
    #[error(
        "cannot connect to {address}: connection refused\nhint: start the controller with `takt run`"
    )]
    NotListening { address: String },
    /// The controller cannot be reached.
    #[error("cannot connect to {address}: {source}")]
    Connect { address: String, source: io::Error },
    /// Sending or receiving failed.
    #[error("connection to {address}: {source}")]
    Connection { address: String, source: io::Error },
    /// The peer closed the connection.
    #[error("{address} closed the connection{}", .last.as_ref().map_or_else(String::new, |m| format!(" after `{m}`")))]
    Closed {
        address: String,
        last: Option<String>,
    },
    /// No reply was received in time.
    #[error("no reply to `{command}` within {waited:?}")]
    NoReply { command: String, waited: Duration },
    /// The controller replied with an error.
    #[error("{text} (`{command}`)")]
    Refused {
        command: String,
        text: String,
        conflict: Option<Conflict>,
    },
    /// A command with this tag is in progress.
    #[error(
        "the tag `{tag}` is that of a command whose reply has not come yet\nhint: use another tag for each command"
    )]
    TagInUse { tag: String },
    /// The received line is not a message.
    #[error("received an invalid message: {0}")]
    Decode(#[from] DecodeError),
    /// A message on a plain connection exceeds the length bound.
    #[error(transparent)]
    Line(#[from] LineTooLong),
    /// The program does not receive its pushes.
    #[error(
        "{bound} notifications of {address} wait unread; the connection was closed\n\
        hint: receive pushes while commands are called"
    )]
    Unread { address: String, bound: usize },
}

/// What another net holds, for which a command was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conflict {
    /// The resource, such as `left_Joint_2` or `platform_Base`.
    pub resource: String,
    /// The net that holds it, with its session and program; `None` if the controller does not know it.
    pub holder: Option<String>,
}
