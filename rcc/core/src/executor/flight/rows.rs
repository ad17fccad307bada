//! A ring of rows with one writer and any number of readers, which never delay it. What the words mean is not known here.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering, fence};

/// Rows of equal width. A row that is being overwritten while it is read is discarded by its reader.
#[derive(Debug)]
pub(super) struct Ring {
    pub(super) width: usize,
    pub(super) rows: usize,
    pub(super) words: Box<[AtomicU64]>,
    /// Number of rows whose writing has begun.
    begun: AtomicU64,
    /// Number of complete rows.
    pub(super) written: AtomicU64,
    /// Whether no more rows are written.
    closed: AtomicBool,
}

/// The writing end of a ring.
#[derive(Debug)]
pub struct FlightWriter {
    ring: Arc<Ring>,
    next: u64,
}

/// A reading end of a ring.
#[derive(Clone, Debug)]
pub struct FlightReader {
    pub(super) ring: Arc<Ring>,
}

/// A ring of so many rows of so many words.
#[must_use]
pub fn ring(width: usize, rows: usize) -> (FlightWriter, FlightReader) {
    let (width, rows) = (width.max(1), rows.max(1));
    let ring = Arc::new(Ring {
        width,
        rows,
        // Written here, so that no page of it is touched for the first time by the net thread.
        words: (0..width * rows).map(|_| AtomicU64::new(0)).collect(),
        begun: AtomicU64::new(0),
        written: AtomicU64::new(0),
        closed: AtomicBool::new(false),
    });
    let reader = FlightReader {
        ring: Arc::clone(&ring),
    };
    (FlightWriter { ring, next: 0 }, reader)
}

impl Drop for FlightWriter {
    fn drop(&mut self) {
        self.ring.closed.store(true, Ordering::Release);
    }
}

impl FlightWriter {
    /// Writes a row; missing words are 0, excess ones are dropped.
    pub fn write(&mut self, words: impl Iterator<Item = u64>) {
        let Self { ring, next } = self;
        let rows = ring.rows as u64;
        let row = usize::try_from(*next % rows).unwrap_or(0);
        *next += 1;
        ring.begun.store(*next, Ordering::Relaxed);
        // Orders `begun` before the words: a reader that sees one of these sees that the row is overwritten.
        fence(Ordering::Release);
        let slots = &ring.words[row * ring.width..(row + 1) * ring.width];
        let words = words.chain(std::iter::repeat(0));
        for (slot, word) in slots.iter().zip(words) {
            slot.store(word, Ordering::Relaxed);
        }
        ring.written.store(*next, Ordering::Release);
    }
}

impl FlightReader {
    /// Words of a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.ring.width
    }

    /// Maximum number of rows that are held.
    #[must_use]
    pub fn rows_max(&self) -> usize {
        self.ring.rows
    }

    /// Number of rows that were written: the cursor of the next one.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.ring.written.load(Ordering::Acquire)
    }

    /// Whether its writing end is gone: what is not read yet are its last rows.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.ring.closed.load(Ordering::Acquire)
    }

    /// Appends the rows since `cursor` to `words`, at most `rows_max`, and moves the cursor behind them; returns the number
    /// of rows since the cursor that were overwritten before they were read. Any number of readers have cursors of their own; a
    /// slow one loses rows, and never delays the writer.
    ///
    /// A cursor is 0 for all rows from the first on, or [`Self::end`] for those of later cycles.
    pub fn read_since(&self, cursor: &mut u64, rows_max: usize, words: &mut Vec<u64>) -> u64 {
        let ring = &*self.ring;
        let rows = ring.rows as u64;
        let end = ring.written.load(Ordering::Acquire);
        // A cursor of the future is that of another ring.
        let since = (*cursor).min(end);
        let first = since.max(end.saturating_sub(rows));
        let last = end.min(first.saturating_add(rows_max as u64));
        let before = words.len();
        for number in first..last {
            let row = usize::try_from(number % rows).unwrap_or(0);
            let slots = &ring.words[row * ring.width..(row + 1) * ring.width];
            words.extend(slots.iter().map(|word| word.load(Ordering::Relaxed)));
        }
        fence(Ordering::Acquire);
        let begun = ring.begun.load(Ordering::Relaxed);
        // Rows that were overwritten while they were read.
        let kept = begun.saturating_sub(rows).clamp(first, last);
        let torn = usize::try_from(kept - first).unwrap_or(usize::MAX);
        words.drain(before..before + torn * ring.width);
        *cursor = last;
        kept - since
    }

    /// All rows that are held, oldest first.
    #[must_use]
    pub fn rows(&self) -> Vec<Vec<u64>> {
        let mut words = Vec::new();
        self.read_since(&mut 0, self.ring.rows, &mut words);
        words.chunks(self.ring.width).map(<[u64]>::to_vec).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_ring_keeps_last_rows() {
        let (mut writer, reader) = ring(2, 4);
        assert!(reader.rows().is_empty());
        for n in 0..10 {
            writer.write([n, n * n].into_iter());
        }
        assert_eq!(reader.rows(), [[6, 36], [7, 49], [8, 64], [9, 81]]);
        writer.write([10].into_iter());
        assert_eq!(
            reader.rows().last().unwrap(),
            &[10, 0],
            "missing words are 0"
        );
    }

    #[test]
    fn flight_cursor_reads_each_row_once() {
        let (mut writer, reader) = ring(2, 4);
        let mut write = |numbers: std::ops::Range<u64>| {
            numbers.for_each(|n| writer.write([n, n * n].into_iter()));
        };
        let (mut cursor, mut words) = (reader.end(), Vec::new());
        let mut read = |most| {
            words.clear();
            let lost = reader.read_since(&mut cursor, most, &mut words);
            (lost, words.clone(), cursor)
        };
        assert_eq!(read(9), (0, vec![], 0), "nothing was written");
        write(0..3);
        assert_eq!(read(2), (0, vec![0, 0, 1, 1], 2), "bounded");
        assert_eq!(read(9), (0, vec![2, 4], 3));
        assert_eq!(read(9), (0, vec![], 3), "each row once");
        write(3..10);
        let held = vec![6, 36, 7, 49, 8, 64, 9, 81];
        assert_eq!(read(9), (3, held, 10), "rows 3 to 5 are overwritten");
        let mut cursor = u64::MAX;
        assert_eq!(reader.read_since(&mut cursor, 9, &mut Vec::new()), 0);
        assert_eq!(cursor, 10, "a cursor of another ring");
    }

    #[test]
    fn flight_cursor_slow_reader_counts_lost_rows() {
        let (mut writer, reader) = ring(8, 64);
        let writing = std::thread::spawn(move || {
            for n in 0..200_000_u64 {
                writer.write(std::iter::repeat_n(n, 8));
            }
        });
        let (mut cursor, mut next, mut words) = (0, 0, Vec::new());
        loop {
            let is_last = writing.is_finished();
            words.clear();
            next += reader.read_since(&mut cursor, 50, &mut words);
            for row in words.chunks(8) {
                assert_eq!(row, [next; 8], "lost rows are those between");
                next += 1;
            }
            assert_eq!(cursor, next);
            if is_last && words.is_empty() {
                break;
            }
        }
        assert_eq!(next, 200_000, "read and lost together are all");
        writing.join().unwrap();
    }

    #[test]
    fn flight_ring_read_during_writes_gives_whole_rows() {
        let (mut writer, reader) = ring(8, 64);
        let writing = std::thread::spawn(move || {
            for n in 0..200_000_u64 {
                writer.write(std::iter::repeat_n(n, 8));
            }
        });
        let mut read = 0;
        while !writing.is_finished() {
            let rows = reader.rows();
            for row in &rows {
                assert!(row.iter().all(|word| *word == row[0]), "{row:?}");
            }
            let numbers: Vec<_> = rows.iter().map(|row| row[0]).collect();
            assert!(
                numbers.windows(2).all(|pair| pair[1] == pair[0] + 1),
                "{numbers:?}"
            );
            read += rows.len();
        }
        assert!(read > 0);
        writing.join().unwrap();
    }
}
