//! The two ways in which lines travel, behind one face: newlines on a plain stream, frames on a
//! WebSocket. It moves no bytes itself.

use tungstenite::protocol::frame::coding::{Control, Data, OpCode};

use crate::error::Error;
use crate::wire::lines::{LineReader, may_begin};
use crate::wire::websocket::{Event, FrameReader, write_frame};

/// How the lines of one connection travel.
#[derive(Debug)]
pub(crate) enum Codec {
    /// Ended by newlines.
    Plain(LineReader),
    /// In frames.
    WebSocket(FrameReader),
}

/// What a client's bytes amount to.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Received {
    /// A line to be handled.
    Line(String),
    /// Bytes to be sent back.
    Answer(Vec<u8>),
    /// The same, and the connection ends.
    Goodbye(Vec<u8>),
}

impl Codec {
    /// Adds received bytes.
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        match self {
            Self::Plain(reader) => reader.push(bytes),
            Self::WebSocket(reader) => reader.push(bytes),
        }
    }

    /// Takes messages of full length from now on.
    pub(crate) const fn unbind(&mut self) {
        match self {
            Self::Plain(reader) => reader.unbind(),
            Self::WebSocket(reader) => reader.unbind(),
        }
    }

    /// Whether what has come can be the first line of a client. Of frames it is not known here.
    pub(crate) fn may_begin(&self) -> bool {
        match self {
            Self::Plain(reader) => may_begin(reader.pending()),
            Self::WebSocket(_) => true,
        }
    }

    /// What came next.
    ///
    /// # Errors
    /// If the bytes cannot be read on; the connection must end.
    pub(crate) fn poll(&mut self) -> Result<Option<Received>, Error> {
        Ok(match self {
            Self::Plain(reader) => reader.poll_message()?.map(Received::Line),
            Self::WebSocket(reader) => reader.poll_event()?.map(|event| match event {
                Event::Message(line) => Received::Line(line),
                Event::Ping(bytes) => Received::Answer(control(Control::Pong, &bytes)),
                Event::Close(bytes) => Received::Goodbye(control(Control::Close, &bytes)),
            }),
        })
    }

    /// Appends a line as it travels to `out`.
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
