//! The life of a net in the thread that evaluates it, from its start to its return, as one table. The
//! executor causes the changes; the controller's view of a net's life is another one.
//!
//! ```text
//!   start ──────────────────▶ Running ──┐ end, abort
//!                               ▲       ▼
//!   start by a rule ▶ Succeeding┘ ───▶ Ended ──▶ Leaving ──▶ returned to the controller
//!                      first evaluation     commands withdrawn
//! ```

/// Why a net ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// It signalled its termination.
    Terminated,
    /// It was aborted.
    Aborted,
    /// The whole controller was stopped.
    Halted,
    /// A synchronization rule stopped it.
    Stopped,
    /// Its evaluation took longer than a period of its thread,
    /// [`RUNAWAY_AFTER`](super::figures::RUNAWAY_AFTER) times in a row.
    Runaway,
    /// A device that it commands, by its number, stopped following commands.
    DeviceFault(usize),
}

/// State of a net in its thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Life {
    /// A rule started it. Until its first evaluation it keeps the commands of the nets that it follows.
    Succeeding,
    /// It is evaluated when it is due.
    Running {
        /// Whether it was evaluated in this cycle.
        evaluated: bool,
    },
    /// It has ended; its commands are still in force.
    Ended {
        end: End,
        /// Whether it was evaluated in this cycle.
        evaluated: bool,
    },
    /// It has ended, and its commands are withdrawn or about to be. It waits to be returned.
    Leaving(End),
}

/// A change of that state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// A cycle of the thread begins, in which the net is due or not.
    Cycle { is_due: bool },
    /// It ends. An earlier end keeps its reason.
    End(End),
    /// A client aborts it, whatever ended it before.
    Abort,
    /// Its commands are withdrawn.
    Withdraw,
}

impl Life {
    /// The state after a change.
    pub(super) const fn after(self, change: Change) -> Self {
        match (self, change) {
            (Self::Succeeding, Change::Cycle { is_due: false } | Change::Withdraw) => self,
            (Self::Succeeding | Self::Running { .. }, Change::Cycle { is_due: true }) => {
                Self::Running { evaluated: true }
            }
            (Self::Succeeding, Change::End(end)) => Self::Ended {
                end,
                evaluated: false,
            },
            (Self::Succeeding, Change::Abort) => Self::Ended {
                end: End::Aborted,
                evaluated: false,
            },
            (Self::Running { .. }, Change::Cycle { is_due: false }) => {
                Self::Running { evaluated: false }
            }
            (Self::Running { .. }, Change::Withdraw) => self,
            (Self::Running { evaluated }, Change::End(end)) => Self::Ended { end, evaluated },
            (Self::Running { evaluated } | Self::Ended { evaluated, .. }, Change::Abort) => {
                Self::Ended {
                    end: End::Aborted,
                    evaluated,
                }
            }
            (Self::Ended { end, .. }, Change::Cycle { .. }) => Self::Ended {
                end,
                evaluated: false,
            },
            (Self::Ended { .. }, Change::End(_)) => self,
            (Self::Ended { end, .. }, Change::Withdraw) => Self::Leaving(end),
            (Self::Leaving(_), Change::Cycle { .. } | Change::End(_) | Change::Withdraw) => self,
            (Self::Leaving(_), Change::Abort) => Self::Leaving(End::Aborted),
        }
    }

    /// Why it ended; `None` while it runs.
    pub(super) const fn end(self) -> Option<End> {
        match self {
            Self::Succeeding | Self::Running { .. } => None,
            Self::Ended { end, .. } | Self::Leaving(end) => Some(end),
        }
    }

    /// Whether it was evaluated in this cycle.
    pub(super) const fn is_evaluated(self) -> bool {
        match self {
            Self::Succeeding | Self::Leaving(_) => false,
            Self::Running { evaluated } | Self::Ended { evaluated, .. } => evaluated,
        }
    }
}

/// How far the start of a net by a rule has been reported. The controller learns of it only after the ends of the
/// nets that it follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StartReport {
    /// To be recorded, then sent.
    Due,
    /// Recorded, to be sent.
    Recorded,
    /// Sent, or started by the controller itself.
    Sent,
}

/// Whether a net was requested to cancel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cancel {
    /// It was not.
    None,
    /// By a rule, which is not reported yet.
    ByRule,
    /// It was, and this is reported.
    Requested,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By change, the states after it, from each of the states above. A star marks an evaluation in this cycle,
    /// brackets the reason of an end.
    const TABLE: &str = "
              succeeding running running* ended(terminated) ended(terminated)* leaving(terminated)
    skip      .          .       running  .                 ended(terminated)  .
    due       running*   running* .       .                 ended(terminated)  .
    stop      ended(stopped) ended(stopped) ended(stopped)* . .               .
    abort     ended(aborted) ended(aborted) ended(aborted)* ended(aborted) ended(aborted)* leaving(aborted)
    withdraw  .          .       .        leaving(terminated) leaving(terminated) .";

    const ENDS: [(&str, End); 3] = [
        ("terminated", End::Terminated),
        ("stopped", End::Stopped),
        ("aborted", End::Aborted),
    ];

    fn life(name: &str) -> Life {
        let (rest, evaluated) = match name.strip_suffix('*') {
            Some(rest) => (rest, true),
            None => (name, false),
        };
        let (kind, end) = rest
            .trim_end_matches(')')
            .split_once('(')
            .unwrap_or((rest, ""));
        let end = ENDS
            .iter()
            .find(|(name, _)| *name == end)
            .map(|(_, end)| *end);
        match (kind, end) {
            ("succeeding", None) => Life::Succeeding,
            ("running", None) => Life::Running { evaluated },
            ("ended", Some(end)) => Life::Ended { end, evaluated },
            ("leaving", Some(end)) => Life::Leaving(end),
            other => panic!("{other:?}"),
        }
    }

    fn change(name: &str) -> Change {
        match name {
            "skip" => Change::Cycle { is_due: false },
            "due" => Change::Cycle { is_due: true },
            "stop" => Change::End(End::Stopped),
            "abort" => Change::Abort,
            "withdraw" => Change::Withdraw,
            name => panic!("{name}"),
        }
    }

    #[test]
    fn net_life_in_thread_follows_its_table() {
        let mut lines = TABLE.lines().skip(1).map(str::split_whitespace);
        let states: Vec<_> = lines.next().unwrap().collect();
        let mut cells = 0;
        for mut line in lines {
            let by = line.next().unwrap();
            for (from, to) in states.iter().zip(line) {
                let before = life(from);
                let expected = life(if to == "." { from } else { to });
                assert_eq!(before.after(change(by)), expected, "{from}, {by}");
                // No net that has ended runs again.
                assert!(before.end().is_none() || expected.end().is_some());
                cells += 1;
            }
        }
        assert_eq!(cells, 6 * 5);
    }
}
