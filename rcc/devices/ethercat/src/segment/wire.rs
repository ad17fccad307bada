//! Figures of a segment's wire in each cycle, as every device of the segment reports them: frames that were lost, working counters
//! that were wrong, how long an answer took. Counters of single ports are in the report of the segment.

use std::time::Duration;

use takt_core::device::Figure;
use takt_ethercat::master::Master;
use takt_rt::Nanos;
use takt_rt::cycle::Tick;

/// Number of the figures.
const COUNT: usize = 8;

/// Their values in a cycle; `None` is not known.
pub(super) type WireValues = [Option<f64>; COUNT];

/// The figures.
pub(super) fn wire_figures() -> [Figure; COUNT] {
    [
        Figure::number("ecat.operational"),
        Figure::number("ecat.lost"),
        Figure::number("ecat.working_counter_errors"),
        Figure::number("ecat.axes_not_proven"),
        Figure::time("ecat.answer_time"),
        Figure::time("ecat.latency"),
        Figure::time("ecat.phase_error"),
        Figure::number("events"),
    ]
}

/// What the driver notes beside the counters of the master.
#[derive(Debug, Default)]
pub(super) struct WireNotes {
    /// When the last frame was sent.
    sent: Option<Duration>,
    /// From then to its answer.
    answer: Option<Duration>,
}

impl WireNotes {
    pub(super) const fn sent(&mut self, at: Duration) {
        (self.sent, self.answer) = (Some(at), None);
    }

    pub(super) fn answered(&mut self, at: Duration) {
        let took = self.sent.take().and_then(|sent| at.checked_sub(sent));
        self.answer = self.answer.or(took);
    }

    /// The figures of this cycle.
    pub(super) fn values(
        &self,
        master: &Master,
        tick: &Tick,
        (unproven, events): (u64, u64),
    ) -> WireValues {
        let frames = master.frames();
        let wrong = master.groups().iter().map(|group| group.misses).sum();
        [
            Some(f64::from(u8::from(master.is_operational()))),
            Some(Figure::count(frames.lost.saturating_sub(frames.stale))),
            Some(Figure::count(wrong)),
            Some(Figure::count(unproven)),
            self.answer.map(|took| took.as_secs_f64()),
            Some((tick.woken - tick.scheduled).as_secs_f64()),
            tick.phase_error.map(Nanos::as_secs_f64),
            Some(Figure::count(events)),
        ]
    }
}
