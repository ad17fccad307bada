//! The flight recorder: the last so many things a real-time thread did, for the report after a fault.
//!
//! It does not leave the thread by itself. Its owner hands it over when the thread ends, or copies the
//! entries out once a fault has ended the real-time part.

use std::fmt;

/// One thing that happened. Displays as one line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// Number of the cycle it happened in.
    pub cycle: u64,
    /// Who says so, as in `ecat`.
    pub source: &'static str,
    /// What happened, as in `working counter`.
    pub what: &'static str,
    /// A figure that goes with it, in whatever unit `what` implies.
    pub value: i64,
}

impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            cycle,
            source,
            what,
            value,
        } = self;
        write!(f, "{cycle} {source}: {what} {value}")
    }
}

/// A ring of entries that overwrites its oldest.
#[derive(Debug)]
pub struct FlightRecorder {
    entries: Box<[Entry]>,
    recorded: u64,
    /// Where the next entry goes, below `entries.len()`.
    next: usize,
}

impl FlightRecorder {
    /// Remembers the last `capacity` entries (at least 1). All memory is taken here.
    pub fn new(capacity: usize) -> Self {
        let blank = Entry {
            cycle: 0,
            source: "",
            what: "",
            value: 0,
        };
        Self {
            entries: vec![blank; capacity.max(1)].into(),
            recorded: 0,
            next: 0,
        }
    }

    /// Remembers `entry`, in place of the oldest if need be.
    pub fn record(&mut self, entry: Entry) {
        self.entries[self.next] = entry;
        self.next = (self.next + 1) % self.entries.len();
        self.recorded += 1;
    }

    /// Entries recorded so far, forgotten ones included.
    pub fn recorded(&self) -> u64 {
        self.recorded
    }

    /// The entries remembered, oldest first.
    pub fn entries(&self) -> impl Iterator<Item = &Entry> {
        let (newer, older) = self.entries.split_at(self.next);
        let is_full = self.recorded >= self.entries.len() as u64;
        let older = if is_full { older } else { &[] };
        older.iter().chain(newer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycles(recorder: &FlightRecorder) -> Vec<u64> {
        recorder.entries().map(|entry| entry.cycle).collect()
    }

    #[test]
    fn remembers_the_last_in_order() {
        let mut recorder = FlightRecorder::new(3);
        assert_eq!(cycles(&recorder), []);
        let expected: [&[u64]; 5] = [&[0], &[0, 1], &[0, 1, 2], &[1, 2, 3], &[2, 3, 4]];
        for (cycle, expected) in (0..).zip(expected) {
            recorder.record(Entry {
                cycle,
                source: "test",
                what: "count",
                value: 0,
            });
            assert_eq!(cycles(&recorder), expected);
        }
        assert_eq!(recorder.recorded(), 5);
    }

    #[test]
    fn an_entry_displays_as_one_line() {
        let entry = Entry {
            cycle: 7,
            source: "ecat",
            what: "working counter",
            value: -1,
        };
        assert_eq!(entry.to_string(), "7 ecat: working counter -1");
    }
}
