//! Totals of a connection, common to both generations. Nothing is counted here.

use std::ops::Add;

/// Totals since a session or client was created.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Measurements accepted as new.
    pub received: u64,
    /// Answers built.
    pub answered: u64,
    /// Measurements lost, by the controller's counter.
    pub lost: u64,
    /// Measurements that were due for an answer and overtaken by the next one first: this host was late. 0 for an LWR.
    pub skipped: u64,
    /// Measurements ignored as duplicates or as older than the newest.
    pub old: u64,
    /// Restarts of the controller, by its counter.
    pub restarts: u64,
    /// Number of silences of the controller.
    pub silences: u64,
    /// Datagrams rejected.
    pub refused: u64,
    /// Answers that held the robot, or added nothing, because the guard rejected the command or demand.
    pub withheld: u64,
}

impl Add for Counters {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            received: self.received + other.received,
            answered: self.answered + other.answered,
            lost: self.lost + other.lost,
            skipped: self.skipped + other.skipped,
            old: self.old + other.old,
            restarts: self.restarts + other.restarts,
            silences: self.silences + other.silences,
            refused: self.refused + other.refused,
            withheld: self.withheld + other.withheld,
        }
    }
}
