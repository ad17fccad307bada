//! The jobs of a slave: those that wait, the one whose operation runs, and the buffer of the steps' own transfers.

use std::collections::VecDeque;

use super::super::event::{JobError, Outbox};
use super::super::job::{Job, Reply};
use crate::config::SlaveSpec;

/// Maximum number of waiting jobs per slave.
const JOBS_MAX: usize = 16;
/// Marks the transfers that the steps make.
pub(super) const OWN: usize = usize::MAX;

/// The jobs of a slave.
#[derive(Debug)]
pub(super) struct Jobs {
    pub(super) waiting: VecDeque<Job>,
    /// A register job, while its operation runs.
    pub(super) current: Option<Job>,
    /// Buffer for the transfers of the steps.
    pub(super) scratch: Vec<u8>,
}

impl Jobs {
    pub(super) fn new(spec: &SlaveSpec) -> Self {
        Self {
            waiting: VecDeque::with_capacity(JOBS_MAX),
            current: None,
            scratch: Self::buffer(spec),
        }
    }

    /// The buffer for a slave with that configuration.
    pub(super) fn buffer(spec: &SlaveSpec) -> Vec<u8> {
        let lens = spec.startup.iter().map(|sdo| sdo.data.len());
        Vec::with_capacity(lens.max().unwrap_or(0).max(16))
    }

    /// Queues a job of a slave that is present; a full queue returns it.
    pub(super) fn submit(&mut self, job: Job, is_present: bool) -> Result<(), Reply> {
        let error = if self.waiting.len() == JOBS_MAX {
            JobError::Busy(JOBS_MAX)
        } else if !is_present {
            JobError::Absent
        } else {
            self.waiting.push_back(job);
            return Ok(());
        };
        Err(Reply {
            job,
            result: Err(error),
        })
    }

    /// Replies to a job; the buffer of a step's own transfer is kept for the next.
    pub(super) fn give_back(&mut self, job: Job, result: Result<(), JobError>, out: &mut Outbox) {
        if job.slave == OWN {
            self.scratch = job.data;
        } else {
            out.reply(Reply { job, result });
        }
    }

    /// Ends the job whose operation was aborted.
    pub(super) fn abort_current(&mut self, out: &mut Outbox) {
        if let Some(job) = self.current.take() {
            self.give_back(job, Err(JobError::Absent), out);
        }
    }

    /// Ends all jobs.
    pub(super) fn abandon(&mut self, out: &mut Outbox) {
        self.abort_current(out);
        while let Some(job) = self.waiting.pop_front() {
            self.give_back(job, Err(JobError::Absent), out);
        }
    }
}
