//! The times of a cycle, from its tick. It reads no clock.

use takt_net::{Moment, Nanos};
use takt_rt::cycle::Tick;

/// Times of a cycle for nets and drivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Slot {
    /// Logical time for nets, so that equal inputs give equal outputs.
    pub(super) moment: Moment,
    /// Begin on the host's clock, to which drivers refer set-points. Equal to logical
    /// time, unless the thread follows a device's clock.
    pub(super) begin: takt_rt::Nanos,
    /// Its deadline.
    pub(super) end: takt_rt::Nanos,
}

impl Slot {
    pub(super) fn of(tick: &Tick, period: takt_rt::Nanos) -> Self {
        let moment = Moment {
            // 0 is "never".
            cycle: tick.index.max(1),
            time: Nanos(tick.time.0),
            wall: Nanos(tick.woken.0),
            ..Moment::default()
        };
        Self {
            moment,
            begin: tick.scheduled,
            end: tick.scheduled + period,
        }
    }
}
