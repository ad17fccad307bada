//! Other frames on the bus while a drive is commanded: its boot-ups and emergencies, and other masters, which explain
//! what the drive does. It holds back no frame.

use std::time::Duration;

use takt_can::Frame;
use takt_can::canopen::{Emergency, Message, NmtState, NodeId};

use crate::can::wire::Wire;

/// What was observed about one node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Observed {
    /// Boot-ups.
    pub(super) boots: u32,
    /// The last state that it reported.
    pub(super) state: Option<NmtState>,
    /// The last emergency other than "no error".
    pub(super) emergency: Option<Emergency>,
    /// SDO answers beyond one per request.
    pub(super) surplus: u32,
    /// SDO requests without an answer.
    pending: u32,
    /// Another node sends SYNC.
    pub(super) foreign_sync: bool,
    /// The last message of another master to it.
    pub(super) other_master: Option<Message>,
}

impl Observed {
    const fn answer(&mut self) {
        match self.pending.checked_sub(1) {
            Some(pending) => self.pending = pending,
            None => self.surplus = self.surplus.saturating_add(1),
        }
    }
}

/// A wire whose frames are observed.
#[derive(Debug)]
pub(super) struct Observer<'w, W> {
    wire: &'w mut W,
    node: NodeId,
    pub(super) observed: Observed,
}

impl<'w, W: Wire> Observer<'w, W> {
    pub(super) fn new(wire: &'w mut W, node: NodeId) -> Self {
        Self {
            wire,
            node,
            observed: Observed::default(),
        }
    }

    fn observe(&mut self, frame: &Frame) {
        let message = Message::decode(frame);
        let observed = &mut self.observed;
        match message {
            Message::Heartbeat(node, NmtState::BootUp, _) if node == self.node => {
                observed.boots += 1;
                observed.state = Some(NmtState::PreOperational);
            }
            Message::Heartbeat(node, state, _) if node == self.node => observed.state = Some(state),
            Message::Emergency(node, emergency) if node == self.node && emergency.code != 0 => {
                observed.emergency = Some(emergency);
            }
            Message::SdoResponse(node, _) if node == self.node => observed.answer(),
            Message::SdoRequest(node, _) if node == self.node => {
                observed.pending = observed.pending.saturating_add(1);
                observed.other_master = Some(message);
            }
            Message::Rpdo(node, _) if node == self.node => observed.other_master = Some(message),
            Message::Sync(_) => observed.foreign_sync = true,
            Message::Nmt(_, node) if node.is_none_or(|node| node == self.node) => {
                observed.other_master = Some(message);
            }
            Message::Heartbeat(..)
            | Message::Emergency(..)
            | Message::Rpdo(..)
            | Message::SdoRequest(..)
            | Message::Nmt(..)
            | Message::Time(..)
            | Message::Tpdo(..)
            | Message::SdoResponse(..)
            | Message::Guard(_)
            | Message::Lss(..)
            | Message::Unknown => {}
        }
    }
}

impl<W: Wire> Wire for Observer<'_, W> {
    fn now(&self) -> Duration {
        self.wire.now()
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        if let Message::SdoRequest(node, _) = Message::decode(frame)
            && node == self.node
        {
            // What was not answered until now counts as lost.
            self.observed.pending = 1;
        }
        self.wire.send(frame)
    }

    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<Frame>> {
        let frame = self.wire.receive(timeout)?;
        if let Some(frame) = &frame {
            self.observe(frame);
        }
        Ok(frame)
    }

    fn is_stopped(&self) -> bool {
        self.wire.is_stopped()
    }
}
