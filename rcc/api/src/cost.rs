//! What nets cost in each cycle.

use std::fmt;
use std::time::Duration;

/// Worst-case cost of a net.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Longest time that its evaluation takes in one cycle.
    pub cycle: Duration,
    /// Its period.
    pub period: Duration,
    /// Time of a period that all nets of its thread may take together.
    pub budget: Duration,
    /// Number of its primitives.
    pub primitives: u32,
}

impl Cost {
    /// Part of the period that it takes, above 0.
    pub fn share(&self) -> f64 {
        self.cycle.as_secs_f64() / self.period.as_secs_f64().max(f64::MIN_POSITIVE)
    }
}

impl fmt::Display for Cost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |time: Duration| time.as_secs_f64() * 1e6;
        write!(
            f,
            "{} primitives cost up to {:.1} us a cycle, {:.1} % of {:.0} us; all nets together may take {:.0} us",
            self.primitives,
            us(self.cycle),
            self.share() * 100.0,
            us(self.period),
            us(self.budget)
        )
    }
}
