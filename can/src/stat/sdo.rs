//! SDO statistics of one node: requests, responses and errors. A passive observer of both sides; it ignores values.

use std::time::Duration;

use crate::canopen::sdo::{Initiate, Message, Request, Response};
use crate::cia402::dictionary::{AbortCode, Address};

/// Response timeout; clients wait for half a second to some seconds.
const ANSWER_MAX: Duration = Duration::from_secs(1);

/// Aborts of one side: count, and the last one.
pub type Aborts = (u32, Option<(Address, AbortCode)>);

/// Statistics of a node's SDO server and its clients.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SdoStat {
    /// Requests that start a transfer.
    pub requests: u32,
    /// Transfers that succeeded or were aborted by the server.
    pub answered: u32,
    /// Requests without response.
    pub unanswered: u32,
    /// Object of the last one.
    pub unanswered_last: Option<Address>,
    /// Aborts of the server.
    pub refused: Aborts,
    /// Aborts of a client, other than after a timeout.
    pub given_up: Aborts,
    /// Requests repeated before their response.
    pub repeats: u32,
    /// Unsolicited responses.
    pub unsolicited: u32,
    /// Of these, second responses to one request, as of two nodes with one number.
    pub doubled: u32,
    /// Maximum response time.
    pub longest: Duration,
    /// Invalid frames to the server: the bus is not CANopen, or the identifier has another use.
    pub strange: u32,
    state: State,
    /// Object and time of the last response, and requests for it that were repeated before it.
    answered_last: Option<(Address, Duration)>,
    owed: u32,
    /// Time of its last frame.
    last: Duration,
}

/// State of a dialogue.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum State {
    #[default]
    Idle,
    /// A request that starts a transfer.
    Requested(Message, Address, Duration),
    /// After the first response; the client is next.
    Answered(Address),
    /// A segment was sent or requested; whether it is the client's last one.
    Segment(Address, Duration, bool),
    /// The client sends blocks.
    BlockDownload(Address),
    /// The server sends blocks.
    BlockUpload(Address),
}

impl SdoStat {
    /// Whether frames with its identifiers are SDOs: some were answered, or all requests are valid.
    pub const fn is_sdo(&self) -> bool {
        self.requests > 0
            && (self.answered > 0 && self.answered >= self.strange || self.strange == 0)
    }

    /// A block transfer that was broken off without an abort does not hide later ones.
    fn forget_blocks(&mut self, at: Duration) {
        let blocks = matches!(self.state, State::BlockDownload(_) | State::BlockUpload(_));
        if blocks && at.saturating_sub(self.last) >= ANSWER_MAX {
            self.state = State::Idle;
        }
        self.last = at;
    }

    /// Handles a message of a client.
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
                | State::Requested(..)
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
            State::Requested(before, ..) if before == *message => {
                self.repeats = self.repeats.saturating_add(1);
                self.owed = self.owed.saturating_add(1);
                self.count_unanswered();
            }
            State::Requested(..) | State::Segment(..) => self.count_unanswered(),
            State::Idle | State::Answered(_) | State::BlockDownload(_) | State::BlockUpload(_) => {}
        }
        self.requests = self.requests.saturating_add(1);
        self.state = State::Requested(*message, address, at);
    }

    /// The pending request counts as unanswered.
    const fn count_unanswered(&mut self) {
        if let State::Requested(_, address, _) | State::Segment(address, ..) = self.state {
            self.unanswered = self.unanswered.saturating_add(1);
            self.unanswered_last = Some(address);
        }
        self.state = State::Idle;
    }

    fn client_aborts(&mut self, address: Address, code: AbortCode) {
        if code == AbortCode::TimedOut
            && matches!(self.state, State::Requested(..) | State::Segment(..))
        {
            return self.count_unanswered();
        }
        self.given_up = (self.given_up.0.saturating_add(1), Some((address, code)));
        self.state = State::Idle;
    }

    const fn end(&mut self) {
        self.answered = self.answered.saturating_add(1);
        self.state = State::Idle;
    }

    /// Handles a message of the server. Returns the confirmed download, if expedited.
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
                self.answered_last = Some((address, at));
                self.end();
            }
            (State::Requested(request, address, since), Some(response))
                if about == Some(address) =>
            {
                self.answered_last = Some((address, at));
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
            _ => self.surplus(about, at),
        }
        None
    }

    /// Handles a response without request.
    fn surplus(&mut self, about: Option<Address>, at: Duration) {
        self.unsolicited = self.unsolicited.saturating_add(1);
        let is_second = self.answered_last.is_some_and(|(address, since)| {
            Some(address) == about && at.saturating_sub(since) < ANSWER_MAX
        });
        match self.owed.checked_sub(1) {
            Some(owed) if is_second => self.owed = owed,
            Some(_) | None => self.doubled = self.doubled.saturating_add(u32::from(is_second)),
        }
    }

    /// Handles a segment response.
    fn segment(&mut self, address: Address, time: Duration, last: bool) {
        self.longest = self.longest.max(time);
        self.state = State::Answered(address);
        if last {
            self.end();
        }
    }

    /// Handles the first response of a transfer.
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
                // Expedited: the request contained all data.
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
            | Response::Abort { .. } => self.unsolicited = self.unsolicited.saturating_add(1),
        }
        None
    }

    /// State at the end of the recording: requests older than the timeout are unanswered.
    pub(super) fn at(mut self, now: Duration) -> Self {
        if let State::Requested(.., since) | State::Segment(_, since, _) = self.state
            && now.saturating_sub(since) >= ANSWER_MAX
        {
            self.count_unanswered();
        }
        self
    }
}

/// Whether a request is valid: reserved bits are 0 and the object can exist. Distinguishes frames of other protocols
/// with these identifiers.
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
