//! Rows of one net thread, or of its nets of one period, aligned by cycle: the thread writes a row of its own after all else of a
//! cycle, so a cycle whose row is there is complete in all rings.

use std::sync::Arc;

use takt_rt::Nanos;

use super::{Column, Pick};
use crate::executor::flight::FlightReader;
use crate::executor::sampler::SampleReader;

/// Maximum number of cycles that are read at once.
const ROWS_MAX: usize = 4096;

/// A ring from which columns are read.
#[derive(Debug)]
pub(crate) struct Source {
    reader: FlightReader,
    /// Keeps the sampler that writes it.
    sampler: Option<SampleReader>,
    cursor: u64,
    /// Rows of cycles that are not complete.
    pending: Vec<u64>,
    /// Why it ends when its writing end is gone.
    cause: String,
    is_over: bool,
}

impl Source {
    /// From now on, the rows of that ring.
    pub(crate) fn of_ring(reader: &FlightReader, cause: String) -> Self {
        Self {
            // The row of the present cycle may be written before that of the thread: rows of earlier cycles are skipped.
            cursor: reader.end().saturating_sub(2),
            reader: reader.clone(),
            sampler: None,
            pending: Vec::new(),
            cause,
            is_over: false,
        }
    }

    /// The rows of a sampler.
    pub(crate) fn of_sampler(reader: SampleReader, cause: String) -> Self {
        Self {
            cursor: 0,
            reader: reader.flight.clone(),
            sampler: Some(reader),
            pending: Vec::new(),
            cause,
            is_over: false,
        }
    }

    /// Samples in so many rows: a sampler writes one for each, all others one for each cycle.
    const fn samples(&self, rows: u64, cycles_a_sample: u64) -> u64 {
        match self.sampler {
            Some(_) => rows,
            None => rows.div_ceil(cycles_a_sample),
        }
    }

    /// Reads new rows; returns how many were lost.
    fn read(&mut self) -> u64 {
        let rows = self.reader.rows_max();
        self.reader
            .read_since(&mut self.cursor, rows, &mut self.pending)
    }

    /// The row of that cycle, if it is there; `next` is the number of the first that was not looked at.
    fn row_of(&self, cycle: u64, next: &mut usize) -> Option<&[u64]> {
        let width = self.reader.width();
        loop {
            let at = *next * width;
            let row = self.pending.get(at..at + width)?;
            let of = *row.first()?;
            if of > cycle {
                return None;
            }
            *next += 1;
            if of == cycle {
                return Some(row);
            }
        }
    }

    /// Drops the rows before that number.
    fn consume(&mut self, rows: usize) {
        let words = (rows * self.reader.width()).min(self.pending.len());
        self.pending.drain(..words);
    }
}

/// A column of a group.
#[derive(Clone)]
struct Picked {
    /// Number of its source; `None` for the thread's own ring.
    source: Option<usize>,
    pick: Pick,
}

/// Probes that are sampled in the same cycles.
pub(crate) struct Group {
    /// Cycles of the thread in a period of its nets.
    net_every: u64,
    /// Every how many periods a sample is taken.
    every: u64,
    timing: Source,
    base: Nanos,
    pub(crate) sources: Vec<Source>,
    columns: Vec<Picked>,
    /// Whether a column is of the thread itself, which has a value in each cycle.
    has_timing: bool,
}

impl std::fmt::Debug for Group {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Group")
            .field("sources", &self.sources)
            .field("columns", &self.columns.len())
            .finish_non_exhaustive()
    }
}

/// What was read of a group.
#[derive(Debug, Default)]
pub(crate) struct Read {
    /// Samples that were lost before the first row.
    pub(crate) lost: u64,
    /// Rows of a time, s, and a value for each column.
    pub(crate) values: Vec<f64>,
    /// The sources that ended, with the cause.
    pub(crate) ended: Vec<(usize, String)>,
}

impl Group {
    pub(crate) fn new(timing: &FlightReader, base: Nanos, net_every: u64, every: u64) -> Self {
        Self {
            net_every: net_every.max(1),
            every: every.max(1),
            timing: Source::of_ring(timing, String::new()),
            base,
            sources: Vec::new(),
            columns: Vec::new(),
            has_timing: false,
        }
    }

    /// Adds a column of a source, or of the thread itself.
    pub(crate) fn add(&mut self, source: Option<usize>, column: &Column) {
        self.has_timing |= source.is_none();
        self.columns.push(Picked {
            source,
            pick: Arc::clone(&column.pick),
        });
    }

    /// Begins with the next cycle, once all sources are there.
    pub(crate) fn begin(&mut self) {
        self.timing.cursor = self.timing.reader.end();
    }

    /// When the times of its rows are 0, on the host's monotonic clock.
    pub(crate) const fn base(&self) -> Nanos {
        self.base
    }

    /// Number of its columns.
    pub(crate) fn columns(&self) -> usize {
        self.columns.len()
    }

    /// The source of a column.
    pub(crate) fn source_of(&self, column: usize) -> Option<usize> {
        self.columns.get(column)?.source
    }

    fn is_sampled(&self, cycle: u64) -> bool {
        (cycle / self.net_every).is_multiple_of(self.every)
    }

    /// The rows since the last call.
    #[expect(clippy::cast_precision_loss, reason = "times below 104 days are exact")]
    pub(crate) fn read(&mut self) -> Read {
        let mut read = Read::default();
        let width = self.timing.reader.width();
        // Before the sources: what it has, they have.
        let cycles_lost = {
            let Source {
                reader,
                cursor,
                pending,
                ..
            } = &mut self.timing;
            pending.clear();
            reader.read_since(cursor, ROWS_MAX, pending)
        };
        let cycles_a_sample = self.net_every * self.every;
        read.lost = cycles_lost.div_ceil(cycles_a_sample);
        // Cycles of which only lost sources have rows are not seen below.
        let (mut since, mut lost_at_least) = (0, 0);
        for (number, source) in self.sources.iter_mut().enumerate() {
            let is_closed = source.reader.is_closed();
            let lost = source.read();
            lost_at_least = lost_at_least.max(source.samples(lost, cycles_a_sample));
            let first = source.pending.first().copied();
            if let (Some(first), true) = (first, lost > 0) {
                since = since.max(first);
            }
            if is_closed && !source.is_over && source.pending.is_empty() {
                source.is_over = true;
                read.ended.push((number, source.cause.clone()));
            }
        }
        let timing = std::mem::take(&mut self.timing.pending);
        let mut next = vec![0; self.sources.len()];
        for row in timing.chunks_exact(width) {
            let [cycle, begin, ..] = *row else { continue };
            let mut here = self.has_timing;
            let rows: Vec<Option<&[u64]>> = self
                .sources
                .iter()
                .zip(&mut next)
                .map(|(source, next)| {
                    let found = source.row_of(cycle, next);
                    here |= found.is_some();
                    found
                })
                .collect();
            if !here || !self.is_sampled(cycle) {
                continue;
            }
            if cycle < since {
                read.lost += 1;
                continue;
            }
            let time = (begin.cast_signed() - self.base.0) as f64 * 1e-9;
            read.values.push(time);
            read.values.extend(self.columns.iter().map(|column| {
                let row = match column.source {
                    None => Some(row),
                    Some(source) => rows.get(source).copied().flatten(),
                };
                row.map_or(f64::from_bits(takt_net::ports::NULL), |row| {
                    (column.pick)(row)
                })
            }));
        }
        read.lost = read.lost.max(lost_at_least);
        self.timing.pending = timing;
        for (source, rows) in self.sources.iter_mut().zip(next) {
            source.consume(rows);
        }
        read
    }
}
