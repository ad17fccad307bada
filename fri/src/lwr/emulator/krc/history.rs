//! What the last measurements said, found by the number that an answer reflects. Older ones are forgotten.

use crate::lwr::AXES;
use std::time::Duration;

const LEN: usize = 64;

/// A measurement sent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sent {
    pub(super) sequence: u16,
    /// Number of its cycle.
    pub(super) index: u64,
    /// When it was sent.
    pub(super) at: Duration,
    /// Set-point it reported, rad.
    pub(super) set_point: [f64; AXES],
    /// Whether it said CMD.
    pub(super) in_command: bool,
    /// Whether the robot followed commands: CMD with power.
    pub(super) following: bool,
}

/// The last 64 measurements.
#[derive(Debug, Clone)]
pub(super) struct History([Option<Sent>; LEN]);

impl History {
    pub(super) fn new() -> Self {
        Self([None; LEN])
    }

    pub(super) fn push(&mut self, sent: Sent) {
        self.0[usize::from(sent.sequence) % LEN] = Some(sent);
    }

    pub(super) fn find(&self, sequence: u16) -> Option<&Sent> {
        let sent = self.0[usize::from(sequence) % LEN].as_ref();
        sent.filter(|sent| sent.sequence == sequence)
    }
}
