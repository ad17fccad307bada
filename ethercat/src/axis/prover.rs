//! The proof of an axis' process data over the mailbox of its slave: submits the uploads and restarts the proof. The
//! comparison is in `takt_cia402::proof`.

use std::time::Duration;

use takt_cia402::proof::{Denied, Exchanged, Objects, Proof, Values};
use takt_cia402::{Goal, Master as Profile, StatusWord};

use crate::AlState;
use crate::coe::Whole;
use crate::master::{Job, JobError, JobKind, Master, Reply};

use super::short;

/// Tag of the jobs of proofs; the lowest byte is the axis.
const TOKEN: u64 = u64::from_be_bytes(*b"proven-\0");
/// Longest object that is compared, bytes.
const BUFFER_LEN: usize = 8;

/// The proof and its upload.
#[derive(Debug)]
pub(super) struct Prover {
    slave: usize,
    axis: u8,
    proof: Proof,
    /// Buffer for an answer; `None` while an upload is pending.
    buffer: Option<Vec<u8>>,
    running: bool,
}

impl Prover {
    pub(super) fn new(slave: usize, axis: u8, carried: Objects, not_mirrored: Objects) -> Self {
        Self {
            slave,
            axis,
            proof: Proof::new(axis, carried, not_mirrored),
            buffer: Some(Vec::with_capacity(BUFFER_LEN)),
            running: false,
        }
    }

    pub(super) const fn proof(&self) -> &Proof {
        &self.proof
    }

    pub(super) const fn axis(&self) -> u8 {
        self.axis
    }

    const fn token(&self) -> u64 {
        TOKEN | self.axis as u64
    }

    /// One cycle, before that of the profile.
    pub(super) fn cycle(
        &mut self,
        master: &mut Master,
        profile: &mut Profile,
        received: &Values,
        sent: &Values,
        age: u32,
        now: Duration,
    ) {
        let slave = master.slave(self.slave);
        let in_op =
            slave.is_some_and(|slave| slave.is_running() && slave.al().0.state == AlState::Op);
        // Frames lost for some cycles do not change the mapping.
        if self.running && !in_op {
            self.proof.restart();
        }
        self.running = in_op;
        let powers = !matches!(profile.goal(), Goal::SwitchOnDisabled | Goal::QuickStop);
        let exchanged = Exchanged {
            received: *received,
            sent: *sent,
            fresh: age == 0,
            state: profile
                .state(StatusWord::new(short(received.at(0x6041))))
                .ok(),
            wanted: in_op && powers,
            mode: profile.mode(),
        };
        self.proof.step(&exchanged, now);
        profile.set_ceiling(self.proof.ceiling());
        self.submit_upload(master, now);
    }

    fn submit_upload(&mut self, master: &mut Master, now: Duration) {
        if !self.proof.has_upload() {
            return;
        }
        // The buffer is in use until an upload from before a restart has ended.
        let Some(mut data) = self.buffer.take() else {
            return;
        };
        let Some(address) = self.proof.poll_upload() else {
            self.buffer = Some(data);
            return;
        };
        data.clear();
        let job = Job {
            slave: self.slave,
            kind: JobKind::Upload {
                address,
                whole: Whole::Entry,
            },
            data,
            token: self.token(),
        };
        if let Err(reply) = master.submit(job) {
            self.take(reply, now);
        }
    }

    pub(super) fn handle_reply(&mut self, reply: Reply, now: Duration) -> Result<(), Reply> {
        if reply.job.slave != self.slave || reply.job.token != self.token() {
            return Err(reply);
        }
        self.take(reply, now);
        Ok(())
    }

    fn take(&mut self, reply: Reply, now: Duration) {
        let answer = match reply.result {
            Ok(()) => Ok(reply.job.data.as_slice()),
            Err(JobError::Abort(code)) => Err(Denied::Abort(code)),
            Err(JobError::Busy(_)) => Err(Denied::Busy),
            Err(_) => Err(Denied::Silent),
        };
        self.proof.handle_upload(answer, now);
        self.buffer = Some(reply.job.data);
    }
}
