//! The last measurements, found by the number that an answer reflects. Older ones are dropped.

use super::AXES;
use std::time::Duration;

const LEN: usize = 64;

/// A measurement sent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sent {
    pub(crate) sequence: u32,
    /// Number of its cycle.
    pub(crate) index: u64,
    /// When it was sent.
    pub(crate) at: Duration,
    /// Set-point it reported, rad.
    pub(crate) set_point: [f64; AXES],
    /// Whether it reported CMD, or one of the COMMANDING states.
    pub(crate) in_command: bool,
    /// Whether the robot followed commands: CMD with power, or COMMANDING_ACTIVE.
    pub(crate) following: bool,
}

/// The last 64 measurements.
#[derive(Debug, Clone)]
pub(crate) struct History([Option<Sent>; LEN]);

impl History {
    pub(crate) fn new() -> Self {
        Self([None; LEN])
    }

    pub(crate) fn push(&mut self, sent: Sent) {
        self.0[slot_of(sent.sequence)] = Some(sent);
    }

    pub(crate) fn find(&self, sequence: u32) -> Option<&Sent> {
        let sent = self.0[slot_of(sequence)].as_ref();
        sent.filter(|sent| sent.sequence == sequence)
    }
}

fn slot_of(sequence: u32) -> usize {
    sequence as usize % LEN
}
