//! Ethernet frames in the mailbox (EoE): when fragments are written, and where received ones go. What a frame is stands in
//! [`super::super::ethernet`].

use std::time::Duration;

use super::super::ethernet::{Ethernet, EthernetCounters};
use super::super::transfer::{Progress, Transfer};
use super::{Mailbox, Output, Phase};
use crate::MailboxKind;
use crate::eoe::Eoe;

impl Mailbox {
    /// Keeps received Ethernet frames from now on, or ends that.
    pub(in super::super) fn set_ethernet(&mut self, on: bool) {
        if on != self.ethernet.is_some() {
            self.ethernet = on.then(Ethernet::new);
        }
    }

    /// Whether the slave sends Ethernet frames whenever it likes, so that its mailbox is to be read often.
    pub(in super::super) fn has_ethernet(&self) -> bool {
        self.ethernet.is_some() && self.speaks(MailboxKind::Eoe)
    }

    /// Counters of Ethernet frames; `None` if they are not used.
    pub(in super::super) fn ethernet_counters(&self) -> Option<EthernetCounters> {
        self.ethernet.as_ref().map(Ethernet::counters)
    }

    /// Copies the oldest received Ethernet frame to `to`; returns its length.
    pub(in super::super) fn fetch_ethernet(&mut self, to: &mut [u8]) -> Option<usize> {
        self.ethernet.as_mut()?.fetch(to)
    }

    /// Whether an Ethernet frame is being sent.
    pub(super) fn streams(&self) -> bool {
        self.transfer.as_ref().is_some_and(Transfer::streams)
    }

    /// The slave accepted a fragment, or its mailbox is still full. Its own messages are read in between: a slave may accept
    /// none before they are.
    pub(super) fn sent_fragment(&mut self, taken: bool) -> Option<Output> {
        self.phase = Phase::Fetch;
        if !taken {
            return None;
        }
        self.accepted = true;
        if !self.transfer.as_mut().is_some_and(Transfer::accepted) {
            return None;
        }
        if let Some(ethernet) = &mut self.ethernet {
            ethernet.count_sent();
        }
        self.end(Ok(()))
    }

    /// Fragments and time stamps are unsolicited; the current transfer keeps waiting.
    pub(super) fn received_eoe(&mut self, inside: &[u8], now: Duration) -> Option<Output> {
        match (Eoe::decode(inside), &mut self.ethernet) {
            (Some(Eoe::Fragment(fragment)), Some(ethernet)) => {
                ethernet.handle(&fragment);
                if self.transfer.is_some() {
                    return self.resume(now);
                }
                // The next one may be there already; an empty mailbox does not answer.
                (self.phase, self.since) = (Phase::Fetch, now);
                None
            }
            (Some(Eoe::Request { .. } | Eoe::Response { .. }), _) if self.transfer.is_some() => {
                let transfer = self.transfer.as_mut().zip(Eoe::decode(inside));
                let progress =
                    transfer.map(|(transfer, message)| transfer.handle_ethernet(&message));
                self.proceed(progress.unwrap_or(Progress::Ignored), now)
            }
            (Some(_) | None, _) => {
                self.ignored += 1;
                None
            }
        }
    }
}
