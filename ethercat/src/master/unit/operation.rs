//! The operations that steps and jobs consist of, each retried until it succeeds or times out: read or write a
//! register, change the state, read or write the SII. The purpose of an operation is not known here.

use std::time::Duration;

use super::super::event::{Fault, JobError, Outbox};
use super::super::job::{Job, JobKind};
use super::op::{Op, StatePhase};
use super::{Answer, Context, Request, Unit};
use crate::register;
use crate::{AlState, AlStatus, AlStatusCode};

/// Consecutive working counters of zero after which a register counts as unreachable.
const MISSES: u8 = 10;
/// Consecutive working counters of zero after which an optional register counts as missing.
const PROBES: u8 = 3;
/// Bits of the SII status: the EEPROM did not acknowledge the command, as while it stores a previous write; a write was
/// not enabled.
const SII_NO_ACKNOWLEDGE: u16 = 0x2000;
const SII_NOT_ENABLED: u16 = 0x4000;
const SII_BUSY: u16 = 0x8000;
/// Timeout of an error acknowledgement.
const ACKNOWLEDGE: Duration = Duration::from_secs(1);

impl Unit {
    pub(super) fn operation_request(&mut self) -> Option<Request<'_>> {
        Some(match self.operation.op {
            Op::Rest | Op::Mailbox => return None,
            Op::Read { at, len } | Op::Probe { at, len } => Request::read(at, len),
            Op::Write { at } => Request::write(at, self.operation.written()?),
            Op::State { wanted, phase } => self.state_request(wanted, phase),
            Op::Sii { polls: true, .. } => Request::read(register::SII_CONTROL, 14),
            Op::Sii {
                word,
                polls: false,
                writes,
                ..
            } => self.operation.sii_request(word, writes),
        })
    }

    fn state_request(&mut self, wanted: AlState, phase: StatePhase) -> Request<'_> {
        let control = match phase {
            StatePhase::Acknowledged
            | StatePhase::Wait
            | StatePhase::AcknowledgeBusy
            | StatePhase::RequestBusy => {
                return Request::read(register::AL_STATUS, 6);
            }
            StatePhase::Acknowledge => AlStatus {
                state: self.status.al.state,
                error: true,
            },
            StatePhase::Request => AlStatus {
                state: wanted,
                error: wanted == AlState::Init,
            },
        };
        let [low, high] = control.raw().to_le_bytes();
        self.operation.buffer[..2].copy_from_slice(&[low, high]);
        Request::write(register::AL_CONTROL, &self.operation.buffer[..2])
    }

    pub(super) fn operation_answer(
        &mut self,
        answer: Answer<'_>,
        cx: &Context<'_>,
        out: &mut Outbox,
    ) {
        // A lost frame says nothing about the slave: try again.
        let Answer::Data { counter, data } = answer else {
            return;
        };
        if counter == 0 {
            self.missed(cx, out);
            return;
        }
        self.operation.misses = 0;
        match self.operation.op {
            Op::Rest | Op::Mailbox => {}
            Op::Read { .. } | Op::Probe { .. } | Op::Write { .. } => self.done(data, cx, out),
            Op::State { wanted, phase } => self.state_answer(wanted, phase, data, cx, out),
            Op::Sii {
                polls: false,
                word,
                end,
                writes,
            } => {
                self.operation.op = Op::Sii {
                    polls: true,
                    word,
                    end,
                    writes,
                };
            }
            Op::Sii {
                polls: true,
                word,
                end,
                writes,
            } => self.sii_answer(word, end, writes, data, cx, out),
        }
    }

    /// Working counter 0. An unaccepted write to AL control is no loss as long as the slave shows its state: it is
    /// repeated until the state change times out.
    fn missed(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let busy = match self.operation.op {
            Op::State { wanted, phase } => phase.busy().map(|phase| Op::State { wanted, phase }),
            Op::Rest
            | Op::Read { .. }
            | Op::Probe { .. }
            | Op::Write { .. }
            | Op::Sii { .. }
            | Op::Mailbox => None,
        };
        if let Some(op) = busy {
            self.operation.op = op;
            return;
        }
        self.operation.misses += 1;
        if matches!(self.operation.op, Op::Probe { .. }) && self.operation.misses >= PROBES {
            self.operation.misses = 0;
            return self.done(&[], cx, out);
        }
        if self.operation.misses < MISSES {
            return;
        }
        self.operation.misses = 0;
        let register = match self.operation.op {
            Op::Read { at, .. } | Op::Probe { at, .. } | Op::Write { at } => at,
            Op::State { .. } => register::AL_STATUS,
            Op::Sii { .. } => register::SII_CONTROL,
            Op::Rest | Op::Mailbox => 0,
        };
        self.failed(Fault::Silent { register }, JobError::NoAnswer, cx, out);
    }

    /// The operation of a job or of a step failed.
    fn failed(&mut self, fault: Fault, error: JobError, cx: &Context<'_>, out: &mut Outbox) {
        match self.jobs.current.take() {
            Some(job) => {
                self.operation.op = Op::Rest;
                self.jobs.give_back(job, Err(error), out);
            }
            None => self.fail(fault, cx, out),
        }
    }

    fn state_answer(
        &mut self,
        wanted: AlState,
        phase: StatePhase,
        data: &[u8],
        cx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let next = match phase {
            StatePhase::Acknowledge => StatePhase::Acknowledged,
            StatePhase::Request => StatePhase::Wait,
            StatePhase::AcknowledgeBusy => {
                self.take_status(data);
                StatePhase::Acknowledge
            }
            StatePhase::Acknowledged | StatePhase::Wait | StatePhase::RequestBusy => {
                self.take_status(data);
                let reached = self.status.al.state == wanted && !self.status.al.error;
                let (waits, error) = (phase == StatePhase::Wait, self.status.al.error);
                if waits && reached {
                    return self.done(&[], cx, out);
                }
                // In INIT an error that is being cleared may show for a moment.
                let refuses = waits || phase == StatePhase::RequestBusy;
                if refuses && error && wanted != AlState::Init {
                    let (status, code) = (self.status.al, self.status.code);
                    return self.fail(
                        Fault::State {
                            wanted,
                            status,
                            code,
                        },
                        cx,
                        out,
                    );
                }
                let goes_on = phase == StatePhase::RequestBusy || !error;
                if waits || !goes_on {
                    phase
                } else {
                    StatePhase::Request
                }
            }
        };
        self.operation.op = Op::State {
            wanted,
            phase: next,
        };
    }

    pub(super) fn take_status(&mut self, data: &[u8]) {
        if let Some([a, b, _, _, c, d]) = data.first_chunk() {
            let code = AlStatusCode(u16::from_le_bytes([*c, *d]));
            self.show(u16::from_le_bytes([*a, *b]), code);
        }
    }

    fn sii_answer(
        &mut self,
        word: u16,
        end: u16,
        writes: bool,
        data: &[u8],
        cx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let Some(([low, high, _, _, _, _], found)) = data.split_first_chunk() else {
            return;
        };
        let status = u16::from_le_bytes([*low, *high]);
        if status & SII_BUSY != 0 {
            return;
        }
        self.operation.sii_status = status;
        if status & SII_NO_ACKNOWLEDGE != 0 {
            // The EEPROM still stores, or firmware accesses it: repeat the command until the SII timeout.
            self.operation.op = Op::Sii {
                polls: false,
                word,
                end,
                writes,
            };
            return;
        }
        if status & SII_NOT_ENABLED != 0 {
            return self.failed(
                Fault::Sii { word, status },
                JobError::Protocol("SII access (0502h)"),
                cx,
                out,
            );
        }
        if writes {
            return self.done(&[], cx, out);
        }
        // Bit 6: eight bytes at once, otherwise four.
        let len = if status & 0x0040 == 0 { 4 } else { 8 };
        let left = 2 * usize::from(end.saturating_sub(word));
        let bytes = found.get(..len.min(left)).unwrap_or_default();
        if !self.take_words(bytes) {
            let capacity = self
                .jobs
                .current
                .as_ref()
                .map_or(0, |job| job.data.capacity());
            let error = JobError::TooLong {
                size: capacity + bytes.len(),
                capacity,
            };
            return self.failed(Fault::Sii { word, status }, error, cx, out);
        }
        self.operation.since = cx.now;
        let word = word.saturating_add(if len == 4 { 2 } else { 4 });
        if word < end {
            self.operation.op = Op::Sii {
                word,
                end,
                polls: false,
                writes,
            };
        } else {
            self.done(&[], cx, out);
        }
    }

    /// SII words go to the job, without growing its buffer, or to the step.
    fn take_words(&mut self, bytes: &[u8]) -> bool {
        match &mut self.jobs.current {
            Some(job) if job.data.len() + bytes.len() > job.data.capacity() => return false,
            Some(job) => job.data.extend_from_slice(bytes),
            None => self.start.sii.extend_from_slice(bytes),
        }
        true
    }

    /// The operation succeeded.
    fn done(&mut self, data: &[u8], cx: &Context<'_>, out: &mut Outbox) {
        let Some(mut job) = self.jobs.current.take() else {
            return self.advance(data, cx, out);
        };
        self.operation.op = Op::Rest;
        let mut result = Ok(());
        if matches!(job.kind, JobKind::ReadRegister { .. }) {
            let (size, capacity) = (data.len(), job.data.capacity());
            if size > capacity {
                result = Err(JobError::TooLong { size, capacity });
            } else {
                job.data.extend_from_slice(data);
            }
        }
        self.jobs.give_back(job, result, out);
    }

    /// Ends an operation that takes too long; each has its own timeout.
    pub(super) fn check_deadline(&mut self, cx: &Context<'_>, out: &mut Outbox) {
        let timeouts = self.timeouts(cx.config);
        let waited = cx.now.saturating_sub(self.operation.since);
        match self.operation.op {
            Op::State { wanted, phase } => {
                let acknowledges = matches!(
                    phase,
                    StatePhase::Acknowledge
                        | StatePhase::AcknowledgeBusy
                        | StatePhase::Acknowledged
                );
                let limit = match (acknowledges, wanted) {
                    (true, _) => ACKNOWLEDGE,
                    (_, AlState::SafeOp | AlState::Op) => timeouts.op,
                    (_, AlState::Init | AlState::PreOp | AlState::Boot | AlState::Other(_)) => {
                        timeouts.pre_op
                    }
                };
                if waited <= limit {
                    return;
                }
                let (status, code) = (self.status.al, self.status.code);
                let unread = matches!(
                    phase,
                    StatePhase::Request | StatePhase::RequestBusy | StatePhase::AcknowledgeBusy
                );
                let fault = if unread {
                    Fault::Unread {
                        wanted,
                        status,
                        waited: limit,
                    }
                } else if status.error {
                    Fault::State {
                        wanted,
                        status,
                        code,
                    }
                } else {
                    Fault::Slow {
                        wanted,
                        status,
                        waited: limit,
                    }
                };
                self.fail(fault, cx, out);
            }
            Op::Sii { word, .. } if waited > timeouts.sii => {
                let refused = self.operation.sii_status & SII_NO_ACKNOWLEDGE != 0;
                let (status, error) = if refused {
                    (self.operation.sii_status, JobError::NoAcknowledge)
                } else {
                    (SII_BUSY, JobError::Timeout(timeouts.sii))
                };
                self.failed(Fault::Sii { word, status }, error, cx, out);
            }
            Op::Rest
            | Op::Read { .. }
            | Op::Probe { .. }
            | Op::Write { .. }
            | Op::Mailbox
            | Op::Sii { .. } => {}
        }
    }

    /// Starts a register or SII job.
    pub(super) fn begin_register_job(&mut self, mut job: Job, cx: &Context<'_>, out: &mut Outbox) {
        let op = match job.kind {
            JobKind::ReadRegister { at, len } => {
                job.data.clear();
                Op::Read {
                    at,
                    len: len.min(128),
                }
            }
            JobKind::WriteRegister { at } if (1..=128).contains(&job.data.len()) => {
                let data = std::mem::take(&mut job.data);
                let op = self.operation.write(at, &data);
                job.data = data;
                op
            }
            JobKind::ReadSii { word, words } => {
                job.data.clear();
                Op::Sii {
                    word,
                    end: word.saturating_add(words),
                    polls: false,
                    writes: false,
                }
            }
            JobKind::WriteSii { word } if job.data.len() == 2 => {
                self.operation.buffer[6..8].copy_from_slice(&job.data);
                Op::Sii {
                    word,
                    end: word,
                    polls: false,
                    writes: true,
                }
            }
            JobKind::WriteRegister { .. }
            | JobKind::WriteSii { .. }
            | JobKind::Upload { .. }
            | JobKind::Download { .. }
            | JobKind::List(_)
            | JobKind::DescribeObject(_)
            | JobKind::DescribeEntry(_)
            | JobKind::ReadFile { .. }
            | JobKind::WriteFile { .. }
            | JobKind::Ethernet(_)
            | JobKind::RawMailbox => {
                let (size, capacity) = (job.data.len(), 128);
                return self
                    .jobs
                    .give_back(job, Err(JobError::TooLong { size, capacity }), out);
            }
        };
        self.operation.begin(op, cx.now);
        self.jobs.current = Some(job);
        self.operation.sii_status = 0;
    }
}
