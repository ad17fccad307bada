//! The steps that use the mailbox: start-up objects, PDO assignment, and reading it back.

use takt_cia402::dictionary::{AbortCode, Address};

use super::super::event::{Fault, JobError, Outbox};
use super::super::job::{Job, JobKind};
use super::queue::OWN;
use super::start::Step;
use super::steps::Prepared;
use super::transfer::Transfer;
use super::{Context, Unit, learn};
use crate::coe::Whole;

impl Unit {
    /// Starts a transfer of this step, in the reserved buffer.
    pub(super) fn own(&mut self, kind: JobKind) -> Prepared {
        let data = std::mem::take(&mut self.jobs.scratch);
        let job = Job {
            slave: OWN,
            kind,
            data,
            token: 0,
        };
        Prepared::Transfer(Transfer::new(job))
    }

    pub(super) fn startup(&mut self, at: usize) -> Prepared {
        let Some(sdo) = self.spec.startup.get(at) else {
            return Prepared::Skip;
        };
        let (address, whole) = (sdo.address, sdo.whole);
        self.jobs.scratch.clear();
        self.jobs.scratch.extend_from_slice(&sdo.data);
        self.own(JobKind::Download { address, whole })
    }

    pub(super) fn assignment(&mut self, at: usize) -> Prepared {
        let Some(assignment) = self
            .start
            .assignments
            .get(at)
            .filter(|_| self.start.refused.is_none())
        else {
            return Prepared::Skip;
        };
        let address = assignment.address;
        self.jobs.scratch.clear();
        assignment.bytes(&mut self.jobs.scratch);
        self.own(JobKind::Download {
            address,
            whole: Whole::Entry,
        })
    }

    /// The fault of a refused write of the PDO set-up, with the mapped or assigned object if there is one.
    fn refused_write(&self, at: usize, code: AbortCode) -> Fault {
        let Some(assignment) = self.start.assignments.get(at) else {
            return Fault::Abort {
                address: Address::default(),
                code,
            };
        };
        let address = assignment.address;
        match assignment.entry() {
            Some(entry) => Fault::Entry {
                address,
                entry,
                code,
            },
            None => Fault::Abort { address, code },
        }
    }

    /// Queries the PDOs of a SyncManager; a slave without CoE has those of its SII, a returning one those that it had.
    pub(super) fn query_pdos(&mut self, at: usize) -> Prepared {
        let Some(channel) = self.process.channels.get(at) else {
            return Prepared::Skip;
        };
        if self.mapped || !self.mailbox.speaks_coe() {
            return Prepared::Skip;
        }
        self.start.learn = learn::Learn::new(channel.assignment());
        self.next_question().unwrap_or(Prepared::Skip)
    }

    pub(super) fn next_question(&mut self) -> Option<Prepared> {
        let address = self.start.learn.question()?;
        self.jobs.scratch.clear();
        Some(self.own(JobKind::Upload {
            address,
            whole: Whole::Entry,
        }))
    }

    /// A transfer of this step has ended.
    pub(super) fn transfer_done(
        &mut self,
        address: Address,
        result: Result<(), JobError>,
        cx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let fault = result.err().map(|error| match (error, self.start.step) {
            (JobError::Abort(code), Step::Assign(at)) => self.refused_write(at.into(), code),
            (JobError::Abort(code), _) => Fault::Abort { address, code },
            (error, _) => Fault::Mailbox { address, error },
        });
        match (self.start.step, fault) {
            (Step::Learn(at), None) => self.learnt(at.into(), cx, out),
            // No such list: the slave has the PDOs of its SII.
            (Step::Learn(at), Some(Fault::Abort { .. })) if self.start.learn.is_at_list() => {
                self.verify(at.into(), cx, out);
            }
            (Step::Startup(at), Some(_)) if self.may_fail(at.into()) => {
                self.enter(self.following(self.start.step), cx, out);
            }
            // The slave may have the wanted PDOs nevertheless; reading back shows it.
            (Step::Assign(_), Some(fault @ (Fault::Abort { .. } | Fault::Entry { .. })))
                if self.accepts_abort() =>
            {
                self.start.refused = Some(fault);
                self.enter(Step::Learn(0), cx, out);
            }
            (_, Some(fault)) => self.fail(fault, cx, out),
            (_, None) => self.enter(self.following(self.start.step), cx, out),
        }
    }

    pub(super) fn may_fail(&self, at: usize) -> bool {
        self.spec.startup.get(at).is_some_and(|sdo| sdo.may_fail)
    }

    pub(super) const fn accepts_abort(&self) -> bool {
        !self.mapped || self.start.refused.is_some()
    }

    pub(super) fn learnt(&mut self, at: usize, cx: &Context<'_>, out: &mut Outbox) {
        let scratch = std::mem::take(&mut self.jobs.scratch);
        self.start.learn.answer(&scratch);
        self.jobs.scratch = scratch;
        if let Some(Prepared::Transfer(transfer)) = self.next_question() {
            let kind = JobKind::Upload {
                address: Address::default(),
                whole: Whole::Entry,
            };
            if let Some(output) = self
                .mailbox
                .begin(transfer, kind, cx.mailbox_capacity(), cx.now)
            {
                self.handle_mailbox(output, cx, out);
            }
            return;
        }
        let pdos = std::mem::take(&mut self.start.learn).into_pdos();
        let Some(channel) = self.process.channels.get_mut(at) else {
            return;
        };
        let wanted = if channel.outputs {
            &self.spec.outputs
        } else {
            &self.spec.inputs
        };
        // The wanted PDOs are kept until the slave has them: the next attempt compares again.
        if let Some(wanted) = wanted
            && let Some(difference) = channel.difference(wanted, &pdos)
        {
            let fault = self.start.refused.take().unwrap_or(difference);
            return self.fail(fault, cx, out);
        }
        channel.set_pdos(pdos);
        self.enter(self.following(self.start.step), cx, out);
    }

    /// The list of a SyncManager cannot be read; acceptable only if no change was configured.
    pub(super) fn verify(&mut self, at: usize, cx: &Context<'_>, out: &mut Outbox) {
        let outputs = self
            .process
            .channels
            .get(at)
            .is_some_and(|channel| channel.outputs);
        let wanted = if outputs {
            &self.spec.outputs
        } else {
            &self.spec.inputs
        };
        let changes = wanted
            .as_ref()
            .is_some_and(|pdos| pdos.iter().any(|pdo| !pdo.entries.is_empty()));
        match self.start.refused.filter(|_| changes) {
            Some(fault) => {
                self.start.refused = None;
                self.fail(fault, cx, out);
            }
            None => self.enter(self.following(self.start.step), cx, out),
        }
    }
}
