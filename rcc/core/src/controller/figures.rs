//! Figures of a running controller: how its threads keep their time and what its drivers count.
//! They judge nothing.

use crate::controller::Controller;
use crate::device::lwr::Lwr;

impl Controller {
    /// How well the net thread keeps its time.
    #[must_use]
    pub fn stats(&self) -> takt_rt::stats::Snapshot {
        self.inner.lock().thread_stats()
    }

    /// Time between handing over set-points to the first and to the last arm of a cycle.
    #[must_use]
    pub fn hand_over(&self) -> takt_rt::stats::Summary {
        self.inner.lock().hand_over()
    }

    /// How the host granted what the threads asked for, with the threads' names.
    #[must_use]
    pub fn grants(&self) -> Vec<(String, takt_rt::Grant)> {
        self.inner.lock().grants()
    }

    /// Reads something of the driver of every arm.
    pub fn with_arms<T>(&self, read: impl Fn(&Lwr) -> T) -> Vec<T> {
        self.inner.lock().arms.iter().map(read).collect()
    }

    /// The state an arm's driver last told.
    #[must_use]
    pub fn arm_state(&self, name: &str) -> Option<crate::device::ArmState> {
        self.inner.lock().devices.find(name).map(|arm| arm.state())
    }
}
