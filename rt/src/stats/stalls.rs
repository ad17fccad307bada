//! Stalls of a thread: when it overslept by far, for how long, and on which processor it resumed. Separate from the
//! distributions, which do not record times. It names no cause.
//!
//! One writer, any number of readers, no lock: an entry is two words, and a reader drops what is overwritten while it
//! reads.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering, fence},
    },
    time::Duration,
};

use crate::{Nanos, linux::clock::processor};

/// Recorded stalls of a thread; the oldest are overwritten.
pub const STALLS_KEPT: usize = 16;
/// Bits of a processor's number beside the length of a stall, us.
const CPU_BITS: u32 = 16;
/// No processor is known.
const NO_CPU: u64 = (1 << CPU_BITS) - 1;

/// A stall of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall {
    /// When the thread resumed, on `CLOCK_MONOTONIC`.
    pub end: Nanos,
    /// Length, in whole microseconds.
    pub length: Duration,
    /// The processor on which it resumed; `None` if unknown.
    pub cpu: Option<usize>,
}

#[derive(Debug, Default)]
struct Entry {
    end_ns: AtomicU64,
    /// Length, us, above the processor.
    length_and_cpu: AtomicU64,
}

#[derive(Debug, Default)]
struct Shared {
    /// Stalls so far. Goes up before an entry is written and once more behind it.
    turns: AtomicU64,
    longest_us: AtomicU64,
    entries: [Entry; STALLS_KEPT],
}

/// Where a thread notes its stalls: wait-free, no allocation.
#[derive(Debug)]
pub struct StallWriter(Arc<Shared>);

/// Where others read them. Clones read the same.
#[derive(Clone, Debug)]
pub struct StallReader(Arc<Shared>);

/// Both ends for the stalls of one thread.
pub fn stalls() -> (StallWriter, StallReader) {
    let shared = Arc::<Shared>::default();
    (StallWriter(Arc::clone(&shared)), StallReader(shared))
}

impl StallWriter {
    /// Records a stall of the calling thread of `length`, until `end`.
    pub fn note(&mut self, end: Nanos, length: Nanos) {
        let shared = &*self.0;
        let turns = shared.turns.load(Ordering::Relaxed);
        let number = usize::try_from(turns / 2).unwrap_or(0) % STALLS_KEPT;
        let cpu = processor().and_then(|cpu| u64::try_from(cpu).ok());
        let cpu = cpu.map_or(NO_CPU, |cpu| cpu.min(NO_CPU));
        let length_us = u64::try_from(length.0 / 1000).unwrap_or(0);
        let length_us = length_us.min(u64::MAX >> CPU_BITS);
        shared.turns.store(turns.wrapping_add(1), Ordering::Relaxed);
        fence(Ordering::Release);
        if let Some(entry) = shared.entries.get(number) {
            let end_ns = u64::try_from(end.0).unwrap_or(0);
            entry.end_ns.store(end_ns, Ordering::Relaxed);
            let word = (length_us << CPU_BITS) | cpu;
            entry.length_and_cpu.store(word, Ordering::Relaxed);
        }
        shared.longest_us.fetch_max(length_us, Ordering::Relaxed);
        shared.turns.store(turns.wrapping_add(2), Ordering::Release);
    }
}

impl StallReader {
    /// How many there were.
    pub fn count(&self) -> u64 {
        self.0.turns.load(Ordering::Relaxed).div_ceil(2)
    }

    /// The longest of all.
    pub fn longest(&self) -> Duration {
        Duration::from_micros(self.0.longest_us.load(Ordering::Relaxed))
    }

    /// The longest of those kept that ended at these instants or between them.
    pub fn longest_between(&self, from: Nanos, to: Nanos) -> Option<Stall> {
        let kept = (0..STALLS_KEPT).filter_map(|number| self.read(number));
        kept.filter(|stall| (from..=to).contains(&stall.end))
            .max_by_key(|stall| stall.length)
    }

    /// An entry; `None` if there is none yet. One that is overwritten just now is read again, a few times at most.
    fn read(&self, number: usize) -> Option<Stall> {
        (0..4).find_map(|_| self.try_read(number))
    }

    fn try_read(&self, number: usize) -> Option<Stall> {
        let entry = self.0.entries.get(number)?;
        let before = self.0.turns.load(Ordering::Acquire);
        let end_ns = entry.end_ns.load(Ordering::Relaxed);
        let word = entry.length_and_cpu.load(Ordering::Relaxed);
        fence(Ordering::Acquire);
        let after = self.0.turns.load(Ordering::Relaxed);
        let turn = u64::try_from(2 * number).unwrap_or(0);
        let written = before > turn;
        let in_turn = !before.is_multiple_of(2)
            && usize::try_from(before / 2).unwrap_or(0) % STALLS_KEPT == number;
        if !written || in_turn || after != before {
            return None;
        }
        let cpu = word & NO_CPU;
        Some(Stall {
            end: Nanos(i64::try_from(end_ns).unwrap_or(i64::MAX)),
            length: Duration::from_micros(word >> CPU_BITS),
            cpu: usize::try_from(cpu).ok().filter(|_| cpu != NO_CPU),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn stall_reader_gives_longest_within_span() {
        let (mut writer, reader) = stalls();
        assert_eq!(reader.longest_between(Nanos(0), Nanos::MAX), None);
        for (end, length) in [(10, 3), (20, 7), (30, 5)] {
            writer.note(Nanos(end * MS), Nanos(length * MS));
        }
        let longest = |from, to| {
            let found = reader.longest_between(Nanos(from * MS), Nanos(to * MS));
            found.map(|stall| (stall.end.0 / MS, stall.length.as_millis()))
        };
        assert_eq!(longest(0, 100), Some((20, 7)));
        assert_eq!(longest(21, 100), Some((30, 5)));
        assert_eq!(longest(10, 19), Some((10, 3)));
        assert_eq!(longest(31, 100), None);
        assert_eq!(
            (reader.count(), reader.longest()),
            (3, Duration::from_millis(7))
        );
        let found = reader.longest_between(Nanos(0), Nanos::MAX);
        assert!(found.is_some_and(|stall| stall.cpu.is_some()), "{found:?}");
    }

    #[test]
    fn stalls_beyond_those_kept_replace_the_oldest() {
        let (mut writer, reader) = stalls();
        let last = i64::try_from(STALLS_KEPT).unwrap() * 3 + 1;
        for number in 1..=last {
            // Each shorter than the one before.
            writer.note(Nanos(number * MS), Nanos((1000 - number) * MS));
        }
        let oldest = reader.longest_between(Nanos(0), Nanos::MAX).unwrap().end;
        assert_eq!(
            oldest.0 / MS,
            last - i64::try_from(STALLS_KEPT).unwrap() + 1
        );
        assert_eq!(reader.count(), last.unsigned_abs());
        assert_eq!(reader.longest(), Duration::from_millis(999));
    }

    #[test]
    fn absurd_stalls_saturate() {
        let (mut writer, reader) = stalls();
        writer.note(Nanos(-5), Nanos(-5));
        writer.note(Nanos::MAX, Nanos::MAX);
        let all = reader.longest_between(Nanos::ZERO, Nanos::MAX).unwrap();
        assert_eq!(all.end, Nanos::MAX);
        assert!(all.length > Duration::from_hours(24));
    }

    #[test]
    fn stall_reader_beside_its_writer_sees_no_mixture() {
        let (mut writer, reader) = stalls();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                // End and length always agree.
                for number in 1..500_000 {
                    writer.note(Nanos(number * 1000), Nanos(number * 1000));
                }
            });
            while reader.count() < 499_999 {
                if let Some(stall) = reader.longest_between(Nanos(0), Nanos::MAX) {
                    assert_eq!(Nanos::from(stall.length), stall.end);
                }
            }
        });
    }
}
