//! Exchange of a running net beside its boxes for programs: values with other nets, and records of its
//! debug taps. Both endpoints share cells and rings, so nets of different threads exchange values like those
//! of one; the evaluating thread neither allocates nor frees. The controller
//! creates the links.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use takt_net::netcomm::Inter;
use takt_net::{Nanos, Plan};
use takt_rt::latest::LatestReader;
use takt_rt::ring::{Consumer, Producer, ring};

use super::sampler::{Samplers, SamplersEnd, samplers};

/// Maximum number of nets that one net exchanges values with, and that write to it.
pub const WIRES_MAX: usize = 16;

/// Maximum number of readers of one net's out values: the controller and other nets.
pub const OUT_READERS: usize = 8;

/// Connection from the out-box of one net to the in-box of another.
#[derive(Debug)]
pub struct Wire {
    given: LatestReader<Box<[u64]>>,
    /// Whether the source net is still loaded.
    alive: Arc<AtomicBool>,
    values: Box<[Passing]>,
    /// The last values taken; `None` at first.
    version: Option<u64>,
    /// Whether the destination net requested the values.
    asked: bool,
}

/// A value of a wire.
#[derive(Debug)]
struct Passing {
    inter: Inter,
    seen: Option<u64>,
}

impl Wire {
    /// Values that the destination net requested: null once the source net is unloaded.
    #[must_use]
    pub fn asked(given: LatestReader<Box<[u64]>>, alive: Arc<AtomicBool>, of: Vec<Inter>) -> Self {
        Self::new(given, alive, of, true)
    }

    /// Values that the source net writes into the other one.
    #[must_use]
    pub fn written(
        given: LatestReader<Box<[u64]>>,
        alive: Arc<AtomicBool>,
        of: Vec<Inter>,
    ) -> Self {
        Self::new(given, alive, of, false)
    }

    fn new(
        given: LatestReader<Box<[u64]>>,
        alive: Arc<AtomicBool>,
        of: Vec<Inter>,
        asked: bool,
    ) -> Self {
        let values = of.into_iter().map(|inter| Passing { inter, seen: None });
        Self {
            given,
            alive,
            values: values.collect(),
            version: None,
            asked,
        }
    }

    fn is_over(&self) -> bool {
        !self.alive.load(Ordering::Acquire)
    }

    /// Copies changed values; returns whether there were any.
    fn pass(&mut self, plan: &Plan) -> bool {
        let (asked, mut changed) = (self.asked, false);
        if self.is_over() {
            for value in self.values.iter().filter(|_| asked) {
                changed |= plan.import_inter(&value.inter, None);
            }
            return changed;
        }
        let version = self.given.version();
        if self.version.replace(version) == Some(version) {
            return false;
        }
        let values = &mut self.values;
        self.given.read_with(|words| {
            for Passing { inter, seen } in values {
                changed |= if asked {
                    plan.import_inter(inter, Some(words))
                } else {
                    plan.import_given(inter, words, seen)
                };
            }
        });
        changed
    }
}

/// Where records of taps go.
#[derive(Debug)]
pub struct TapWriter {
    /// Whether the taps are polled.
    on: Arc<AtomicBool>,
    free: Consumer<Box<[u64]>>,
    full: Producer<Box<[u64]>>,
    /// Records lost because the ring was full.
    lost: u64,
}

/// Where records of taps arrive.
#[derive(Debug)]
pub struct TapReader {
    on: Arc<AtomicBool>,
    free: Producer<Box<[u64]>>,
    full: Consumer<Box<[u64]>>,
}

/// Creates both endpoints of a ring for `records` records of so many words.
#[must_use]
pub fn taps(records: usize, words: usize) -> (TapWriter, TapReader) {
    let (mut free_in, free_out) = ring(records);
    let (full_in, full_out) = ring(records);
    for _ in 0..records {
        // The ring has capacity for all buffers.
        let _ = free_in.push(vec![0; words].into_boxed_slice());
    }
    let on = Arc::new(AtomicBool::new(true));
    let writer = TapWriter {
        on: Arc::clone(&on),
        free: free_out,
        full: full_in,
        lost: 0,
    };
    let reader = TapReader {
        on,
        free: free_in,
        full: full_out,
    };
    (writer, reader)
}

impl TapWriter {
    fn record(&mut self, plan: &Plan, time: Nanos) {
        if !self.on.load(Ordering::Relaxed) {
            return;
        }
        let Some(mut record) = self.free.pop() else {
            self.lost += 1;
            return;
        };
        plan.record(time, &mut record);
        // As many places as records: there is one.
        let _ = self.full.push(record);
    }
}

impl TapReader {
    /// Sets whether the taps are polled.
    pub fn set_on(&self, on: bool) {
        self.on.store(on, Ordering::Relaxed);
    }

    /// Calls `take` with each record that has arrived, oldest first.
    pub fn drain(&mut self, mut take: impl FnMut(&[u64])) {
        while let Some(record) = self.full.pop() {
            take(&record);
            let _ = self.free.push(record);
        }
    }
}

/// A running net's side of its links.
#[expect(
    clippy::vec_box,
    reason = "wires move in and out as boxes; a cycle neither allocates nor frees any"
)]
#[derive(Debug)]
pub struct Links {
    wires: Vec<Box<Wire>>,
    incoming: Consumer<Box<Wire>>,
    over: Producer<Box<Wire>>,
    taps_incoming: Option<Consumer<Box<TapWriter>>>,
    taps: Option<Box<TapWriter>>,
    samplers: Samplers,
    /// The program's box as last applied.
    seen: Box<[u64]>,
}

/// The controller's side of a net's links. The net counts as loaded until it is dropped.
#[derive(Debug)]
pub struct LinksEnd {
    wires: Producer<Box<Wire>>,
    over: Consumer<Box<Wire>>,
    /// Wires of other nets that were sent and not returned.
    given: usize,
    taps: Option<Producer<Box<TapWriter>>>,
    /// Its samplers.
    pub samplers: SamplersEnd,
    alive: Arc<AtomicBool>,
}

impl Drop for LinksEnd {
    fn drop(&mut self) {
        self.alive.store(false, Ordering::Release);
    }
}

impl LinksEnd {
    /// The flag whether the net is still loaded.
    #[must_use]
    pub const fn alive(&self) -> &Arc<AtomicBool> {
        &self.alive
    }

    /// Sends a wire by which another net writes to this one.
    ///
    /// # Errors
    /// If [`WIRES_MAX`] other nets do so already.
    pub fn connect(&mut self, wire: Wire) -> Result<(), Wire> {
        while self.over.pop().is_some() {
            self.given = self.given.saturating_sub(1);
        }
        if self.given >= WIRES_MAX {
            return Err(wire);
        }
        self.given += 1;
        self.wires.push(Box::new(wire)).map_err(|wire| *wire)
    }

    /// Sends the writer of tap records; only once, and only if the net has taps.
    pub fn record_taps(&mut self, writer: TapWriter) {
        if let Some(taps) = &mut self.taps {
            // The queue has one slot, used once.
            let _ = taps.push(Box::new(writer));
        }
        self.taps = None;
    }
}

/// Creates both endpoints of a net's links.
#[must_use]
pub fn links(plan: &Plan) -> (Links, LinksEnd) {
    let (wires, incoming) = ring(WIRES_MAX);
    let (over_in, over) = ring(WIRES_MAX);
    let (taps, taps_incoming) = (plan.record_words() > 0).then(|| ring(1)).unzip();
    let (samplers, samplers_end) = samplers();
    let links = Links {
        wires: Vec::with_capacity(2 * WIRES_MAX),
        incoming,
        over: over_in,
        taps_incoming,
        taps: None,
        samplers,
        seen: plan.inbox_words().collect(),
    };
    let end = LinksEnd {
        wires,
        over,
        given: 0,
        taps,
        samplers: samplers_end,
        alive: Arc::new(AtomicBool::new(true)),
    };
    (links, end)
}

impl Links {
    /// Adds a wire of values that the net requested; at most [`WIRES_MAX`] before it runs.
    pub fn ask(&mut self, wire: Wire) {
        self.wires.push(Box::new(wire));
    }

    /// Applies values of other nets since the last cycle; returns whether there were any.
    pub(super) fn receive(&mut self, plan: &Plan) -> bool {
        while self.wires.len() < self.wires.capacity() {
            let Some(wire) = self.incoming.pop() else {
                break;
            };
            self.wires.push(wire);
        }
        let (mut changed, mut next) = (false, 0);
        while let Some(wire) = self.wires.get_mut(next) {
            changed |= wire.pass(plan);
            if !wire.asked && wire.is_over() {
                let wire = self.wires.swap_remove(next);
                // As many places as wires that other nets may have: there is one.
                let _ = self.over.push(wire);
            } else {
                next += 1;
            }
        }
        changed
    }

    /// Applies values that programs wrote.
    pub(super) fn import(&mut self, plan: &Plan, words: &[u64]) {
        plan.import_changes(words, &mut self.seen);
    }

    /// Records the taps of the cycle that was evaluated last.
    #[inline]
    pub(super) fn record(&mut self, plan: &Plan, time: Nanos) {
        let Some(incoming) = &mut self.taps_incoming else {
            return;
        };
        if self.taps.is_none() {
            self.taps = incoming.pop();
        }
        if let Some(taps) = &mut self.taps {
            taps.record(plan, time);
        }
    }

    /// Samples the net after its evaluation in this cycle of its thread.
    #[inline]
    pub(super) fn sample(&mut self, plan: &Plan, cycle: u64, every: u64, state: u64) {
        self.samplers.sample(plan, cycle, every, state);
    }

    /// Takes new samplers and returns those without reader, while the net is not evaluated.
    pub fn exchange_samplers(&mut self) {
        self.samplers.exchange();
    }
}
