//! Figures of a network's bus in each cycle, as every arm of the network reports them: how full it is, frames that could not be sent.
//! It measures nothing itself.

use takt_can::load::LoadReader;
use takt_core::device::Figure;
use takt_rt::cycle::Tick;

/// Number of the figures.
pub(super) const COUNT: usize = 8;

/// The figures.
pub(super) fn bus_figures() -> [Figure; COUNT] {
    [
        Figure::number("can.load"),
        Figure::with_unit("can.bit_rate", "bit/s"),
        Figure::number("can.received"),
        Figure::number("can.failed"),
        Figure::number("can.node_faults"),
        Figure::number("can.axes_not_proven"),
        Figure::time("can.latency"),
        Figure::number("events"),
    ]
}

/// The load of the bus.
#[derive(Debug)]
pub(super) struct BusLoad {
    reader: LoadReader,
    /// Of the interface when the driver started.
    bit_rate: Option<u32>,
}

impl BusLoad {
    pub(super) fn new(reader: LoadReader) -> Self {
        let bit_rate = reader.bit_rate();
        Self { reader, bit_rate }
    }
}

/// What is counted.
#[derive(Debug)]
pub(super) struct BusCounts {
    pub(super) received: u64,
    /// Frames that could not be sent or received.
    pub(super) failed: u64,
    pub(super) faults: u64,
    pub(super) unproven: u64,
    pub(super) events: u64,
}

impl BusLoad {
    /// The figures of this cycle; `None` is not known.
    pub(super) fn values(&self, counts: &BusCounts, tick: &Tick) -> [Option<f64>; COUNT] {
        let bits = self.reader.read().map(|load| f64::from(load.last));
        let rate = self.bit_rate.filter(|rate| *rate > 0).map(f64::from);
        [
            bits.zip(rate).map(|(bits, rate)| (bits / rate).min(1.0)),
            bits,
            Some(Figure::count(counts.received)),
            Some(Figure::count(counts.failed)),
            Some(Figure::count(counts.faults)),
            Some(Figure::count(counts.unproven)),
            Some((tick.woken - tick.scheduled).as_secs_f64()),
            Some(Figure::count(counts.events)),
        ]
    }
}
