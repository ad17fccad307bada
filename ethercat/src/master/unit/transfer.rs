//! One job that goes through a mailbox, message by message: SDO expedited, normal and in segments, complete access, SDO
//! information with its fragments (ETG.1000.6, clause 5.6). The mailbox transports the messages.

use takt_cia402::dictionary::{AbortCode, Address};

use super::super::event::JobError;
use super::super::job::{EthernetJob, Job, JobKind};
use super::ethernet::EthernetTransfer;
use super::file::FileTransfer;
use super::queue::OWN;
use crate::coe::{Information, SDO_LEN, Sdo};
use crate::eoe::{Eoe, EoeRequest, FRAME_MAX, FRAME_MIN};
use crate::foe::Foe;
use crate::{CoeService, MailboxKind};

/// The result of a message of the slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Progress {
    /// The message is unrelated.
    Ignored,
    /// Send the next message.
    Next,
    /// Wait for more messages.
    More,
    /// The transfer has ended.
    Done(Result<(), JobError>),
}

/// Phase of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// The first message.
    Begin,
    /// Segments follow.
    Segments { toggle: bool },
    /// Send an abort to the slave, then end with this error.
    Abort(AbortCode, JobError),
}

/// A job in transfer.
#[derive(Debug)]
pub(in crate::master) struct Transfer {
    job: Job,
    phase: Phase,
    /// Bytes written so far, or total bytes to read.
    count: usize,
    /// Length of the last written segment, bytes.
    part: usize,
    /// Of a file.
    file: FileTransfer,
    /// Of an Ethernet port.
    ethernet: EthernetTransfer,
}

impl Transfer {
    pub(in crate::master) fn new(mut job: Job) -> Self {
        if !sends(job.kind) {
            job.data.clear();
        }
        Self {
            job,
            phase: Phase::Begin,
            count: 0,
            part: 0,
            file: FileTransfer::default(),
            ethernet: EthernetTransfer::default(),
        }
    }

    /// The protocol of its messages.
    pub(super) const fn mailbox_kind(&self) -> MailboxKind {
        match protocol(self.job.kind) {
            Some(kind) => kind,
            None => MailboxKind::Coe,
        }
    }

    /// Bytes of the file or object that were transferred so far.
    pub(in crate::master) fn transferred(&self) -> usize {
        if matches!(self.job.kind, JobKind::WriteFile { .. }) {
            self.file.done()
        } else if matches!(self.job.kind, JobKind::Download { .. }) {
            self.count
        } else if self.streams() {
            self.ethernet.done()
        } else {
            self.job.data.len()
        }
    }

    pub(in crate::master) fn into_job(self) -> Job {
        self.job
    }

    /// Whether its request may be repeated: reads change nothing, and start-up writes are idempotent. Objects that
    /// programs write may be commands.
    pub(super) fn may_restart(&self) -> bool {
        match self.job.kind {
            JobKind::Upload { .. } => !matches!(self.phase, Phase::Abort(..)),
            JobKind::Download { .. } => {
                self.job.slave == OWN && !matches!(self.phase, Phase::Abort(..))
            }
            // Fragments of two lists could not be distinguished.
            JobKind::List(_) | JobKind::DescribeObject(_) | JobKind::DescribeEntry(_) => {
                self.count == 0
            }
            // Addresses and filters are states, not commands.
            JobKind::Ethernet(EthernetJob::Request { .. }) => true,
            JobKind::Ethernet(EthernetJob::Send { .. })
            | JobKind::RawMailbox
            | JobKind::ReadFile { .. }
            | JobKind::WriteFile { .. }
            | JobKind::ReadRegister { .. }
            | JobKind::WriteRegister { .. }
            | JobKind::ReadSii { .. }
            | JobKind::WriteSii { .. } => false,
        }
    }

    /// Restarts with the first message.
    pub(super) fn restart(&mut self) {
        if !sends(self.job.kind) {
            self.job.data.clear();
        }
        (self.phase, self.count, self.part) = (Phase::Begin, 0, 0);
    }

    pub(super) const fn is_raw(&self) -> bool {
        matches!(self.job.kind, JobKind::RawMailbox)
    }

    /// The object of the transfer.
    pub(in crate::master) const fn address(&self) -> Address {
        match self.job.kind {
            JobKind::Upload { address, .. }
            | JobKind::Download { address, .. }
            | JobKind::DescribeEntry(address) => address,
            JobKind::DescribeObject(index) => Address::new(index, 0),
            JobKind::List(_)
            | JobKind::RawMailbox
            | JobKind::ReadFile { .. }
            | JobKind::WriteFile { .. }
            | JobKind::Ethernet(_)
            | JobKind::ReadRegister { .. }
            | JobKind::WriteRegister { .. }
            | JobKind::ReadSii { .. }
            | JobKind::WriteSii { .. } => Address::new(0, 0),
        }
    }

    /// Writes the next message without mailbox header to `to`, which is as long as the mailbox allows; returns its
    /// length.
    pub(super) fn write(&mut self, to: &mut [u8]) -> Option<usize> {
        if self.mailbox_kind() == MailboxKind::Foe {
            return self.file.write(&self.job, to);
        }
        if let JobKind::Ethernet(kind) = self.job.kind {
            return self.ethernet.write(kind, &self.job, to);
        }
        let (service, inside) = to.split_first_chunk_mut::<{ CoeService::LEN }>()?;
        let service_of = self
            .job
            .kind
            .information()
            .map_or(CoeService::SdoRequest, |_| CoeService::SdoInformation);
        *service = service_of.encode();
        let len = match self.phase {
            Phase::Abort(code, _) => Sdo::Abort {
                address: self.address(),
                code,
            }
            .encode(inside)?,
            Phase::Begin => self.begin(inside)?,
            Phase::Segments { toggle } => self.segment(toggle, inside)?,
        };
        Some(CoeService::LEN + len)
    }

    fn begin(&mut self, to: &mut [u8]) -> Option<usize> {
        match self.job.kind {
            JobKind::Upload { address, whole } => Sdo::Upload { address, whole }.encode(to),
            JobKind::Download { address, whole } => {
                let capacity = to.len().checked_sub(SDO_LEN)?;
                let size = u32::try_from(self.job.data.len()).ok()?;
                self.count = self.job.data.len().min(capacity);
                if size <= 4 {
                    self.count = self.job.data.len();
                }
                let data = self.job.data.get(..self.count)?;
                Sdo::Download {
                    address,
                    whole,
                    size,
                    data,
                }
                .encode(to)
            }
            JobKind::List(kind) => inform(Information::LIST, &kind.to_le_bytes(), to),
            JobKind::DescribeObject(index) => inform(Information::OBJECT, &index.to_le_bytes(), to),
            JobKind::DescribeEntry(address) => {
                let [low, high] = address.index.to_le_bytes();
                // Value info 0: no units, defaults or limits; not every slave supports them.
                inform(Information::ENTRY, &[low, high, address.sub, 0], to)
            }
            JobKind::RawMailbox
            | JobKind::ReadFile { .. }
            | JobKind::WriteFile { .. }
            | JobKind::Ethernet(_)
            | JobKind::ReadRegister { .. }
            | JobKind::WriteRegister { .. }
            | JobKind::ReadSii { .. }
            | JobKind::WriteSii { .. } => None,
        }
    }

    fn segment(&mut self, toggle: bool, to: &mut [u8]) -> Option<usize> {
        if !matches!(self.job.kind, JobKind::Download { .. }) {
            return Sdo::UploadSegment { toggle }.encode(to);
        }
        let rest = self.job.data.get(self.count..)?;
        self.part = rest.len().min(to.len().checked_sub(1)?);
        let last = self.part == rest.len();
        let data = rest.get(..self.part)?;
        Sdo::DownloadSegment { toggle, last, data }.encode(to)
    }

    /// Copies a raw message; `None` if it is longer than the mailbox.
    pub(super) fn copy_raw(&self, to: &mut [u8]) -> Option<()> {
        to.get_mut(..self.job.data.len())?
            .copy_from_slice(&self.job.data);
        Some(())
    }

    /// Handles a raw mailbox message.
    pub(super) fn handle_raw(&mut self, mailbox: &[u8]) -> Progress {
        self.job.data.clear();
        Progress::Done(self.append(mailbox))
    }

    /// Handles a mailbox error.
    pub(super) const fn handle_error(error: crate::MailboxError) -> Progress {
        Progress::Done(Err(JobError::Mailbox(error)))
    }

    /// Handles a FoE message from a mailbox of `len` bytes.
    pub(super) fn handle_file(&mut self, bytes: &[u8], len: usize) -> Progress {
        if self.mailbox_kind() != MailboxKind::Foe {
            return Progress::Ignored;
        }
        match Foe::decode(bytes) {
            Some(message) => self.file.handle(&message, &mut self.job, len),
            None => Progress::Done(Err(JobError::Protocol("FoE message"))),
        }
    }

    /// Whether it sends an Ethernet frame: its fragments are not answered, and the mailbox is read between them.
    pub(super) const fn streams(&self) -> bool {
        matches!(self.job.kind, JobKind::Ethernet(EthernetJob::Send { .. }))
    }

    /// Begins an Ethernet frame with its number; an error if it is none.
    pub(super) fn begin_frame(&mut self, number: u8) -> Result<(), JobError> {
        let len = self.job.data.len();
        if self.streams() && !(FRAME_MIN..=FRAME_MAX).contains(&len) {
            return Err(JobError::FrameLength(len));
        }
        self.ethernet.set_frame(number);
        Ok(())
    }

    /// The slave accepted the pending fragment of an Ethernet frame; whether it was the last.
    pub(super) fn accepted(&mut self) -> bool {
        self.ethernet.accepted(self.job.data.len())
    }

    /// Handles an EoE message that is no fragment.
    pub(super) fn handle_ethernet(&mut self, message: &Eoe<'_>) -> Progress {
        if let JobKind::Ethernet(kind) = self.job.kind {
            EthernetTransfer::handle(kind, message, &mut self.job)
        } else {
            Progress::Ignored
        }
    }

    /// Handles a CoE message other than an emergency.
    pub(super) fn handle(&mut self, service: CoeService, bytes: &[u8]) -> Progress {
        let informs = self.job.kind.information().is_some();
        if self.mailbox_kind() != MailboxKind::Coe {
            return Progress::Ignored;
        }
        match service {
            CoeService::SdoInformation if informs => self.handle_information(bytes),
            // An abort has the service of a request.
            CoeService::SdoRequest | CoeService::SdoResponse if !informs => {
                match Sdo::decode_response(bytes) {
                    Some(sdo) => self.handle_sdo(&sdo),
                    None => Progress::Done(Err(JobError::Protocol("SDO"))),
                }
            }
            CoeService::SdoInformation
            | CoeService::SdoRequest
            | CoeService::SdoResponse
            | CoeService::Emergency
            | CoeService::Pdo(_)
            | CoeService::Other(_) => Progress::Ignored,
        }
    }

    fn handle_sdo(&mut self, sdo: &Sdo<'_>) -> Progress {
        let uploads = matches!(self.job.kind, JobKind::Upload { .. });
        match (*sdo, self.phase) {
            (Sdo::Abort { address, code }, _)
                if address == self.address() || address == Address::default() =>
            {
                Progress::Done(Err(JobError::Abort(code)))
            }
            (
                Sdo::Uploaded {
                    address,
                    size,
                    data,
                    ..
                },
                Phase::Begin,
            ) if uploads && address == self.address() => self.uploaded(size, data),
            (Sdo::UploadedSegment { toggle, last, data }, Phase::Segments { toggle: expected })
                if uploads =>
            {
                self.uploaded_segment(toggle == expected, last, data)
            }
            (Sdo::Downloaded { address, .. }, Phase::Begin)
                if !uploads && address == self.address() =>
            {
                self.written(false)
            }
            (Sdo::DownloadedSegment { toggle }, Phase::Segments { toggle: expected })
                if !uploads =>
            {
                if toggle != expected {
                    return self.give_up(
                        AbortCode::Toggle,
                        JobError::Protocol("SDO segment (toggle bit)"),
                    );
                }
                self.count += std::mem::take(&mut self.part);
                self.written(!expected)
            }
            // Late answers of an aborted transfer.
            _ => Progress::Ignored,
        }
    }

    fn uploaded(&mut self, size: u32, data: &[u8]) -> Progress {
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        self.job.data.clear();
        let capacity = self.job.data.capacity();
        if size > capacity {
            return self.give_up(AbortCode::OutOfMemory, JobError::TooLong { size, capacity });
        }
        self.count = size;
        if data.len() >= size {
            // The data may be padded to the length of the mailbox.
            return Progress::Done(self.append(data.get(..size).unwrap_or_default()));
        }
        if let Err(error) = self.append(data) {
            return Progress::Done(Err(error));
        }
        self.phase = Phase::Segments { toggle: false };
        Progress::Next
    }

    fn uploaded_segment(&mut self, in_turn: bool, last: bool, data: &[u8]) -> Progress {
        if !in_turn {
            return self.give_up(
                AbortCode::Toggle,
                JobError::Protocol("SDO segment (toggle bit)"),
            );
        }
        let left = self.count.saturating_sub(self.job.data.len());
        if let Err(error) = self.append(data.get(..data.len().min(left)).unwrap_or_default()) {
            return Progress::Done(Err(error));
        }
        if last {
            let whole = self.job.data.len() == self.count;
            return Progress::Done(if whole {
                Ok(())
            } else {
                Err(JobError::Protocol("SDO transfer (too short)"))
            });
        }
        if data.is_empty() || self.job.data.len() == self.count {
            return self.give_up(
                AbortCode::TooLong,
                JobError::Protocol("SDO transfer (too long)"),
            );
        }
        self.flip();
        Progress::Next
    }

    fn flip(&mut self) {
        if let Phase::Segments { toggle } = self.phase {
            self.phase = Phase::Segments { toggle: !toggle };
        }
    }

    /// Handles the confirmed bytes; the rest is sent in segments.
    fn written(&mut self, toggle: bool) -> Progress {
        if self.count == self.job.data.len() {
            return Progress::Done(Ok(()));
        }
        self.phase = Phase::Segments { toggle };
        Progress::Next
    }

    fn give_up(&mut self, code: AbortCode, error: JobError) -> Progress {
        self.phase = Phase::Abort(code, error);
        Progress::Next
    }

    /// The result with which it ends once the pending message is sent; `None` while it continues.
    pub(super) const fn ends(&self) -> Option<Result<(), JobError>> {
        match self.phase {
            Phase::Abort(_, error) => Some(Err(error)),
            Phase::Begin | Phase::Segments { .. } => self.file.ends(),
        }
    }

    fn handle_information(&mut self, bytes: &[u8]) -> Progress {
        let Some((header, data)) = Information::decode(bytes) else {
            return Progress::Done(Err(JobError::Protocol("SDO information")));
        };
        let Some(requested) = self.job.kind.information() else {
            return Progress::Ignored;
        };
        if header.operation == Information::ERROR {
            let code = data
                .first_chunk()
                .map_or(0, |four| u32::from_le_bytes(*four));
            return Progress::Done(Err(JobError::Abort(AbortCode::from_raw(code))));
        }
        if header.operation != requested + 1 {
            return Progress::Ignored;
        }
        // The first fragment of a list repeats its kind.
        let skip = if requested == Information::LIST && self.count == 0 {
            2
        } else {
            0
        };
        self.count += 1;
        if let Err(error) = self.append(data.get(skip..).unwrap_or_default()) {
            return Progress::Done(Err(error));
        }
        if header.incomplete || header.left > 0 {
            return Progress::More;
        }
        Progress::Done(Ok(()))
    }

    /// Appends bytes without growing the buffer.
    fn append(&mut self, bytes: &[u8]) -> Result<(), JobError> {
        let capacity = self.job.data.capacity();
        let size = self.job.data.len() + bytes.len();
        if size > capacity {
            return Err(JobError::TooLong { size, capacity });
        }
        self.job.data.extend_from_slice(bytes);
        Ok(())
    }
}

fn inform(operation: u8, data: &[u8], to: &mut [u8]) -> Option<usize> {
    let header = Information {
        operation,
        incomplete: false,
        left: 0,
    };
    to.get_mut(..Information::LEN)?
        .copy_from_slice(&header.encode());
    let end = Information::LEN + data.len();
    to.get_mut(Information::LEN..end)?.copy_from_slice(data);
    Some(end)
}

/// The mailbox protocol that a job requires.
pub(super) const fn protocol(kind: JobKind) -> Option<MailboxKind> {
    match kind {
        JobKind::Upload { .. }
        | JobKind::Download { .. }
        | JobKind::List(_)
        | JobKind::DescribeObject(_)
        | JobKind::DescribeEntry(_) => Some(MailboxKind::Coe),
        JobKind::ReadFile { .. } | JobKind::WriteFile { .. } => Some(MailboxKind::Foe),
        JobKind::Ethernet(_) => Some(MailboxKind::Eoe),
        JobKind::RawMailbox
        | JobKind::ReadRegister { .. }
        | JobKind::WriteRegister { .. }
        | JobKind::ReadSii { .. }
        | JobKind::WriteSii { .. } => None,
    }
}

/// Whether `data` of a job is what is sent, rather than a buffer for the answer.
const fn sends(kind: JobKind) -> bool {
    match kind {
        JobKind::Download { .. } | JobKind::RawMailbox | JobKind::WriteFile { .. } => true,
        JobKind::Ethernet(EthernetJob::Request { request, .. }) => match request {
            EoeRequest::SetAddress | EoeRequest::SetFilter => true,
            EoeRequest::GetAddress | EoeRequest::GetFilter => false,
        },
        JobKind::Ethernet(EthernetJob::Send { .. }) => true,
        JobKind::Upload { .. }
        | JobKind::List(_)
        | JobKind::DescribeObject(_)
        | JobKind::DescribeEntry(_)
        | JobKind::ReadFile { .. }
        | JobKind::ReadRegister { .. }
        | JobKind::WriteRegister { .. }
        | JobKind::ReadSii { .. }
        | JobKind::WriteSii { .. } => false,
    }
}
