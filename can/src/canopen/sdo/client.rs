//! SDO client: one read or write at a time, expedited or segmented depending on the length, or in
//! blocks if requested.

use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address};

use super::buffer::Buffer;
use super::{BLOCK_MAX, BlockSegment, Bytes, Initiate, Message, Request, Response};

/// Outcome of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The value was read; see [`Client::value`].
    Read,
    /// The value was written.
    Written,
    /// The server aborted.
    Refused(AbortCode),
    /// The client aborted: the response was invalid or missing ([`AbortCode::TimedOut`]).
    GaveUp(AbortCode),
}

/// Result of a message of the server, or of a timeout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Message to send.
    pub send: Option<Message>,
    /// The transfer has ended.
    pub outcome: Option<Outcome>,
}

impl Progress {
    fn send(request: &Request) -> Self {
        Self {
            send: Some(request.encode()),
            outcome: None,
        }
    }

    const fn over(outcome: Outcome) -> Self {
        Self {
            send: None,
            outcome: Some(outcome),
        }
    }
}

/// State of a transfer, named by the expected response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    Download,
    DownloadSegment {
        toggle: bool,
        at: usize,
    },
    Upload,
    UploadSegment {
        toggle: bool,
        size: Option<usize>,
    },
    BlockDownload,
    /// Sending segments of a block that starts at byte `start`; after the last one it waits for the
    /// acknowledgement.
    BlockDownloadAck {
        crc: bool,
        block: u8,
        start: usize,
        sequence: u8,
    },
    BlockDownloadEnd,
    BlockUpload,
    BlockUploadSegment {
        crc: bool,
        size: Option<usize>,
        sequence: u8,
    },
    BlockUploadEnd {
        crc: bool,
        size: Option<usize>,
    },
}

/// An SDO client.
#[derive(Clone, Debug)]
pub struct Client {
    state: State,
    address: Address,
    value: Buffer,
    last_received: Duration,
    timeout: Duration,
}

impl Client {
    /// A client with this maximum value length (at most [`super::TRANSFER_MAX`]) and response timeout.
    pub fn new(transfer_max: usize, timeout: Duration) -> Self {
        Self {
            state: State::Idle,
            address: Address::default(),
            value: Buffer::new(transfer_max),
            last_received: Duration::ZERO,
            timeout,
        }
    }

    /// Whether no transfer is running.
    pub fn is_idle(&self) -> bool {
        self.state == State::Idle
    }

    /// The object of the current or last transfer.
    pub const fn address(&self) -> Address {
        self.address
    }

    /// The value read so far.
    pub fn value(&self) -> &[u8] {
        self.value.as_slice()
    }

    /// Starts a read; returns the message to send. A running transfer is dropped.
    pub fn read(&mut self, address: Address, in_blocks: bool, now: Duration) -> Message {
        (self.address, self.last_received) = (address, now);
        self.value.clear();
        if in_blocks {
            self.state = State::BlockUpload;
            let (block, switch) = (BLOCK_MAX, 0);
            let crc = true;
            return Request::BlockUpload {
                address,
                crc,
                block,
                switch,
            }
            .encode();
        }
        self.state = State::Upload;
        Request::Upload { address }.encode()
    }

    /// Starts a write; returns the message to send. A running transfer is dropped.
    ///
    /// # Errors
    /// If the value exceeds the maximum length of the client.
    pub fn write(
        &mut self,
        address: Address,
        value: &[u8],
        in_blocks: bool,
        now: Duration,
    ) -> Result<Message, AbortCode> {
        self.value.set(value)?;
        (self.address, self.last_received) = (address, now);
        let size = u32::try_from(value.len()).ok();
        if in_blocks {
            self.state = State::BlockDownload;
            let crc = true;
            return Ok(Request::BlockDownload { address, crc, size }.encode());
        }
        self.state = State::Download;
        let data = if (1..=4).contains(&value.len()) {
            Initiate::Expedited(Bytes::new(value))
        } else {
            Initiate::Segmented(size)
        };
        Ok(Request::Download { address, data }.encode())
    }

    /// Latest time of the next [`Self::poll`].
    pub fn poll_timeout(&self) -> Option<Duration> {
        if self.state == State::Idle {
            return None;
        }
        let wait = if self.has_segment() {
            Duration::ZERO
        } else {
            self.timeout
        };
        Some(self.last_received + wait)
    }

    /// The next message without a response: a segment of a block, or an abort after a timeout. To
    /// be called until it returns nothing.
    pub fn poll(&mut self, now: Duration) -> Progress {
        if self.has_segment() {
            return self.next_segment();
        }
        if self.state == State::Idle || now < self.last_received + self.timeout {
            return Progress::default();
        }
        self.give_up(AbortCode::TimedOut)
    }

    /// Aborts the transfer; returns the abort message.
    pub fn give_up(&mut self, code: AbortCode) -> Progress {
        self.state = State::Idle;
        let address = self.address;
        Progress {
            send: Some(Request::Abort { address, code }.encode()),
            outcome: Some(Outcome::GaveUp(code)),
        }
    }

    /// Handles a message of the server. Ignored without a running transfer.
    pub fn handle(&mut self, message: &Message, now: Duration) -> Progress {
        if self.state == State::Idle {
            return Progress::default();
        }
        self.last_received = now;
        if let State::BlockUploadSegment { .. } = self.state
            && message[0] != 0x80
        {
            return self.block_segment(message);
        }
        match Response::decode(message) {
            // The response to an aborted request: the current one is still pending.
            Some(response)
                if response
                    .address()
                    .is_some_and(|about| about != self.address) =>
            {
                Progress::default()
            }
            Some(Response::Abort { code, .. }) => {
                self.state = State::Idle;
                Progress::over(Outcome::Refused(code))
            }
            Some(response) => match self.advance(response) {
                Ok(progress) => progress,
                Err(code) => self.give_up(code),
            },
            None => self.give_up(AbortCode::CommandSpecifier),
        }
    }

    #[expect(clippy::too_many_lines, reason = "the transition table")]
    fn advance(&mut self, response: Response) -> Result<Progress, AbortCode> {
        match (self.state, response) {
            (State::Download, Response::Download { address }) => {
                self.check(address)?;
                if (1..=4).contains(&self.value.len()) {
                    return Ok(self.done(Outcome::Written));
                }
                Ok(self.send_segment(false, 0))
            }
            (
                State::DownloadSegment { toggle, at },
                Response::DownloadSegment { toggle: received },
            ) => {
                if received != toggle {
                    return Err(AbortCode::Toggle);
                }
                if at >= self.value.len() {
                    return Ok(self.done(Outcome::Written));
                }
                Ok(self.send_segment(!toggle, at))
            }
            (State::Upload, Response::Upload { address, data })
            | (State::BlockUpload, Response::Upload { address, data }) => {
                self.check(address)?;
                self.begin_read(data)
            }
            (
                State::UploadSegment { toggle, size },
                Response::UploadSegment {
                    toggle: received,
                    last,
                    data,
                },
            ) => {
                if received != toggle {
                    return Err(AbortCode::Toggle);
                }
                self.value.put(data.as_slice())?;
                if last {
                    self.check_size(size)?;
                    return Ok(self.done(Outcome::Read));
                }
                let toggle = !toggle;
                self.state = State::UploadSegment { toggle, size };
                Ok(Progress::send(&Request::UploadSegment { toggle }))
            }
            (
                State::BlockDownload,
                Response::BlockDownload {
                    address,
                    crc,
                    block,
                },
            ) => {
                self.check(address)?;
                self.next_block(crc, block, 0)
            }
            (
                State::BlockDownloadAck {
                    crc,
                    start,
                    sequence,
                    ..
                },
                Response::BlockDownloadAck {
                    sequence: acked,
                    block,
                },
            ) => {
                if acked > sequence {
                    return Err(AbortCode::SequenceNumber);
                }
                self.next_block(crc, block, start + 7 * usize::from(acked))
            }
            (State::BlockDownloadEnd, Response::BlockDownloadEnd) => {
                Ok(self.done(Outcome::Written))
            }
            (State::BlockUpload, Response::BlockUpload { address, crc, size }) => {
                self.check(address)?;
                let size = self.value.announced(size)?;
                self.state = State::BlockUploadSegment {
                    crc,
                    size,
                    sequence: 0,
                };
                Ok(Progress::send(&Request::BlockUploadStart))
            }
            (
                State::BlockUploadEnd { crc: checked, size },
                Response::BlockUploadEnd {
                    unused,
                    crc: received,
                },
            ) => {
                self.value.drop_last(unused);
                if checked && self.value.crc() != received {
                    return Err(AbortCode::Crc);
                }
                self.check_size(size)?;
                self.state = State::Idle;
                Ok(Progress {
                    send: Some(Request::BlockUploadEnd.encode()),
                    outcome: Some(Outcome::Read),
                })
            }
            _ => Err(AbortCode::CommandSpecifier),
        }
    }

    const fn done(&mut self, outcome: Outcome) -> Progress {
        self.state = State::Idle;
        Progress::over(outcome)
    }

    /// A response for another object belongs to another request.
    fn check(&self, address: Address) -> Result<(), AbortCode> {
        if address == self.address {
            Ok(())
        } else {
            Err(AbortCode::ParameterIncompatible)
        }
    }

    fn check_size(&self, size: Option<usize>) -> Result<(), AbortCode> {
        if size.is_none_or(|size| size == self.value.len()) {
            Ok(())
        } else {
            Err(AbortCode::Length)
        }
    }

    fn begin_read(&mut self, data: Initiate) -> Result<Progress, AbortCode> {
        match data {
            Initiate::Expedited(data) => {
                self.value.put(data.as_slice())?;
                Ok(self.done(Outcome::Read))
            }
            Initiate::Segmented(size) => {
                let size = self.value.announced(size)?;
                let toggle = false;
                self.state = State::UploadSegment { toggle, size };
                Ok(Progress::send(&Request::UploadSegment { toggle }))
            }
        }
    }

    fn send_segment(&mut self, toggle: bool, at: usize) -> Progress {
        let (data, last) = self.value.segment(at);
        let at = at + data.as_slice().len();
        self.state = State::DownloadSegment { toggle, at };
        Progress::send(&Request::DownloadSegment { toggle, last, data })
    }

    /// After the server's start or acknowledgement: the next block, or the end.
    fn next_block(
        &mut self,
        crc_wanted: bool,
        block: u8,
        start: usize,
    ) -> Result<Progress, AbortCode> {
        if !(1..=BLOCK_MAX).contains(&block) {
            return Err(AbortCode::BlockSize);
        }
        // An empty value is one empty segment.
        if start >= self.value.len().max(1) {
            self.state = State::BlockDownloadEnd;
            let unused = self.value.unused(start);
            let crc = if crc_wanted { self.value.crc() } else { 0 };
            return Ok(Progress::send(&Request::BlockDownloadEnd { unused, crc }));
        }
        self.state = State::BlockDownloadAck {
            crc: crc_wanted,
            block,
            start,
            sequence: 0,
        };
        Ok(Progress::default())
    }

    fn has_segment(&self) -> bool {
        let State::BlockDownloadAck {
            block,
            start,
            sequence,
            ..
        } = self.state
        else {
            return false;
        };
        self.value.has_segment(start, sequence, block)
    }

    fn next_segment(&mut self) -> Progress {
        let State::BlockDownloadAck {
            start, sequence, ..
        } = &mut self.state
        else {
            return Progress::default();
        };
        *sequence += 1;
        let segment = self.value.block_segment(*start, *sequence);
        Progress {
            send: Some(segment.encode()),
            outcome: None,
        }
    }

    /// Handles a segment of a block; drops one out of sequence and requests it again.
    fn block_segment(&mut self, message: &Message) -> Progress {
        let State::BlockUploadSegment {
            crc,
            size,
            sequence,
        } = self.state
        else {
            return Progress::default();
        };
        let Some(segment) = BlockSegment::decode(message) else {
            return self.give_up(AbortCode::SequenceNumber);
        };
        let in_turn = segment.sequence == sequence + 1;
        let good = if in_turn { segment.sequence } else { sequence };
        if in_turn && self.value.put(&segment.data).is_err() {
            return self.give_up(AbortCode::OutOfMemory);
        }
        let ends = segment.last || segment.sequence >= BLOCK_MAX;
        self.state = match (ends, segment.last && in_turn) {
            (true, true) => State::BlockUploadEnd { crc, size },
            (true, false) => State::BlockUploadSegment {
                crc,
                size,
                sequence: 0,
            },
            (false, _) => State::BlockUploadSegment {
                crc,
                size,
                sequence: good,
            },
        };
        if !ends {
            return Progress::default();
        }
        Progress::send(&Request::BlockUploadAck {
            sequence: good,
            block: BLOCK_MAX,
        })
    }
}
