//! Who wants nets on several controllers to begin at one instant: asks all, then chooses the instant. It runs no net.

use takt_core::Nanos;

use super::message::{Commit, Prepare, Ready, Refusal};
use super::{LEAD_MIN, REPLY_TIMEOUT};
use crate::command::{Boot, Nonce, Txn};

/// Longest common period of all participants, beyond which no start is found.
const GRID_MAX: i64 = 1_000_000_000;

/// A cell that is to take part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    /// Its name.
    pub cell: String,
    /// Its run, as its info says.
    pub boot: Boot,
    /// The clock of its host, as its info says; empty if it does not.
    pub clock: String,
    /// The session of commands at it, and a nonce of that.
    pub session: u32,
    /// See `session`.
    pub nonce: Nonce,
    /// Its nets that begin.
    pub nets: Vec<String>,
}

/// How it ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All are armed for this instant of TAI, ns. Each begins if the arms of all reach it.
    Armed {
        /// The instant.
        start_tai_ns: i64,
    },
    /// One refused; all were asked to abort.
    Refused {
        /// The cell.
        cell: String,
        /// Why.
        why: Refusal,
    },
    /// One did not reply in time; all were asked to abort.
    Silent {
        /// The cell.
        cell: String,
    },
    /// The participants do not fit together; all were asked to abort.
    Mismatch {
        /// Why, with a hint.
        text: String,
    },
}

/// What the caller has to do, for the member of that position.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Goal {
    /// Query `start/prepare`.
    Prepare(usize, Prepare),
    /// Query `start/commit`.
    Commit(usize, Commit),
    /// Query `start/abort`.
    Abort(usize),
    /// It is over.
    Finished(Outcome),
}

#[derive(Debug)]
enum Phase {
    Preparing { until: Nanos },
    Committing { until: Nanos, start_tai_ns: i64 },
    Finished,
}

/// One coordinated start, from the side of who wants it.
#[derive(Debug)]
pub struct Initiator {
    txn: Txn,
    members: Vec<Member>,
    /// The replies to the prepare, and when they arrived.
    ready: Vec<Option<(Ready, Nanos)>>,
    /// The start is at least this far ahead when it is chosen.
    lead: Nanos,
    armed: Vec<bool>,
    failed: Option<Outcome>,
    phase: Phase,
    goals: std::collections::VecDeque<Goal>,
}

impl Initiator {
    /// Begins to prepare it, for a start that is at least `lead` ahead when it is chosen. The participants check the members.
    #[must_use]
    pub fn new(txn: Txn, members: Vec<Member>, lead: Nanos, now: Nanos) -> Self {
        let partners: Vec<String> = members.iter().map(|it| it.cell.clone()).collect();
        let first = members.first().map(|it| it.clock.clone());
        let clock =
            first.filter(|first| !first.is_empty() && members.iter().all(|it| it.clock == *first));
        let prepare = |(place, member): (usize, &Member)| {
            let prepare = Prepare {
                txn,
                boot: member.boot,
                partners: partners.clone(),
                session: member.session,
                nonce: member.nonce,
                nets: member.nets.clone(),
                clock: clock.clone(),
            };
            Goal::Prepare(place, prepare)
        };
        Self {
            txn,
            goals: members.iter().enumerate().map(prepare).collect(),
            ready: vec![None; members.len()],
            lead: lead.max(LEAD_MIN),
            armed: vec![false; members.len()],
            members,
            failed: None,
            phase: Phase::Preparing {
                until: now + REPLY_TIMEOUT,
            },
        }
    }

    /// Takes the reply of a member to its prepare, which arrived at `now`.
    pub fn handle_ready(&mut self, place: usize, reply: Result<Ready, Refusal>, now: Nanos) {
        let is_preparing = matches!(self.phase, Phase::Preparing { .. });
        match reply {
            Ok(ready) if is_preparing && ready.txn == self.txn => {
                if let Some(it) = self.ready.get_mut(place) {
                    *it = Some((ready, now));
                }
            }
            Ok(_) => {}
            Err(why) => self.refuse(place, why),
        }
    }

    /// Takes the reply of a member to its commit.
    pub fn handle_armed(&mut self, place: usize, reply: Result<(), Refusal>) {
        match reply {
            Ok(()) => {
                if let Some(it) = self.armed.get_mut(place) {
                    *it = true;
                }
            }
            Err(why) => self.refuse(place, why),
        }
    }

    fn refuse(&mut self, place: usize, why: Refusal) {
        let cell = self
            .members
            .get(place)
            .map(|it| it.cell.clone())
            .unwrap_or_default();
        self.failed.get_or_insert(Outcome::Refused { cell, why });
    }

    /// What is due; to be called until it returns `None`. `now` is on any clock that is not stepped: TAI is that of the participants.
    pub fn poll(&mut self, now: Nanos) -> Option<Goal> {
        if self.goals.is_empty() {
            self.advance(now);
        }
        self.goals.pop_front()
    }

    fn advance(&mut self, now: Nanos) {
        let (until, replied): (Nanos, Vec<bool>) = match &self.phase {
            Phase::Preparing { until } => {
                (*until, self.ready.iter().map(Option::is_some).collect())
            }
            Phase::Committing { until, .. } => (*until, self.armed.clone()),
            Phase::Finished => return,
        };
        let silent = replied.iter().position(|has| !has);
        let failed = self.failed.take().or_else(|| {
            let member = silent
                .filter(|_| now > until)
                .and_then(|at| self.members.get(at));
            member.map(|it| Outcome::Silent {
                cell: it.cell.clone(),
            })
        });
        if let Some(outcome) = failed {
            return self.abort(outcome);
        }
        if silent.is_some() {
            return;
        }
        if let Phase::Committing { start_tai_ns, .. } = self.phase {
            self.phase = Phase::Finished;
            self.goals
                .push_back(Goal::Finished(Outcome::Armed { start_tai_ns }));
            return;
        }
        match self.choose(now) {
            Ok(start_tai_ns) => self.commit(start_tai_ns, now),
            Err(text) => self.abort(Outcome::Mismatch { text }),
        }
    }

    fn commit(&mut self, start_tai_ns: i64, now: Nanos) {
        let nonces: Vec<Nonce> = self.ready.iter().flatten().map(|it| it.0.nonce).collect();
        for (place, member) in self.members.iter().enumerate() {
            let commit = Commit {
                txn: self.txn,
                boot: member.boot,
                start_tai_ns,
                nonces: nonces.clone(),
            };
            self.goals.push_back(Goal::Commit(place, commit));
        }
        self.phase = Phase::Committing {
            until: now + REPLY_TIMEOUT,
            start_tai_ns,
        };
    }

    fn abort(&mut self, outcome: Outcome) {
        self.goals.extend((0..self.members.len()).map(Goal::Abort));
        self.goals.push_back(Goal::Finished(outcome));
        self.phase = Phase::Finished;
    }

    /// The first instant on the grids of all participants that leaves all of them time.
    fn choose(&self, now: Nanos) -> Result<i64, String> {
        let ready = || self.ready.iter().flatten().zip(&self.members);
        let Some(((first, _), first_member)) = ready().next() else {
            return Err("no cell takes part".to_owned());
        };
        let mut grid: i64 = 1;
        let (mut lead, mut tai) = (self.lead.0, i64::MIN);
        for ((it, arrived), member) in ready() {
            if it.tai_utc_s != first.tai_utc_s {
                return Err(format!(
                    "TAI is {} s ahead of UTC on {}, and {} s on {}\nhint: let phc2sys or chrony set the same offset on both",
                    first.tai_utc_s, first_member.cell, it.tai_utc_s, member.cell
                ));
            }
            grid = common(grid, it.period_ns).ok_or_else(|| {
                format!(
                    "the periods have no common multiple of at most 1 s; that of {} is {} ns",
                    member.cell, it.period_ns
                )
            })?;
            lead = lead.max(it.lead_ns);
            tai = tai.max(it.tai_ns.saturating_add((now - *arrived).0));
        }
        let wrong = "a cell's TAI is beyond all years\nhint: takt fleet doctor";
        let earliest = tai.checked_add(lead).ok_or(wrong)?;
        let beyond = earliest.rem_euclid(grid);
        let start = if beyond == 0 {
            Some(earliest)
        } else {
            earliest.checked_add(grid - beyond)
        };
        start.ok_or_else(|| wrong.to_owned())
    }
}

/// The least common multiple of two periods, ns; `None` if it is too long, or one is no period.
fn common(a: i64, b: i64) -> Option<i64> {
    if a <= 0 || b <= 0 {
        return None;
    }
    let (mut x, mut y) = (a, b);
    while y != 0 {
        (x, y) = (y, x % y);
    }
    (a / x).checked_mul(b).filter(|it| *it <= GRID_MAX)
}
