//! Mailboxes of a slave: headers, counters, repeats, errors. The application handles the content of CoE mailboxes.

use std::collections::VecDeque;

use crate::{MailboxError, MailboxHeader, MailboxKind};

use super::Slave;
use super::faults::happens;

/// Maximum number of queued messages; the oldest are dropped when there are more.
const REPLIES_MAX: usize = 16;

/// Received request and messages to send.
#[derive(Clone, Debug, Default)]
pub(super) struct Post {
    replies: VecDeque<Vec<u8>>,
    /// The request in progress, and its completion time, ns.
    request: Vec<u8>,
    due: Option<u64>,
    /// Counter of the last mailbox received, and of the last sent.
    counters: (u8, u8),
}

impl Post {
    pub(super) fn reset(&mut self) {
        self.replies.clear();
        self.due = None;
        self.counters = (0, 0);
    }
}

impl Slave {
    /// Makes it send an Ethernet frame by its mailbox with a period in ns, as if a master had set its address before;
    /// `None` ends that.
    pub fn set_ethernet(&mut self, period: Option<u64>) {
        self.config.eoe = period;
        let now = self.ran;
        if let Some(station) = &mut self.station {
            station.announce(period.map(|_| now));
        }
    }

    pub(super) fn poll_mailbox(&mut self, now: u64) {
        if self.faults.hung {
            return;
        }
        let post = &mut self.post;
        if post.due.is_none() && self.memory.take_mailbox(0, &mut post.request) {
            post.due = Some(now + self.config.times.mailbox.draw(&mut self.random));
        }
        if post.due.is_some_and(|due| now >= due) {
            post.due = None;
            let request = std::mem::take(&mut post.request);
            self.answer(&request, now);
            self.post.request = request;
        }
        let mut unasked = Vec::new();
        while self.post.replies.len() < REPLIES_MAX && self.application.unasked(&mut unasked) {
            self.queue(MailboxKind::Coe, &unasked);
        }
        self.send_ethernet(now);
        if let Some(reply) = self.post.replies.front()
            && self.memory.put_mailbox(1, reply)
        {
            self.post.replies.pop_front();
        }
    }

    fn answer(&mut self, mailbox: &[u8], now: u64) {
        let mut reply = Vec::new();
        if self.application.has_raw_mailbox() {
            if self.application.mailbox(mailbox, &mut reply) {
                self.send(reply);
            }
            return;
        }
        let Some((header, inside)) = MailboxHeader::decode(mailbox) else {
            self.queue(MailboxKind::Error, &MailboxError(0x0006).encode());
            return;
        };
        if header.counter != 0 && header.counter == self.post.counters.0 {
            // The master sent it again; it was already executed.
            return;
        }
        self.post.counters.0 = header.counter;
        if self.config.counters_follow && header.counter != 0 {
            // The counter of the answer, which is incremented below, is that of the request.
            self.post.counters.1 = header.counter.wrapping_sub(1);
        }
        if let Some((left, code)) = &mut self.faults.mailbox_errors
            && happens(left)
        {
            let error = MailboxError(*code).encode();
            self.queue(MailboxKind::Error, &error);
            return;
        }
        if header.kind == MailboxKind::Foe && self.files.is_some() {
            let len = |number| self.memory.sync_manager(number).len;
            let (state, lens) = (self.state, (len(0), len(1)));
            let answer = self.files.as_mut();
            let answer = answer.and_then(|server| server.answer(inside, state, lens));
            if let Some(answer) = answer.filter(|_| !happens(&mut self.faults.lose_answers)) {
                self.queue(MailboxKind::Foe, &answer);
            }
            return;
        }
        let offset = self.offset();
        if header.kind == MailboxKind::Eoe
            && self.state != crate::AlState::Boot
            && let Some(station) = &mut self.station
        {
            let time = self
                .clock
                .as_ref()
                .map_or(now, |clock| clock.local(now).wrapping_add(offset));
            let answer = station.answer(inside, now, time);
            if let Some(answer) = answer.filter(|_| !happens(&mut self.faults.lose_answers)) {
                self.queue(MailboxKind::Eoe, &answer);
            }
            return;
        }
        if header.kind != MailboxKind::Coe
            || self.config.sii.coe == 0
            || self.state == crate::AlState::Boot
        {
            self.queue(MailboxKind::Error, &MailboxError(0x0002).encode());
            return;
        }
        if self.application.mailbox(inside, &mut reply) && !happens(&mut self.faults.lose_answers) {
            self.queue(MailboxKind::Coe, &reply);
        }
    }

    /// Queues a fragment of an Ethernet frame whenever the mailbox has nothing else to send.
    fn send_ethernet(&mut self, now: u64) {
        let len = usize::from(self.memory.sync_manager(1).len);
        let period = self.config.eoe;
        let Some(station) = &mut self.station else {
            return;
        };
        if self.post.replies.is_empty()
            && let Some(fragment) = station.fragment(now, period, len)
        {
            self.queue(MailboxKind::Eoe, &fragment);
        }
    }

    fn queue(&mut self, kind: MailboxKind, inside: &[u8]) {
        self.post.counters.1 = MailboxHeader::next_counter(self.post.counters.1);
        let header = MailboxHeader {
            len: u16::try_from(inside.len()).unwrap_or(u16::MAX),
            address: 0,
            kind,
            counter: self.post.counters.1,
        };
        let mut message = header.encode().to_vec();
        message.extend_from_slice(inside);
        if happens(&mut self.faults.repeat_answers) {
            self.send(message.clone());
        }
        self.send(message);
    }

    fn send(&mut self, message: Vec<u8>) {
        let replies = &mut self.post.replies;
        if replies.len() == REPLIES_MAX {
            replies.pop_front();
        }
        replies.push_back(message);
    }
}
