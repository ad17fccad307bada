//! Samplers: they write the values of some ports of a net into a ring of their own after each evaluation, as long as the ring has a
//! reader. They travel to the net and back as boxes; the evaluating thread neither allocates nor frees them.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use takt_net::Plan;
use takt_net::ports::Sampled;
use takt_rt::ring::{Consumer, Producer, ring};

use super::flight::rows::{self, FlightReader, FlightWriter};

/// Maximum number of samplers of one net.
pub const SAMPLERS_MAX: usize = 8;
/// Maximum number of words that all samplers of one net thread write in a cycle.
pub const SAMPLED_WORDS_MAX: usize = 1024;
/// Samplers on their way to a net or back.
const WAITING: usize = 8 * SAMPLERS_MAX;
/// Time that the ring of a sampler covers, as far as its words suffice.
const SPAN: Duration = Duration::from_secs(4);
/// Maximum number of words of the ring of a sampler.
const WORDS_MAX: usize = 1 << 16;
/// Words of a row before those of its ports: the cycle and the state of the net.
pub(crate) const HEAD: usize = 2;

/// Writes samples of one net.
#[derive(Debug)]
pub struct Sampler {
    sampled: Sampled,
    /// It writes every so many cycles of its net.
    every: u64,
    flight: FlightWriter,
    words: Box<[u64]>,
    reader: Weak<()>,
}

/// Reads the samples of a net. The sampler is removed when this is dropped.
#[derive(Debug)]
pub struct SampleReader {
    /// Its rows: the cycle, the state of the net, and the words of the ports as bits of `f64`.
    pub flight: FlightReader,
    _alive: Arc<()>,
}

/// Both ends of a sampler that writes in every n-th cycle of a net with that period.
#[must_use]
pub fn sampler(sampled: Sampled, every: u64, period: Duration) -> (Box<Sampler>, SampleReader) {
    let (every, words) = (every.max(1), sampled.words());
    let between = period.as_nanos().max(1).saturating_mul(every.into());
    let rows = usize::try_from(SPAN.as_nanos() / between).unwrap_or(usize::MAX);
    let width = HEAD + words;
    let rows = rows.clamp(16, (WORDS_MAX / width).max(16));
    let (flight, reader) = rows::ring(width, rows);
    let alive = Arc::new(());
    let sampler = Sampler {
        sampled,
        every,
        flight,
        words: vec![0; words].into(),
        reader: Arc::downgrade(&alive),
    };
    let reader = SampleReader {
        flight: reader,
        _alive: alive,
    };
    (Box::new(sampler), reader)
}

impl Sampler {
    fn is_over(&self) -> bool {
        self.reader.strong_count() == 0
    }

    /// Writes a row, if one is due in this cycle of the thread, of which the net is evaluated in every `net_every`-th.
    fn sample(&mut self, plan: &Plan, cycle: u64, net_every: u64, state: u64) {
        if !(cycle / net_every.max(1)).is_multiple_of(self.every) {
            return;
        }
        plan.sample(&self.sampled, &mut self.words);
        let words = self.words.iter().copied();
        self.flight.write([cycle, state].into_iter().chain(words));
    }
}

/// The samplers of a running net.
#[expect(
    clippy::vec_box,
    reason = "samplers move in and out as boxes; a cycle neither allocates nor frees any"
)]
#[derive(Debug)]
pub(super) struct Samplers {
    /// Samplers here and on their way here.
    count: Arc<AtomicU32>,
    active: Vec<Box<Sampler>>,
    incoming: Consumer<Box<Sampler>>,
    over: Producer<Box<Sampler>>,
}

/// The controller's side of the samplers of a net.
#[derive(Debug)]
pub struct SamplersEnd {
    count: Arc<AtomicU32>,
    incoming: Producer<Box<Sampler>>,
    over: Consumer<Box<Sampler>>,
    /// The readers of samplers that were sent, with the words that these write.
    given: Vec<(Weak<()>, usize)>,
}

/// Both ends of the samplers of a net.
pub(super) fn samplers() -> (Samplers, SamplersEnd) {
    let (incoming_in, incoming) = ring(WAITING);
    let (over, over_out) = ring(WAITING + SAMPLERS_MAX);
    let count = Arc::new(AtomicU32::new(0));
    let samplers = Samplers {
        count: Arc::clone(&count),
        active: Vec::with_capacity(SAMPLERS_MAX),
        incoming,
        over,
    };
    let end = SamplersEnd {
        count,
        incoming: incoming_in,
        over: over_out,
        given: Vec::new(),
    };
    (samplers, end)
}

impl Samplers {
    /// Samples the net after its evaluation; without samplers, one test.
    #[inline]
    pub(super) fn sample(&mut self, plan: &Plan, cycle: u64, net_every: u64, state: u64) {
        if self.count.load(Ordering::Relaxed) != 0 {
            self.sample_all(plan, cycle, net_every, state);
        }
    }

    fn sample_all(&mut self, plan: &Plan, cycle: u64, net_every: u64, state: u64) {
        self.exchange();
        for sampler in &mut self.active {
            sampler.sample(plan, cycle, net_every, state);
        }
    }

    /// Takes new samplers and returns those without reader.
    pub(super) fn exchange(&mut self) {
        let mut next = 0;
        while let Some(sampler) = self.active.get(next) {
            if sampler.is_over() {
                let sampler = self.active.swap_remove(next);
                self.give_back(sampler);
            } else {
                next += 1;
            }
        }
        while self.active.len() < self.active.capacity() {
            let Some(sampler) = self.incoming.pop() else {
                break;
            };
            if sampler.is_over() {
                self.give_back(sampler);
            } else {
                self.active.push(sampler);
            }
        }
    }

    fn give_back(&mut self, sampler: Box<Sampler>) {
        // As many places as samplers that can be here and on their way: there is one.
        let _ = self.over.push(sampler);
        self.count.fetch_sub(1, Ordering::Relaxed);
    }
}

impl SamplersEnd {
    /// Frees what the net returned; returns the words that its samplers write, and their number.
    pub fn taken(&mut self) -> (usize, usize) {
        while self.over.pop().is_some() {}
        self.given.retain(|(reader, _)| reader.strong_count() > 0);
        let words = self.given.iter().map(|(_, words)| words).sum();
        (words, self.given.len())
    }

    /// Sends a sampler.
    ///
    /// # Errors
    /// If the net has [`SAMPLERS_MAX`] samplers, or too many are on their way.
    pub fn send(&mut self, sampler: Box<Sampler>) -> Result<(), Box<Sampler>> {
        let (_, number) = self.taken();
        if number >= SAMPLERS_MAX {
            return Err(sampler);
        }
        let given = (sampler.reader.clone(), sampler.words.len());
        self.count.fetch_add(1, Ordering::Relaxed);
        if let Err(sampler) = self.incoming.push(sampler) {
            self.count.fetch_sub(1, Ordering::Relaxed);
            return Err(sampler);
        }
        self.given.push(given);
        Ok(())
    }
}

impl SampleReader {
    /// Whether its net has ended.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.flight.is_closed()
    }
}
