//! SDO dialogues of one node as they were seen: requests, answers, and what was amiss between the two. It follows the
//! messages of both sides without taking part, and knows no values.

use std::time::Duration;

use crate::canopen::sdo::{Initiate, Message, Request, Response};
use crate::cia402::dictionary::{AbortCode, Address};

/// An answer that takes longer does not come: clients wait for half a second to some seconds.
const ANSWER_MAX: Duration = Duration::from_secs(1);

/// An abort: how often either side sent one, and the last.
pub type Aborts = (u32, Option<(Address, AbortCode)>);

/// What is known of one node's SDO server and its clients.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SdoStat {
    /// Requests that begin a transfer.
    pub requests: u32,
    /// Transfers that came to a good end or were refused: the server answered.
    pub answered: u32,
    /// Requests without an answer.
    pub unanswered: u32,
    /// The object of the last one of these.
    pub unanswered_last: Option<Address>,
    /// Aborts of the server.
    pub refused: Aborts,
    /// Aborts of a client, other than after silence.
    pub given_up: Aborts,
    /// The same request again before its answer.
    pub repeats: u32,
    /// Answers that belong to no request.
    pub unasked: u32,
    /// Longest time from a request to its answer.
    pub longest: Duration,
    /// Frames to the server that are no SDO: this is no CANopen bus, or the identifier is used otherwise.
    pub strange: u32,
    state: State,
    /// When the last of its frames was seen.
    last: Duration,
}

/// Where a dialogue is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum State {
    #[default]
    Idle,
    /// A request that begins a transfer.
    Asked(Message, Address, Duration),
    /// The first answer came; the client's turn.
    Answered(Address),
    /// A segment was sent or asked for; it is the last one that the client sends.
    Segment(Address, Duration, bool),
    /// The client sends blocks.
    BlockDownload(Address),
    /// The server sends blocks.
    BlockUpload(Address),
}

impl SdoStat {
    /// Whether frames with its identifiers are SDOs: some were answered, or all that a client sent are well made.
    #[must_use]
    pub const fn is_sdo(&self) -> bool {
        self.requests > 0
            && (self.answered > 0 && self.answered >= self.strange || self.strange == 0)
    }

    /// A transfer in blocks that was broken off without a word does not hide what comes later.
    fn forget_blocks(&mut self, at: Duration) {
        let blocks = matches!(self.state, State::BlockDownload(_) | State::BlockUpload(_));
        if blocks && at.saturating_sub(self.last) >= ANSWER_MAX {
            self.state = State::Idle;
        }
        self.last = at;
    }

    /// From a client.
    pub(super) fn handle_request(&mut self, message: &Message, at: Duration) {
        self.forget_blocks(at);
        if let State::BlockDownload(_) = self.state
            && message[0] != 0x80
        {
            return;
        }
        match Request::decode(message) {
            Some(Request::Abort { address, code }) => self.client_aborts(address, code),
            Some(
                Request::Upload { address }
                | Request::Download { address, .. }
                | Request::BlockUpload { address, .. }
                | Request::BlockDownload { address, .. },
            ) if is_well_made(message) => self.begin(message, address, at),
            Some(
                request @ (Request::DownloadSegment { .. }
                | Request::UploadSegment { .. }
                | Request::BlockDownloadEnd { .. }),
            ) => match self.state {
                State::Answered(address) | State::Segment(address, ..) => {
                    let last = matches!(request, Request::DownloadSegment { last: true, .. });
                    self.state = State::Segment(address, at, last);
                }
                State::Idle
                | State::Asked(..)
                | State::BlockDownload(_)
                | State::BlockUpload(_) => self.strange = self.strange.saturating_add(1),
            },
            Some(Request::BlockUploadEnd) if matches!(self.state, State::BlockUpload(_)) => {
                self.end();
            }
            Some(Request::BlockUploadStart | Request::BlockUploadAck { .. })
                if matches!(self.state, State::BlockUpload(_)) => {}
            Some(_) | None => self.strange = self.strange.saturating_add(1),
        }
    }

    fn begin(&mut self, message: &Message, address: Address, at: Duration) {
        match self.state {
            State::Asked(before, ..) if before == *message => {
                self.repeats = self.repeats.saturating_add(1);
                self.lose();
            }
            State::Asked(..) | State::Segment(..) => self.lose(),
            State::Idle | State::Answered(_) | State::BlockDownload(_) | State::BlockUpload(_) => {}
        }
        self.requests = self.requests.saturating_add(1);
        self.state = State::Asked(*message, address, at);
    }

    /// What was asked gets no answer any more.
    const fn lose(&mut self) {
        if let State::Asked(_, address, _) | State::Segment(address, ..) = self.state {
            self.unanswered = self.unanswered.saturating_add(1);
            self.unanswered_last = Some(address);
        }
        self.state = State::Idle;
    }

    fn client_aborts(&mut self, address: Address, code: AbortCode) {
        if code == AbortCode::TimedOut
            && matches!(self.state, State::Asked(..) | State::Segment(..))
        {
            return self.lose();
        }
        self.given_up = (self.given_up.0.saturating_add(1), Some((address, code)));
        self.state = State::Idle;
    }

    const fn end(&mut self) {
        self.answered = self.answered.saturating_add(1);
        self.state = State::Idle;
    }

    /// From the server. Returns the download that it confirms, if it is one of up to four bytes.
    pub(super) fn handle_response(
        &mut self,
        message: &Message,
        at: Duration,
    ) -> Option<(Address, [u8; 4])> {
        self.forget_blocks(at);
        if let State::BlockUpload(_) = self.state
            && message[0] != 0x80
        {
            return None;
        }
        let response = Response::decode(message);
        let about = response.as_ref().and_then(Response::address);
        match (self.state, response) {
            (state, Some(Response::Abort { address, code })) if state != State::Idle => {
                self.refused = (self.refused.0.saturating_add(1), Some((address, code)));
                self.end();
            }
            (State::Asked(request, address, since), Some(response)) if about == Some(address) => {
                self.longest = self.longest.max(at.saturating_sub(since));
                return self.answer(&request, address, response);
            }
            (State::Segment(address, since, last), Some(Response::DownloadSegment { .. })) => {
                self.segment(address, at.saturating_sub(since), last);
            }
            (State::Segment(address, since, _), Some(Response::UploadSegment { last, .. })) => {
                self.segment(address, at.saturating_sub(since), last);
            }
            (State::Segment(address, since, _), Some(Response::BlockDownloadEnd)) => {
                self.segment(address, at.saturating_sub(since), true);
            }
            (State::BlockDownload(_), Some(Response::BlockDownloadAck { .. })) => {}
            (State::BlockDownload(_), Some(Response::BlockDownloadEnd)) => self.end(),
            _ => self.unasked = self.unasked.saturating_add(1),
        }
        None
    }

    /// A segment was answered.
    fn segment(&mut self, address: Address, time: Duration, last: bool) {
        self.longest = self.longest.max(time);
        self.state = State::Answered(address);
        if last {
            self.end();
        }
    }

    /// The first answer of a transfer.
    fn answer(
        &mut self,
        request: &Message,
        address: Address,
        response: Response,
    ) -> Option<(Address, [u8; 4])> {
        match response {
            Response::Upload {
                data: Initiate::Expedited(_),
                ..
            } => self.end(),
            Response::Upload { .. } => self.state = State::Answered(address),
            Response::Download { .. } => {
                // Expedited: all of it was in the request.
                if request[0] & 0x02 == 0 {
                    self.state = State::Answered(address);
                    return None;
                }
                self.end();
                let [.., a, b, c, d] = *request;
                return Some((address, [a, b, c, d]));
            }
            Response::BlockDownload { .. } => self.state = State::BlockDownload(address),
            Response::BlockUpload { .. } => self.state = State::BlockUpload(address),
            Response::DownloadSegment { .. }
            | Response::UploadSegment { .. }
            | Response::BlockDownloadAck { .. }
            | Response::BlockDownloadEnd
            | Response::BlockUploadEnd { .. }
            | Response::Abort { .. } => self.unasked = self.unasked.saturating_add(1),
        }
        None
    }

    /// As it is at the end of the recording: what waits for an answer for long gets none.
    pub(super) fn at(mut self, now: Duration) -> Self {
        if let State::Asked(.., since) | State::Segment(_, since, _) = self.state
            && now.saturating_sub(since) >= ANSWER_MAX
        {
            self.lose();
        }
        self
    }
}

/// Whether a request that begins a transfer is one: bits that are reserved are 0, and its object can be. Frames of
/// other protocols under these identifiers are told apart by that.
fn is_well_made(message: &Message) -> bool {
    let index = u16::from_le_bytes([message[1], message[2]]);
    let reserved = match message[0] >> 5 {
        1 => 0x10,
        2 => 0x1F,
        5 => 0x1B,
        6 => 0x18,
        _ => 0,
    };
    index >= 0x1000 && message[0] & reserved == 0
}
