//! The controller's side of one net's links: the recording of its debug taps, which begins when a client polls them.
//! No net is evaluated here.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_net::ports::Ports;
use takt_net::taps::{Tap, record_time};
use takt_net::{Nanos, Plan};

use crate::executor::links::{LinksEnd, TapReader, taps};

/// How long a net's taps are recorded after the last poll.
pub const TAPS_RECORDED_FOR: Duration = Duration::from_secs(10);
/// Maximum number of nets whose taps are recorded.
pub const RECORDED_NETS_MAX: usize = 16;
/// Records that wait for the supervisor, which polls every few milliseconds.
const WAITING: usize = 512;
/// Bytes of the waiting records.
const WAITING_BYTES: usize = 4 << 20;
/// Bytes of the records kept of one net; the oldest are dropped.
const REMEMBERED_BYTES: usize = 64 << 20;

/// What one cycle of a net recorded.
#[derive(Clone, Debug)]
pub struct TapRecord {
    /// Its number, from 0 at the first poll; gaps are lost records.
    pub number: u64,
    words: Arc<[u64]>,
}

impl TapRecord {
    /// The logical time of the cycle.
    #[must_use]
    pub fn time(&self) -> Nanos {
        record_time(&self.words)
    }

    /// The text of a port's value; `None` if it was null.
    #[must_use]
    pub fn text(&self, tap: &Tap) -> Option<String> {
        tap.text(&self.words)
    }
}

/// The debug taps of a net and their records.
#[derive(Clone, Debug)]
pub struct Taps {
    /// The tapped ports.
    pub taps: Arc<[Tap]>,
    /// The records, oldest first.
    pub records: Vec<TapRecord>,
}

/// The recording of one net's taps.
#[derive(Debug)]
pub(in crate::controller) struct TapRecording {
    reader: TapReader,
    until: Instant,
    /// The longest time span of a tap.
    span: Duration,
    records_max: usize,
    next: u64,
    records: VecDeque<TapRecord>,
}

impl TapRecording {
    /// Takes new records; returns whether the recording is still requested.
    pub(in crate::controller) fn drain(&mut self, now: Instant) {
        let Self {
            reader,
            next,
            records,
            ..
        } = self;
        reader.set_on(now < self.until);
        reader.drain(|words| {
            let (number, words) = (*next, words.into());
            *next += 1;
            records.push_back(TapRecord { number, words });
        });
        if now >= self.until {
            *records = VecDeque::new();
            return;
        }
        let newest = records.back().map_or(Nanos(0), TapRecord::time);
        let span = i64::try_from(self.span.as_nanos()).unwrap_or(i64::MAX);
        let old = |record: &TapRecord| newest.0 - record.time().0 > span;
        while records.len() > self.records_max || records.front().is_some_and(old) {
            records.pop_front();
        }
    }

    pub(super) fn is_on(&self) -> bool {
        Instant::now() < self.until
    }
}

/// The controller's side of a net's links.
#[derive(Debug)]
pub(in crate::controller) struct NetLinks {
    pub(in crate::controller) end: LinksEnd,
    taps: Arc<[Tap]>,
    record_words: usize,
    /// Its ports, by name.
    pub(in crate::controller) ports: Arc<Ports>,
    pub(super) recording: Option<TapRecording>,
}

impl NetLinks {
    pub(super) fn new(end: LinksEnd, plan: &Plan) -> Self {
        Self {
            end,
            taps: Arc::clone(plan.taps()),
            record_words: plan.record_words(),
            ports: Arc::clone(plan.ports()),
            recording: None,
        }
    }

    /// Whether the net has taps and they are not recorded.
    pub(super) fn would_begin(&self) -> bool {
        let recording = self.recording.as_ref();
        !self.taps.is_empty() && !recording.is_some_and(TapRecording::is_on)
    }

    /// The taps with their records from number `from` on; they are recorded from now on.
    pub(super) fn poll(&mut self, from: u64) -> Taps {
        let taps = Arc::clone(&self.taps);
        let mut records = Vec::new();
        if !taps.is_empty() {
            let now = Instant::now();
            let recording = self.begin_recording(now);
            recording.until = now + TAPS_RECORDED_FOR;
            recording.drain(now);
            let new = recording.records.iter();
            records.extend(new.filter(|record| record.number >= from).cloned());
        }
        Taps { taps, records }
    }

    /// The recording of the net's taps, created if there is none.
    fn begin_recording(&mut self, now: Instant) -> &mut TapRecording {
        let (end, words) = (&mut self.end, self.record_words.max(1));
        let seconds = self.taps.iter().map(|tap| tap.seconds);
        self.recording.get_or_insert_with(|| {
            let waiting = WAITING
                .min(WAITING_BYTES / (words * size_of::<u64>()))
                .max(8);
            let (writer, reader) = taps(waiting, words);
            end.record_taps(writer);
            TapRecording {
                reader,
                until: now,
                span: Duration::from_secs_f64(seconds.fold(0.0, f64::max)),
                records_max: REMEMBERED_BYTES / (words * size_of::<u64>()),
                next: 0,
                records: VecDeque::new(),
            }
        })
    }
}
