//! Knobs for what goes wrong on wires and in cabinets, common to both generations. No behaviour.

use std::time::Duration;

/// What goes wrong with datagrams of one direction. At most 64 are under way; more are lost.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LineFaults {
    /// Probability that a datagram is lost, 0..=1.
    pub drop: f64,
    /// Probability that a datagram comes twice, 0..=1.
    pub duplicate: f64,
    /// Probability that a datagram is held back by 1.5 periods, behind its successor, 0..=1.
    pub reorder: f64,
    /// Delay of every datagram.
    pub delay: Duration,
    /// Longest additional delay, uniformly distributed.
    pub jitter: Duration,
    /// Number of datagrams to lose next, whatever the probabilities.
    pub drop_next: u32,
}

/// A loss of drive power in the course of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PowerOff {
    /// When, since the controller's start.
    pub at: Duration,
    /// For how long.
    pub span: Duration,
}

impl PowerOff {
    /// Whether the power is away at `time` since the controller's start.
    pub(crate) fn covers(&self, time: Duration) -> bool {
        time >= self.at && time - self.at < self.span
    }
}
