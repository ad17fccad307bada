//! One frame at a time: matches answers to the sent frame. A frame that has not returned when the next one is sent is
//! lost; a later answer is counted and dropped. The meaning of the datagrams is not known here.

use std::time::Duration;

use crate::wire::FrameWriter;
use crate::{Address, Command, DatagramHeader, Frame};

/// Maximum number of datagrams per frame.
pub(super) const DATAGRAMS_MAX: usize = 72;

/// The requester of a datagram, which gets its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Owner {
    /// Distribution of the system time.
    Clock,
    /// Process data of a group; outputs, inputs or both.
    Process(u8),
    /// Number of slaves, and their states.
    Census,
    /// The AL status of one slave, when the census differs.
    Inspection(u16),
    /// The scan.
    Scan,
    /// The slave at a position.
    Survey(u16),
    /// Gives a slave its address back.
    Adoption(u16),
    /// Clears an address that belongs to another slave.
    Release(u16),
    /// A request of a slave's own state machine.
    Unit(u16),
}

/// A datagram of the pending frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sent {
    pub(super) owner: Owner,
    pub(super) command: Command,
    address: Address,
    len: u16,
    /// Offset of its data in the frame.
    at: usize,
}

/// Frame counters since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounters {
    /// Sent; with two ports a frame counts once.
    pub sent: u64,
    /// Answered in time.
    pub answered: u64,
    /// Not returned when the next one was sent.
    pub lost: u64,
    /// Returned late, or twice.
    pub stale: u64,
    /// Unreadable, or not what was sent.
    pub foreign: u64,
}

/// Kind of a received frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Received {
    /// Unrelated to the pending frame.
    Nothing,
    /// One half of a ring; the frame of the other port is pending.
    Half,
    /// The answer is complete.
    Whole,
}

/// The pending frame and its answer.
#[derive(Debug)]
pub(super) struct Exchange {
    sent: Vec<Sent>,
    frame: Vec<u8>,
    answer: Vec<u8>,
    index: u8,
    sent_at: Duration,
    open: bool,
    ports: u8,
    received: [bool; 2],
    /// Consecutive frames that a port did not deliver.
    silent: [u8; 2],
    /// Working counter of the census, by receiving port.
    census: [u16; 2],
    counters: FrameCounters,
}

/// Number of frames after which a silent port is no longer awaited.
const SILENT_MAX: u8 = 3;

impl Exchange {
    pub(super) fn new(redundant: bool) -> Self {
        Self {
            sent: Vec::with_capacity(DATAGRAMS_MAX),
            frame: vec![0; FrameWriter::LEN_MAX],
            answer: vec![0; FrameWriter::LEN_MAX],
            index: 0,
            sent_at: Duration::ZERO,
            open: false,
            ports: if redundant { 2 } else { 1 },
            received: [false; 2],
            silent: [0; 2],
            census: [0; 2],
            counters: FrameCounters::default(),
        }
    }

    pub(super) const fn counters(&self) -> FrameCounters {
        self.counters
    }

    /// Continues counting from these values.
    pub(super) const fn keep(&mut self, counters: FrameCounters) {
        self.counters = counters;
    }

    /// Both ports delivered this frame.
    pub(super) const fn is_complete(&self) -> bool {
        self.received[0] && self.received[1]
    }

    pub(super) const fn is_open(&self) -> bool {
        self.open
    }

    pub(super) const fn sent_at(&self) -> Duration {
        self.sent_at
    }

    /// Number of slaves that answered, by the port at which their half of the ring ends; and which ports receive
    /// frames.
    pub(super) const fn halves(&self) -> ([u16; 2], [bool; 2]) {
        (
            self.census,
            [self.silent[0] < SILENT_MAX, self.silent[1] < SILENT_MAX],
        )
    }

    /// Position at which a ring is open with slaves on both ends: position 0 is then a different slave from either end,
    /// and addressing by position is impossible.
    pub(super) const fn split(&self) -> Option<u16> {
        let [first, last] = self.census;
        if first > 0 && last > 0 {
            Some(first)
        } else {
            None
        }
    }

    /// Closes the pending frame: `Whole` if one half of the ring answered, `Nothing` if it is lost or there was none.
    pub(super) fn close(&mut self) -> Received {
        if !std::mem::take(&mut self.open) {
            return Received::Nothing;
        }
        self.count_silent();
        if self.received.contains(&true) {
            self.counters.answered += 1;
            return Received::Whole;
        }
        self.counters.lost += 1;
        Received::Nothing
    }

    fn count_silent(&mut self) {
        for (silent, received) in self.silent.iter_mut().zip(self.received) {
            *silent = if received {
                0
            } else {
                silent.saturating_add(1)
            };
        }
    }

    /// Starts a new frame.
    pub(super) fn begin(&mut self, now: Duration) -> Batch<'_> {
        self.index = self.index.wrapping_add(1);
        self.sent.clear();
        self.sent_at = now;
        self.received = [false; 2];
        self.census = [0; 2];
        Batch {
            index: self.index,
            sent: &mut self.sent,
            writer: FrameWriter::new(&mut self.frame).ok(),
            used: crate::FrameHeader::LEN,
        }
    }

    /// Ends the frame of `len` bytes and copies it to the owner's send buffer; `None` if it is empty or the buffer is
    /// too short.
    pub(super) fn finish(&mut self, len: usize, to: &mut [u8]) -> Option<usize> {
        if self.sent.is_empty() {
            return None;
        }
        let frame = self.frame.get(..len)?;
        to.get_mut(..len)?.copy_from_slice(frame);
        self.open = true;
        self.counters.sent += 1;
        Some(len)
    }

    /// Handles a frame received on a port.
    pub(super) fn handle(&mut self, port: usize, bytes: &[u8]) -> Received {
        let port = port.min(1);
        let Ok(frame) = Frame::decode(bytes) else {
            self.counters.foreign += 1;
            return Received::Nothing;
        };
        let first = frame.datagrams().next().and_then(Result::ok);
        let current = first.is_some_and(|datagram| datagram.header.index == self.index);
        if !self.open || !current || self.received.get(port) == Some(&true) {
            self.counters.stale += 1;
            return Received::Nothing;
        }
        if !self.is_answer(&frame) {
            self.counters.foreign += 1;
            return Received::Nothing;
        }
        if self.received.contains(&true) {
            self.merge(bytes);
        } else if let Some(to) = self.answer.get_mut(..bytes.len()) {
            to.copy_from_slice(bytes);
        } else {
            // Padding beyond the longest frame is never sent.
            self.counters.foreign += 1;
            return Received::Nothing;
        }
        self.note_census(port, &frame);
        self.received
            .iter_mut()
            .skip(port)
            .take(1)
            .for_each(|received| *received = true);
        let waits = |n: usize| {
            self.received.get(n) == Some(&false)
                && self.silent.get(n).is_some_and(|d| *d < SILENT_MAX)
        };
        if self.ports == 2 && (waits(0) || waits(1)) {
            return Received::Half;
        }
        self.open = false;
        self.count_silent();
        self.counters.answered += 1;
        Received::Whole
    }

    /// Same datagrams in the same order: command, index, length and address. Of a position only the register counts,
    /// as each slave has added one to the rest.
    fn is_answer(&self, frame: &Frame<'_>) -> bool {
        let mut sent = self.sent.iter();
        for datagram in frame.datagrams() {
            let (Ok(datagram), Some(sent)) = (datagram, sent.next()) else {
                return false;
            };
            if !sent.matches(&datagram.header, self.index) {
                return false;
            }
        }
        sent.next().is_none()
    }

    fn note_census(&mut self, port: usize, frame: &Frame<'_>) {
        let counted = self.sent.iter().zip(frame.datagrams());
        for (sent, datagram) in counted {
            // While slaves are only counted, this is the census.
            let counts = sent.owner == Owner::Census
                || (sent.owner == Owner::Scan && sent.command == Command::Brd);
            if let (true, Ok(datagram), Some(to)) = (counts, datagram, self.census.get_mut(port)) {
                *to = datagram.working_counter.raw();
            }
        }
    }

    /// Adds the other half of the ring: working counters are added; of a broadcast the bits are OR-ed, of all else
    /// those bytes are taken that the other half changed.
    fn merge(&mut self, bytes: &[u8]) {
        for sent in &self.sent {
            let data = sent.at..sent.at + usize::from(sent.len);
            let broad = matches!(sent.command, Command::Brd | Command::Brw);
            let (Some(to), Some(from), Some(out)) = (
                self.answer.get_mut(data.clone()),
                bytes.get(data.clone()),
                self.frame.get(data),
            ) else {
                continue;
            };
            for ((to, from), out) in to.iter_mut().zip(from).zip(out) {
                if broad {
                    *to |= *from;
                } else if *to == *out {
                    *to = *from;
                }
            }
            let counters = sent.counter_range();
            let other = counter(bytes, &counters);
            let sum = counter(&self.answer, &counters).wrapping_add(other);
            if let Some(to) = self.answer.get_mut(counters) {
                to.copy_from_slice(&sum.to_le_bytes());
            }
        }
    }

    /// Number of datagrams of the frame.
    pub(super) const fn len(&self) -> usize {
        self.sent.len()
    }

    /// A datagram of the frame.
    pub(super) fn sent(&self, number: usize) -> Option<Sent> {
        self.sent.get(number).copied()
    }

    /// The answer to a datagram: data and working counter.
    pub(super) fn answer(&self, sent: &Sent) -> (&[u8], u16) {
        let data = self.answer.get(sent.at..sent.at + usize::from(sent.len));
        (
            data.unwrap_or_default(),
            counter(&self.answer, &sent.counter_range()),
        )
    }
}

fn counter(bytes: &[u8], range: &std::ops::Range<usize>) -> u16 {
    let two = bytes.get(range.clone()).and_then(|rest| rest.first_chunk());
    two.map_or(0, |two| u16::from_le_bytes(*two))
}

impl Sent {
    fn counter_range(&self) -> std::ops::Range<usize> {
        let end = self.at + usize::from(self.len);
        end..end + 2
    }

    fn matches(&self, header: &DatagramHeader, index: u8) -> bool {
        let same_address = match (self.address, header.address) {
            (Address::Device { adp: a, ado: x }, Address::Device { adp: b, ado: y }) => {
                x == y && (a == b || self.command.is_positional())
            }
            (Address::Logical(a), Address::Logical(b)) => a == b,
            (Address::Device { .. }, Address::Logical(_))
            | (Address::Logical(_), Address::Device { .. }) => false,
        };
        same_address
            && header.index == index
            && header.command == self.command
            && header.len == self.len
    }
}

/// A frame being filled.
#[derive(Debug)]
pub(super) struct Batch<'a> {
    index: u8,
    sent: &'a mut Vec<Sent>,
    writer: Option<FrameWriter<'a>>,
    used: usize,
}

impl Batch<'_> {
    /// Data capacity of one more datagram, bytes.
    pub(super) const fn remaining(&self) -> usize {
        if self.sent.len() == DATAGRAMS_MAX {
            return 0;
        }
        FrameWriter::LEN_MAX.saturating_sub(self.used + DatagramHeader::LEN + 2)
    }

    /// Adds a datagram; returns whether it fitted.
    pub(super) fn push(
        &mut self,
        owner: Owner,
        command: Command,
        address: Address,
        data: &[u8],
    ) -> bool {
        let Some(writer) = self
            .writer
            .as_mut()
            .filter(|_| self.sent.len() < DATAGRAMS_MAX)
        else {
            return false;
        };
        let Ok(len) = u16::try_from(data.len()) else {
            return false;
        };
        if writer.push(command, self.index, address, data).is_err() {
            return false;
        }
        self.sent.push(Sent {
            owner,
            command,
            address,
            len,
            at: self.used + DatagramHeader::LEN,
        });
        self.used += DatagramHeader::LEN + data.len() + 2;
        true
    }

    /// Length of the frame, bytes.
    pub(super) fn finish(self) -> usize {
        self.writer.map_or(0, FrameWriter::finish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATUS: Address = Address::Device {
        adp: 0x1001,
        ado: 0x0130,
    };

    /// A frame of a census and a read, as sent.
    fn sent(exchange: &mut Exchange) -> Vec<u8> {
        exchange.close();
        let mut batch = exchange.begin(Duration::ZERO);
        let all = Address::Device {
            adp: 0,
            ado: 0x0130,
        };
        assert!(batch.push(Owner::Census, Command::Brd, all, &[0; 2]));
        assert!(batch.push(Owner::Unit(0), Command::Fprd, STATUS, &[0; 6]));
        let len = batch.finish();
        let mut to = vec![0; 1500];
        assert_eq!(exchange.finish(len, &mut to), Some(len));
        to.truncate(len);
        to
    }

    #[test]
    fn only_the_pending_frame_is_matched() {
        let mut exchange = Exchange::new(false);
        let first = sent(&mut exchange);
        let second = sent(&mut exchange);
        assert_eq!(exchange.handle(0, &first), Received::Nothing, "late");
        for (at, byte) in [(2, 8), (6, 0x31), (8, 3), (16, 5), (18, 7)] {
            let mut other = second.clone();
            other[at] = byte;
            assert_eq!(exchange.handle(0, &other), Received::Nothing, "byte {at}");
        }
        assert_eq!(exchange.handle(0, &second[..9]), Received::Nothing, "cut");
        assert_eq!(exchange.handle(0, &second), Received::Whole);
        assert_eq!(exchange.handle(0, &second), Received::Nothing, "twice");
        let counters = exchange.counters();
        assert_eq!((counters.sent, counters.lost, counters.answered), (2, 1, 1));
        assert_eq!((counters.stale, counters.foreign), (2, 6));
    }

    #[test]
    fn position_address_increments_along_the_ring() {
        let mut exchange = Exchange::new(false);
        let mut frame = sent(&mut exchange);
        frame[4] = 9;
        frame[14] = 9;
        assert_eq!(exchange.handle(0, &frame), Received::Whole);
        let census = exchange.sent(0).unwrap();
        assert_eq!(exchange.answer(&census), (&[0, 0][..], 9));
    }

    #[test]
    fn halves_of_a_cut_ring_are_merged() {
        let mut exchange = Exchange::new(true);
        let frame = sent(&mut exchange);
        let (mut a, mut b) = (frame.clone(), frame);
        (a[12], a[14]) = (0x08, 2);
        (b[12], b[14]) = (0x04, 3);
        b[26..32].copy_from_slice(&[4, 0, 0, 0, 0x1B, 0]);
        b[32] = 1;
        assert_eq!(exchange.handle(0, &a), Received::Half);
        assert_eq!(exchange.handle(1, &b), Received::Whole);
        let census = exchange.sent(0).unwrap();
        assert_eq!(exchange.answer(&census), (&[0x0C, 0][..], 5));
        let status = exchange.sent(1).unwrap();
        assert_eq!(exchange.answer(&status), (&[4, 0, 0, 0, 0x1B, 0][..], 1));
        assert_eq!(exchange.halves(), ([2, 3], [true, true]));
    }

    #[test]
    fn port_that_is_cut_off_causes_no_wait() {
        let mut exchange = Exchange::new(true);
        for _ in 0..SILENT_MAX {
            let frame = sent(&mut exchange);
            assert_eq!(exchange.handle(1, &frame), Received::Half);
            assert_eq!(exchange.close(), Received::Whole);
        }
        let frame = sent(&mut exchange);
        assert_eq!(exchange.handle(1, &frame), Received::Whole);
        assert_eq!(exchange.halves().1, [false, true]);
    }
}
