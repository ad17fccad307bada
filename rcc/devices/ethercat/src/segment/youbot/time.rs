//! Times of a cycle as the machines of a youBot take them.

use std::time::Duration;

use takt_rt::cycle::Tick;

pub(super) fn now(tick: &Tick) -> Duration {
    Duration::from_nanos(tick.scheduled.0.unsigned_abs())
}
