//! The jobs of a slave: queueing, start and end, and the dispatch of its mailbox messages. What a job does on the wire
//! is in [`super::operation`] and [`super::transfer`].

use super::super::event::{EmergencyReport, JobError, Outbox};
use super::super::job::{Job, Reply};
use super::mailbox::Output;
use super::{Context, Unit, transfer};

/// Maximum number of waiting jobs per slave.
pub(super) const JOBS_MAX: usize = 16;
/// Marks the transfers that the steps make.
pub(super) const OWN: usize = usize::MAX;

impl Unit {
    /// Queues a job; a full queue returns it.
    pub(in crate::master) fn submit(&mut self, job: Job) -> Result<(), Reply> {
        let error = if self.jobs.len() == JOBS_MAX {
            JobError::Busy(JOBS_MAX)
        } else if !self.is_present() {
            JobError::Absent
        } else {
            self.jobs.push_back(job);
            return Ok(());
        };
        Err(Reply {
            job,
            result: Err(error),
        })
    }

    /// Ends all jobs.
    pub(in crate::master) fn abandon(&mut self, out: &mut Outbox) {
        if let Some(transfer) = self.mailbox.reset() {
            self.give_back(transfer.into_job(), Err(JobError::Absent), out);
        }
        if let Some(job) = self.job.take() {
            self.give_back(job, Err(JobError::Absent), out);
        }
        while let Some(job) = self.jobs.pop_front() {
            self.give_back(job, Err(JobError::Absent), out);
        }
    }

    /// Replies to a job; the buffer of a step's own transfer is kept for the next.
    pub(super) fn give_back(&mut self, job: Job, result: Result<(), JobError>, out: &mut Outbox) {
        if job.slave == OWN {
            self.scratch = job.data;
        } else {
            out.reply(Reply { job, result });
        }
    }

    pub(super) fn begin_job(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let mailbox = self.jobs.front().map(|job| job.kind.is_mailbox());
        if mailbox.is_none_or(|mailbox| mailbox && !self.mailbox.is_free()) {
            return;
        }
        let Some(job) = self.jobs.pop_front() else {
            return;
        };
        if mailbox == Some(true) {
            let kind = job.kind;
            if let Some(output) = self.mailbox.begin(
                transfer::Transfer::new(job),
                kind,
                cx.mailbox_capacity(),
                cx.now,
            ) {
                self.handle_mailbox(output, cx, out);
            }
            return;
        }
        self.begin_register_job(job, cx, out);
    }

    pub(super) fn handle_mailbox(&mut self, output: Output, cx: &Context<'_>, out: &mut Outbox) {
        match output {
            Output::Emergency(emergency) => out.emergency(EmergencyReport {
                slave: self.number,
                emergency,
                at: cx.now,
            }),
            Output::Done(transfer, result) => {
                let address = transfer.address();
                let job = transfer.into_job();
                if job.slave == OWN {
                    self.scratch = job.data;
                    self.transfer_done(address, result, cx, out);
                } else {
                    out.reply(Reply { job, result });
                }
            }
        }
    }

    /// Unsolicited messages of the mailbox, and repeat requests.
    pub(in crate::master) const fn mailbox_counters(&self) -> (u32, u32) {
        (self.mailbox.ignored, self.mailbox.repeated)
    }
}
