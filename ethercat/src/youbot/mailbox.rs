//! TMCL requests of one drive, one at a time, through the master's mailbox while the cycle runs. What was lost is
//! asked again. What a request means is its asker's business.
//!
//! ```text
//!          1 call              2 poll                3 reply
//! Free -----------> Due -----------------> Asked -----------------> Answered --4 the same call, or two polls--> Free
//!                    ^                       |
//!                    +---- 5 time-out, or no reply to this; up to three times
//! ```
//! 1 and 4 in [`Mailbox::call`] and [`Mailbox::poll`], 2 in [`Mailbox::poll`], 3 and 5 in [`Mailbox::handle_reply`].
//! Before 2 a mailbox that saw a time-out lets 100 ms pass: an answer that comes late is there by then, and the
//! master throws it away.

use std::time::Duration;

use super::tmcl::{Answer, Refusal, Request};
use crate::master::{Job, JobError, JobKind, Master, Reply};

/// Longest mailbox, bytes.
const ROOM: usize = 1486;
/// How often a request is asked before it fails.
const ATTEMPTS: u8 = 4;
/// How long late answers are waited for.
const SETTLE: Duration = Duration::from_millis(100);

/// Why there is no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    /// The drive refused it.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// It did not get there or back, whatever often it was asked.
    #[error("{0}")]
    Lost(JobError),
}

type Outcome = Result<Answer, CallError>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Free,
    Due(Request),
    Asked(Request),
    /// Nobody has fetched it for so many polls.
    Answered(Request, Outcome, u8),
}

/// The TMCL mailbox of a drive.
#[derive(Debug)]
pub struct Mailbox {
    slave: usize,
    state: State,
    /// Lent to the master while a request is under way.
    memory: Option<Vec<u8>>,
    attempts: u8,
    not_before: Duration,
    repeats: u64,
}

impl Mailbox {
    /// That of a slave, by its number with the master.
    #[must_use]
    pub fn new(slave: usize) -> Self {
        Self {
            slave,
            state: State::Free,
            memory: Some(Vec::with_capacity(ROOM)),
            attempts: 0,
            not_before: Duration::ZERO,
            repeats: 0,
        }
    }

    /// Number of the slave.
    #[must_use]
    pub const fn slave(&self) -> usize {
        self.slave
    }

    /// How often a request was asked again.
    #[must_use]
    pub const fn repeats(&self) -> u64 {
        self.repeats
    }

    /// To be called with the same request in every cycle until its outcome is there. Nothing, too, while another
    /// request is under way.
    pub fn call(&mut self, request: Request) -> Option<Outcome> {
        match self.state {
            State::Free => self.state = State::Due(request),
            State::Answered(to, outcome, _) if to == request => {
                self.state = State::Free;
                return Some(outcome);
            }
            State::Due(_) | State::Asked(_) | State::Answered(..) => {}
        }
        None
    }

    /// Once a cycle, behind all calls: an outcome that nobody fetched for two cycles is forgotten, a request that is due goes to the
    /// master.
    pub fn poll(&mut self, master: &mut Master, now: Duration) {
        match self.state {
            State::Answered(request, outcome, 0) => {
                self.state = State::Answered(request, outcome, 1);
            }
            State::Answered(..) => self.state = State::Free,
            State::Due(request) if now >= self.not_before => self.submit(request, master),
            State::Free | State::Due(_) | State::Asked(_) => {}
        }
    }

    fn submit(&mut self, request: Request, master: &mut Master) {
        let Some(mut data) = self.memory.take() else {
            return;
        };
        data.clear();
        data.extend_from_slice(&request.encode());
        let job = Job {
            slave: self.slave,
            kind: JobKind::RawMailbox,
            data,
            token: 0,
        };
        match master.submit(job) {
            Ok(()) => self.state = State::Asked(request),
            Err(Reply { job, result }) => {
                self.memory = Some(job.data);
                match result {
                    // The next cycle tries again.
                    Ok(()) | Err(JobError::Busy(_)) => {}
                    Err(error) => self.end(request, Err(CallError::Lost(error))),
                }
            }
        }
    }

    /// A reply of the master to a job for this slave.
    pub fn handle_reply(&mut self, reply: Reply, now: Duration) {
        let Reply { job, result } = reply;
        if let State::Asked(request) = self.state {
            let outcome = match result {
                Ok(()) => request.answer(&job.data).map_err(CallError::Refused),
                Err(error) => Err(CallError::Lost(error)),
            };
            let lost = matches!(
                outcome,
                Err(CallError::Lost(JobError::Timeout(_)) | CallError::Refused(Refusal::Foreign))
            );
            if lost {
                self.not_before = now + SETTLE;
            }
            self.attempts += u8::from(lost);
            if lost && self.attempts < ATTEMPTS {
                self.repeats += 1;
                self.state = State::Due(request);
            } else {
                if self.attempts > 0 {
                    self.not_before = now + SETTLE;
                }
                self.end(request, outcome);
            }
        }
        self.memory = Some(job.data);
    }

    /// The request that is due, answered so.
    #[cfg(test)]
    pub(super) fn pretend(&mut self, outcome: Outcome) -> Option<Request> {
        let State::Due(request) = self.state else {
            return None;
        };
        self.end(request, outcome);
        Some(request)
    }

    fn end(&mut self, request: Request, outcome: Outcome) {
        self.attempts = 0;
        self.state = State::Answered(request, outcome, 0);
    }
}
