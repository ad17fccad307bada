//! Connection errors of server and client. The errors of single commands are part of the protocol and are defined
//! with the commands.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use crate::wire::DecodeError;
use crate::wire::lines::LineTooLong;
use crate::wire::websocket::FrameError;

/// Why a server could not start, or a connection failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(clippy::error_impl_error, reason = "the one error type of the crate")]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum Error {
    /// The server would be reachable from other machines.
    #[error(
        "refusing to listen at {0} without a token\n\
        hint: create one with `openssl rand -hex 32 > FILE; chmod 600 FILE` and name it as token_file under [controller] \
        of cell.toml, in TAKT_TOKEN_FILE, or as the systemd credential takt-token; or listen at a loopback address such \
        as 127.0.0.1"
    )]
    NotLoopback(SocketAddr),
    /// The address is in use or does not exist.
    #[error(
        "cannot listen at {address}: {source}\nhint: another controller may already be running"
    )]
    Listen {
        address: SocketAddr,
        source: io::Error,
    },
    /// The Unix socket cannot be created.
    #[error(
        "cannot listen at {path}: {source}\nhint: name another path as socket under [controller] of cell.toml, or \"\" for none"
    )]
    Local { path: String, source: io::Error },
    /// All connection slots of the kind are in use.
    #[error("too many connections: at most {bound}; close one first")]
    Full { bound: usize },
    /// The connection was evicted in favour of another one.
    #[error(
        "closed: another connection needed this one's place; shake hands soon, and do not stay idle"
    )]
    Evicted,
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
    Refused { command: String, text: String },
    /// The received line is not a message.
    #[error("received an invalid message: {0}")]
    Decode(#[from] DecodeError),
    /// A message on a plain connection exceeds the length bound.
    #[error(transparent)]
    Line(#[from] LineTooLong),
    /// The bytes on a WebSocket connection are not a valid frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
}
