//! The synchronization rules of a controller: as programs request them and see them, and how far their threads have
//! answered. Conditions are parsed in [`condition`]; the net threads evaluate the rules.

pub(super) mod condition;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::str::FromStr;

use crate::controller::admission::forest::Succession;
use crate::error::Error;
use crate::executor::rules::RuleState;
use crate::ids::NetId;

/// Maximum number of rules kept; the oldest that no longer wait are dropped first.
const RULES_KEPT: usize = 4096;

/// Maximum number of rules of which only the final state is kept.
const STATES_KEPT: usize = 1 << 18;

/// Identifier of a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RuleId(pub u32);

impl fmt::Display for RuleId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for RuleId {
    type Err = std::num::ParseIntError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        text.parse().map(Self)
    }
}

impl RuleState {
    /// Its name on the wire.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Active => "ACTIVE",
            Self::Fired => "FIRED",
            Self::FireFailed => "FIREFAILED",
            Self::Inactive => "INACTIVE",
        }
    }
}

/// A rule to be installed.
#[derive(Clone, Debug, Default)]
pub struct RuleRequest {
    /// When it fires.
    pub condition: String,
    /// Nets that it ends.
    pub stop: Vec<NetId>,
    /// Nets that it asks to cancel.
    pub cancel: Vec<NetId>,
    /// Nets that it starts.
    pub start: Vec<NetId>,
    /// Description for users.
    pub description: String,
}

/// A rule as programs see it.
#[derive(Clone, Debug)]
pub struct RuleInfo {
    /// Its identifier.
    pub id: RuleId,
    /// The request.
    pub request: RuleRequest,
    /// Its state.
    pub state: RuleState,
    /// Why it failed to fire, with a hint.
    pub why: Option<String>,
}

/// Whether a new rule waits in its threads.
#[derive(Debug)]
enum Installation {
    /// So many threads have not answered yet.
    Pending(usize),
    /// All have accepted it, or one has rejected it; the caller does not know yet.
    Answered(Result<(), Error>),
    /// The caller knows.
    Reported,
}

/// A rule in the registry.
#[derive(Debug)]
struct RuleEntry {
    request: RuleRequest,
    /// Nets and keys in its condition.
    asked: Vec<(NetId, String)>,
    state: RuleState,
    why: Option<String>,
    succession: Succession,
    installation: Installation,
    /// Net threads in which it waits.
    waiting: usize,
    /// Its state in the others.
    outcome: RuleState,
}

impl RuleEntry {
    fn info(&self, id: RuleId) -> RuleInfo {
        RuleInfo {
            id,
            request: self.request.clone(),
            state: self.state,
            why: self.why.clone(),
        }
    }

    /// Whether a net occurs in it.
    fn names(&self, net: NetId) -> bool {
        let RuleRequest {
            stop,
            cancel,
            start,
            ..
        } = &self.request;
        let mut acted_on = stop.iter().chain(cancel).chain(start);
        acted_on.any(|named| *named == net) || self.asked.iter().any(|(asked, _)| *asked == net)
    }
}

/// All rules that are kept.
#[derive(Debug, Default)]
pub(super) struct Rules {
    all: BTreeMap<RuleId, RuleEntry>,
    /// The final states of those that were dropped, and of immediate starts.
    final_states: BTreeMap<RuleId, RuleState>,
    last: Option<u32>,
}

impl Rules {
    /// The next rule's number; an immediate start takes one too.
    pub(super) fn next_id(&mut self) -> RuleId {
        let next = self.last.map_or(0, |last| last.wrapping_add(1));
        self.last = Some(next);
        RuleId(next)
    }

    /// Adds a rule that was sent to so many threads; `asked` are the nets and keys of its condition.
    pub(super) fn add(
        &mut self,
        id: RuleId,
        request: RuleRequest,
        asked: Vec<(NetId, String)>,
        succession: Succession,
        threads: usize,
    ) {
        let entry = RuleEntry {
            request,
            asked,
            state: RuleState::Active,
            why: None,
            succession,
            installation: Installation::Pending(threads),
            waiting: threads,
            outcome: RuleState::Fired,
        };
        self.all.insert(id, entry);
        self.drop_oldest();
    }

    fn drop_oldest(&mut self) {
        while self.all.len() > RULES_KEPT {
            let mut rules = self.all.iter();
            let over = rules.find(|(_, entry)| entry.state != RuleState::Active);
            let Some(id) = over.map(|(id, _)| *id) else {
                return;
            };
            if let Some(entry) = self.all.remove(&id) {
                self.decide(id, entry.state);
            }
        }
    }

    /// Keeps the final state of a rule, or of an immediate start, which counts as one.
    pub(super) fn decide(&mut self, id: RuleId, state: RuleState) {
        self.final_states.insert(id, state);
        while self.final_states.len() > STATES_KEPT {
            self.final_states.pop_first();
        }
    }

    /// The state of a rule, which is kept longer than the rule itself.
    pub(super) fn state(&self, id: RuleId) -> Option<RuleState> {
        let kept = self.all.get(&id).map(|entry| entry.state);
        kept.or_else(|| self.final_states.get(&id).copied())
    }

    pub(super) fn info(&self, id: RuleId) -> Option<RuleInfo> {
        Some(self.all.get(&id)?.info(id))
    }

    /// The rules in which a net occurs.
    pub(super) fn naming(&self, net: NetId) -> Vec<RuleInfo> {
        let naming = self.all.iter().filter(|(_, entry)| entry.names(net));
        naming.map(|(id, entry)| entry.info(*id)).collect()
    }

    pub(super) fn states(&self) -> Vec<RuleState> {
        self.all.values().map(|entry| entry.state).collect()
    }

    fn active(&self) -> impl Iterator<Item = &RuleEntry> {
        let rules = self.all.values();
        rules.filter(|entry| entry.state == RuleState::Active)
    }

    /// The successions of the rules that wait.
    pub(super) fn successions(&self) -> impl Iterator<Item = &Succession> {
        self.active().map(|entry| &entry.succession)
    }

    /// The keys of a net in the conditions of rules that wait.
    pub(super) fn asked_of(&self, net: NetId) -> BTreeSet<String> {
        let asked = self.active().flat_map(|entry| &entry.asked);
        let of_net = asked.filter(|(asked, _)| *asked == net);
        of_net.map(|(_, key)| key.clone()).collect()
    }

    /// Whether the threads accepted a new rule, once it is known; reported once.
    pub(super) fn installed(&mut self, id: RuleId) -> Option<Result<(), Error>> {
        let entry = self.all.get_mut(&id)?;
        match std::mem::replace(&mut entry.installation, Installation::Reported) {
            pending @ Installation::Pending(_) => {
                entry.installation = pending;
                None
            }
            Installation::Answered(outcome) => Some(outcome),
            Installation::Reported => Some(Ok(())),
        }
    }

    /// A rule waits in one more thread. Returns the nets that it starts once it waits in all.
    pub(super) fn accepted(&mut self, id: RuleId) -> Vec<NetId> {
        let Some(entry) = self.all.get_mut(&id) else {
            return Vec::new();
        };
        let Installation::Pending(unanswered) = &mut entry.installation else {
            return Vec::new();
        };
        *unanswered = unanswered.saturating_sub(1);
        if *unanswered > 0 {
            return Vec::new();
        }
        entry.installation = Installation::Answered(Ok(()));
        entry.request.start.clone()
    }

    /// One thread rejected a rule: it waits in none.
    pub(super) fn rejected(&mut self, id: RuleId, why: Error) {
        if let Some(entry) = self.all.get_mut(&id) {
            entry.installation = Installation::Answered(Err(why));
        }
    }

    /// A rule no longer waits in one of its threads, where it ended in `state`, `why` if it failed there. Returns
    /// the reason if it has ended in all and failed.
    pub(super) fn ended(
        &mut self,
        id: RuleId,
        state: RuleState,
        why: Option<String>,
    ) -> Option<String> {
        let entry = self.all.get_mut(&id)?;
        entry.why = entry.why.take().or(why);
        entry.outcome = worse(entry.outcome, state);
        entry.waiting = entry.waiting.saturating_sub(1);
        if entry.waiting > 0 {
            return None;
        }
        entry.state = entry.outcome;
        let why = entry.why.as_deref();
        let why = why.unwrap_or("a net of another thread could not start");
        (entry.state == RuleState::FireFailed).then(|| why.to_owned())
    }
}

/// Combined state of a rule from the states in two threads.
const fn worse(one: RuleState, other: RuleState) -> RuleState {
    match (one, other) {
        (RuleState::FireFailed, _) | (_, RuleState::FireFailed) => RuleState::FireFailed,
        (RuleState::Inactive, _) | (_, RuleState::Inactive) => RuleState::Inactive,
        (RuleState::Active, _) | (_, RuleState::Active) => RuleState::Active,
        (RuleState::Fired, RuleState::Fired) => RuleState::Fired,
    }
}
