//! Handling of each kind of frame and of timeouts. [`Node::handle_frame`] checks the NMT state.

use std::time::Duration;

use super::hooks::NodeHooks;
use super::{Application, Event, Node};
use crate::canopen::emcy::{Source, code, register};
use crate::canopen::message::{LSS_SLAVE, frame};
use crate::canopen::nmt::{Consumer, HeartbeatEvent, Input, Reset, State, Watch};
use crate::canopen::pdo::Received;
use crate::canopen::{HEARTBEAT, Message, NmtCommand, NodeId, lss, sdo};
use crate::{Frame, Id};

impl<A: Application> Node<A> {
    pub(super) fn handle_remote(&mut self, id: Id, now: Duration) {
        if id == self.slave.id().cob(HEARTBEAT) {
            if let Some(answer) = self.slave.handle_guard(now) {
                self.push(answer);
            }
        } else if self.slave.state() == State::Operational {
            let mine = self
                .tpdos
                .iter_mut()
                .find(|(_, tpdo)| tpdo.id() == Some(id));
            let sent = mine.and_then(|(_, tpdo)| tpdo.handle_remote(&self.dictionary, now));
            if let Some(frame) = sent {
                self.push(frame);
            }
        }
    }

    pub(super) fn handle_nmt(&mut self, frame: &Frame, now: Duration) {
        let Message::Nmt(command, node) = Message::decode(frame) else {
            return;
        };
        // 0 addresses all nodes; numbers above 127 address none.
        let to_all = frame.data().get(1) == Some(&0);
        if to_all || node == Some(self.slave.id()) {
            let is_reset = matches!(
                command,
                NmtCommand::ResetNode | NmtCommand::ResetCommunication
            );
            if is_reset && self.slave.state() == State::Initialising {
                // It waits for LSS; starts if it has a node number by now.
                self.begin(Reset::Communication, now);
            } else {
                self.manage(Input::Command(command), now);
            }
        }
    }

    pub(super) fn handle_lss(&mut self, data: &[u8], now: Duration) {
        let Some(message) = data.first_chunk() else {
            return;
        };
        let (answer, done) = self.lss.handle(message);
        if let Some(answer) = answer {
            self.push(frame(LSS_SLAVE, &answer));
        }
        match done {
            Some(lss::Done::Activate(_)) => self.begin(Reset::Communication, now),
            Some(done @ (lss::Done::Store(_) | lss::Done::BitTiming(..))) => {
                self.notify(Event::Lss(done), now);
            }
            None => {}
        }
    }

    pub(super) fn handle_sync(&mut self, data: &[u8], now: Duration) {
        let counter = match self.sync.handle(data, now) {
            Ok(counter) => counter,
            Err(wrong) => {
                let data = [wrong.len, wrong.expected, 0, 0, 0];
                let register = register::COMMUNICATION;
                self.errors
                    .raise(Source::Communication, code::SYNC_LENGTH, register, data);
                return;
            }
        };
        self.errors.clear(Source::Communication, code::SYNC_LENGTH);
        let operational = self.slave.state() == State::Operational;
        if operational {
            for (_, rpdo) in &mut self.rpdos {
                rpdo.handle_sync(&mut self.dictionary);
            }
        }
        self.notify(Event::Sync, now);
        for at in 0..self.rpdos.len() {
            let (number, rpdo) = &mut self.rpdos[at];
            let number = *number;
            if rpdo.take_applied() {
                self.notify(Event::Received(number), now);
            }
        }
        self.write_errors();
        if operational {
            for at in 0..self.tpdos.len() {
                let (_, tpdo) = &mut self.tpdos[at];
                if let Some(frame) = tpdo.handle_sync(counter, &self.dictionary, now) {
                    self.push(frame);
                }
            }
        }
    }

    pub(super) fn handle_sdo(&mut self, data: &[u8], now: Duration) {
        let Some(message) = data.first_chunk() else {
            return;
        };
        if let Some(abort) = self.quirks.abort_absent(message) {
            return self.answer(message, abort, now);
        }
        let mut hooks = NodeHooks::new(&mut self.application);
        let answer = self
            .server
            .handle(message, &mut self.dictionary, &mut hooks, now);
        let written = hooks.written();
        if let Some(address) = written {
            self.configure(address, now);
        }
        if let Some(answer) = answer {
            self.answer(message, answer, now);
        }
    }

    fn answer(&mut self, request: &sdo::Message, answer: sdo::Message, now: Duration) {
        let answer = self.quirks.shape(request, answer);
        let answer = frame(self.settings.response, &answer);
        if self.quirks.delays() {
            self.quirks.delay(answer, now);
        } else {
            self.push(answer);
        }
    }

    pub(super) fn handle_rpdo(&mut self, id: Id, data: &[u8], now: Duration) {
        if self.slave.state() != State::Operational {
            return;
        }
        let window = self.sync.is_open(now);
        let mine = self
            .rpdos
            .iter_mut()
            .find(|(_, rpdo)| rpdo.id() == Some(id));
        let Some((number, rpdo)) = mine.filter(|(_, rpdo)| !rpdo.mapping().is_empty()) else {
            return;
        };
        let number = *number;
        let was_late = rpdo.is_late();
        let received = rpdo.handle(data, &mut self.dictionary, window, now);
        let long = rpdo.is_long(data.len());
        let [low, high] = number.saturating_add(1).to_le_bytes();
        let details = [low, high, u8::try_from(data.len()).unwrap_or(0), 0, 0];
        let bits = register::COMMUNICATION;
        let from = Source::Communication;
        let short = matches!(received, Received::Short { .. });
        for (wrong, code) in [(short, code::PDO_SHORT), (long, code::PDO_LONG)] {
            if wrong {
                self.errors.raise(from, code, bits, details);
            } else {
                self.errors.clear(from, code);
            }
        }
        if was_late && !self.rpdos.iter().any(|(_, rpdo)| rpdo.is_late()) {
            self.errors.clear(from, code::RPDO_TIMEOUT);
        }
        if was_late && !short {
            self.notify(Event::InTime(number), now);
        }
        if received == Received::Taken {
            self.notify(Event::Received(number), now);
        }
    }

    pub(super) fn handle_heartbeat(&mut self, frame: &Frame, now: Duration) {
        if self.consumers.is_empty() {
            return;
        }
        let Message::Heartbeat(node, state, _) = Message::decode(frame) else {
            return;
        };
        let mine = |watched: &&mut (Option<NodeId>, Consumer)| watched.0 == Some(node);
        let Some((_, consumer)) = self.consumers.iter_mut().find(mine) else {
            return;
        };
        let event = consumer.handle(state, now);
        let lost = |(_, c): &(_, Consumer)| c.watch() == Watch::Lost;
        if matches!(event, HeartbeatEvent::Appeared(_)) && !self.consumers.iter().any(lost) {
            self.errors.clear(Source::Communication, code::HEARTBEAT);
            self.notify(Event::Back, now);
        }
    }

    /// A heartbeat or the guarding master was lost: EMCY 8130h, reaction 1029h, and notification of
    /// the application.
    pub(super) fn handle_loss(&mut self, node: u8, now: Duration) {
        let data = [node, 0, 0, 0, 0];
        let bits = register::COMMUNICATION;
        self.errors
            .raise(Source::Communication, code::HEARTBEAT, bits, data);
        self.notify(Event::Lost, now);
        self.manage(Input::Error(self.settings.behaviour), now);
    }

    /// Handles timeouts: late PDOs, lost heartbeats, due messages.
    pub(super) fn run_timers(&mut self, now: Duration) {
        self.run_quirks(now);
        self.run_application(now);
        for at in 0..self.consumers.len() {
            let (node, consumer) = &mut self.consumers[at];
            if consumer.poll(now) {
                let node = node.map_or(0, NodeId::raw);
                self.handle_loss(node, now);
            }
        }
        if self.slave.poll_life(now) {
            self.handle_loss(0, now);
        }
        if self.slave.state() == State::Operational {
            self.run_deadlines(now);
        }
        if let Some(counter) = self.sync_producer.as_mut().and_then(|p| p.poll(now))
            && self.slave.state().communicates()
        {
            let counter = counter.as_slice();
            self.push(frame(self.settings.sync, counter));
            self.handle_sync(counter, now);
        }
        self.write_errors();
    }

    pub(super) fn run_deadlines(&mut self, now: Duration) {
        for at in 0..self.rpdos.len() {
            let (number, rpdo) = &mut self.rpdos[at];
            if rpdo.poll(now) {
                let number = *number;
                let [low, high] = number.saturating_add(1).to_le_bytes();
                let bits = register::COMMUNICATION;
                let data = [low, high, 0, 0, 0];
                self.errors
                    .raise(Source::Communication, code::RPDO_TIMEOUT, bits, data);
                self.notify(Event::Late(number), now);
            }
        }
    }
}
