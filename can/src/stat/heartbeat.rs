//! Heartbeat statistics of one node: period, changes of the period, and restarts of the node.

use std::time::Duration;

use super::Intervals;
use crate::canopen::{NmtCommand, NmtState};

/// Tolerance of equal intervals, relative to the longer one.
const SAME: f64 = 0.25;
/// Maximum time from a reset command to the boot-up that it caused. Nodes take up to some seconds.
const RESET_MAX: Duration = Duration::from_secs(10);

/// Maximum time between the boot-ups of two nodes with one number after one reset.
const TWIN_MAX: Duration = Duration::from_millis(100);
/// Restarts that are a loop.
const LOOP_MIN: u32 = 3;

/// Heartbeat statistics of one node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heartbeat {
    /// Last reported state.
    pub state: NmtState,
    /// Intervals of the current period, without gaps.
    pub intervals: Intervals,
    /// Number of late heartbeats.
    pub gaps: u32,
    /// Number of boot-ups.
    pub boots: u32,
    /// Number of restarts during operation without a reset command.
    pub reboots: u32,
    /// Number of restarts without a heartbeat since the last boot-up and without a reset command.
    pub loops: u32,
    /// Number of boot-ups right after another, as of two nodes with one number.
    pub twins: u32,
    /// Sent by this host.
    pub own: bool,
    /// Time of the last boot-up.
    booted: Option<Duration>,
    /// Number of boot-ups after an observed reset command, and the time of the last.
    pub resets: (u32, Option<NmtCommand>),
    /// Mean of the previous period, if it changed during operation.
    pub earlier: Option<Duration>,
    /// Value written to 1017h; zero: off. `None` if not observed since the boot-up.
    pub written: Option<Duration>,
    /// An outlier interval: the period changed if the next interval is the same.
    odd: Option<Duration>,
    /// The outlier was counted as a gap.
    was_gap: bool,
    /// A reset command without boot-up yet.
    commanded: Option<(NmtCommand, Duration)>,
}

impl Heartbeat {
    pub(super) const fn new() -> Self {
        Self {
            state: NmtState::BootUp,
            intervals: Intervals::new(),
            gaps: 0,
            boots: 0,
            reboots: 0,
            loops: 0,
            twins: 0,
            own: false,
            booted: None,
            resets: (0, None),
            earlier: None,
            written: None,
            odd: None,
            was_gap: false,
            commanded: None,
        }
    }

    /// Number of restarts without a reset command, if they are so many that the node does not stay up.
    pub fn boot_loop(&self) -> Option<u32> {
        let twins = if self.twins >= LOOP_MIN {
            self.twins
        } else {
            0
        };
        let restarts = self.reboots + self.loops + twins;
        (restarts >= LOOP_MIN).then_some(restarts)
    }

    /// Its period: as observed, or as written to 1017h while too few were observed.
    pub fn period(&self) -> Duration {
        match self.written {
            Some(written) if self.intervals.count() < 2 => written,
            Some(_) | None => self.intervals.mean(),
        }
    }

    /// Timeout of the heartbeat: twice its period, once two intervals were observed or 1017h was written.
    pub fn timeout(&self) -> Option<Duration> {
        let seen = (self.intervals.count() >= 2).then(|| self.intervals.mean());
        match self.written {
            Some(written) if written.is_zero() => None,
            Some(written) => Some(seen.unwrap_or(written).max(written).saturating_mul(2)),
            None => seen.map(|mean| mean.saturating_mul(2)),
        }
    }

    /// Handles a reset command to the node.
    pub(super) const fn command(&mut self, command: NmtCommand, at: Duration) {
        self.commanded = Some((command, at));
    }

    /// Handles a write to 1017h: a new period starts.
    pub(super) fn write(&mut self, period: Duration, at: Duration) {
        self.restart_statistics(at);
        self.written = Some(period);
    }

    /// Restarts the statistics.
    fn restart_statistics(&mut self, at: Duration) {
        if self.intervals.count() >= 2 {
            self.earlier = Some(self.intervals.mean());
        }
        self.intervals = Intervals::new();
        self.intervals.restart(at);
        (self.odd, self.was_gap) = (None, false);
    }

    /// Handles a heartbeat or boot-up message.
    pub(super) fn handle(&mut self, state: NmtState, at: Duration) {
        if state == NmtState::BootUp {
            self.boot(at);
        } else {
            let interval = self.intervals.last().map(|last| at.saturating_sub(last));
            self.interval(interval, at);
        }
        self.state = state;
    }

    fn boot(&mut self, at: Duration) {
        let was_at_work = self.intervals.last().is_some() && self.state != NmtState::BootUp;
        let command = self.commanded.take();
        let command = command.filter(|(_, sent)| at.saturating_sub(*sent) <= RESET_MAX);
        if let Some((command, _)) = command {
            self.resets = (self.resets.0.saturating_add(1), Some(command));
        } else {
            self.reboots += u32::from(was_at_work);
            let since = self.booted.map(|before| at.saturating_sub(before));
            if let Some(since) = since.filter(|_| !was_at_work) {
                let is_twin = since <= TWIN_MAX && self.state == NmtState::BootUp;
                self.twins += u32::from(is_twin);
                self.loops += u32::from(!is_twin);
            }
        }
        self.booted = Some(at);
        self.boots += 1;
        // The value of 1017h is no longer known.
        self.restart_statistics(at);
        (self.written, self.earlier) = (None, None);
    }

    fn interval(&mut self, interval: Option<Duration>, at: Duration) {
        let Some(interval) = interval else {
            return self.intervals.record(at);
        };
        let late = self.timeout().is_some_and(|timeout| interval > timeout);
        let early = self.intervals.count() >= 2 && interval < self.intervals.mean() / 2;
        let Some(odd) = self.odd.filter(|_| late || early) else {
            if late || early {
                (self.odd, self.was_gap) = (Some(interval), late);
                self.gaps += u32::from(late);
                self.intervals.restart(at);
            } else {
                self.odd = None;
                self.intervals.record(at);
            }
            return;
        };
        if is_same(odd, interval) {
            // Two in a row: not a gap but a new period.
            self.gaps -= u32::from(self.was_gap);
            let last = at.saturating_sub(interval);
            self.restart_statistics(last.saturating_sub(odd));
            self.intervals.record(last);
            self.intervals.record(at);
            return;
        }
        (self.odd, self.was_gap) = (Some(interval), late);
        self.gaps += u32::from(late);
        self.intervals.restart(at);
    }
}

fn is_same(a: Duration, b: Duration) -> bool {
    a.abs_diff(b).as_secs_f64() <= SAME * a.max(b).as_secs_f64()
}
