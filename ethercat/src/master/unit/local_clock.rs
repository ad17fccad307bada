//! The clock of a slave: what was measured of it, and whether it follows the reference. How it is set up is in
//! [`super::clock`].

/// The clock of a slave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::master) struct UnitClock {
    /// Receive times of its ports, as latched at start, ns of local time.
    pub(in crate::master) times: [u32; 4],
    /// The receive times were read.
    pub(in crate::master) latched: bool,
    /// Propagation delay from the reference, ns.
    pub(in crate::master) delay_ns: u32,
    /// Offset added to its local time, ns.
    pub(super) offset: u64,
    /// System time difference as last read, ns; positive is ahead.
    pub(in crate::master) difference_ns: Option<i32>,
    /// Differences beyond the window since it was locked.
    pub(in crate::master) violations: u64,
    /// Consecutive differences beyond the window.
    outside: u8,
    /// Consecutive differences within the window while it locks.
    pub(super) streak: u8,
    /// It follows the reference.
    pub(in crate::master) locked: bool,
    /// First SYNC0, system time, ns.
    pub(in crate::master) start_ns: Option<u64>,
}

/// A change that is reported once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ClockChange {
    Lost,
    Back,
}

impl UnitClock {
    /// It no longer follows the reference: the slave is offline.
    pub(super) const fn unlock(&mut self) {
        (self.locked, self.outside) = (false, 0);
    }

    /// Judges a difference. A locked clock that is outside of the window three times in a row is lost.
    pub(super) const fn judge(
        &mut self,
        difference_ns: i32,
        window_ns: u32,
    ) -> Option<ClockChange> {
        self.difference_ns = Some(difference_ns);
        if difference_ns.unsigned_abs() <= window_ns {
            let was_lost = self.is_lost();
            (self.locked, self.outside) = (true, 0);
            return if was_lost {
                Some(ClockChange::Back)
            } else {
                None
            };
        }
        if !self.locked {
            return None;
        }
        self.violations += 1;
        self.outside = self.outside.saturating_add(1);
        if self.outside == OUTSIDE {
            return Some(ClockChange::Lost);
        }
        None
    }

    /// A locked clock is outside of the window for longer than noise explains.
    pub(in crate::master) const fn is_lost(&self) -> bool {
        self.outside >= OUTSIDE
    }
}

/// Consecutive differences beyond the window after which a clock is reported as lost.
const OUTSIDE: u8 = 3;
