//! One node's heartbeat as it is seen: how often it comes, when that changes, and how the node starts again. What is
//! wrong with it, the findings say.

use std::time::Duration;

use super::Intervals;
use crate::canopen::{NmtCommand, NmtState};

/// How far an interval may be from another one that is taken for the same, as share of the longer.
const SAME: f64 = 0.25;
/// A boot-up this long behind a reset command is its consequence. Nodes take up to some seconds.
const RESET_MAX: Duration = Duration::from_secs(10);

/// What is known of one node's heartbeat.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heartbeat {
    /// As it told last.
    pub state: NmtState,
    /// Times from one to the next, of the present period; those in which some were missing are not among them.
    pub intervals: Intervals,
    /// How often it came too late.
    pub gaps: u32,
    /// How often the node started.
    pub boots: u32,
    /// How often it started while it had been at work and nobody had sent it a reset.
    pub reboots: u32,
    /// How often it started because of a reset command that is in the recording, and the last of these.
    pub resets: (u32, Option<NmtCommand>),
    /// Mean of the period before the present one, if it changed while the node was at work.
    pub earlier: Option<Duration>,
    /// As 1017h was written; zero is off. `None` while that was not seen since the node started.
    pub written: Option<Duration>,
    /// An interval that was much longer or shorter than the others: the period changed, if the next is the same.
    odd: Option<Duration>,
    /// The odd one was counted as a gap.
    was_gap: bool,
    /// A reset command that the node has not answered yet.
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
            resets: (0, None),
            earlier: None,
            written: None,
            odd: None,
            was_gap: false,
            commanded: None,
        }
    }

    /// How often it comes: as it was seen, or as 1017h says while too few were seen.
    #[must_use]
    pub fn period(&self) -> Duration {
        match self.written {
            Some(written) if self.intervals.count() < 2 => written,
            Some(_) | None => self.intervals.mean(),
        }
    }

    /// Longest silence that is not one: twice the usual time, as soon as two intervals were seen or 1017h was written.
    #[must_use]
    pub fn patience(&self) -> Option<Duration> {
        let seen = (self.intervals.count() >= 2).then(|| self.intervals.mean());
        match self.written {
            Some(written) if written.is_zero() => None,
            Some(written) => Some(seen.unwrap_or(written).max(written).saturating_mul(2)),
            None => seen.map(|mean| mean.saturating_mul(2)),
        }
    }

    /// A reset command to it.
    pub(super) const fn command(&mut self, command: NmtCommand, at: Duration) {
        self.commanded = Some((command, at));
    }

    /// 1017h was written: from now on another period counts.
    pub(super) fn write(&mut self, period: Duration, at: Duration) {
        self.renew(at);
        self.written = Some(period);
    }

    /// The statistics begin again.
    fn renew(&mut self, at: Duration) {
        if self.intervals.count() >= 2 {
            self.earlier = Some(self.intervals.mean());
        }
        self.intervals = Intervals::new();
        self.intervals.restart(at);
        (self.odd, self.was_gap) = (None, false);
    }

    /// A heartbeat or a boot-up message came.
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
        }
        self.boots += 1;
        // What 1017h was is not known any more.
        self.renew(at);
        (self.written, self.earlier) = (None, None);
    }

    fn interval(&mut self, interval: Option<Duration>, at: Duration) {
        let Some(interval) = interval else {
            return self.intervals.record(at);
        };
        let late = self.patience().is_some_and(|patience| interval > patience);
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
            // Two in a row: it is no gap but another period.
            self.gaps -= u32::from(self.was_gap);
            let last = at.saturating_sub(interval);
            self.renew(last.saturating_sub(odd));
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
