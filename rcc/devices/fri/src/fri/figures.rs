//! Figures of a FRI connection in each cycle, as probes of its arm: how the controller rates it, what was lost, how fast the answers
//! were. Why an answer was late is in the events.

use takt_core::device::Figure;
use takt_rt::Nanos;

use super::{Protocol, Totals};

/// Number of the figures.
const COUNT: usize = 7;

/// The figures of an arm with this protocol.
pub(crate) fn figures<P: Protocol>() -> [Figure; COUNT] {
    [
        Figure::state("fri.quality", P::QUALITIES),
        Figure::state("fri.state", P::STATES),
        Figure::number("fri.lost"),
        Figure::number("fri.malformed"),
        Figure::time("fri.answer_time"),
        Figure::time("fri.phase_error"),
        Figure::number("events"),
    ]
}

/// What the driver notes beside the counters of the session.
#[derive(Debug, Default)]
pub(super) struct Notes {
    /// From the arrival of the last measurement to the sending of its answer.
    pub(super) answer_time: Option<Nanos>,
    /// From the instant of the last measurement on the robot's clock to its arrival.
    pub(super) phase_error: Option<Nanos>,
}

impl Notes {
    /// The figures of this cycle; those that the controller reports are null while it is silent.
    pub(super) fn values<P: Protocol>(
        &self,
        session: &P,
        is_silent: bool,
        events: u64,
    ) -> [Option<f64>; COUNT] {
        let Totals {
            lost, malformed, ..
        } = session.totals();
        let reported = |code: i32| (!is_silent).then(|| f64::from(code));
        let time = |span: Option<Nanos>| span.filter(|_| !is_silent).map(Nanos::as_secs_f64);
        [
            reported(session.quality_code()),
            reported(session.state_code()),
            Some(Figure::count(lost)),
            Some(Figure::count(malformed)),
            time(self.answer_time),
            time(self.phase_error),
            Some(Figure::count(events)),
        ]
    }
}
