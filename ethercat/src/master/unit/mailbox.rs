//! The mailbox of a slave, from the master's side (ETG.1000.4, clause 8; ETG.1000.6, clause 5.1): sends a message,
//! polls for the answer, fetches it, requests a repeat if it was lost, and sorts received messages.
//!
//! ```text
//!            1 begin           2 accepted         3 full             4 read
//! Idle ------------> Send ----------> Poll <-------------> Fetch ----------> Idle, Send or Poll
//!   ^                                  ^ 7 repeated          | 5 lost
//!   | 8 timeout, from any              |                     v         6 already read
//!                              RepeatWait <-- RepeatRequest <-- RepeatCheck --(still full)--> Fetch
//!                                  | 9 never repeated
//!                                  v
//!                                 Send (a request that may be repeated)
//! ```
//!
//! Slaves must repeat a lost message (ETG.1000.4, clause 8.4.3), but not all do. A request that may be repeated is then
//! sent again, as it is if there is no answer at all.

mod port;

use std::time::Duration;

use super::super::event::JobError;
use super::super::job::JobKind;
use super::datagram::{Answer, Request};
use super::ethernet::Ethernet;
use super::transfer::{Progress, Transfer, protocol};
use crate::config::Timeouts;
use crate::register;
use crate::sii::MailboxAreas;
use crate::{CoeService, Emergency, MailboxError, MailboxHeader, MailboxKind, SyncManager};

/// Longest mailbox that is used, bytes: the capacity of one datagram.
const LEN_MAX: usize = 1486;
/// Timeout of a requested repeat: firmware has its answers ready within 40 ms.
const REPEAT_TIMEOUT: Duration = Duration::from_millis(150);
/// Maximum number of attempts for a request that may be repeated.
const ATTEMPTS: u8 = 3;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    Clear,
    Discard,
    Send,
    Poll,
    Fetch,
    RepeatCheck,
    RepeatRequest,
    RepeatWait,
}

/// Output of a mailbox.
#[derive(Debug)]
pub(super) enum Output {
    /// An emergency.
    Emergency(Emergency),
    /// The transfer has ended.
    Done(Transfer, Result<(), JobError>),
}

/// The mailbox of a slave.
#[derive(Debug)]
pub(super) struct Mailbox {
    areas: MailboxAreas,
    /// Protocols, as in SII word 1Ch.
    protocols: u16,
    phase: Phase,
    message: Box<[u8; LEN_MAX]>,
    /// Counters of the last sent and the last received message.
    counters: (u8, u8),
    /// A digest of the last received message, to detect one that is fetched twice.
    received: u64,
    /// The requested value of the repeat bit.
    repeat: bool,
    transfer: Option<Transfer>,
    since: Duration,
    /// Time of the last repeat request.
    repeat_since: Duration,
    /// Number of attempts of the transfer.
    attempts: u8,
    timeouts: Timeouts,
    /// Received Ethernet frames; `None` if they are not used.
    ethernet: Option<Ethernet>,
    /// Number of the last Ethernet frame sent, 0 to 15.
    frame: u8,
    /// The slave accepted the pending fragment of an Ethernet frame.
    accepted: bool,
    /// Number of unsolicited messages.
    pub(super) ignored: u32,
    /// Number of repeat requests and of repeated requests.
    pub(super) repeated: u32,
}

impl Mailbox {
    pub(super) fn new(timeouts: Timeouts) -> Self {
        Self {
            areas: MailboxAreas::default(),
            protocols: 0,
            phase: Phase::Idle,
            message: Box::new([0; LEN_MAX]),
            counters: (0, 0),
            received: 0,
            repeat: false,
            transfer: None,
            since: Duration::ZERO,
            repeat_since: Duration::ZERO,
            attempts: 0,
            timeouts,
            ethernet: None,
            frame: 0,
            accepted: false,
            ignored: 0,
            repeated: 0,
        }
    }

    /// Sets the timeouts for answers.
    pub(super) const fn set_timeouts(&mut self, timeouts: Timeouts) {
        self.timeouts = timeouts;
    }

    /// Sets its areas and protocols.
    pub(super) const fn configure(&mut self, areas: MailboxAreas, protocols: u16) {
        (self.areas, self.protocols) = (areas, protocols);
    }

    pub(super) fn exists(&self) -> bool {
        let fits = |len: u16| usize::from(len) > MailboxHeader::LEN && usize::from(len) <= LEN_MAX;
        fits(self.areas.receive_len) && fits(self.areas.send_len)
    }

    pub(super) fn speaks_coe(&self) -> bool {
        self.speaks(MailboxKind::Coe)
    }

    /// Whether its SII announces a protocol.
    fn speaks(&self, kind: MailboxKind) -> bool {
        let bit = match kind {
            MailboxKind::Aoe => 0x01,
            MailboxKind::Eoe => 0x02,
            MailboxKind::Coe => 0x04,
            MailboxKind::Foe => 0x08,
            MailboxKind::Soe => 0x10,
            MailboxKind::Voe => 0x20,
            MailboxKind::Error | MailboxKind::Other(_) => 0,
        };
        self.exists() && self.protocols & bit != 0
    }

    /// Bytes of the current transfer so far; `None` without one.
    pub(super) fn transferred(&self) -> Option<usize> {
        self.transfer.as_ref().map(Transfer::transferred)
    }

    /// Whether a transfer can begin.
    pub(super) const fn is_free(&self) -> bool {
        self.transfer.is_none()
    }

    /// Whether it is idle.
    pub(super) const fn is_idle(&self) -> bool {
        matches!(self.phase, Phase::Idle) && self.transfer.is_none()
    }

    /// The set-up of both SyncManagers, written in INIT.
    pub(super) fn sync_managers(&self) -> [u8; 16] {
        let sm = |start, len, control| {
            let sm = SyncManager {
                start,
                len,
                control,
                activate: 1,
                ..SyncManager::default()
            };
            sm.encode()
        };
        let MailboxAreas {
            receive,
            receive_len,
            send,
            send_len,
        } = self.areas;
        let mut bytes = [0; 16];
        let (out, back) = bytes.split_at_mut(8);
        out.copy_from_slice(&sm(receive, receive_len, SyncManager::MAILBOX_OUT));
        back.copy_from_slice(&sm(send, send_len, SyncManager::MAILBOX_IN));
        bytes
    }

    /// Resets, as the slave does in INIT; returns the aborted transfer.
    pub(super) fn reset(&mut self) -> Option<Transfer> {
        self.phase = Phase::Idle;
        // A slave that lost only its link still knows the counter of the last message, and would take a message with
        // the same counter for a repetition.
        self.counters.1 = 0;
        self.repeat = false;
        if let Some(ethernet) = &mut self.ethernet {
            ethernet.reset();
        }
        self.transfer.take()
    }

    /// Length of the longer of its two areas, bytes; zero if there are none.
    pub(super) fn size(&self) -> usize {
        if self.exists() {
            self.areas.receive_len.max(self.areas.send_len).into()
        } else {
            0
        }
    }

    /// Starts a transfer with datagrams of at most `capacity` bytes. Call it only if the mailbox is free.
    pub(super) fn begin(
        &mut self,
        mut transfer: Transfer,
        kind: JobKind,
        capacity: usize,
        now: Duration,
    ) -> Option<Output> {
        let missing = match protocol(kind) {
            Some(kind) if !self.speaks(kind) => Some(kind.name()),
            None if !self.exists() => Some("mailbox"),
            Some(_) | None => None,
        };
        if let Some(missing) = missing {
            return Some(Output::Done(transfer, Err(JobError::Unsupported(missing))));
        }
        let size = self.size();
        if size > capacity {
            return Some(Output::Done(
                transfer,
                Err(JobError::MailboxTooLong { size, capacity }),
            ));
        }
        if transfer.streams() {
            self.frame = (self.frame + 1) % 16;
            if let Err(error) = transfer.begin_frame(self.frame) {
                return Some(Output::Done(transfer, Err(error)));
            }
        }
        let raw = transfer.is_raw();
        self.transfer = Some(transfer);
        self.attempts = 1;
        let output = self.send(now);
        if raw && output.is_none() {
            self.phase = Phase::Clear;
        }
        output
    }

    /// Whether the current transfer is raw, without mailbox headers.
    fn is_raw(&self) -> bool {
        self.transfer.as_ref().is_some_and(Transfer::is_raw)
    }

    /// Fetches an unsolicited message if the mailbox is full.
    pub(super) const fn check_full(&mut self, full: bool, now: Duration) {
        if full && matches!(self.phase, Phase::Idle) {
            (self.phase, self.since) = (Phase::Fetch, now);
        }
    }

    fn send(&mut self, now: Duration) -> Option<Output> {
        self.since = now;
        (self.phase, self.accepted) = (Phase::Send, false);
        let len = usize::from(self.areas.receive_len);
        let transfer = self.transfer.as_mut()?;
        let written = self.message.get_mut(..len).and_then(|message| {
            message.fill(0);
            if transfer.is_raw() {
                return transfer.copy_raw(message);
            }
            let (header, inside) = message.split_first_chunk_mut::<{ MailboxHeader::LEN }>()?;
            let len = u16::try_from(transfer.write(inside)?).ok()?;
            self.counters.0 = MailboxHeader::next_counter(self.counters.0);
            let (kind, counter) = (transfer.mailbox_kind(), self.counters.0);
            *header = MailboxHeader {
                len,
                address: 0,
                kind,
                counter,
            }
            .encode();
            Some(())
        });
        if written.is_none() {
            return self.end(Err(JobError::TooLong {
                size: 0,
                capacity: len,
            }));
        }
        None
    }

    /// Nothing is left to read: continues with what is pending.
    fn resume(&mut self, now: Duration) -> Option<Output> {
        self.phase = Phase::Idle;
        match &self.transfer {
            None => None,
            Some(transfer) if !transfer.streams() => {
                self.phase = Phase::Poll;
                None
            }
            Some(_) if self.accepted => self.send(now),
            Some(_) => {
                self.phase = Phase::Send;
                None
            }
        }
    }

    fn end(&mut self, result: Result<(), JobError>) -> Option<Output> {
        self.phase = Phase::Idle;
        self.transfer
            .take()
            .map(|transfer| Output::Done(transfer, result))
    }

    /// Handles timeouts: ends the transfer or repeats its request.
    pub(super) fn check(&mut self, now: Duration) -> Option<Output> {
        if self.phase == Phase::Idle {
            return None;
        }
        let timeout = if self.is_raw() {
            self.timeouts.raw
        } else {
            self.timeouts.mailbox
        };
        let again = self.attempts < ATTEMPTS && self.may_restart();
        // All attempts together take no longer than one request that must not be repeated.
        let budget = if again || self.attempts > 1 {
            timeout / u32::from(ATTEMPTS)
        } else {
            timeout
        };
        let waited = now.saturating_sub(self.since);
        let unrepeated = self.phase == Phase::RepeatWait
            && now.saturating_sub(self.repeat_since) > REPEAT_TIMEOUT;
        if waited <= budget && !(again && unrepeated) {
            return None;
        }
        if self.transfer.is_none() {
            self.phase = Phase::Idle;
            return None;
        }
        if !again {
            return self.end(Err(JobError::Timeout(timeout)));
        }
        self.attempts += 1;
        self.repeated += 1;
        if let Some(transfer) = &mut self.transfer {
            transfer.restart();
        }
        self.send(now)
    }

    fn may_restart(&self) -> bool {
        self.transfer.as_ref().is_some_and(Transfer::may_restart)
    }

    /// The next datagram.
    pub(super) fn request(&self) -> Option<Request<'_>> {
        let sm1 = register::SYNC_MANAGER + 8;
        Some(match self.phase {
            Phase::Idle => return None,
            Phase::Send => {
                let data = self.message.get(..self.areas.receive_len.into())?;
                Request::write(self.areas.receive, data)
            }
            Phase::Clear | Phase::Poll | Phase::RepeatCheck | Phase::RepeatWait => {
                Request::read(sm1, 8)
            }
            Phase::Discard | Phase::Fetch => Request::read(self.areas.send, self.areas.send_len),
            Phase::RepeatRequest => {
                Request::write(sm1 + 6, if self.repeat { &[0x03] } else { &[0x01] })
            }
        })
    }

    /// Handles its result.
    pub(super) fn answer(&mut self, answer: Answer<'_>, now: Duration) -> Option<Output> {
        let Answer::Data { counter, data } = answer else {
            // Whether the slave accepted it is unknown: a message is sent again with the same counter; for one that was
            // being fetched a repeat is requested.
            if self.phase == Phase::Fetch {
                self.phase = Phase::RepeatCheck;
            }
            if self.phase == Phase::Send && self.is_raw() {
                self.phase = Phase::Poll;
            }
            return None;
        };
        let done = counter > 0;
        let sm = data
            .first_chunk()
            .map(SyncManager::decode)
            .unwrap_or_default();
        match self.phase {
            Phase::Idle => None,
            Phase::Clear | Phase::Discard => {
                self.cleared(done, sm);
                None
            }
            Phase::Send => self.sent(done),
            Phase::Poll if done && sm.is_full() => {
                self.phase = Phase::Fetch;
                None
            }
            Phase::Poll if done && self.streams() => self.resume(now),
            Phase::Poll => None,
            Phase::Fetch if done => self.received(data, now),
            Phase::Fetch => self.resume(now),
            Phase::RepeatCheck => {
                if done {
                    self.repeat = sm.activate & 0x02 == 0;
                    self.phase = if sm.is_full() {
                        Phase::Fetch
                    } else {
                        Phase::RepeatRequest
                    };
                }
                None
            }
            Phase::RepeatRequest => {
                if done {
                    self.repeated += 1;
                    (self.phase, self.repeat_since) = (Phase::RepeatWait, now);
                }
                None
            }
            Phase::RepeatWait => {
                if done && (sm.pdi & 0x02 != 0) == self.repeat {
                    self.phase = if sm.is_full() {
                        Phase::Fetch
                    } else {
                        Phase::Poll
                    };
                }
                None
            }
        }
    }

    /// Discards the content of the mailbox before a raw message is sent.
    const fn cleared(&mut self, done: bool, sm: SyncManager) {
        self.phase = match self.phase {
            Phase::Clear if !done => Phase::Clear,
            Phase::Clear if sm.is_full() => Phase::Discard,
            Phase::Clear => Phase::Send,
            Phase::Discard
            | Phase::Idle
            | Phase::Send
            | Phase::Poll
            | Phase::Fetch
            | Phase::RepeatCheck
            | Phase::RepeatRequest
            | Phase::RepeatWait => {
                self.ignored += done as u32;
                Phase::Clear
            }
        };
    }

    /// The slave accepted the message, or its mailbox is still full.
    fn sent(&mut self, taken: bool) -> Option<Output> {
        if self.streams() {
            return self.sent_fragment(taken);
        }
        if !taken {
            return None;
        }
        self.phase = Phase::Poll;
        let ends = self.transfer.as_ref().and_then(Transfer::ends)?;
        self.end(ends)
    }

    fn received(&mut self, mailbox: &[u8], now: Duration) -> Option<Output> {
        let waiting = if self.transfer.is_some() {
            Phase::Poll
        } else {
            Phase::Idle
        };
        self.phase = waiting;
        if let Some(transfer) = self.transfer.as_mut().filter(|transfer| transfer.is_raw()) {
            let progress = transfer.handle_raw(mailbox);
            return self.proceed(progress, now);
        }
        let header = MailboxHeader::decode(mailbox);
        // A slave without protocols sends no headers either.
        let Some((header, inside)) = header.filter(|_| self.protocols != 0) else {
            self.ignored += 1;
            return None;
        };
        // Firmware that copies the counter of the request may give a new message the previous counter.
        let digest = digest(mailbox.get(..MailboxHeader::LEN + usize::from(header.len)));
        let twice = header.counter == self.counters.1 && digest == self.received;
        if header.counter != 0 && twice {
            // Fetched twice: the repeat arrived after all.
            return None;
        }
        (self.counters.1, self.received) = (header.counter, digest);
        match header.kind {
            MailboxKind::Coe => self.received_coe(inside, now),
            MailboxKind::Error => match MailboxError::decode(inside) {
                Some(error) if self.transfer.is_some() => {
                    self.proceed(Transfer::handle_error(error), now)
                }
                Some(_) | None => {
                    self.ignored += 1;
                    None
                }
            },
            MailboxKind::Foe if self.transfer.is_some() => {
                let len = usize::from(self.areas.send_len);
                let transfer = self.transfer.as_mut();
                let progress = transfer.map(|transfer| transfer.handle_file(inside, len));
                self.proceed(progress.unwrap_or(Progress::Ignored), now)
            }
            MailboxKind::Eoe => self.received_eoe(inside, now),
            MailboxKind::Aoe
            | MailboxKind::Foe
            | MailboxKind::Soe
            | MailboxKind::Voe
            | MailboxKind::Other(_) => {
                self.ignored += 1;
                None
            }
        }
    }

    fn received_coe(&mut self, inside: &[u8], now: Duration) -> Option<Output> {
        let (service, bytes) = CoeService::decode(inside)?;
        if service == CoeService::Emergency {
            // Unsolicited; the current transfer keeps waiting.
            return Emergency::decode(bytes).map(Output::Emergency);
        }
        let progress = match &mut self.transfer {
            Some(transfer) => transfer.handle(service, bytes),
            None => Progress::Ignored,
        };
        self.proceed(progress, now)
    }

    fn proceed(&mut self, progress: Progress, now: Duration) -> Option<Output> {
        match progress {
            Progress::Ignored => {
                self.ignored += 1;
                None
            }
            Progress::Next => self.send(now),
            Progress::More => {
                self.since = now;
                None
            }
            Progress::Done(result) => self.end(result),
        }
    }
}

/// FNV-1a over a message.
fn digest(message: Option<&[u8]>) -> u64 {
    let bytes = message.unwrap_or_default().iter();
    bytes.fold(0xCBF2_9CE4_8422_2325, |digest, byte| {
        (digest ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01B3)
    })
}
