//! LSS master: one job at a time, each with requests and their response or timeout. A fast scan
//! takes 133 requests and must not run in an operational network.

use std::time::Duration;

use super::{
    ACTIVATE_TIMING, FAST_SCAN, IDENTIFIED, IDENTIFIED_NONE, IDENTIFY_NONE, INQUIRE, INQUIRE_NODE,
    Identity, Message, Mode, NO_NODE, SCAN_RESET, SELECT, SELECTED, SET_NODE, SET_TIMING, STORE,
    SWITCH_GLOBAL, number, short, with_number,
};
use crate::canopen::NodeId;

/// Jobs of a master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Job {
    /// Switch all slaves to that mode. Unconfirmed.
    Switch(Mode),
    /// Switch the slave with that address to configuration mode.
    Select(Identity),
    /// Set the node number of the slave in configuration mode; `None` removes it.
    SetNode(Option<NodeId>),
    /// Set its bit timing: index of table 0 of CiA 305 (0: 1000, 1: 800, 2: 500, 3: 250, 4: 125, 6:
    /// 50, 7: 20, 8: 10 kbit/s).
    SetBitTiming(u8),
    /// Activate the new bit timing of all slaves in configuration mode after this delay, ms.
    ActivateBitTiming(u16),
    /// Store its configuration.
    Store,
    /// Inquire its address.
    Inquire,
    /// Inquire its node number.
    InquireNode,
    /// Check for slaves without a node number.
    IdentifyUnconfigured,
    /// Find one slave without a node number and switch it to configuration mode. Known parts of its
    /// address shorten the search.
    FastScan([Option<u32>; 4]),
}

/// Result of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// Done.
    Done,
    /// The inquired or found address.
    Address(Identity),
    /// The inquired node number.
    Node(Option<NodeId>),
    /// Whether a slave answered.
    Present(bool),
}

/// Why a job failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LssError {
    /// No slave answered.
    #[error(
        "no LSS slave answered: is one in configuration mode (or, for a scan, without a node \
         number), and is the bit rate right?"
    )]
    Silent,
    /// The slave reported an error.
    #[error("the LSS slave reported error {error}, specific error {specific}")]
    Refused {
        /// 1: out of range or not supported; 2 (store): no access to the medium; FFh: specific.
        error: u8,
        /// Manufacturer-specific error code.
        specific: u8,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Is any unconfigured slave present?
    Presence,
    /// Is this bit 0?
    Bit(u8),
    /// Is this the whole number?
    Whole,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle,
    /// Sending the messages of a job, starting with this one; the last one may have a response.
    Sending(u8),
    Waiting(u8),
    Scan {
        phase: Phase,
        sub: u8,
        sent: bool,
    },
}

/// An LSS master.
///
/// ```text
///       start            all sent           response or timeout
/// Idle -------> Sending ----------> Waiting -------------------> Idle (outcome)
///   \---------> Scan: presence -> bit 31 .. 0 -> whole, four times -> Idle (outcome)
/// ```
#[derive(Clone, Debug)]
pub struct Master {
    timeout: Duration,
    job: Job,
    state: State,
    since: Duration,
    found: [u32; 4],
    /// A slave answered the request of a scan. All slaves may answer one after the other, so the master waits for the
    /// whole timeout: a late response would be taken for one to the next request.
    answered: bool,
    outcome: Option<Result<Reply, LssError>>,
}

impl Master {
    /// A master with this response timeout; a scan takes 133 times the timeout, because all slaves may answer each
    /// request.
    pub const fn new(timeout: Duration) -> Self {
        Self {
            timeout,
            job: Job::Switch(Mode::Waiting),
            state: State::Idle,
            since: Duration::ZERO,
            found: [0; 4],
            answered: false,
            outcome: None,
        }
    }

    /// Whether no job is running.
    pub fn is_idle(&self) -> bool {
        self.state == State::Idle
    }

    /// Starts a job; a running one is dropped.
    pub const fn start(&mut self, job: Job) {
        self.job = job;
        self.outcome = None;
        (self.found, self.answered) = ([0; 4], false);
        self.state = match job {
            Job::FastScan(_) => State::Scan {
                phase: Phase::Presence,
                sub: 0,
                sent: false,
            },
            Job::Switch(_)
            | Job::Select(_)
            | Job::SetNode(_)
            | Job::SetBitTiming(_)
            | Job::ActivateBitTiming(_)
            | Job::Store
            | Job::Inquire
            | Job::InquireNode
            | Job::IdentifyUnconfigured => State::Sending(0),
        };
    }

    /// Result of the last job; returned once.
    pub const fn take_outcome(&mut self) -> Option<Result<Reply, LssError>> {
        self.outcome.take()
    }

    /// The next frame to send.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Message> {
        let silent = now >= self.since + self.timeout;
        match self.state {
            State::Idle => None,
            State::Sending(at) => self.send(at, now),
            State::Waiting(_) if silent => {
                self.end(if self.job == Job::IdentifyUnconfigured {
                    Ok(Reply::Present(false))
                } else {
                    Err(LssError::Silent)
                });
                None
            }
            State::Waiting(_) => None,
            State::Scan { sent: true, .. } if !silent => None,
            State::Scan { sent: true, .. } => {
                let answered = std::mem::take(&mut self.answered);
                self.handle_scan_result(answered);
                self.poll_transmit(now)
            }
            State::Scan { phase, sub, .. } => {
                self.since = now;
                let sent = true;
                self.state = State::Scan { phase, sub, sent };
                Some(self.scan_request(phase, sub))
            }
        }
    }

    /// When [`Self::poll_transmit`] has something to do.
    pub fn poll_timeout(&self) -> Option<Duration> {
        match self.state {
            State::Idle => None,
            State::Sending(_) | State::Scan { sent: false, .. } => Some(Duration::ZERO),
            State::Waiting(_) | State::Scan { sent: true, .. } => Some(self.since + self.timeout),
        }
    }

    fn end(&mut self, outcome: Result<Reply, LssError>) {
        self.state = State::Idle;
        self.outcome = Some(outcome);
    }

    /// The next message of a job, and whether it is the last.
    fn message(&self, at: u8) -> (Message, bool) {
        let last = |message| (message, true);
        match self.job {
            Job::Switch(mode) => last(short(
                SWITCH_GLOBAL,
                u8::from(mode == Mode::Configuration),
                0,
            )),
            Job::Select(identity) => {
                let number = identity.numbers()[usize::from(at & 3)];
                (with_number(SELECT + at, number), at >= 3)
            }
            Job::SetNode(node) => last(short(SET_NODE, node.map_or(NO_NODE, NodeId::raw), 0)),
            Job::SetBitTiming(index) => last(short(SET_TIMING, 0, index)),
            Job::ActivateBitTiming(delay) => {
                let [low, high] = delay.to_le_bytes();
                last(short(ACTIVATE_TIMING, low, high))
            }
            Job::Store => last(short(STORE, 0, 0)),
            // Each with its own response.
            Job::Inquire => last(short(INQUIRE + at, 0, 0)),
            Job::InquireNode => last(short(INQUIRE_NODE, 0, 0)),
            Job::IdentifyUnconfigured | Job::FastScan(_) => last(short(IDENTIFY_NONE, 0, 0)),
        }
    }

    fn send(&mut self, at: u8, now: Duration) -> Option<Message> {
        let (message, last) = self.message(at);
        self.since = now;
        if !last {
            self.state = State::Sending(at + 1);
        } else if matches!(self.job, Job::Switch(_) | Job::ActivateBitTiming(_)) {
            self.end(Ok(Reply::Done));
        } else {
            self.state = State::Waiting(at);
        }
        Some(message)
    }

    /// Handles a message of a slave.
    pub fn handle(&mut self, message: &Message) {
        match self.state {
            State::Waiting(at) => self.answered(at, message),
            State::Scan { sent: true, .. } => self.answered |= message[0] == IDENTIFIED,
            State::Idle | State::Sending(_) | State::Scan { sent: false, .. } => {}
        }
    }

    fn answered(&mut self, at: u8, message: &Message) {
        let [command, error, specific, ..] = *message;
        match (self.job, command) {
            (Job::Select(_), SELECTED) => self.end(Ok(Reply::Done)),
            (Job::SetNode(_), SET_NODE)
            | (Job::SetBitTiming(_), SET_TIMING)
            | (Job::Store, STORE) => {
                self.end(if error == 0 {
                    Ok(Reply::Done)
                } else {
                    Err(LssError::Refused { error, specific })
                });
            }
            (Job::Inquire, _) if command == INQUIRE + at => {
                if let Some(found) = self.found.get_mut(usize::from(at)) {
                    *found = number(message);
                }
                if at < 3 {
                    self.state = State::Sending(at + 1);
                } else {
                    self.end(Ok(Reply::Address(Identity::from_numbers(self.found))));
                }
            }
            (Job::InquireNode, INQUIRE_NODE) => {
                self.end(Ok(Reply::Node(NodeId::new(error).ok())));
            }
            (Job::IdentifyUnconfigured, IDENTIFIED_NONE) => self.end(Ok(Reply::Present(true))),
            _ => {}
        }
    }

    fn scan_request(&self, phase: Phase, sub: u8) -> Message {
        let number = self.found[usize::from(sub & 3)];
        let (bit, next) = match phase {
            Phase::Presence => (SCAN_RESET, 0),
            Phase::Bit(bit) => (bit, sub),
            Phase::Whole => (0, (sub + 1) & 3),
        };
        let [a, b, c, d] = number.to_le_bytes();
        [FAST_SCAN, a, b, c, d, bit, sub, next]
    }

    /// Evaluates whether a request of a scan was answered.
    fn handle_scan_result(&mut self, answered: bool) {
        let State::Scan { phase, sub, .. } = self.state else {
            return;
        };
        let next = match phase {
            Phase::Presence | Phase::Whole if !answered => {
                self.end(Err(LssError::Silent));
                return;
            }
            Phase::Presence => self.begin(0),
            Phase::Whole if sub >= 3 => {
                self.end(Ok(Reply::Address(Identity::from_numbers(self.found))));
                return;
            }
            Phase::Whole => self.begin(sub + 1),
            Phase::Bit(bit) => {
                if !answered {
                    self.found[usize::from(sub & 3)] |= 1 << bit;
                }
                let phase = bit.checked_sub(1).map_or(Phase::Whole, Phase::Bit);
                (phase, sub)
            }
        };
        let (phase, sub) = next;
        let sent = false;
        self.state = State::Scan { phase, sub, sent };
    }

    /// Starts the search for one of the four numbers, unless it is known.
    fn begin(&mut self, sub: u8) -> (Phase, u8) {
        let at = usize::from(sub & 3);
        let known = match self.job {
            Job::FastScan(known) => known[at],
            Job::Switch(_)
            | Job::Select(_)
            | Job::SetNode(_)
            | Job::SetBitTiming(_)
            | Job::ActivateBitTiming(_)
            | Job::Store
            | Job::Inquire
            | Job::InquireNode
            | Job::IdentifyUnconfigured => None,
        };
        self.found[at] = known.unwrap_or(0);
        (known.map_or(Phase::Bit(31), |_| Phase::Whole), sub)
    }
}
