//! An operation that steps and jobs consist of, with the bytes that it writes. Its purpose is not known here.

use std::time::Duration;

use super::datagram::Request;
use crate::{AlState, register};

/// Longest write to registers, bytes.
pub(super) const WRITE_MAX: usize = 256;

/// An operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Op {
    /// None.
    Rest,
    /// Read registers.
    Read { at: u16, len: u16 },
    /// Read registers that may not exist: no answer is a valid result.
    Probe { at: u16, len: u16 },
    /// Write the write buffer to registers.
    Write { at: u16 },
    /// Change the state.
    State { wanted: AlState, phase: StatePhase },
    /// Read words of the SII up to one, or write one.
    Sii {
        word: u16,
        end: u16,
        polls: bool,
        writes: bool,
    },
    /// Wait for the transfer in the mailbox.
    Mailbox,
}

/// Phase of a state change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StatePhase {
    /// Acknowledge an error.
    Acknowledge,
    /// AL control does not accept the acknowledgement: check whether the slave answers, then acknowledge again.
    AcknowledgeBusy,
    /// Wait until the error is cleared.
    Acknowledged,
    /// Request the state.
    Request,
    /// AL control does not accept the request, as firmware has not read the previous one: read AL status, then request
    /// again.
    RequestBusy,
    /// Wait for the state.
    Wait,
}

impl StatePhase {
    /// The next phase when a write to AL control is not accepted; `None` for a phase that reads.
    pub(super) const fn busy(self) -> Option<Self> {
        match self {
            Self::Acknowledge => Some(Self::AcknowledgeBusy),
            Self::Request => Some(Self::RequestBusy),
            Self::AcknowledgeBusy | Self::Acknowledged | Self::RequestBusy | Self::Wait => None,
        }
    }
}

/// The present operation.
#[derive(Debug)]
pub(super) struct Operation {
    pub(super) op: Op,
    /// When it began, or last made progress.
    pub(super) since: Duration,
    /// Consecutive working counters of zero.
    pub(super) misses: u8,
    /// SII status as last read.
    pub(super) sii_status: u16,
    pub(super) buffer: [u8; WRITE_MAX],
    len: usize,
}

impl Default for Operation {
    fn default() -> Self {
        Self {
            op: Op::Rest,
            since: Duration::ZERO,
            misses: 0,
            sii_status: 0,
            buffer: [0; WRITE_MAX],
            len: 0,
        }
    }
}

impl Operation {
    /// Begins an operation.
    pub(super) const fn begin(&mut self, op: Op, now: Duration) {
        (self.op, self.since, self.misses) = (op, now, 0);
    }

    /// Whether there is none.
    pub(super) const fn is_at_rest(&self) -> bool {
        matches!(self.op, Op::Rest)
    }

    /// Starts a write of these bytes, truncated to the buffer; no write is longer.
    pub(super) fn write(&mut self, at: u16, bytes: &[u8]) -> Op {
        self.len = bytes.len().min(WRITE_MAX);
        for (to, from) in self.buffer.iter_mut().zip(bytes) {
            *to = *from;
        }
        Op::Write { at }
    }

    /// The bytes to write.
    pub(super) fn written(&self) -> Option<&[u8]> {
        self.buffer.get(..self.len)
    }

    /// The datagram that starts an access to a word of the SII.
    pub(super) fn sii_request(&mut self, word: u16, writes: bool) -> Request<'_> {
        let [low, high] = word.to_le_bytes();
        let command = if writes { [0x01, 0x02] } else { [0x00, 0x01] };
        let head = [command[0], command[1], low, high, 0, 0];
        // The word to write follows the address in the buffer, where its job put it.
        self.buffer[..6].copy_from_slice(&head);
        Request::write(
            register::SII_CONTROL,
            &self.buffer[..if writes { 8 } else { 6 }],
        )
    }
}
