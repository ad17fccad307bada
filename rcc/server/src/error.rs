//! Errors of a server and its connections. The errors of single commands are part of the protocol and are defined
//! with the commands.

use std::io;
use std::net::SocketAddr;

use takt_client::wire::lines::LineTooLong;

use crate::websocket::FrameError;

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
    /// The system refuses threads.
    #[error("cannot start the server's threads: {0}")]
    Threads(#[source] io::Error),
    /// All connection slots of the kind are in use.
    #[error("too many connections: at most {bound}; close one first")]
    Full { bound: usize },
    /// The connection was evicted in favour of another one.
    #[error(
        "closed: another connection needed this one's place; shake hands soon, and do not stay idle"
    )]
    Evicted,
    /// Sending or receiving failed.
    #[error("connection to {address}: {source}")]
    Connection { address: String, source: io::Error },
    /// A message on a plain connection exceeds the length bound.
    #[error(transparent)]
    Line(#[from] LineTooLong),
    /// The bytes on a WebSocket connection are not a valid frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
}
