//! Timing statistics of a cycle, recorded by its thread and read by others while it runs.
//!
//! It draws no conclusion and drops nothing: the counters run from the start of the writer. For the last
//! second, subtract two readings.
//!
//! The writer counts into plain shared counters with the layout of `hdrhistogram` (two significant
//! digits), so that a reading becomes such a histogram and the library does the rest. The alternative is
//! library histograms in the real-time thread with regular copies by [`latest`](crate::latest). It hides
//! the cycles since the last copy, which after a fault are the important ones, and costs the copying cycle
//! up to some microseconds (`benches/cycle.rs`). The price of the counters: a reading during a recording
//! may have that cycle in one figure and not yet in another.

mod counters;
mod recorder;
mod stalls;

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use self::counters::add;
pub use self::{
    recorder::{Distribution, Recorder, RecorderReader, Summary},
    stalls::{STALLS_KEPT, Stall, StallReader, StallWriter, stalls},
};
use crate::{Nanos, cycle::Tick};

/// Creates the statistics of one cycle thread. All memory, about 115 KiB, is allocated here.
pub fn pair() -> (StatsWriter, StatsReader) {
    let (stalls_writer, stalls_reader) = stalls();
    let writer = StatsWriter {
        latency: Recorder::new(),
        execution: Recorder::new(),
        period_error: Recorder::new(),
        phase_error: Recorder::new(),
        totals: Arc::default(),
        stalls: stalls_writer,
        previous: None,
    };
    let reader = StatsReader {
        latency: writer.latency.reader(),
        execution: writer.execution.reader(),
        period_error: writer.period_error.reader(),
        phase_error: writer.phase_error.reader(),
        totals: Arc::clone(&writer.totals),
        stalls: stalls_reader,
    };
    (writer, reader)
}

#[derive(Debug, Default)]
struct Totals {
    cycles: AtomicU64,
    overruns: AtomicU64,
}

/// The recording endpoint of the cycle thread: wait-free, no allocation.
#[derive(Debug)]
pub struct StatsWriter {
    latency: Recorder,
    execution: Recorder,
    period_error: Recorder,
    phase_error: Recorder,
    totals: Arc<Totals>,
    stalls: StallWriter,
    previous: Option<Tick>,
}

/// Missed slots in a row that count as a stall: robots and drives tolerate fewer.
const STALL_SLOTS: u32 = 4;

impl StatsWriter {
    /// Records the cycle of `tick`, whose work ended at `finished`.
    pub fn record(&mut self, tick: &Tick, finished: Nanos) {
        self.latency.record(self.lateness(tick));
        self.execution.record(finished - tick.woken);
        if let Some(previous) = self.previous.replace(*tick) {
            let interval = tick.woken - previous.woken;
            self.period_error
                .record((interval - (tick.scheduled - previous.scheduled)).abs());
        }
        add(&self.totals.overruns, tick.missed.into());
        add(&self.totals.cycles, 1);
    }

    /// Records a stall if `STALL_SLOTS` slots were missed before this one. Call it before the work of the cycle, so that
    /// the cause of a fault detected there is already recorded.
    pub fn note_stall(&mut self, tick: &Tick) {
        if tick.missed >= STALL_SLOTS && self.previous.is_some() {
            self.stalls.note(tick.woken, self.lateness(tick));
        }
    }

    /// Records the distance of a wake-up from its nominal time on a followed clock, early or late.
    pub(crate) fn record_phase(&mut self, error: Nanos) {
        self.phase_error.record(error.abs());
    }

    /// Delay of the wake-up. After missed slots it counts from the first of them: from the slot served, an
    /// outage of many periods would look like a short delay.
    fn lateness(&self, tick: &Tick) -> Nanos {
        let due = match self.previous {
            Some(previous) if tick.missed > 0 => previous.scheduled + slot_after(&previous, tick),
            _ => tick.scheduled,
        };
        tick.woken - due
    }
}

/// The grid's period, from two of its slots.
fn slot_after(previous: &Tick, tick: &Tick) -> Nanos {
    let slots = i64::try_from(tick.index.saturating_sub(previous.index)).unwrap_or(i64::MAX);
    Nanos((tick.scheduled - previous.scheduled).0 / slots.max(1))
}

/// The reading endpoint, usable at any time and from any thread. Clones read the same statistics.
#[derive(Debug, Clone)]
pub struct StatsReader {
    latency: RecorderReader,
    execution: RecorderReader,
    period_error: RecorderReader,
    phase_error: RecorderReader,
    totals: Arc<Totals>,
    stalls: StallReader,
}

impl StatsReader {
    /// Stalls of the thread.
    pub const fn stalls(&self) -> &StallReader {
        &self.stalls
    }

    /// Number of missed cycles. Costs one load.
    pub fn overruns(&self) -> u64 {
        self.totals.overruns.load(Ordering::Relaxed)
    }

    /// The current statistics. Allocates; not for the real-time path.
    pub fn snapshot(&self) -> Snapshot {
        let latency = self.latency.read();
        let execution = self.execution.read();
        let period_error = self.period_error.read();
        let phase_error = self.phase_error.read();
        Snapshot {
            cycles: self.totals.cycles.load(Ordering::Relaxed),
            overruns: self.totals.overruns.load(Ordering::Relaxed),
            latency: latency.summary(),
            execution: execution.summary(),
            period_error: period_error.summary(),
            phase_error: phase_error.summary(),
            distributions: [latency, execution, period_error, phase_error],
        }
    }
}

/// The statistics of one cycle thread at one time. Displays as one line.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Cycles run.
    pub cycles: u64,
    /// Missed slots in total.
    pub overruns: u64,
    /// From the due time of a cycle to its wake-up. After missed slots, from the first of them.
    pub latency: Summary,
    /// From the wake-up to the end of the cycle's work.
    pub execution: Summary,
    /// Difference between the distance of two wake-ups and that of their slots.
    pub period_error: Summary,
    /// Distance of wake-ups from their nominal time on the followed clock; empty without one.
    pub phase_error: Summary,
    distributions: [Distribution; 4],
}

impl Snapshot {
    /// The latencies as (upper bound, count), ascending, empty buckets left out.
    pub fn latency_buckets(&self) -> impl Iterator<Item = (Nanos, u64)> {
        self.distributions[0].buckets()
    }

    /// The execution times as (upper bound, count), ascending, empty buckets left out.
    pub fn execution_buckets(&self) -> impl Iterator<Item = (Nanos, u64)> {
        self.distributions[1].buckets()
    }

    /// The period errors as (upper bound, count), ascending, empty buckets left out.
    pub fn period_error_buckets(&self) -> impl Iterator<Item = (Nanos, u64)> {
        self.distributions[2].buckets()
    }

    /// The phase errors as (upper bound, count), ascending, empty buckets left out.
    pub fn phase_error_buckets(&self) -> impl Iterator<Item = (Nanos, u64)> {
        self.distributions[3].buckets()
    }
}

impl fmt::Display for Snapshot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            cycles,
            overruns,
            latency,
            execution,
            period_error,
            phase_error,
            ..
        } = self;
        write!(
            f,
            "{cycles} cycles, {overruns} missed; latency {latency}; execution {execution}; \
             period error {period_error}"
        )?;
        if phase_error.count > 0 {
            write!(f, "; phase error {phase_error}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cycle::Grid;
    use std::time::Duration;

    /// Wakes `late_ns` after each deadline in turn and works for 1000 ns.
    fn run(late_ns: &[i64]) -> Snapshot {
        let (mut writer, reader) = pair();
        let mut grid = Grid::new(Nanos::from_millis(5), Duration::from_millis(1));
        for &late in late_ns {
            let tick = grid.next(grid.deadline() + Nanos(late));
            writer.record(&tick, tick.woken + Nanos(1_000));
        }
        reader.snapshot()
    }

    #[test]
    fn stats_empty_reads_as_zeros() {
        let snapshot = run(&[]);
        assert_eq!((snapshot.cycles, snapshot.overruns), (0, 0));
        assert_eq!(snapshot.latency, Summary::default());
        assert_eq!(snapshot.latency_buckets().count(), 0);
    }

    #[test]
    fn stats_series_are_independent() {
        let snapshot = run(&[10, 10, 200, 10]);
        assert_eq!((snapshot.cycles, snapshot.overruns), (4, 0));
        let Summary {
            min,
            max,
            count,
            p50,
            ..
        } = snapshot.latency;
        assert_eq!(
            (min, max, count, p50),
            (Nanos(10), Nanos(200), 4, Nanos(10))
        );
        assert_eq!(
            (snapshot.execution.min, snapshot.execution.max),
            (Nanos(1_000), Nanos(1_000))
        );
        // Intervals: 0, +190, -190 off the period.
        let Summary {
            min, max, count, ..
        } = snapshot.period_error;
        assert_eq!((min, max, count), (Nanos(0), Nanos(190), 3));
        let buckets: Vec<_> = snapshot.period_error_buckets().collect();
        assert_eq!(buckets, [(Nanos(0), 1), (Nanos(190), 2)]);
    }

    #[test]
    fn stats_outage_counts_from_first_missed_slot() {
        let snapshot = run(&[0, 5_300_000, 0]);
        assert_eq!((snapshot.cycles, snapshot.overruns), (3, 5));
        assert_eq!(
            snapshot.latency.max,
            Nanos(5_300_000),
            "not 0.3 ms, counted from its last slot"
        );
        assert_eq!(snapshot.period_error.max, Nanos(300_000));
    }

    #[test]
    fn stalls_of_four_slots_and_more_are_kept() {
        let (mut writer, reader) = pair();
        let mut grid = Grid::new(Nanos::from_millis(5), Duration::from_millis(1));
        for late in [9_500_000, 0, 3_900_000, 0, 4_200_000, 0] {
            let tick = grid.next(grid.deadline() + Nanos(late));
            writer.note_stall(&tick);
            writer.record(&tick, tick.woken);
        }
        assert_eq!(reader.stalls().count(), 1, "a late start is none");
        assert_eq!(reader.stalls().longest(), Duration::from_micros(4_200));
    }

    #[test]
    fn stats_reader_follows_running_writer() {
        let (mut writer, reader) = pair();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                let mut grid = Grid::new(Nanos::ZERO, Duration::from_millis(1));
                for _ in 0..20_000 {
                    let tick = grid.next(grid.deadline());
                    writer.record(&tick, tick.woken);
                }
            });
            let mut cycles = 0;
            while cycles < 20_000 {
                let snapshot = reader.clone().snapshot();
                assert!(snapshot.cycles >= cycles);
                cycles = snapshot.cycles;
            }
        });
        assert_eq!(reader.snapshot().latency.count, 20_000);
    }

    #[test]
    fn stats_phase_errors_are_separate_series() {
        let (mut writer, reader) = pair();
        writer.record_phase(Nanos(-70));
        writer.record_phase(Nanos(50));
        let snapshot = reader.snapshot();
        assert_eq!(
            (snapshot.phase_error.count, snapshot.phase_error.max),
            (2, Nanos(70))
        );
        assert_eq!(snapshot.phase_error_buckets().count(), 2);
        assert!(snapshot.to_string().contains("phase error p50 50ns"));
    }

    #[test]
    fn displays_as_one_line() {
        let text = run(&[10, 10]).to_string();
        assert_eq!(
            text,
            "2 cycles, 0 missed; latency p50 10ns p99 10ns p99.9 10ns max 10ns; \
             execution p50 1us p99 1us p99.9 1us max 1us; \
             period error p50 0ns p99 0ns p99.9 0ns max 0ns"
        );
    }
}
