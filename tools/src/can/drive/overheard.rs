//! What else goes over the bus while a drive is asked: a reboot of it, emergencies, and other masters, whose doing
//! explains what the drive does. It hinders no frame.

use std::time::Duration;

use takt_can::Frame;
use takt_can::canopen::{Emergency, Message, NmtState, NodeId};

use crate::can::wire::Wire;

/// What was overheard about one node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Heard {
    /// Boot-ups.
    pub(super) boots: u32,
    /// The last state that it told.
    pub(super) state: Option<NmtState>,
    /// The last emergency other than "no error".
    pub(super) emergency: Option<Emergency>,
    /// What another master sent to it, last.
    pub(super) stranger: Option<Message>,
}

/// A wire at which is listened.
#[derive(Debug)]
pub(super) struct Overheard<'w, W> {
    wire: &'w mut W,
    node: NodeId,
    pub(super) heard: Heard,
}

impl<'w, W: Wire> Overheard<'w, W> {
    pub(super) fn new(wire: &'w mut W, node: NodeId) -> Self {
        Self {
            wire,
            node,
            heard: Heard::default(),
        }
    }

    fn listen(&mut self, frame: &Frame) {
        let message = Message::decode(frame);
        let heard = &mut self.heard;
        match message {
            Message::Heartbeat(node, NmtState::BootUp, _) if node == self.node => {
                heard.boots += 1;
                heard.state = Some(NmtState::PreOperational);
            }
            Message::Heartbeat(node, state, _) if node == self.node => heard.state = Some(state),
            Message::Emergency(node, emergency) if node == self.node && emergency.code != 0 => {
                heard.emergency = Some(emergency);
            }
            Message::Rpdo(node, _) | Message::SdoRequest(node, _) if node == self.node => {
                heard.stranger = Some(message);
            }
            Message::Nmt(_, node) if node.is_none_or(|node| node == self.node) => {
                heard.stranger = Some(message);
            }
            Message::Heartbeat(..)
            | Message::Emergency(..)
            | Message::Rpdo(..)
            | Message::SdoRequest(..)
            | Message::Nmt(..)
            | Message::Sync(_)
            | Message::Time(..)
            | Message::Tpdo(..)
            | Message::SdoResponse(..)
            | Message::Guard(_)
            | Message::Lss(..)
            | Message::Unknown => {}
        }
    }
}

impl<W: Wire> Wire for Overheard<'_, W> {
    fn now(&self) -> Duration {
        self.wire.now()
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        self.wire.send(frame)
    }

    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<Frame>> {
        let frame = self.wire.receive(timeout)?;
        if let Some(frame) = &frame {
            self.listen(frame);
        }
        Ok(frame)
    }

    fn is_stopped(&self) -> bool {
        self.wire.is_stopped()
    }
}
