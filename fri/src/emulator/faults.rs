//! Fault settings for wires and cabinets, common to both generations. No behaviour.

use std::time::Duration;

/// Faults of datagrams in one direction. At most 64 are in flight; more are lost.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LineFaults {
    /// Probability that a datagram is lost, 0..=1.
    pub drop: f64,
    /// Probability that a datagram is duplicated, 0..=1.
    pub duplicate: f64,
    /// Probability that a datagram is delayed by 1.5 periods, behind its successor, 0..=1.
    pub reorder: f64,
    /// Delay of every datagram.
    pub delay: Duration,
    /// Longest additional delay, uniformly distributed.
    pub jitter: Duration,
    /// Number of next datagrams to lose, whatever the probabilities.
    pub drop_next: u32,
}

/// A scheduled loss of drive power.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PowerOff {
    /// Start, since the controller's start.
    pub at: Duration,
    /// Duration.
    pub span: Duration,
}

impl PowerOff {
    /// Whether the power is off at `time` since the controller's start.
    pub(crate) fn covers(&self, time: Duration) -> bool {
        time >= self.at && time - self.at < self.span
    }
}
