//! WebSocket frames (RFC 6455 clause 5) with the deviations of the known client: frames without mask, a close payload
//! without a status code, text that need not be UTF-8. `tungstenite`'s own connection rejects all three, so it only
//! codes the frame headers and their meaning is implemented here. The handshake is not.

use std::io::Cursor;

use takt_client::wire::MESSAGE_BYTES_MAX;
use tungstenite::protocol::frame::FrameHeader;
use tungstenite::protocol::frame::coding::{Control, OpCode};

/// Most payload bytes of a ping, pong or close (clause 5.5).
const CONTROL_BYTES_MAX: usize = 125;

/// What was decoded from a client's frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// One complete message, from one or several frames.
    Message(String),
    /// The same for a reader that keeps bytes, which need not be text.
    Bytes(Vec<u8>),
    /// A ping; answer with a pong of these bytes.
    Ping(Vec<u8>),
    /// The client closes; answer with the same bytes and end the connection.
    Close(Vec<u8>),
}

/// Why a client's frames cannot be decoded further.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// A frame, or a message of several frames, is too long.
    #[error("a message has more than {bound} bytes")]
    TooLong {
        /// The bound.
        bound: usize,
    },
    /// An invalid control frame (clause 5.5).
    #[error("a control frame is fragmented or has more than {CONTROL_BYTES_MAX} bytes")]
    Control,
    /// Reserved bits are set, but no extension was negotiated.
    #[error("a frame has reserved bits set")]
    Reserved,
    /// An invalid frame header.
    #[error("{0}")]
    Header(#[from] tungstenite::Error),
}

/// Reassembles messages from a client's frames.
#[derive(Debug)]
pub(crate) struct FrameReader {
    bound: usize,
    keeps_bytes: bool,
    bytes: Vec<u8>,
    /// First byte of the frame in progress.
    start: usize,
    /// Payload of the fragments of the message in progress.
    message: Vec<u8>,
}

impl Default for FrameReader {
    fn default() -> Self {
        Self::bounded(MESSAGE_BYTES_MAX)
    }
}

impl FrameReader {
    /// A reader for messages of at most `bound` bytes.
    pub(crate) fn bounded(bound: usize) -> Self {
        Self {
            bound: bound.min(MESSAGE_BYTES_MAX),
            keeps_bytes: false,
            bytes: Vec::new(),
            start: 0,
            message: Vec::new(),
        }
    }

    /// A reader for messages of at most `bound` bytes, which need not be text.
    pub(crate) fn of_bytes(bound: usize) -> Self {
        Self {
            keeps_bytes: true,
            ..Self::bounded(bound)
        }
    }

    /// Raises the bound to [`MESSAGE_BYTES_MAX`].
    pub(crate) const fn raise_bound(&mut self) {
        self.bound = MESSAGE_BYTES_MAX;
    }

    /// Raises the bound to this one.
    pub(crate) const fn raise_bound_to(&mut self, bytes: usize) {
        self.bound = bytes;
    }

    /// Adds received bytes.
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.start);
        self.start = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next event. Must not be called again after an error or [`Event::Close`].
    pub(crate) fn poll_event(&mut self) -> Result<Option<Event>, FrameError> {
        while let Some((header, payload)) = self.next_frame()? {
            let event = match header.opcode {
                OpCode::Data(_) => self.handle_data(header.is_final, payload)?,
                OpCode::Control(Control::Ping) => Some(Event::Ping(payload)),
                OpCode::Control(Control::Close) => Some(Event::Close(payload)),
                OpCode::Control(Control::Pong | Control::Reserved(_)) => None,
            };
            if event.is_some() {
                return Ok(event);
            }
        }
        Ok(None)
    }

    /// Any data frame continues the message in progress: the known client does not set opcodes reliably.
    /// One frame is the message in most cases, and nets are long: it is not copied.
    fn handle_data(&mut self, last: bool, payload: Vec<u8>) -> Result<Option<Event>, FrameError> {
        let bound = self.bound;
        if self.message.len() + payload.len() > bound {
            return Err(FrameError::TooLong { bound });
        }
        if self.message.is_empty() {
            self.message = payload;
        } else {
            self.message.extend_from_slice(&payload);
        }
        if !last {
            return Ok(None);
        }
        let message = std::mem::take(&mut self.message);
        if self.keeps_bytes {
            return Ok(Some(Event::Bytes(message)));
        }
        let message = String::from_utf8(message);
        Ok(Some(Event::Message(message.unwrap_or_else(|error| {
            String::from_utf8_lossy(error.as_bytes()).into_owned()
        }))))
    }

    fn next_frame(&mut self) -> Result<Option<(FrameHeader, Vec<u8>)>, FrameError> {
        let received = self.bytes.get(self.start..).unwrap_or_default();
        let mut cursor = Cursor::new(received);
        let Some((header, length)) = FrameHeader::parse(&mut cursor)? else {
            return Ok(None);
        };
        let bound = self.bound;
        let length = usize::try_from(length).map_err(|_| FrameError::TooLong { bound })?;
        check(&header, length, bound)?;
        let begin = usize::try_from(cursor.position()).unwrap_or(received.len());
        let Some(payload) = received.get(begin..begin + length) else {
            return Ok(None);
        };
        let payload = unmask(payload, header.mask);
        self.start += begin + length;
        Ok(Some((header, payload)))
    }
}

fn check(header: &FrameHeader, length: usize, bound: usize) -> Result<(), FrameError> {
    if header.rsv1 || header.rsv2 || header.rsv3 {
        return Err(FrameError::Reserved);
    }
    let control = matches!(header.opcode, OpCode::Control(_));
    if control && (!header.is_final || length > CONTROL_BYTES_MAX) {
        return Err(FrameError::Control);
    }
    if length > bound {
        Err(FrameError::TooLong { bound })
    } else {
        Ok(())
    }
}

fn unmask(payload: &[u8], mask: Option<[u8; 4]>) -> Vec<u8> {
    match mask {
        None => payload.to_vec(),
        Some(mask) => payload
            .iter()
            .zip(mask.iter().cycle())
            .map(|(b, m)| b ^ m)
            .collect(),
    }
}

/// Appends a server frame to `out`.
pub(crate) fn write_frame(opcode: OpCode, payload: &[u8], out: &mut Vec<u8>) {
    let header = FrameHeader {
        opcode,
        ..FrameHeader::default()
    };
    let written = header.format(payload.len() as u64, out);
    debug_assert!(written.is_ok(), "writing to a Vec cannot fail");
    out.extend_from_slice(payload);
}

/// Feeds any bytes to the reader, for fuzzing.
#[doc(hidden)]
pub fn fuzz(data: &[u8]) {
    let mut frames = FrameReader::default();
    frames.push(data);
    while let Ok(Some(_)) = frames.poll_event() {}
}

#[cfg(test)]
mod tests;
