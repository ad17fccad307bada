//! Times of a cycle as the machines of a youBot take them.

use std::time::Duration;

use takt_rt::Nanos;
use takt_rt::cycle::Tick;

pub(super) fn now(tick: &Tick) -> Duration {
    Duration::from_nanos(tick.scheduled.0.unsigned_abs())
}

#[expect(
    clippy::cast_precision_loss,
    reason = "spans of milliseconds are exact"
)]
pub(super) const fn seconds(span: Nanos) -> f64 {
    span.0 as f64 * 1e-9
}
