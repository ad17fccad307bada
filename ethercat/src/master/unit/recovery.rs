//! Whether a slave reached its goal, and when a failed one is tried again. It reports nothing.

use std::time::Duration;

use super::super::event::Fault;

/// Firmware that shows OP may still be enabling its SyncManagers; after this time its working counter must be complete.
const COUNT_GRACE: Duration = Duration::from_millis(100);
/// Time in its goal after which a slave is no longer one that keeps failing.
const STABLE: Duration = Duration::from_secs(1);

/// Faults of a slave, and its time in the goal.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::master) struct Recovery {
    pub(in crate::master) fault: Option<Fault>,
    /// Consecutive failures.
    pub(super) failures: u8,
    /// When it is tried again.
    pub(super) again: Duration,
    /// Time at which it last reached its goal.
    reached_at: Duration,
    /// The working counter was complete since then.
    pub(super) counted: bool,
}

impl Recovery {
    /// It reached its goal.
    pub(super) const fn reach(&mut self, now: Duration) {
        (self.reached_at, self.counted, self.fault) = (now, false, None);
    }

    /// Whether its working counter must be complete.
    pub(super) fn is_settled(&self, now: Duration) -> bool {
        self.counted || now.saturating_sub(self.reached_at) > COUNT_GRACE
    }

    /// It failed; `wait` is the time to the first retry, and doubles with each failure. Returns whether the fault is new.
    pub(super) fn fail(
        &mut self,
        fault: Fault,
        was_running: bool,
        wait: Duration,
        now: Duration,
    ) -> bool {
        if was_running && now.saturating_sub(self.reached_at) > STABLE {
            self.failures = 0;
        }
        self.again = now + wait * (1 << self.failures.min(5));
        self.failures = self.failures.saturating_add(1);
        self.fault.replace(fault) != Some(fault)
    }
}
