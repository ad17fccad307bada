//! One frame at a time: what was sent, and which answer belongs to it. A frame that is not back when the next one
//! goes is lost; what comes back later than that is counted and dropped. What the datagrams mean is not known here.

use std::time::Duration;

use crate::wire::FrameWriter;
use crate::{Address, Command, DatagramHeader, Frame};

/// Most datagrams of one frame.
pub(super) const DATAGRAMS_MAX: usize = 72;

/// Who asked for a datagram, and so gets its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Owner {
    /// Distribution of the system time.
    Clock,
    /// Process data of a group; outputs, inputs or both.
    Process(u8),
    /// How many there are, and their states.
    Census,
    /// The AL status of a slave, out of turn.
    Inspection(u16),
    /// The scan.
    Scan,
    /// Who is at a position.
    Survey(u16),
    /// A slave is to get its address back.
    Adoption(u16),
    /// A slave is to lose an address that is another's.
    Release(u16),
    /// Whatever a slave's own machine does.
    Unit(u16),
}

/// A datagram of the frame under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sent {
    pub(super) owner: Owner,
    pub(super) command: Command,
    address: Address,
    len: u16,
    /// Where its data begins in the frame.
    at: usize,
}

/// What became of the frames, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounters {
    /// Sent; with two ports a frame counts once.
    pub sent: u64,
    /// Answered in time.
    pub answered: u64,
    /// Not back when the next one went.
    pub lost: u64,
    /// Back too late, or twice.
    pub stale: u64,
    /// Unreadable, or not what was sent.
    pub foreign: u64,
}

/// What a received frame was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// Nothing to do with the frame under way.
    Nothing,
    /// One half; the other port's frame is waited for.
    Half,
    /// The answer is complete.
    Whole,
}

/// The frame under way and its answer.
#[derive(Debug)]
pub(super) struct Exchange {
    sent: Vec<Sent>,
    frame: Vec<u8>,
    answer: Vec<u8>,
    index: u8,
    sent_at: Duration,
    open: bool,
    ports: u8,
    heard: [bool; 2],
    /// Frames in a row that a port did not deliver.
    deaf: [u8; 2],
    /// Working counter of the census, by the port that it came in by.
    census: [u16; 2],
    counters: FrameCounters,
}

/// After so many frames a silent port is no longer waited for.
const DEAF: u8 = 3;

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
            heard: [false; 2],
            deaf: [0; 2],
            census: [0; 2],
            counters: FrameCounters::default(),
        }
    }

    pub(super) const fn counters(&self) -> FrameCounters {
        self.counters
    }

    /// Goes on counting from here.
    pub(super) const fn keep(&mut self, counters: FrameCounters) {
        self.counters = counters;
    }

    /// Both ports delivered this frame.
    pub(super) const fn is_complete(&self) -> bool {
        self.heard[0] && self.heard[1]
    }

    pub(super) const fn is_open(&self) -> bool {
        self.open
    }

    pub(super) const fn sent_at(&self) -> Duration {
        self.sent_at
    }

    /// Slaves that answered, by the port that their half of the ring ends at; and which ports are heard.
    pub(super) const fn halves(&self) -> ([u16; 2], [bool; 2]) {
        (self.census, [self.deaf[0] < DEAF, self.deaf[1] < DEAF])
    }

    /// Where a ring is open, if slaves are reached from both of its ends: position 0 is then another slave from either
    /// end, and nothing can be asked by position.
    pub(super) const fn split(&self) -> Option<u16> {
        let [first, last] = self.census;
        if first > 0 && last > 0 {
            Some(first)
        } else {
            None
        }
    }

    /// Closes the frame under way: `Whole` if one half of the ring answered, `Nothing` if it is lost or there was none.
    pub(super) fn close(&mut self) -> Heard {
        if !std::mem::take(&mut self.open) {
            return Heard::Nothing;
        }
        self.note_deaf();
        if self.heard.contains(&true) {
            self.counters.answered += 1;
            return Heard::Whole;
        }
        self.counters.lost += 1;
        Heard::Nothing
    }

    fn note_deaf(&mut self) {
        for (deaf, heard) in self.deaf.iter_mut().zip(self.heard) {
            *deaf = if heard { 0 } else { deaf.saturating_add(1) };
        }
    }

    /// Begins a new frame.
    pub(super) fn begin(&mut self, now: Duration) -> Batch<'_> {
        self.index = self.index.wrapping_add(1);
        self.sent.clear();
        self.sent_at = now;
        self.heard = [false; 2];
        self.census = [0; 2];
        Batch {
            index: self.index,
            sent: &mut self.sent,
            writer: FrameWriter::new(&mut self.frame).ok(),
            used: crate::FrameHeader::LEN,
        }
    }

    /// Ends the frame of so many bytes and copies it to where its owner sends it from; `None` if nothing is in it,
    /// or the buffer is too short.
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

    /// Takes a frame that came in by a port.
    pub(super) fn handle(&mut self, port: usize, bytes: &[u8]) -> Heard {
        let port = port.min(1);
        let Ok(frame) = Frame::decode(bytes) else {
            self.counters.foreign += 1;
            return Heard::Nothing;
        };
        let first = frame.datagrams().next().and_then(Result::ok);
        let current = first.is_some_and(|datagram| datagram.header.index == self.index);
        if !self.open || !current || self.heard.get(port) == Some(&true) {
            self.counters.stale += 1;
            return Heard::Nothing;
        }
        if !self.is_answer(&frame) {
            self.counters.foreign += 1;
            return Heard::Nothing;
        }
        if self.heard.contains(&true) {
            self.merge(bytes);
        } else if let Some(to) = self.answer.get_mut(..bytes.len()) {
            to.copy_from_slice(bytes);
        } else {
            // Padding beyond the longest frame: nobody sends that.
            self.counters.foreign += 1;
            return Heard::Nothing;
        }
        self.note_census(port, &frame);
        self.heard
            .iter_mut()
            .skip(port)
            .take(1)
            .for_each(|heard| *heard = true);
        let waits = |n: usize| {
            self.heard.get(n) == Some(&false) && self.deaf.get(n).is_some_and(|d| *d < DEAF)
        };
        if self.ports == 2 && (waits(0) || waits(1)) {
            return Heard::Half;
        }
        self.open = false;
        self.note_deaf();
        self.counters.answered += 1;
        Heard::Whole
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
            // While slaves are only counted, that is the census.
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

    /// How many datagrams the frame has.
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
        let place = match (self.address, header.address) {
            (Address::Device { adp: a, ado: x }, Address::Device { adp: b, ado: y }) => {
                x == y && (a == b || self.command.is_positional())
            }
            (Address::Logical(a), Address::Logical(b)) => a == b,
            (Address::Device { .. }, Address::Logical(_))
            | (Address::Logical(_), Address::Device { .. }) => false,
        };
        place && header.index == index && header.command == self.command && header.len == self.len
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
    /// Bytes of data that one more datagram can have.
    pub(super) const fn room(&self) -> usize {
        if self.sent.len() == DATAGRAMS_MAX {
            return 0;
        }
        FrameWriter::LEN_MAX.saturating_sub(self.used + DatagramHeader::LEN + 2)
    }

    /// Adds a datagram; returns whether there was room for it.
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
    fn only_the_frame_under_way_is_answered() {
        let mut exchange = Exchange::new(false);
        let first = sent(&mut exchange);
        let second = sent(&mut exchange);
        assert_eq!(exchange.handle(0, &first), Heard::Nothing, "late");
        for (at, byte) in [(2, 8), (6, 0x31), (8, 3), (16, 5), (18, 7)] {
            let mut other = second.clone();
            other[at] = byte;
            assert_eq!(exchange.handle(0, &other), Heard::Nothing, "byte {at}");
        }
        assert_eq!(exchange.handle(0, &second[..9]), Heard::Nothing, "cut");
        assert_eq!(exchange.handle(0, &second), Heard::Whole);
        assert_eq!(exchange.handle(0, &second), Heard::Nothing, "twice");
        let counters = exchange.counters();
        assert_eq!((counters.sent, counters.lost, counters.answered), (2, 1, 1));
        assert_eq!((counters.stale, counters.foreign), (2, 6));
    }

    #[test]
    fn a_position_counts_up_on_its_way() {
        let mut exchange = Exchange::new(false);
        let mut frame = sent(&mut exchange);
        frame[4] = 9;
        frame[14] = 9;
        assert_eq!(exchange.handle(0, &frame), Heard::Whole);
        let census = exchange.sent(0).unwrap();
        assert_eq!(exchange.answer(&census), (&[0, 0][..], 9));
    }

    #[test]
    fn halves_of_a_cut_ring_are_put_together() {
        let mut exchange = Exchange::new(true);
        let frame = sent(&mut exchange);
        let (mut a, mut b) = (frame.clone(), frame);
        (a[12], a[14]) = (0x08, 2);
        (b[12], b[14]) = (0x04, 3);
        b[26..32].copy_from_slice(&[4, 0, 0, 0, 0x1B, 0]);
        b[32] = 1;
        assert_eq!(exchange.handle(0, &a), Heard::Half);
        assert_eq!(exchange.handle(1, &b), Heard::Whole);
        let census = exchange.sent(0).unwrap();
        assert_eq!(exchange.answer(&census), (&[0x0C, 0][..], 5));
        let status = exchange.sent(1).unwrap();
        assert_eq!(exchange.answer(&status), (&[4, 0, 0, 0, 0x1B, 0][..], 1));
        assert_eq!(exchange.halves(), ([2, 3], [true, true]));
    }

    #[test]
    fn a_port_that_is_cut_off_is_not_waited_for() {
        let mut exchange = Exchange::new(true);
        for _ in 0..DEAF {
            let frame = sent(&mut exchange);
            assert_eq!(exchange.handle(1, &frame), Heard::Half);
            assert_eq!(exchange.close(), Heard::Whole);
        }
        let frame = sent(&mut exchange);
        assert_eq!(exchange.handle(1, &frame), Heard::Whole);
        assert_eq!(exchange.halves().1, [false, true]);
    }
}
