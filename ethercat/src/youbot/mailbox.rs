//! TMCL requests of one drive, one at a time, through the master's mailbox while the cycle runs. Lost requests are
//! repeated. The meaning of a request is up to the caller.
//!
//! ```text
//!          1 call              2 poll                3 reply
//! Free -----------> Due -----------------> Sent ------------------> Answered --4 the same call, or two polls--> Free
//!                    ^                       |
//!                    +---- 5 timeout, or another reply; up to three times
//! ```
//! 1 and 4 in [`Mailbox::call`] and [`Mailbox::poll`], 2 in [`Mailbox::poll`], 3 and 5 in [`Mailbox::handle_reply`].
//! After a timeout, 2 is delayed by 100 ms: a late answer has arrived by then, and the master discards it.

use std::time::Duration;

use super::tmcl::{Answer, Request, TmclError};
use crate::master::{Job, JobError, JobKind, Master, Reply};

/// Longest mailbox, bytes.
const MAILBOX_MAX: usize = 1486;
/// Maximum number of attempts of a request.
const ATTEMPTS: u8 = 4;
/// Delay for late answers.
const SETTLE: Duration = Duration::from_millis(100);

/// Why a request failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    /// The drive refused it.
    #[error(transparent)]
    Refused(#[from] TmclError),
    /// It or its answer was lost in all attempts.
    #[error("{0}")]
    Lost(JobError),
}

type Outcome = Result<Answer, CallError>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Free,
    Due(Request),
    Sent(Request),
    /// Number of polls since it was available.
    Answered(Request, Outcome, u8),
}

/// The TMCL mailbox of a drive.
#[derive(Debug)]
pub struct Mailbox {
    slave: usize,
    state: State,
    /// Lent to the master while a request is pending.
    memory: Option<Vec<u8>>,
    attempts: u8,
    not_before: Duration,
    repeats: u64,
}

impl Mailbox {
    /// The mailbox of a slave, by its number at the master.
    pub fn new(slave: usize) -> Self {
        Self {
            slave,
            state: State::Free,
            memory: Some(Vec::with_capacity(MAILBOX_MAX)),
            attempts: 0,
            not_before: Duration::ZERO,
            repeats: 0,
        }
    }

    /// Number of the slave.
    pub const fn slave(&self) -> usize {
        self.slave
    }

    /// Number of repeated requests.
    pub const fn repeats(&self) -> u64 {
        self.repeats
    }

    /// Call it with the same request in every cycle until it returns the outcome. It also returns `None` while another
    /// request is pending.
    pub fn call(&mut self, request: Request) -> Option<Outcome> {
        match self.state {
            State::Free => self.state = State::Due(request),
            State::Answered(to, outcome, _) if to == request => {
                self.state = State::Free;
                return Some(outcome);
            }
            State::Due(_) | State::Sent(_) | State::Answered(..) => {}
        }
        None
    }

    /// Call it once per cycle, after all calls: an outcome not fetched for two cycles is dropped, a due request goes to
    /// the master.
    pub fn poll(&mut self, master: &mut Master, now: Duration) {
        match self.state {
            State::Answered(request, outcome, 0) => {
                self.state = State::Answered(request, outcome, 1);
            }
            State::Answered(..) => self.state = State::Free,
            State::Due(request) if now >= self.not_before => self.submit(request, master),
            State::Free | State::Due(_) | State::Sent(_) => {}
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
            Ok(()) => self.state = State::Sent(request),
            Err(Reply { job, result }) => {
                self.memory = Some(job.data);
                match result {
                    // Retried in the next cycle.
                    Ok(()) | Err(JobError::Busy(_)) => {}
                    Err(error) => self.end(request, Err(CallError::Lost(error))),
                }
            }
        }
    }

    /// Handles a reply of the master to a job for this slave.
    pub fn handle_reply(&mut self, reply: Reply, now: Duration) {
        let Reply { job, result } = reply;
        if let State::Sent(request) = self.state {
            let outcome = match result {
                Ok(()) => request.answer(&job.data).map_err(CallError::Refused),
                Err(error) => Err(CallError::Lost(error)),
            };
            let lost = matches!(
                outcome,
                Err(CallError::Lost(JobError::Timeout(_)) | CallError::Refused(TmclError::Foreign))
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

    /// Ends the current request with this outcome.
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
