//! The datagrams of a slave's state machine: what it requests, what comes back, and whose turn it is. At most one is
//! pending.

use std::time::Duration;

use super::super::image::Image;
use crate::AlState;
use crate::config::MasterConfig;

/// A datagram that a slave's state machine requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::master) enum Request<'a> {
    Read { at: u16, len: u16 },
    Write { at: u16, data: &'a [u8] },
}

impl<'a> Request<'a> {
    pub(super) const fn read(at: u16, len: u16) -> Self {
        Self::Read { at, len }
    }

    pub(super) const fn write(at: u16, data: &'a [u8]) -> Self {
        Self::Write { at, data }
    }
}

/// The result of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::master) enum Answer<'a> {
    /// Its frame was lost.
    Lost,
    /// It returned.
    Data { counter: u16, data: &'a [u8] },
}

/// What a slave's state machine knows of the segment.
#[derive(Clone, Copy, Debug)]
pub(in crate::master) struct Context<'a> {
    pub(in crate::master) now: Duration,
    /// When the frame of this answer was sent.
    pub(in crate::master) sent_at: Duration,
    /// System time of the reference clock as the frame of this answer passed it, ns.
    pub(in crate::master) reference_ns: Option<u64>,
    /// The slave whose clock is the reference.
    pub(in crate::master) reference: Option<usize>,
    pub(in crate::master) config: &'a MasterConfig,
    pub(in crate::master) image: &'a Image,
}

impl Context<'_> {
    /// Capacity of a mailbox datagram, beside the image if that is exchanged, bytes.
    pub(super) fn mailbox_capacity(&self) -> usize {
        if self.config.goal == AlState::PreOp {
            Image::default().mailbox_capacity()
        } else {
            self.image.mailbox_capacity()
        }
    }
}

/// The purpose of a pending datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Pending {
    /// No pending datagram.
    #[default]
    Nothing,
    Operation,
    Mailbox,
    Watch,
    /// For an operation that was aborted.
    Past,
}

/// Whose datagram was offered, and whose is pending.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Turn {
    offered: Pending,
    pending: Pending,
}

impl Turn {
    /// Whether no datagram is pending.
    pub(super) const fn is_free(self) -> bool {
        matches!(self.pending, Pending::Nothing)
    }

    /// Offers a datagram of this purpose.
    pub(super) const fn offer(&mut self, purpose: Pending) {
        self.offered = purpose;
    }

    /// The offered datagram was put into a frame.
    pub(super) const fn sent(&mut self) {
        self.pending = self.offered;
    }

    /// The purpose of the datagram that returned or was lost; none is pending then.
    pub(super) const fn take(&mut self) -> Pending {
        std::mem::replace(&mut self.pending, Pending::Nothing)
    }

    /// A step begins: the pending datagram, if any, is for an operation that was aborted.
    pub(super) fn abort(&mut self) {
        if !self.is_free() {
            self.pending = Pending::Past;
        }
    }
}
