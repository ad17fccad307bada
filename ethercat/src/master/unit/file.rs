//! The client of a file transfer (FoE; ETG.1000.6, clause 5.8), packet by packet.
//!
//! ```text
//! write: Request --acknowledge 0--> Packet 1 --acknowledge 1--> Packet 2 .. --acknowledge of a short packet--> done
//! read:  Request --data 1--> Acknowledge 1 --data 2--> Acknowledge 2 .. after a short packet --> done
//! busy:  a written packet is sent again; a read request waits
//! ```

use super::super::event::JobError;
use super::super::job::{Job, JobKind};
use super::transfer::Progress;
use crate::MailboxHeader;
use crate::foe::Foe;

/// Consecutive busy answers after which a slave counts as hung; at 1 ms per answer more than a minute.
const BUSY_MAX: u32 = 100_000;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Phase {
    #[default]
    Request,
    /// A packet is written.
    Packet,
    /// A packet was read.
    Acknowledge { last: bool },
}

/// A file transfer.
#[derive(Debug, Default)]
pub(super) struct FileTransfer {
    phase: Phase,
    /// The number of the packet.
    packet: u32,
    /// Bytes of acknowledged packets.
    done: usize,
    /// Length of the packet that is written, and whether it fills the mailbox.
    part: usize,
    is_full: bool,
    /// Consecutive busy answers.
    busy: u32,
}

impl FileTransfer {
    pub(super) const fn done(&self) -> usize {
        self.done
    }

    /// Writes the next message to `to`, which is as long as the mailbox allows; returns its length.
    pub(super) fn write(&mut self, job: &Job, to: &mut [u8]) -> Option<usize> {
        match (self.phase, &job.kind) {
            (Phase::Request, JobKind::ReadFile { name, password }) => Foe::Read {
                password: *password,
                name: name.as_bytes(),
            }
            .encode(to),
            (Phase::Request, JobKind::WriteFile { name, password }) => Foe::Write {
                password: *password,
                name: name.as_bytes(),
            }
            .encode(to),
            (Phase::Packet, _) => {
                let capacity = to.len().checked_sub(Foe::HEAD).filter(|room| *room > 0)?;
                let rest = job.data.get(self.done..)?;
                let data = rest.get(..rest.len().min(capacity))?;
                (self.part, self.is_full) = (data.len(), data.len() == capacity);
                let packet = self.packet;
                Foe::Data { packet, data }.encode(to)
            }
            (Phase::Acknowledge { .. }, _) => {
                let packet = self.packet;
                Foe::Acknowledge { packet }.encode(to)
            }
            (Phase::Request, _) => None,
        }
    }

    /// The result with which it ends once the pending message is sent: nothing answers the last acknowledgement.
    pub(super) const fn ends(&self) -> Option<Result<(), JobError>> {
        match self.phase {
            Phase::Acknowledge { last: true } => Some(Ok(())),
            Phase::Acknowledge { last: false } | Phase::Request | Phase::Packet => None,
        }
    }

    /// Handles a message from a mailbox of `len` bytes.
    pub(super) fn handle(&mut self, message: &Foe<'_>, job: &mut Job, len: usize) -> Progress {
        match *message {
            Foe::Error { code, text } => {
                // The buffer holds at least a part of the text.
                job.data.clear();
                let text = text.get(..text.len().min(job.data.capacity()));
                job.data.extend_from_slice(text.unwrap_or_default());
                Progress::Done(Err(JobError::File(code)))
            }
            Foe::Busy { .. } => self.handle_busy(),
            Foe::Acknowledge { packet } => self.handle_acknowledge(packet, job),
            Foe::Data { packet, data } => self.handle_data(packet, data, job, len),
            Foe::Read { .. } | Foe::Write { .. } => {
                Progress::Done(Err(JobError::Protocol("FoE message")))
            }
        }
    }

    const fn handle_busy(&mut self) -> Progress {
        self.busy += 1;
        if self.busy > BUSY_MAX {
            return Progress::Done(Err(JobError::Protocol("end of FoE (always busy)")));
        }
        match self.phase {
            Phase::Packet => Progress::Next,
            Phase::Request | Phase::Acknowledge { .. } => Progress::More,
        }
    }

    fn handle_acknowledge(&mut self, packet: u32, job: &Job) -> Progress {
        let writes = matches!(job.kind, JobKind::WriteFile { .. });
        match self.phase {
            Phase::Request if writes && packet == 0 => {}
            Phase::Packet if packet == self.packet => {
                self.done += self.part;
                if !self.is_full {
                    return Progress::Done(Ok(()));
                }
            }
            // A packet that was sent again is acknowledged again.
            Phase::Packet if packet == self.packet.wrapping_sub(1) => return Progress::Ignored,
            Phase::Request | Phase::Packet | Phase::Acknowledge { .. } => {
                return Progress::Done(Err(JobError::Protocol("FoE packet number")));
            }
        }
        (self.phase, self.busy) = (Phase::Packet, 0);
        self.packet = self.packet.wrapping_add(1);
        Progress::Next
    }

    fn handle_data(&mut self, packet: u32, data: &[u8], job: &mut Job, len: usize) -> Progress {
        let reads = matches!(job.kind, JobKind::ReadFile { .. });
        if !reads || packet != self.packet.wrapping_add(1) {
            return if reads && packet == self.packet {
                Progress::Ignored
            } else {
                Progress::Done(Err(JobError::Protocol("FoE packet number")))
            };
        }
        let (size, capacity) = (job.data.len() + data.len(), job.data.capacity());
        if size > capacity {
            return Progress::Done(Err(JobError::TooLong { size, capacity }));
        }
        job.data.extend_from_slice(data);
        let last = data.len() + Foe::HEAD + MailboxHeader::LEN < len;
        (self.packet, self.busy, self.phase) = (packet, 0, Phase::Acknowledge { last });
        Progress::Next
    }
}
