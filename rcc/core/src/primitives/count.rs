//! What becomes of the set-points that primitives give. The driver counts what a device rejects.

use takt_net::set_points::{SetPointCounters, Withheld};

use super::error;

/// Counts what becomes of a set-point: the value that is to be reported, whether another primitive commands the same, the
/// device's error, and the value's. What a device with an error rejects is counted by its driver.
pub(super) fn count(
    counters: &SetPointCounters,
    value: Option<f64>,
    concurrent: bool,
    device: i32,
    illegal: i32,
) {
    let why = match (value, concurrent, device, illegal) {
        (None, ..) => Withheld::Null,
        (Some(_), true, ..) => Withheld::Concurrent,
        (Some(_), false, 0, 0) => return counters.note_given(),
        (Some(_), false, 0, error::RANGE) => Withheld::Range,
        (Some(_), false, 0, _) => Withheld::NoNumber,
        (Some(_), false, ..) => return,
    };
    counters.note_withheld(why, value.unwrap_or(0.0));
}
