//! SDO server on an object dictionary. Serves one client at a time by expedited, segmented and
//! block transfer, and aborts after a timeout of the client.

use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address, Dictionary, Hooks};

use super::buffer::Buffer;
use super::{BLOCK_MAX, BlockSegment, Bytes, Initiate, Message, Request, Response};

/// State of a transfer.
///
/// ```text
///              Download (segmented)          last segment
/// Idle  ------------------------> Download -------------> Idle
///    |--- Upload (longer than 4) --> Upload ------------> Idle
///    |--- BlockDownload --> BlockDownload -- last --> BlockDownloadEnd -- end --> Idle
///    |--- BlockUpload --> BlockReady -- go --> BlockUpload -- all acked --> BlockUploadEnd --> Idle
/// any ---- abort, timeout or unexpected message ----> Idle
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    Download {
        toggle: bool,
        size: Option<usize>,
    },
    Upload {
        toggle: bool,
        at: usize,
    },
    BlockDownload {
        crc: bool,
        size: Option<usize>,
        sequence: u8,
    },
    BlockDownloadEnd {
        crc: bool,
        size: Option<usize>,
    },
    BlockReady {
        crc: bool,
        block: u8,
    },
    /// Segments of the current block, which starts at byte `start`, are sent up to `sequence`.
    BlockUpload {
        crc: bool,
        block: u8,
        start: usize,
        sequence: u8,
    },
    BlockUploadEnd,
}

/// An SDO server.
#[derive(Clone, Debug)]
pub struct Server {
    state: State,
    address: Address,
    /// The transferred value.
    value: Buffer,
    /// Time of the client's last message.
    last_received: Duration,
    timeout: Duration,
    /// Segments per block that it accepts.
    block: u8,
}

impl Server {
    /// A server with this maximum value length (at most [`super::TRANSFER_MAX`]) that aborts when a client is silent
    /// for `timeout`.
    pub fn new(transfer_max: usize, timeout: Duration) -> Self {
        Self {
            state: State::Idle,
            address: Address::default(),
            value: Buffer::new(transfer_max),
            last_received: Duration::ZERO,
            timeout,
            block: BLOCK_MAX,
        }
    }

    /// Whether no transfer is running.
    pub fn is_idle(&self) -> bool {
        self.state == State::Idle
    }

    /// Drops a transfer without an abort, as reset communication does.
    pub const fn reset(&mut self) {
        self.state = State::Idle;
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

    /// Handles a message of the client; returns the response.
    pub fn handle<H: Hooks>(
        &mut self,
        message: &Message,
        dictionary: &mut Dictionary,
        hooks: &mut H,
        now: Duration,
    ) -> Option<Message> {
        self.last_received = now;
        if let State::BlockDownload { .. } = self.state
            && message[0] != 0x80
        {
            return self.block_segment(message).map(|answer| answer.encode());
        }
        let request = Request::decode(message);
        let answered = match request {
            Some(Request::Abort { .. }) => {
                self.state = State::Idle;
                return None;
            }
            Some(request) => self.answer(request, dictionary, hooks),
            None => Err(AbortCode::CommandSpecifier),
        };
        match answered {
            Ok(answer) => answer.map(|answer| answer.encode()),
            Err(code) => Some(self.abort(code)),
        }
    }

    /// The next message without a request: a segment of a block, or an abort after a timeout. To be
    /// called until it returns nothing.
    pub fn poll(&mut self, now: Duration) -> Option<Message> {
        if let Some(segment) = self.next_segment() {
            return Some(segment);
        }
        let late = self.state != State::Idle && now >= self.last_received + self.timeout;
        late.then(|| self.abort(AbortCode::TimedOut))
    }

    fn abort(&mut self, code: AbortCode) -> Message {
        self.state = State::Idle;
        let address = self.address;
        Response::Abort { address, code }.encode()
    }

    fn answer<H: Hooks>(
        &mut self,
        request: Request,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<Option<Response>, AbortCode> {
        Ok(Some(match request {
            Request::Download { address, data } => {
                self.begin(address);
                self.download(data, dictionary, hooks)?
            }
            Request::DownloadSegment { toggle, last, data } => {
                self.download_segment(toggle, last, &data, dictionary, hooks)?
            }
            Request::Upload { address } => {
                self.begin(address);
                self.fetch(dictionary, hooks)?;
                self.upload()
            }
            Request::UploadSegment { toggle } => self.upload_segment(toggle)?,
            Request::BlockDownload { address, crc, size } => {
                self.begin(address);
                self.block_download(crc, size, dictionary)?
            }
            Request::BlockDownloadEnd { unused, crc } => {
                self.block_download_end(unused, crc, dictionary, hooks)?
            }
            Request::BlockUpload {
                address,
                crc,
                block,
                switch,
            } => {
                self.begin(address);
                self.fetch(dictionary, hooks)?;
                self.block_upload(crc, block, switch)?
            }
            Request::BlockUploadStart => {
                self.block_start()?;
                return Ok(None);
            }
            Request::BlockUploadAck { sequence, block } => {
                return self.block_ack(sequence, block);
            }
            Request::BlockUploadEnd => {
                if self.state != State::BlockUploadEnd {
                    return Err(AbortCode::CommandSpecifier);
                }
                self.state = State::Idle;
                return Ok(None);
            }
            Request::Abort { .. } => return Ok(None),
        }))
    }

    fn begin(&mut self, address: Address) {
        self.state = State::Idle;
        self.address = address;
        self.value.clear();
    }

    fn download<H: Hooks>(
        &mut self,
        data: Initiate,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<Response, AbortCode> {
        let address = self.address;
        match data {
            Initiate::Expedited(data) => {
                dictionary.download(address, data.as_slice(), hooks)?;
            }
            Initiate::Segmented(size) => {
                let size = self.check_begin(size, dictionary)?;
                self.state = State::Download {
                    toggle: false,
                    size,
                };
            }
        }
        Ok(Response::Download { address })
    }

    /// Checks before the first data: the object, and the indicated size.
    fn check_begin(
        &self,
        size: Option<u32>,
        dictionary: &Dictionary,
    ) -> Result<Option<usize>, AbortCode> {
        let size = self.value.announced(size)?;
        match dictionary.check_download(self.address, &[]) {
            Err(code @ (AbortCode::NoObject | AbortCode::NoSubIndex | AbortCode::ReadOnly)) => {
                Err(code)
            }
            _ => Ok(size),
        }
    }

    /// Writes the received value if it has the indicated size.
    fn store<H: Hooks>(
        &mut self,
        size: Option<usize>,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<(), AbortCode> {
        match size {
            Some(size) if self.value.len() > size => Err(AbortCode::TooLong),
            Some(size) if self.value.len() < size => Err(AbortCode::TooShort),
            _ => dictionary.download(self.address, self.value.as_slice(), hooks),
        }
    }

    fn download_segment<H: Hooks>(
        &mut self,
        toggle: bool,
        last: bool,
        data: &Bytes,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<Response, AbortCode> {
        let State::Download {
            toggle: expected,
            size,
        } = self.state
        else {
            return Err(AbortCode::CommandSpecifier);
        };
        if toggle != expected {
            return Err(AbortCode::Toggle);
        }
        self.value.put(data.as_slice())?;
        self.state = State::Download {
            toggle: !toggle,
            size,
        };
        if last {
            self.state = State::Idle;
            self.store(size, dictionary, hooks)?;
        }
        Ok(Response::DownloadSegment { toggle })
    }

    /// Reads the value into the buffer, so that it does not change during the transfer.
    fn fetch<H: Hooks>(
        &mut self,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<(), AbortCode> {
        let value = dictionary.upload(self.address, hooks)?;
        self.value.set(value)
    }

    fn upload(&mut self) -> Response {
        let address = self.address;
        let data = if (1..=4).contains(&self.value.len()) {
            Initiate::Expedited(Bytes::new(self.value.as_slice()))
        } else {
            self.state = State::Upload {
                toggle: false,
                at: 0,
            };
            Initiate::Segmented(Some(self.value.size()))
        };
        Response::Upload { address, data }
    }

    fn upload_segment(&mut self, toggle: bool) -> Result<Response, AbortCode> {
        let State::Upload {
            toggle: expected,
            at,
        } = self.state
        else {
            return Err(AbortCode::CommandSpecifier);
        };
        if toggle != expected {
            return Err(AbortCode::Toggle);
        }
        let (data, last) = self.value.segment(at);
        let at = at + data.as_slice().len();
        self.state = if last {
            State::Idle
        } else {
            State::Upload {
                toggle: !toggle,
                at,
            }
        };
        Ok(Response::UploadSegment { toggle, last, data })
    }

    fn block_download(
        &mut self,
        crc: bool,
        size: Option<u32>,
        dictionary: &Dictionary,
    ) -> Result<Response, AbortCode> {
        let size = self.check_begin(size, dictionary)?;
        self.state = State::BlockDownload {
            crc,
            size,
            sequence: 0,
        };
        Ok(Response::BlockDownload {
            address: self.address,
            crc: true,
            block: self.block,
        })
    }

    /// Handles a segment of a block. Drops one out of sequence; the acknowledgement at the end of
    /// the block indicates where to repeat.
    fn block_segment(&mut self, message: &Message) -> Option<Response> {
        let State::BlockDownload {
            crc,
            size,
            sequence,
        } = self.state
        else {
            return None;
        };
        let segment = BlockSegment::decode(message)?;
        let mut good = sequence;
        let in_turn = segment.sequence == sequence + 1;
        if in_turn {
            if self.value.put(&segment.data).is_err() {
                return Some(self.refuse(AbortCode::OutOfMemory));
            }
            good = segment.sequence;
        }
        self.state = State::BlockDownload {
            crc,
            size,
            sequence: good,
        };
        if !(segment.last || segment.sequence >= self.block) {
            return None;
        }
        self.state = if segment.last && in_turn {
            State::BlockDownloadEnd { crc, size }
        } else {
            State::BlockDownload {
                crc,
                size,
                sequence: 0,
            }
        };
        Some(Response::BlockDownloadAck {
            sequence: good,
            block: self.block,
        })
    }

    fn refuse(&mut self, code: AbortCode) -> Response {
        self.state = State::Idle;
        Response::Abort {
            address: self.address,
            code,
        }
    }

    fn block_download_end<H: Hooks>(
        &mut self,
        unused: u8,
        received: u16,
        dictionary: &mut Dictionary,
        hooks: &mut H,
    ) -> Result<Response, AbortCode> {
        let State::BlockDownloadEnd { crc: checked, size } = self.state else {
            return Err(AbortCode::CommandSpecifier);
        };
        self.value.drop_last(unused);
        if checked && self.value.crc() != received {
            return Err(AbortCode::Crc);
        }
        self.state = State::Idle;
        self.store(size, dictionary, hooks)?;
        Ok(Response::BlockDownloadEnd)
    }

    fn block_upload(&mut self, crc: bool, block: u8, switch: u8) -> Result<Response, AbortCode> {
        if !(1..=BLOCK_MAX).contains(&block) {
            return Err(AbortCode::BlockSize);
        }
        // A value up to the protocol switch threshold may use a normal upload.
        if self.value.len() <= usize::from(switch) {
            return Ok(self.upload());
        }
        self.state = State::BlockReady { crc, block };
        Ok(Response::BlockUpload {
            address: self.address,
            crc: true,
            size: Some(self.value.size()),
        })
    }

    fn block_start(&mut self) -> Result<(), AbortCode> {
        let State::BlockReady { crc, block } = self.state else {
            return Err(AbortCode::CommandSpecifier);
        };
        self.state = State::BlockUpload {
            crc,
            block,
            start: 0,
            sequence: 0,
        };
        Ok(())
    }

    /// Whether the current block has unsent segments.
    fn has_segment(&self) -> bool {
        let State::BlockUpload {
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

    fn next_segment(&mut self) -> Option<Message> {
        if !self.has_segment() {
            return None;
        }
        let State::BlockUpload {
            start, sequence, ..
        } = &mut self.state
        else {
            return None;
        };
        *sequence += 1;
        Some(self.value.block_segment(*start, *sequence).encode())
    }

    /// Handles the client's acknowledgement: sends the next block, or repeats from there.
    fn block_ack(&mut self, acked: u8, next: u8) -> Result<Option<Response>, AbortCode> {
        let State::BlockUpload {
            crc: checked,
            start,
            sequence,
            ..
        } = self.state
        else {
            return Err(AbortCode::CommandSpecifier);
        };
        if acked > sequence {
            return Err(AbortCode::SequenceNumber);
        }
        if !(1..=BLOCK_MAX).contains(&next) {
            return Err(AbortCode::BlockSize);
        }
        let start = start + 7 * usize::from(acked);
        if start >= self.value.len() {
            self.state = State::BlockUploadEnd;
            let unused = self.value.unused(start);
            let crc = if checked { self.value.crc() } else { 0 };
            return Ok(Some(Response::BlockUploadEnd { unused, crc }));
        }
        self.state = State::BlockUpload {
            crc: checked,
            block: next,
            start,
            sequence: 0,
        };
        Ok(None)
    }
}
