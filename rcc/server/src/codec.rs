//! The two transports of lines behind one interface: newline-terminated on a plain stream, frames on a WebSocket.
//! It does no I/O itself.

use takt_client::wire::lines::{LineReader, may_be_first_line};
use tungstenite::protocol::frame::coding::{Control, Data, OpCode};

use crate::error::Error;
use crate::websocket::{Event, FrameReader, write_frame};

/// The line transport of one connection.
#[derive(Debug)]
pub(crate) enum Codec {
    /// Terminated by newlines.
    Plain(LineReader),
    /// In frames.
    WebSocket(FrameReader),
}

/// What was decoded from a client's bytes.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Received {
    /// A line to be handled.
    Line(String),
    /// A ping was received; these bytes are to be sent.
    Reply(Vec<u8>),
    /// The client closes; send these bytes and end the connection.
    Close(Vec<u8>),
}

impl Codec {
    /// Adds received bytes.
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        match self {
            Self::Plain(reader) => reader.push(bytes),
            Self::WebSocket(reader) => reader.push(bytes),
        }
    }

    /// Raises the bound on message length to that of an admitted client.
    pub(crate) const fn raise_bound(&mut self) {
        match self {
            Self::Plain(reader) => reader.raise_bound(),
            Self::WebSocket(reader) => reader.raise_bound(),
        }
    }

    /// Raises the bound on the length of messages in frames to this one.
    pub(crate) const fn raise_bound_to(&mut self, bytes: usize) {
        if let Self::WebSocket(reader) = self {
            reader.raise_bound_to(bytes);
        }
    }

    /// Whether the received bytes can be the beginning of a client's first line; always true for frames.
    pub(crate) fn may_be_first_line(&self) -> bool {
        match self {
            Self::Plain(reader) => may_be_first_line(reader.pending()),
            Self::WebSocket(_) => true,
        }
    }

    /// The next line or control frame.
    pub(crate) fn poll(&mut self) -> Result<Option<Received>, Error> {
        Ok(match self {
            Self::Plain(reader) => reader.poll_message()?.map(Received::Line),
            Self::WebSocket(reader) => reader.poll_event()?.map(|event| match event {
                Event::Message(line) => Received::Line(line),
                Event::Bytes(line) => Received::Line(String::from_utf8_lossy(&line).into_owned()),
                Event::Ping(bytes) => Received::Reply(control(Control::Pong, &bytes)),
                Event::Close(bytes) => Received::Close(control(Control::Close, &bytes)),
            }),
        })
    }

    /// Appends an encoded line to `out`.
    pub(crate) fn write(&self, line: &str, out: &mut Vec<u8>) {
        match self {
            Self::Plain(_) => {
                out.extend_from_slice(line.as_bytes());
                out.push(b'\n');
            }
            Self::WebSocket(_) => write_frame(OpCode::Data(Data::Text), line.as_bytes(), out),
        }
    }
}

fn control(kind: Control, payload: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    write_frame(OpCode::Control(kind), payload, &mut out);
    out
}
