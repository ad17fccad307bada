//! Ethernet frames through the mailbox of a slave (EoE; ETG.1000.6, clause 5.9): requests to its Ethernet port, frames to
//! send in fragments, and received frames until they are fetched.
//!
//! ```text
//! request: written --response--> done
//! frame:   fragment 0 accepted, mailbox read once, fragment 1 accepted, .. last fragment accepted --> done
//! ```

use super::super::event::JobError;
use super::super::job::{EthernetJob, Job};
use super::transfer::Progress;
use crate::eoe::{Eoe, EoeRequest, EoeResult, FRAME_MAX, Fragment, FragmentError, Reassembly};

/// Received frames that are kept until they are fetched.
const FRAMES_MAX: usize = 16;

/// Counters of the Ethernet port of a slave since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EthernetCounters {
    /// Frames sent to the slave.
    pub sent: u64,
    /// Frames received from the slave.
    pub received: u64,
    /// Frames received and dropped, because earlier ones were not fetched in time.
    pub overflowed: u64,
    /// Frames dropped because their fragments do not fit together.
    pub broken: u64,
    /// Why the last of these was dropped.
    pub cause: Option<FragmentError>,
}

#[derive(Clone, Copy, Debug)]
struct Received {
    len: usize,
    frame: [u8; FRAME_MAX],
}

/// Frames of a slave; allocated once.
#[derive(Debug)]
pub(super) struct Ethernet {
    reassembly: Reassembly,
    frames: Box<[Received]>,
    first: usize,
    count: usize,
    counters: EthernetCounters,
}

impl Ethernet {
    pub(super) fn new() -> Self {
        let none = Received {
            len: 0,
            frame: [0; FRAME_MAX],
        };
        Self {
            reassembly: Reassembly::default(),
            frames: vec![none; FRAMES_MAX].into_boxed_slice(),
            first: 0,
            count: 0,
            counters: EthernetCounters::default(),
        }
    }

    pub(super) fn counters(&self) -> EthernetCounters {
        let (broken, cause) = self.reassembly.dropped();
        EthernetCounters {
            broken,
            cause,
            ..self.counters
        }
    }

    pub(super) const fn count_sent(&mut self) {
        self.counters.sent += 1;
    }

    /// The slave restarts: what it had begun is never continued.
    pub(super) fn reset(&mut self) {
        self.reassembly.reset();
    }

    pub(super) fn handle(&mut self, fragment: &Fragment<'_>) {
        let Some((frame, _)) = self.reassembly.push(fragment) else {
            return;
        };
        let at = (self.first + self.count) % FRAMES_MAX;
        let slot = self.frames.get_mut(at);
        let Some(slot) = slot.filter(|_| self.count < FRAMES_MAX) else {
            self.counters.overflowed += 1;
            return;
        };
        for (to, from) in slot.frame.iter_mut().zip(frame) {
            *to = *from;
        }
        slot.len = frame.len();
        self.count += 1;
        self.counters.received += 1;
    }

    /// Copies the oldest frame to `to` and removes it; returns its length. One that does not fit is cut.
    pub(super) fn fetch(&mut self, to: &mut [u8]) -> Option<usize> {
        let slot = self.frames.get(self.first).filter(|_| self.count > 0)?;
        let len = slot.len.min(to.len());
        for (to, from) in to.iter_mut().zip(slot.frame.get(..len)?) {
            *to = *from;
        }
        self.first = (self.first + 1) % FRAMES_MAX;
        self.count -= 1;
        Some(len)
    }
}

/// A request to an Ethernet port, or a frame in transfer.
#[derive(Debug, Default)]
pub(super) struct EthernetTransfer {
    /// Number of the frame.
    frame: u8,
    /// Number of the fragment, its position, and its length.
    number: u8,
    at: u16,
    part: u16,
}

impl EthernetTransfer {
    pub(super) const fn set_frame(&mut self, frame: u8) {
        self.frame = frame;
    }

    pub(super) fn done(&self) -> usize {
        self.at.into()
    }

    /// Writes the next message to `to`, which is as long as the mailbox allows; returns its length.
    pub(super) fn write(&mut self, kind: EthernetJob, job: &Job, to: &mut [u8]) -> Option<usize> {
        match kind {
            EthernetJob::Request { port, request } => Eoe::Request {
                port,
                request,
                data: &job.data,
            }
            .encode(to),
            EthernetJob::Send { port } => {
                let capacity = to.len().checked_sub(Eoe::HEAD)?;
                let fragment = Fragment::of(&job.data, self.at.into(), self.number, capacity)?;
                self.part = u16::try_from(fragment.data.len()).ok()?;
                Eoe::Fragment(Fragment {
                    port,
                    frame: self.frame,
                    ..fragment
                })
                .encode(to)
            }
        }
    }

    /// The slave accepted the pending fragment; whether it was the last.
    pub(super) fn accepted(&mut self, len: usize) -> bool {
        self.at += self.part;
        self.part = 0;
        self.number = self.number.wrapping_add(1);
        self.done() >= len
    }

    /// Handles a message that is no fragment.
    pub(super) fn handle(kind: EthernetJob, message: &Eoe<'_>, job: &mut Job) -> Progress {
        let EthernetJob::Request { request, .. } = kind else {
            return Progress::Ignored;
        };
        match *message {
            Eoe::Response {
                request: answered,
                result,
                data,
                ..
            } => {
                if result != EoeResult::SUCCESS {
                    return Progress::Done(Err(JobError::Ethernet(result)));
                }
                if answered != request {
                    return Progress::Ignored;
                }
                let reads = matches!(request, EoeRequest::GetAddress | EoeRequest::GetFilter);
                let data = if reads { data } else { &[] };
                let (size, capacity) = (data.len(), job.data.capacity());
                if size > capacity {
                    return Progress::Done(Err(JobError::TooLong { size, capacity }));
                }
                job.data.clear();
                job.data.extend_from_slice(data);
                Progress::Done(Ok(()))
            }
            // Slaves refuse what they do not support by a message of the type of the request; its second word is the
            // result, which the data does not show.
            Eoe::Request {
                request: refused, ..
            } if refused == request => {
                Progress::Done(Err(JobError::Ethernet(EoeResult::UNSUPPORTED)))
            }
            Eoe::Request { .. } | Eoe::TimeStamp { .. } | Eoe::Fragment(_) => Progress::Ignored,
        }
    }
}
