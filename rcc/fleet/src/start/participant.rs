//! One cell in coordinated starts. What it decides, the caller does: it loads, keeps, hands over and releases nets.

use std::fmt;

use takt_core::Nanos;
use takt_core::tai::{JUMP, Tai, TaiState};

use super::message::{Armed, Beat, Commit, Prepare, Ready, Refusal};
use super::{
    AHEAD_MAX, DECISION, GUARD, HANDOVER_MIN, OVER, PARTNERS_MAX, RESERVATION, SILENCE,
    TRANSACTIONS_MAX,
};
use crate::command::{Boot, Entropy, Nonce, Txn};

/// What a participant has to say about itself while it prepares.
#[derive(Clone, Copy, Debug)]
pub struct Readiness {
    /// Its clock.
    pub tai: Tai,
    /// Period of the net thread; above 0.
    pub period: Nanos,
    /// Time that it needs before a start.
    pub lead: Nanos,
}

/// Why resources are released without a start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReleaseCause {
    /// No commit arrived in time.
    Expired,
    /// The initiator aborted it.
    Aborted,
    /// Not all partners were armed in time.
    NotArmed,
    /// The clock was stepped, or lost its service, after the commit.
    Clock,
    /// This host stalled until it was too late.
    Stalled,
}

impl fmt::Display for ReleaseCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Expired => "no commit arrived in time\nhint: the initiator has gone, or its link is slow: try again",
            Self::Aborted => "the initiator aborted it",
            Self::NotArmed => {
                "not all partners were armed in time\nhint: their logs name the cause; a longer lead gives messages more time"
            }
            Self::Clock => {
                "the clock was stepped, or lost its time service, after the commit\nhint: takt fleet doctor"
            }
            Self::Stalled => "this host stalled until it was too late\nhint: takt doctor",
        })
    }
}

/// What the caller has to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// Hand the net over: it begins in the cycle nearest to this instant of `CLOCK_MONOTONIC`; the first one after it would be a
    /// whole period late by the least error of a clock.
    Begin {
        /// The coordinated start.
        txn: Txn,
        /// When.
        at: Nanos,
    },
    /// Unload the net; its resources are free.
    Release {
        /// The coordinated start.
        txn: Txn,
        /// Why.
        cause: ReleaseCause,
    },
    /// A partner does not run, or can no longer be reached: the policy of the session applies to the net.
    PartnerLost {
        /// The coordinated start.
        txn: Txn,
        /// The partner.
        cell: String,
    },
}

#[derive(Debug)]
enum Phase {
    /// Resources are kept until then.
    Ready { until: Nanos },
    /// Committed; waits for the arms of all.
    Committed {
        commit: Commit,
        /// The start on `CLOCK_MONOTONIC`, and the offset of TAI with which it was computed.
        start: Nanos,
        offset: Nanos,
        /// Which partners are armed.
        armed: [bool; PARTNERS_MAX],
    },
    /// Handed over.
    Running {
        nonces: Vec<Nonce>,
        /// When each partner gave a sign of life last; `None` once it is lost or over.
        seen: [Option<Nanos>; PARTNERS_MAX],
    },
    /// Its nets have ended by themselves; the partners learn so until then.
    Over { until: Nanos },
}

#[derive(Debug)]
struct Transaction {
    prepare: Prepare,
    ready: Ready,
    own: usize,
    /// All partners have the clock of this host.
    shares_clock: bool,
    phase: Phase,
}

/// What is due for one start.
enum Due {
    Release(ReleaseCause),
    Output(Output),
}

impl Transaction {
    fn poll(&mut self, tai: &Tai, now: Nanos, ignores_arms: bool) -> Option<Due> {
        let txn = self.prepare.txn;
        match &mut self.phase {
            Phase::Ready { until } => (now > *until).then_some(Due::Release(ReleaseCause::Expired)),
            Phase::Committed { start, .. } if now < *start - DECISION => None,
            Phase::Committed {
                commit,
                start,
                offset,
                armed,
            } => {
                let partners = commit.nonces.len();
                let is_armed = ignores_arms || armed.iter().take(partners).all(|it| *it);
                let is_stepped = (tai.offset - *offset).abs() > JUMP;
                if now > *start - HANDOVER_MIN {
                    return Some(Due::Release(ReleaseCause::Stalled));
                } else if !is_armed {
                    return Some(Due::Release(ReleaseCause::NotArmed));
                } else if is_stepped || !is_fit(tai, self.shares_clock) {
                    return Some(Due::Release(ReleaseCause::Clock));
                }
                let at = *start;
                let mut seen = [None; PARTNERS_MAX];
                for (place, seen) in seen.iter_mut().take(partners).enumerate() {
                    *seen = (place != self.own).then_some(at);
                }
                let nonces = std::mem::take(&mut commit.nonces);
                self.phase = Phase::Running { nonces, seen };
                Some(Due::Output(Output::Begin { txn, at }))
            }
            Phase::Running { seen, .. } => {
                let is_silent = |it: &&mut Option<Nanos>| it.is_some_and(|at| now > at + SILENCE);
                let place = seen.iter_mut().position(|it| is_silent(&it))?;
                *seen.get_mut(place)? = None;
                let cell = self.prepare.partners.get(place)?.clone();
                Some(Due::Output(Output::PartnerLost { txn, cell }))
            }
            Phase::Over { .. } => None,
        }
    }
}

/// Whether a clock permits a start.
fn is_fit(tai: &Tai, is_shared: bool) -> bool {
    is_shared || tai.state != TaiState::Free
}

/// A cell's part in coordinated starts.
pub struct Participant {
    cell: String,
    boot: Boot,
    /// The clock of its host, which other cells of that host have too.
    clock: String,
    entropy: Entropy,
    transactions: Vec<Transaction>,
    /// A fault put in by tests of the simulator.
    #[cfg(test)]
    pub(super) ignores_arms: bool,
}

impl fmt::Debug for Participant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Participant")
            .field("cell", &self.cell)
            .field("transactions", &self.transactions)
            .finish_non_exhaustive()
    }
}

impl Participant {
    /// A cell in no coordinated start. `clock` is what the cells of one host have in common; empty if that is not known.
    #[must_use]
    pub fn new(cell: &str, boot: Boot, clock: &str, entropy: Entropy) -> Self {
        Self {
            cell: cell.to_owned(),
            boot,
            clock: clock.to_owned(),
            entropy,
            transactions: Vec::new(),
            #[cfg(test)]
            ignores_arms: false,
        }
    }

    /// Takes part in a start whose net the caller has loaded. A repeated request receives the same reply and keeps the
    /// resources no longer.
    ///
    /// # Errors
    /// If it is for another run, the partners or the clock are not fit, or there are too many. The caller then unloads the net.
    pub fn prepare(
        &mut self,
        request: &Prepare,
        readiness: &Readiness,
        now: Nanos,
    ) -> Result<Ready, Refusal> {
        if request.boot != self.boot {
            return Err(Refusal::OtherBoot);
        }
        let name = self.cell.clone();
        let cell = || name.clone();
        let own = self.position(&request.partners);
        let own = own.ok_or_else(|| Refusal::Partners { cell: cell() })?;
        if let Some(known) = self.find(request.txn) {
            let is_repeated =
                known.prepare == *request && matches!(known.phase, Phase::Ready { .. });
            return if is_repeated {
                Ok(known.ready.clone())
            } else {
                Err(Refusal::Prepared)
            };
        }
        let tai = readiness.tai;
        let shares_clock = request.clock.is_some();
        if request
            .clock
            .as_ref()
            .is_some_and(|it| it.is_empty() || *it != self.clock)
        {
            return Err(Refusal::OtherClock { cell: cell() });
        }
        if !is_fit(&tai, shares_clock) {
            let why = tai.cause.to_string();
            return Err(Refusal::Clock { cell: cell(), why });
        }
        if !shares_clock && tai.uncertainty.0 > readiness.period.0 / 4 {
            let uncertainty_ns = tai.uncertainty.0;
            return Err(Refusal::Uncertain {
                cell: cell(),
                uncertainty_ns,
            });
        }
        if self.transactions.len() >= TRANSACTIONS_MAX {
            let bound = TRANSACTIONS_MAX;
            return Err(Refusal::TooMany {
                cell: cell(),
                bound,
            });
        }
        let ready = Ready {
            txn: request.txn,
            nonce: Nonce((self.entropy)()),
            period_ns: readiness.period.0,
            lead_ns: readiness.lead.0,
            uncertainty_ns: tai.uncertainty.0,
            tai_utc_s: tai.tai_utc_s,
            tai_ns: tai.tai(now).0,
        };
        self.transactions.push(Transaction {
            prepare: request.clone(),
            ready: ready.clone(),
            own,
            shares_clock,
            phase: Phase::Ready {
                until: now + RESERVATION,
            },
        });
        Ok(ready)
    }

    /// Position of this cell among partners that are fit for a start.
    fn position(&self, partners: &[String]) -> Option<usize> {
        let is_fit = (2..=PARTNERS_MAX).contains(&partners.len());
        let mut sorted: Vec<&String> = partners.iter().collect();
        sorted.sort_unstable();
        sorted.dedup();
        let own = partners.iter().position(|cell| *cell == self.cell);
        own.filter(|_| is_fit && sorted.len() == partners.len())
    }

    fn find(&mut self, txn: Txn) -> Option<&mut Transaction> {
        self.transactions
            .iter_mut()
            .find(|it| it.prepare.txn == txn)
    }

    /// Accepts the instant of the start. What it returns is to be published to all partners; a repeated commit receives it again.
    ///
    /// # Errors
    /// If it is for another run, was not prepared or not with these permissions, is late, or not on the grid of the net thread.
    pub fn commit(&mut self, commit: &Commit, tai: &Tai, now: Nanos) -> Result<Armed, Refusal> {
        let cell = self.cell.clone();
        if commit.boot != self.boot {
            return Err(Refusal::OtherBoot);
        }
        let Some(known) = self.find(commit.txn) else {
            return Err(Refusal::Unknown { cell });
        };
        let has_all = commit.nonces.len() == known.prepare.partners.len();
        let given = commit.nonces.get(known.own).copied();
        if !has_all || given != Some(known.ready.nonce) {
            return Err(Refusal::Nonce { cell });
        }
        let armed = Armed {
            txn: commit.txn,
            cell: cell.clone(),
            start_tai_ns: commit.start_tai_ns,
            nonces: commit.nonces.clone(),
        };
        match &known.phase {
            Phase::Ready { until } if now <= *until => {}
            Phase::Ready { .. } => return Err(Refusal::Unknown { cell }),
            Phase::Committed {
                commit: earlier, ..
            } if earlier == commit => return Ok(armed),
            Phase::Committed { .. } | Phase::Running { .. } | Phase::Over { .. } => {
                return Err(Refusal::Prepared);
            }
        }
        if !is_fit(tai, known.shares_clock) {
            let why = tai.cause.to_string();
            return Err(Refusal::Clock { cell, why });
        }
        let start = tai.monotonic(Nanos(commit.start_tai_ns));
        let ahead = start - now;
        if ahead < GUARD {
            let late_ns = (GUARD - ahead).0;
            return Err(Refusal::Late { cell, late_ns });
        }
        if ahead > AHEAD_MAX {
            let ahead_ns = ahead.0;
            return Err(Refusal::Ahead { cell, ahead_ns });
        }
        let period_ns = known.ready.period_ns;
        if period_ns <= 0 || commit.start_tai_ns.checked_rem(period_ns) != Some(0) {
            return Err(Refusal::Grid { cell, period_ns });
        }
        let own = known.own;
        let mut is_armed = [false; PARTNERS_MAX];
        if let Some(it) = is_armed.get_mut(own) {
            *it = true;
        }
        known.phase = Phase::Committed {
            commit: commit.clone(),
            start,
            offset: tai.offset,
            armed: is_armed,
        };
        Ok(armed)
    }

    /// Takes the arm of a partner. One that is not for exactly this start has no effect.
    pub fn armed(&mut self, message: &Armed) {
        let Some(known) = self.find(message.txn) else {
            return;
        };
        let place = known
            .prepare
            .partners
            .iter()
            .position(|it| *it == message.cell);
        let Phase::Committed { commit, armed, .. } = &mut known.phase else {
            return;
        };
        let is_same =
            message.start_tai_ns == commit.start_tai_ns && message.nonces == commit.nonces;
        if let Some(it) = place
            .and_then(|place| armed.get_mut(place))
            .filter(|_| is_same)
        {
            *it = true;
        }
    }

    /// Takes a partner's sign that its net runs.
    pub fn beat(&mut self, message: &Beat, now: Nanos) {
        let Some(known) = self.find(message.txn) else {
            return;
        };
        let Some(place) = known
            .prepare
            .partners
            .iter()
            .position(|it| *it == message.cell)
        else {
            return;
        };
        let Phase::Running { nonces, seen } = &mut known.phase else {
            return;
        };
        if nonces.get(place) != Some(&message.nonce) {
            return;
        }
        // One that was lost stays lost: its net may have ended in between.
        let Some(seen) = seen.get_mut(place) else {
            return;
        };
        *seen = seen.filter(|_| !message.over).map(|at| at.max(now));
    }

    /// The arms that are to be published every [`super::BEAT_EVERY`] until the start: one may be lost, or reach a partner before its
    /// commit.
    #[must_use]
    pub fn arms(&self) -> Vec<Armed> {
        let arm = |it: &Transaction| match &it.phase {
            Phase::Committed { commit, .. } => Some(Armed {
                txn: commit.txn,
                cell: self.cell.clone(),
                start_tai_ns: commit.start_tai_ns,
                nonces: commit.nonces.clone(),
            }),
            Phase::Ready { .. } | Phase::Running { .. } | Phase::Over { .. } => None,
        };
        self.transactions.iter().filter_map(arm).collect()
    }

    /// The beats that are due every [`super::BEAT_EVERY`] while nets run.
    #[must_use]
    pub fn beats(&self) -> Vec<Beat> {
        let beat = |it: &Transaction, over| Beat {
            txn: it.prepare.txn,
            cell: self.cell.clone(),
            nonce: it.ready.nonce,
            over,
        };
        let beats = self.transactions.iter().filter_map(|it| match it.phase {
            Phase::Running { .. } => Some(beat(it, false)),
            Phase::Over { .. } => Some(beat(it, true)),
            Phase::Ready { .. } | Phase::Committed { .. } => None,
        });
        beats.collect()
    }

    /// Aborts a start that has not been handed over; `None` if there is none: a net that was handed over is cancelled as any other.
    pub fn abort(&mut self, txn: Txn) -> Option<Output> {
        let is_it = |it: &Transaction| {
            let is_waiting = matches!(it.phase, Phase::Ready { .. } | Phase::Committed { .. });
            it.prepare.txn == txn && is_waiting
        };
        let index = self.transactions.iter().position(is_it)?;
        let cause = ReleaseCause::Aborted;
        Some(self.release(index, cause))
    }

    /// The nets of a start have ended by themselves: the partners are informed for a while, and do not count this cell as lost.
    pub fn over(&mut self, txn: Txn, now: Nanos) {
        if let Some(known) = self.find(txn) {
            known.phase = Phase::Over { until: now + OVER };
        }
    }

    /// Whether it takes part in a start.
    #[must_use]
    pub fn knows(&self, txn: Txn) -> bool {
        self.transactions.iter().any(|it| it.prepare.txn == txn)
    }

    /// The net of a start has ended otherwise, or did not begin: the partners lose this cell.
    pub fn ended(&mut self, txn: Txn) {
        self.transactions.retain(|it| it.prepare.txn != txn);
    }

    fn release(&mut self, index: usize, cause: ReleaseCause) -> Output {
        let txn = self.transactions.swap_remove(index).prepare.txn;
        Output::Release { txn, cause }
    }

    /// What is due; to be called until it returns `None`, and again at [`Self::poll_timeout`].
    pub fn poll(&mut self, tai: &Tai, now: Nanos) -> Option<Output> {
        #[cfg(test)]
        let ignores_arms = self.ignores_arms;
        #[cfg(not(test))]
        let ignores_arms = false;
        self.transactions
            .retain(|it| !matches!(it.phase, Phase::Over { until } if now > until));
        for index in 0..self.transactions.len() {
            let transaction = self.transactions.get_mut(index)?;
            match transaction.poll(tai, now, ignores_arms) {
                Some(Due::Release(cause)) => return Some(self.release(index, cause)),
                Some(Due::Output(output)) => return Some(output),
                None => {}
            }
        }
        None
    }

    /// When [`Self::poll`] has something to do at the latest.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Nanos> {
        let due = |it: &Transaction| match &it.phase {
            Phase::Ready { until } => Some(*until + Nanos(1)),
            Phase::Committed { start, .. } => Some(*start - DECISION),
            Phase::Running { seen, .. } => {
                let last = seen.iter().flatten().min();
                last.map(|at| *at + SILENCE + Nanos(1))
            }
            Phase::Over { until } => Some(*until + Nanos(1)),
        };
        self.transactions.iter().filter_map(due).min()
    }
}
