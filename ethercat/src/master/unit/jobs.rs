//! The jobs of a slave: queueing, start and end, and the dispatch of its mailbox messages. What a job does on the wire
//! is in [`super::operation`] and [`super::transfer`].

use super::super::event::{EmergencyReport, JobError, Outbox};
use super::super::job::{Job, Reply};
use super::mailbox::Output;
use super::queue::OWN;
use super::{Context, EthernetCounters, Unit, transfer};

impl Unit {
    /// Queues a job; a full queue returns it.
    pub(in crate::master) fn submit(&mut self, job: Job) -> Result<(), Reply> {
        self.jobs.submit(job, self.is_present())
    }

    /// Ends all jobs.
    pub(in crate::master) fn abandon(&mut self, out: &mut Outbox) {
        if let Some(transfer) = self.mailbox.reset() {
            self.jobs
                .give_back(transfer.into_job(), Err(JobError::Absent), out);
        }
        self.jobs.abandon(out);
    }

    pub(super) fn begin_job(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let mailbox = self.jobs.waiting.front().map(|job| job.kind.is_mailbox());
        if mailbox.is_none_or(|mailbox| mailbox && !self.mailbox.is_free()) {
            return;
        }
        let Some(job) = self.jobs.waiting.pop_front() else {
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
                    self.jobs.scratch = job.data;
                    self.transfer_done(address, result, cx, out);
                } else {
                    out.reply(Reply { job, result });
                }
            }
        }
    }

    /// Bytes of the current transfer so far; `None` without one.
    pub(in crate::master) fn transferred(&self) -> Option<usize> {
        self.mailbox.transferred()
    }

    /// Counters of Ethernet frames; `None` if they are not used.
    pub(in crate::master) fn ethernet_counters(&self) -> Option<EthernetCounters> {
        self.mailbox.ethernet_counters()
    }

    /// Copies the oldest received Ethernet frame to `to`; returns its length.
    pub(in crate::master) fn fetch_ethernet(&mut self, to: &mut [u8]) -> Option<usize> {
        self.mailbox.fetch_ethernet(to)
    }

    /// Unsolicited messages of the mailbox, and repeat requests.
    pub(in crate::master) const fn mailbox_counters(&self) -> (u32, u32) {
        (self.mailbox.ignored, self.mailbox.repeated)
    }
}
