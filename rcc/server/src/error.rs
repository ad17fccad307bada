//! What can go wrong around connections, on both sides. What a command is refused for is part of
//! the protocol and stands with the commands.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use crate::wire::DecodeError;
use crate::wire::lines::LineTooLong;
use crate::wire::websocket::FrameError;

/// Why a server could not be set up, or a connection not be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(clippy::error_impl_error, reason = "the one error type of the crate")]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum Error {
    /// The server would be reachable from other machines.
    #[error(
        "refusing to listen at {0} without a token: make one with `openssl rand -hex 32 > FILE; chmod 600 \
         FILE` and name it as token_file under [controller] of cell.toml, or in TAKT_TOKEN_FILE, or as \
         the systemd credential takt-token; or listen at a loopback address such as 127.0.0.1"
    )]
    NotLoopback(SocketAddr),
    /// The address is taken or not there.
    #[error("cannot listen at {address}: {source} (does another controller run already?)")]
    Listen {
        address: SocketAddr,
        source: io::Error,
    },
    /// The Unix socket cannot be made.
    #[error(
        "cannot listen at {path}: {source}\nhint: name another path as socket under [controller] of cell.toml, or \"\" for none"
    )]
    Local { path: String, source: io::Error },
    /// As many connections as there may be of the kind.
    #[error("too many connections: at most {bound}; close one first")]
    Full { bound: usize },
    /// Another connection needed the place.
    #[error(
        "closed: another connection needed this one's place; shake hands soon, and do not stay idle"
    )]
    Displaced,
    /// No controller runs there.
    #[error("nobody listens at {address}: start `takt run`")]
    NobodyListens { address: String },
    /// The controller cannot be reached.
    #[error("cannot connect to {address}: {source}")]
    Connect { address: String, source: io::Error },
    /// Sending or receiving failed.
    #[error("connection to {address}: {source}")]
    Connection { address: String, source: io::Error },
    /// The other side ended the connection.
    #[error("{address} closed the connection{}", .last.as_ref().map_or_else(String::new, |m| format!(" after `{m}`")))]
    Closed {
        address: String,
        last: Option<String>,
    },
    /// No reply in time.
    #[error("no reply to `{command}` within {waited:?}")]
    NoReply { command: String, waited: Duration },
    /// The controller answered with an error.
    #[error("{text} (`{command}`)")]
    Refused { command: String, text: String },
    /// A line that is no message.
    #[error("received something that is no message: {0}")]
    Decode(#[from] DecodeError),
    /// A message beyond the bounds on a plain connection.
    #[error(transparent)]
    Line(#[from] LineTooLong),
    /// Something that is no frame on a WebSocket connection.
    #[error(transparent)]
    Frame(#[from] FrameError),
}
