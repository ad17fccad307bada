//! The flight recorder: the last events of a real-time thread, for the report after a fault.
//!
//! It stays in its thread. Its owner returns it when the thread ends, or, on a fault in a thread that
//! continues, copies the entries into a [`latest`](crate::latest) cell ([`FlightRecorder::copy_to`]).

use std::{cell::Cell, fmt};

/// One event. Displays as one line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// Number of the cycle.
    pub cycle: u64,
    /// Source of the event, as in `ecat`.
    pub source: &'static str,
    /// Name of the event, as in `working counter`.
    pub event: &'static str,
    /// Value of the event; its name implies the unit.
    pub value: i64,
}

impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            cycle,
            source,
            event,
            value,
        } = self;
        write!(f, "{cycle} {source}: {event} {value}")
    }
}

impl Entry {
    /// An empty entry, the initial content of entry memory.
    pub(crate) const BLANK: Self = Self {
        cycle: 0,
        source: "",
        event: "",
        value: 0,
    };
}

/// A ring of entries that overwrites its oldest. Recording takes `&self`, so that the loop that runs a
/// cycle and the cycle's body can share it; it may be moved to another thread, not shared with one.
#[derive(Debug)]
pub struct FlightRecorder {
    entries: Box<[Cell<Entry>]>,
    recorded: Cell<u64>,
    /// Index of the next entry, below `entries.len()`.
    next: Cell<usize>,
}

impl FlightRecorder {
    /// A recorder of the last `capacity` entries (at least 1). All memory is allocated here.
    pub fn new(capacity: usize) -> Self {
        Self {
            entries: vec![Cell::new(Entry::BLANK); capacity.max(1)].into(),
            recorded: Cell::new(0),
            next: Cell::new(0),
        }
    }

    /// Records an event of `source` in cycle `cycle`; overwrites the oldest entry if the ring is full.
    pub fn note(&self, cycle: u64, source: &'static str, event: &'static str, value: i64) {
        self.record(Entry {
            cycle,
            source,
            event,
            value,
        });
    }

    /// Records `entry`; overwrites the oldest if the ring is full.
    pub fn record(&self, entry: Entry) {
        let next = self.next.get();
        self.entries[next].set(entry);
        self.next.set((next + 1) % self.entries.len());
        self.recorded.set(self.recorded.get() + 1);
    }

    /// Number of entries recorded so far, overwritten ones included.
    pub fn recorded(&self) -> u64 {
        self.recorded.get()
    }

    /// The stored entries, oldest first.
    pub fn entries(&self) -> impl DoubleEndedIterator<Item = Entry> {
        let (newer, older) = self.entries.split_at(self.next.get());
        let is_full = self.recorded() >= self.entries.len() as u64;
        let older = if is_full { older } else { &[] };
        older.iter().chain(newer).map(Cell::get)
    }

    /// Copies the newest entries that fit into `into`, oldest first, and blanks the rest. Returns their
    /// number.
    pub fn copy_to(&self, into: &mut [Entry]) -> usize {
        let mut count = 0;
        for (slot, entry) in into.iter_mut().zip(self.entries().rev()) {
            *slot = entry;
            count += 1;
        }
        into[..count].reverse();
        into[count..].fill(Entry::BLANK);
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycles(recorder: &FlightRecorder) -> Vec<u64> {
        recorder.entries().map(|entry| entry.cycle).collect()
    }

    #[test]
    fn recorder_keeps_last_entries_in_order() {
        let recorder = FlightRecorder::new(3);
        assert_eq!(cycles(&recorder), []);
        let expected: [&[u64]; 5] = [&[0], &[0, 1], &[0, 1, 2], &[1, 2, 3], &[2, 3, 4]];
        for (cycle, expected) in (0..).zip(expected) {
            recorder.note(cycle, "test", "count", 0);
            assert_eq!(cycles(&recorder), expected);
        }
        assert_eq!(recorder.recorded(), 5);
    }

    #[test]
    fn recorder_copies_newest_in_order() {
        let recorder = FlightRecorder::new(3);
        (0..5).for_each(|cycle| recorder.note(cycle, "test", "count", 0));
        let mut two = [Entry::BLANK; 2];
        assert_eq!(recorder.copy_to(&mut two), 2);
        assert_eq!(two.map(|entry| entry.cycle), [3, 4]);
        let mut five = [two[1]; 5];
        assert_eq!(recorder.copy_to(&mut five), 3);
        assert_eq!(five.map(|entry| entry.cycle), [2, 3, 4, 0, 0]);
        assert_eq!(five[4], Entry::BLANK);
    }

    #[test]
    fn entry_displays_as_one_line() {
        let entry = Entry {
            cycle: 7,
            source: "ecat",
            event: "working counter",
            value: -1,
        };
        assert_eq!(entry.to_string(), "7 ecat: working counter -1");
    }
}
