//! The SDO client of a node: selects the next transfer and passes the outcome to its owner.

use std::time::Duration;

use takt_cia402::dictionary::AbortCode;
use takt_cia402::proof::Denied;

use super::{Member, Owner, QUIET_TIME};
use crate::canopen::network::startup::{Action, Answer, Phase};
use crate::canopen::network::{Axis, Outcome, TRANSFERS_MAX, Transfer};
use crate::canopen::sdo;

impl Member {
    pub(in crate::canopen::network) fn enqueue(
        &mut self,
        transfer: Transfer,
    ) -> Result<(), Transfer> {
        if self.waiting.len() + self.finished.len() >= TRANSFERS_MAX {
            return Err(transfer);
        }
        self.waiting.push_back(transfer);
        Ok(())
    }

    pub(in crate::canopen::network) fn take_finished(&mut self) -> Option<(Transfer, Outcome)> {
        self.finished.pop_front()
    }

    pub(super) fn has_sdo(&self) -> bool {
        let ready = self.may_transfer() && !self.waiting.is_empty();
        let proves = self.is_running() && self.axes.iter().any(Axis::has_upload);
        let next =
            self.client.is_idle() && (ready || proves || self.pending_request != Action::None);
        self.message.is_some() || next
    }

    fn may_transfer(&self) -> bool {
        match self.startup.phase() {
            Phase::Off | Phase::Running | Phase::Failed => true,
            Phase::Resetting | Phase::Checking(_) | Phase::Configuring { .. } | Phase::Starting => {
                false
            }
        }
    }

    /// The next SDO message to the server of the node.
    pub(in crate::canopen::network) fn poll_sdo(&mut self, now: Duration) -> Option<sdo::Message> {
        // An abort is sent at once.
        if let Some(message) = self.message.take() {
            return Some(message);
        }
        if now < self.quiet_until {
            return None;
        }
        if self.client.is_idle() {
            self.next_transfer(now);
            return self.message.take();
        }
        let progress = self.client.poll(now);
        self.progress(progress, now);
        self.message.take()
    }

    fn next_transfer(&mut self, now: Duration) {
        match std::mem::replace(&mut self.pending_request, Action::None) {
            Action::Read(address) => {
                self.owner = Owner::Startup;
                self.message = Some(self.client.read(address, false, now));
            }
            Action::Write(at) => {
                let Some(download) = self.startup.download(at) else {
                    return;
                };
                self.owner = Owner::Startup;
                let written = self
                    .client
                    .write(download.address, &download.data, false, now);
                match written {
                    Ok(message) => self.message = Some(message),
                    Err(code) => self.finish(Outcome::GaveUp(code), now),
                }
            }
            Action::None | Action::Command(_) => {
                if !self.next_of_axes(now) {
                    self.next_of_user(now);
                }
            }
        }
    }

    fn next_of_axes(&mut self, now: Duration) -> bool {
        let running = self.is_running();
        let mut axes = self.axes.iter_mut().enumerate().filter(|_| running);
        let next = axes.find_map(|(at, axis)| Some((at, axis.poll_upload()?)));
        let Some((at, address)) = next else {
            return false;
        };
        self.owner = Owner::Axis(at);
        self.message = Some(self.client.read(address, false, now));
        true
    }

    fn next_of_user(&mut self, now: Duration) {
        if !self.may_transfer() {
            return;
        }
        let Some(transfer) = self.waiting.pop_front() else {
            return;
        };
        let (address, blocks) = (transfer.address, transfer.in_blocks);
        if transfer.write {
            let written = self.client.write(address, &transfer.data, blocks, now);
            self.owner = Owner::User(transfer);
            match written {
                Ok(message) => self.message = Some(message),
                Err(code) => self.finish(Outcome::GaveUp(code), now),
            }
        } else {
            self.owner = Owner::User(transfer);
            self.message = Some(self.client.read(address, blocks, now));
        }
    }

    pub(in crate::canopen::network) fn handle_sdo(
        &mut self,
        message: &sdo::Message,
        now: Duration,
    ) {
        if !self.client.is_idle() {
            let progress = self.client.handle(message, now);
            self.progress(progress, now);
        } else if now < self.babble.end {
            self.quiet_until = (now + QUIET_TIME).min(self.babble.end);
        }
    }

    fn progress(&mut self, progress: sdo::Progress, now: Duration) {
        if progress.send.is_some() {
            self.message = progress.send;
        }
        if let Some(outcome) = progress.outcome {
            self.finish(outcome, now);
        }
    }

    fn finish(&mut self, outcome: Outcome, now: Duration) {
        match std::mem::replace(&mut self.owner, Owner::None) {
            Owner::None => {}
            Owner::Startup if self.retry_request(outcome, now) => {}
            Owner::Startup => {
                let answer = match outcome {
                    Outcome::Read => Answer::Value(self.client.value()),
                    Outcome::Written => Answer::Written,
                    Outcome::Refused(code) => Answer::Refused(code),
                    Outcome::GaveUp(AbortCode::TimedOut) => Answer::Silent,
                    Outcome::GaveUp(code) => Answer::Refused(code),
                };
                let action = self.startup.handle_answer(answer, now);
                self.execute(action, now);
            }
            Owner::Axis(at) => {
                let answer = match outcome {
                    Outcome::Read => Ok(self.client.value()),
                    Outcome::Refused(code) => Err(Denied::Abort(code)),
                    Outcome::Written | Outcome::GaveUp(_) => Err(Denied::Silent),
                };
                if let Some(axis) = self.axes.get_mut(at) {
                    axis.handle_upload(answer, now);
                }
            }
            Owner::User(mut transfer) => {
                if outcome == Outcome::Read {
                    transfer.data.clear();
                    transfer.data.extend_from_slice(self.client.value());
                }
                self.finished.push_back((transfer, outcome));
            }
        }
    }

    /// Ends the running transfer without reporting to the start procedure.
    pub(super) fn drop_transfer(&mut self, code: AbortCode) {
        let owner = std::mem::replace(&mut self.owner, Owner::None);
        if !self.client.is_idle() {
            // The server restarted or is offline: no one receives a report.
            let _ = self.client.give_up(code);
            self.message = None;
        }
        if let Owner::User(transfer) = owner {
            self.finished.push_back((transfer, Outcome::GaveUp(code)));
        }
    }
}
