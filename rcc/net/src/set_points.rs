//! What becomes of the set-points of a primitive that commands a device: counted in each evaluation by relaxed stores, read by
//! any thread. Set-points that a driver rejects are counted by the driver.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Why a primitive does not give a set-point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Withheld {
    /// It is out of range.
    Range,
    /// It is not a number.
    NoNumber,
    /// Another primitive of the net commands the same.
    Concurrent,
    /// It is null.
    Null,
}

impl Withheld {
    /// All reasons; the position of each is its index in [`SetPointCounts::withheld`].
    pub const ALL: [Self; 4] = [Self::Range, Self::NoNumber, Self::Concurrent, Self::Null];
}

/// Counters of one primitive. One thread stores, with plain relaxed stores; any thread loads, and may see an evaluation in
/// one figure and not yet in another.
#[derive(Debug, Default)]
pub struct SetPointCounters {
    given: AtomicU64,
    withheld: [AtomicU64; 4],
    /// Bits of the last set-point that was withheld.
    value: AtomicU64,
}

/// What [`SetPointCounters`] held at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetPointCounts {
    /// Evaluations in which a set-point was given.
    pub given: u64,
    /// Evaluations in which it was withheld, by reason.
    pub withheld: [u64; 4],
    /// The last set-point that was withheld, in the unit of its port.
    pub value: f64,
}

impl SetPointCounters {
    /// Counts an evaluation that gave a set-point.
    pub fn note_given(&self) {
        add_one(&self.given);
    }

    /// Counts an evaluation that withheld this set-point, in the unit of its port.
    pub fn note_withheld(&self, why: Withheld, value: f64) {
        self.value.store(value.to_bits(), Ordering::Relaxed);
        add_one(&self.withheld[why as usize]);
    }

    /// The counters as of now.
    pub fn read(&self) -> SetPointCounts {
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        SetPointCounts {
            given: load(&self.given),
            withheld: self.withheld.each_ref().map(load),
            value: f64::from_bits(load(&self.value)),
        }
    }
}

/// Not atomic as a whole: there is one writer.
fn add_one(counter: &AtomicU64) {
    counter.store(
        counter.load(Ordering::Relaxed).wrapping_add(1),
        Ordering::Relaxed,
    );
}

/// The set-points of one primitive, as they are found while the net is loaded.
#[derive(Clone, Debug)]
pub struct SetPoints {
    /// The primitive's name in the net.
    pub primitive: String,
    /// The device that it commands.
    pub device: String,
    /// Which part of the device, such as `joint 3`.
    pub part: String,
    /// Unit of the set-points, such as `rad`.
    pub unit: &'static str,
    /// Lowest and highest set-point, in that unit.
    pub range: [f64; 2],
    /// Its counters.
    pub counters: Arc<SetPointCounters>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_points_are_counted_by_reason() {
        let counters = SetPointCounters::default();
        counters.note_given();
        counters.note_withheld(Withheld::Range, 30.0);
        counters.note_withheld(Withheld::Range, 31.0);
        counters.note_withheld(Withheld::Null, 0.0);
        let counts = counters.read();
        assert_eq!((counts.given, counts.withheld), (1, [2, 0, 0, 1]));
        for (index, why) in Withheld::ALL.into_iter().enumerate() {
            assert_eq!(why as usize, index);
        }
    }
}
