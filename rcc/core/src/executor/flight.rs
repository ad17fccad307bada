//! Flight recorder: rings of the last rows of words, written by the net thread in each cycle without allocation or lock, read by any
//! thread at any time. A ring has one per device and one for the out values of all nets of a thread; what the words mean
//! is up to their readers. A longer ring records longer: nothing else depends on its size. A reader with a cursor takes each row once.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering, fence};
use std::time::Duration;

use takt_net::{Image, Moment};

use super::{DeviceView, Running};
use crate::device::Place;

mod since;

/// Time that a flight file covers before its trigger.
pub(crate) const BEFORE: Duration = Duration::from_secs(10);
/// Time that a flight file covers after its trigger.
pub(crate) const AFTER: Duration = Duration::from_secs(1);
/// Time that a device's ring covers: that of a flight file, and a second for a disk that is slow to begin.
const SPAN: Duration = Duration::from_secs(11);
/// Upper bound on the words of one ring, 32 MiB; one of more words covers less time.
const WORDS_MAX: usize = 1 << 22;
/// Rows of the ring for out values of the nets of a thread, 8 MiB.
const NET_ROWS: usize = 1 << 17;
/// Words of out values in one row of it; longer out-boxes take several rows.
pub(crate) const NET_WORDS: usize = 6;
/// Words of a device's row before those of its joints: cycle, begin of the cycle, status, and number of faults.
pub(crate) const HEAD: usize = 4;
/// Words by joint: set-point, commanded and measured position, measured velocity, error.
pub(crate) const JOINT_WORDS: usize = 5;
/// The word of a device's row that is the begin of its cycle, ns.
pub(crate) const DEVICE_BEGIN: usize = 1;
/// The word of a row of out values that is the begin of its cycle, ns.
pub(crate) const NET_BEGIN: usize = 0;

/// Rows of equal width. A row that is being overwritten while it is read is discarded by its reader.
#[derive(Debug)]
struct Ring {
    width: usize,
    rows: usize,
    words: Box<[AtomicU64]>,
    /// Number of rows whose writing has begun.
    begun: AtomicU64,
    /// Number of complete rows.
    written: AtomicU64,
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
    ring: Arc<Ring>,
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
    });
    let reader = FlightReader {
        ring: Arc::clone(&ring),
    };
    (FlightWriter { ring, next: 0 }, reader)
}

/// The ring of a device for the last seconds of a thread with that period.
#[must_use]
pub fn of_device(place: &Place, period: Duration) -> (FlightWriter, FlightReader) {
    let width = HEAD + place.joints * JOINT_WORDS + place.signals.len();
    let rows = SPAN.as_nanos() / period.as_nanos().max(1);
    let rows = usize::try_from(rows).unwrap_or(usize::MAX);
    ring(width, rows.min(WORDS_MAX / width))
}

/// The ring for out values of all nets of a thread.
#[must_use]
pub fn of_nets() -> (FlightWriter, FlightReader) {
    ring(NET_WORDS + 2, NET_ROWS)
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

    /// Writes what nets commanded to a device in this cycle, and what it reported before.
    pub(super) fn write_device(
        &mut self,
        (place, view): (&Place, DeviceView),
        image: &Image,
        moment: Moment,
        begin: takt_rt::Nanos,
    ) {
        let begin = begin.0.cast_unsigned();
        let head = [moment.cycle, begin, view.status as u64, view.faults];
        let joints = image
            .joints
            .iter()
            .skip(place.first_joint)
            .take(place.joints);
        let joints = joints.flat_map(|joint| {
            let (command, state) = (joint.command.get(), joint.state.get());
            let set_point = command
                .is_in_force(moment.cycle)
                .then_some(command.position);
            let bits = |value: Option<f64>| value.unwrap_or(f64::NAN).to_bits();
            [
                bits(set_point),
                bits(state.commanded_position),
                bits(state.measured_position),
                bits(state.measured_velocity),
                f64::from(state.error).to_bits(),
            ]
        });
        let signals = image.signals.iter().skip(place.signals.start);
        let signals = signals.take(place.signals.len()).map(std::cell::Cell::get);
        self.write(head.into_iter().chain(joints).chain(signals));
    }

    /// Writes the out values of a net, which changed in the cycle that began then.
    pub(super) fn write_net(&mut self, net: &Running, begin: takt_rt::Nanos) {
        let mut words = net.plan.outbox_words();
        for part in 0.. {
            let mut row = [0; NET_WORDS];
            let mut given = 0;
            for (slot, word) in row.iter_mut().zip(&mut words) {
                *slot = word;
                given += 1;
            }
            if given == 0 {
                break;
            }
            let head = [begin.0.cast_unsigned(), (u64::from(net.id) << 32) | part];
            self.write(head.into_iter().chain(row));
        }
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

    /// The out-boxes of a net with so many words, as they changed: the begin of the cycle, ns, and the words; oldest first.
    #[must_use]
    pub fn rows_of_net(&self, net: u32, words: usize, since: i64) -> Vec<(i64, Vec<u64>)> {
        let mut found: Vec<(i64, Vec<u64>)> = Vec::new();
        for row in self.rows_since(since, NET_BEGIN) {
            let [begin, source, ref values @ ..] = row[..] else {
                continue;
            };
            if source >> 32 != u64::from(net) {
                continue;
            }
            if source & u64::from(u32::MAX) == 0 {
                found.push((begin.cast_signed(), Vec::with_capacity(words)));
            }
            // The first parts of the oldest out-box may be overwritten.
            if let Some((_, whole)) = found.last_mut() {
                let left = words - whole.len().min(words);
                whole.extend(values.iter().take(left));
            }
        }
        found.retain(|(_, whole)| whole.len() == words);
        found
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

    #[test]
    fn flight_ring_holds_out_values_by_net() {
        let (mut writer, reader) = of_nets();
        let text = "{a=Core::DoubleValue(Value='2.5'),\
            o=Core::DoubleNetcommOut(inValue=a.outValue,Key='v'),\
            p=Core::DoubleNetcommOut(inValue=a.outValue,Key='w'),\
            q=Core::DoubleNetcommOut(inValue=a.outValue,Key='x'),c=Cancel(),outTerminate=c.outCancel}";
        let mut net = crate::executor::tests::net(7, text);
        net.plan.evaluate(&Image::default(), Moment::default());
        let words = net.plan.outbox().words();
        writer.write_net(&net, takt_rt::Nanos(5));
        let rows = reader.rows_of_net(7, words, 0);
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].0, rows[0].1.len()), (5, words));
        assert!(words > NET_WORDS, "it takes several rows");
        let entry = net.plan.outbox().find("outx").unwrap();
        assert_eq!(entry.value(&rows[0].1), [2.5_f64.to_bits()]);
        assert!(reader.rows_of_net(8, words, 0).is_empty());
        assert!(reader.rows_of_net(7, words, 6).is_empty(), "too early");
    }
}
