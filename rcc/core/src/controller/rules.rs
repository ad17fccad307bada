//! Synchronization rules as programs install them: conditions as text, nets by identifier. The net
//! threads evaluate them.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use takt_net::{Element, Type};

use crate::controller::admission::Succession;
use crate::controller::condition::Parser;
use crate::controller::net::Net;
use crate::controller::registry::Registry;
use crate::controller::threads::busy;
use crate::controller::{Controller, NetId, NetState};
use crate::error::Error;
use crate::executor::rules::shared::{Part, Shared};
use crate::executor::rules::{
    Failure, Literal, NetActions, Question, Rule, RuleRefusal, RuleState, Step,
};
use crate::executor::thread::Command;

/// Maximum length of a condition, bytes.
const CONDITION_BYTES: usize = 16 << 10;
/// Maximum number of rules kept; the oldest that no longer wait are dropped first.
const RULES_KEPT: usize = 4096;

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

/// A rule in the registry.
#[derive(Debug)]
pub(super) struct RuleEntry {
    pub(super) request: RuleRequest,
    /// Nets and keys in its condition.
    asked: Vec<(NetId, String)>,
    pub(super) state: RuleState,
    why: Option<String>,
    /// Its succession of nets.
    pub(super) succession: Succession,
    /// Set while answers of net threads are pending, then their result.
    adding: Option<Option<Result<(), Error>>>,
    /// Net threads that have not answered yet.
    unanswered: usize,
    /// Net threads in which it waits.
    waiting: usize,
    /// Its state in the others.
    outcome: RuleState,
}

/// Reason of a rule that lost a net before it reached the thread.
const CROSSED: &str = "it was started or taken away while the rule was installed";

impl Controller {
    /// Installs a synchronization rule. The nets that it starts become `Scheduled`, and their
    /// resources are reserved. It fires at most once, between two cycles.
    ///
    /// # Errors
    /// If the condition is invalid, a net is in the wrong state, or a resource cannot be
    /// reserved.
    pub fn schedule(&self, request: RuleRequest) -> Result<RuleId, Error> {
        let first = self.install(request.clone());
        let Err(Error::WrongState {
            state: NetState::Ready | NetState::Scheduled,
            what: CROSSED,
            ..
        }) = first
        else {
            return first;
        };
        // A net that an earlier rule released may still be in transfer: two cycles later it is here.
        let slowest = self.threads().iter().map(|thread| thread.period).max();
        std::thread::sleep(2 * slowest.unwrap_or_default());
        self.install(request)
    }

    fn install(&self, request: RuleRequest) -> Result<RuleId, Error> {
        let mut registry = self.inner.lock();
        let id = registry.install(request)?;
        self.inner.announce(&registry);
        self.inner
            .wait_for(registry, |registry| registry.installed(id))??;
        Ok(id)
    }

    /// A rule; `None` if it does not exist or was dropped.
    #[must_use]
    pub fn rule(&self, id: RuleId) -> Option<RuleInfo> {
        let registry = self.inner.lock();
        let entry = registry.rules.get(&id)?;
        Some(RuleInfo {
            id,
            request: entry.request.clone(),
            state: entry.state,
            why: entry.why.clone(),
        })
    }

    /// The rules in which a net occurs.
    #[must_use]
    pub fn rules_of(&self, net: NetId) -> Vec<RuleInfo> {
        let registry = self.inner.lock();
        let occurs = |entry: &&RuleEntry| {
            let RuleRequest {
                stop,
                cancel,
                start,
                ..
            } = &entry.request;
            let listed = stop.iter().chain(cancel).chain(start).any(|n| *n == net);
            listed || entry.asked.iter().any(|(asked, _)| *asked == net)
        };
        let entries = registry.rules.iter().filter(|(_, entry)| occurs(entry));
        let info = |(id, entry): (&RuleId, &RuleEntry)| RuleInfo {
            id: *id,
            request: entry.request.clone(),
            state: entry.state,
            why: entry.why.clone(),
        };
        entries.map(info).collect()
    }

    /// The states of all rules that are kept.
    #[must_use]
    pub fn rule_states(&self) -> Vec<RuleState> {
        let registry = self.inner.lock();
        registry.rules.values().map(|entry| entry.state).collect()
    }
}

impl Registry {
    pub(super) fn install(&mut self, mut request: RuleRequest) -> Result<RuleId, Error> {
        self.refuse_if_closing()?;
        self.refuse_if_stopped()?;
        if request.condition.len() > CONDITION_BYTES {
            let (what, bound) = ("bytes of a condition", CONDITION_BYTES);
            return Err(Error::TooMany { what, bound });
        }
        for nets in [&mut request.stop, &mut request.cancel] {
            nets.sort_unstable();
            nets.dedup();
        }
        let condition = Parser::parse(&request.condition)?;
        let mut literals = Vec::with_capacity(condition.literals.len());
        for (net, key) in &condition.literals {
            literals.push(self.literal(net, key)?);
        }
        self.check_nets(&request)?;
        let threads = self.threads_of(&request, &literals);
        let RuleRequest { stop, start, .. } = &request;
        let whole = Rule::new(
            0,
            literals.clone(),
            condition.steps.clone(),
            NetActions::default(),
        );
        let succession = Succession::of(&whole, stop, start, threads.len() == 1);
        self.keep_for_rule(&succession, start)?;
        let id = self.give_to_threads(&request, &literals, &condition.steps, &threads)?;
        let asked = condition.literals.into_iter();
        let asked = asked.filter_map(|(net, key)| Some((net.parse().ok()?, key)));
        let entry = RuleEntry {
            request,
            asked: asked.collect(),
            state: RuleState::Active,
            why: None,
            succession,
            adding: Some(None),
            unanswered: threads.len(),
            waiting: threads.len(),
            outcome: RuleState::Fired,
        };
        self.rules.insert(id, entry);
        self.forget_old_rules();
        Ok(id)
    }

    /// Sends a rule to the threads that it concerns, and the nets that it starts to theirs.
    fn give_to_threads(
        &mut self,
        request: &RuleRequest,
        literals: &[Literal],
        steps: &[Step],
        threads: &[usize],
    ) -> Result<RuleId, Error> {
        // The commands below must arrive, or a net would be lost.
        self.has_room(request.start.len() + 1)?;
        let id = self.next_rule();
        let starts = !request.start.is_empty();
        let requested = self.stop.switch().generation();
        let shared = (threads.len() > 1).then(|| Arc::new(self.share(threads, literals, starts)));
        for net in &request.start {
            if let Some(running) = self.net(*net)?.hand_to_rules(requested) {
                self.command(Command::Schedule(running))?;
            }
        }
        for (number, thread) in threads.iter().enumerate() {
            let of_thread = |nets: &[NetId]| -> Vec<u32> {
                let nets = nets.iter().map(|net| net.0);
                nets.filter(|net| self.thread_of(*net) == *thread).collect()
            };
            let orders = NetActions {
                stop: of_thread(&request.stop),
                cancel: of_thread(&request.cancel),
                start: of_thread(&request.start),
            };
            let mut rule = Box::new(Rule::new(id.0, literals.to_vec(), steps.to_vec(), orders));
            rule.requested = requested;
            rule.part = shared.clone().map(|shared| Part::new(shared, number));
            self.send(*thread, Command::AddRule(rule))
                .map_err(|_| busy())?;
        }
        Ok(id)
    }

    /// Checks that all nets of a rule are in the right state.
    fn check_nets(&mut self, request: &RuleRequest) -> Result<(), Error> {
        for id in request.stop.iter().chain(&request.cancel) {
            let state = self.net(*id)?.state();
            if matches!(
                state,
                NetState::Loading | NetState::Rejected | NetState::Unloaded
            ) {
                let what = "a rule can only stop or cancel a net that could run";
                return Err(Error::WrongState {
                    net: *id,
                    state,
                    what,
                });
            }
        }
        for id in &request.start {
            let net = self.net(*id)?;
            let state = net.state();
            let twice = request.start.iter().filter(|other| *other == id).count() > 1;
            if !matches!(state, NetState::Ready | NetState::Scheduled) || twice || net.is_to_start()
            {
                let what = "a rule can only start a net that is READY or SCHEDULED, and once";
                return Err(Error::WrongState {
                    net: *id,
                    state,
                    what,
                });
            }
        }
        Ok(())
    }

    /// The threads that a rule concerns. Literals with a final answer concern none.
    fn threads_of(&self, request: &RuleRequest, literals: &[Literal]) -> Vec<usize> {
        let RuleRequest {
            stop,
            cancel,
            start,
            ..
        } = request;
        let done_to = stop.iter().chain(cancel).chain(start).map(|net| net.0);
        let asked = literals.iter().filter(|l| !l.last).map(|l| l.net);
        let mut threads: Vec<_> = done_to.chain(asked).map(|n| self.thread_of(n)).collect();
        threads.sort_unstable();
        threads.dedup();
        if threads.is_empty() {
            threads.push(0);
        }
        threads
    }

    /// The shared part of a rule in several threads. The fastest thread with a literal decides.
    fn share(&self, threads: &[usize], literals: &[Literal], starts: bool) -> Shared {
        let part = |net: u32| threads.iter().position(|t| *t == self.thread_of(net));
        let owned = literals.iter().map(|literal| {
            let owner = part(literal.net).filter(|_| !literal.last);
            (*literal, owner)
        });
        let owned: Vec<_> = owned.collect();
        let period = |part: &usize| self.threads.get(threads[*part]).map(|t| t.period);
        let answering = owned.iter().filter_map(|(_, owner)| *owner);
        let decider = answering.min_by_key(period);
        let decider = decider.or_else(|| (0..threads.len()).min_by_key(period));
        Shared::new(&owned, threads.len(), decider.unwrap_or(0), starts)
    }

    fn forget_old_rules(&mut self) {
        while self.rules.len() > RULES_KEPT {
            let old = self
                .rules
                .iter()
                .find(|(_, entry)| entry.state != RuleState::Active);
            let Some(id) = old.map(|(id, _)| *id) else {
                return;
            };
            self.rules.remove(&id);
        }
    }

    /// The answer of the net thread to a new rule, once it is known.
    fn installed(&mut self, id: RuleId) -> Option<Result<(), Error>> {
        let entry = self.rules.get_mut(&id)?;
        match entry.adding.take() {
            Some(None) => {
                entry.adding = Some(None);
                None
            }
            Some(Some(outcome)) => Some(outcome),
            None => Some(Ok(())),
        }
    }

    fn literal(&mut self, name: &str, key: &str) -> Result<Literal, Error> {
        let unknown = |what: String| Error::Condition { what };
        let id: NetId = name
            .parse()
            .map_err(|_| unknown(format!("there is no net `{name}`")))?;
        let net = self
            .net(id)
            .map_err(|_| unknown(format!("there is no net `{name}`")))?;
        let state = net.state();
        let over = matches!(
            state,
            NetState::Terminated | NetState::Unloaded | NetState::Rejected
        );
        if key == "terminated" && state == NetState::Loading {
            return Err(unknown(format!(
                "{id} is still {state}; wait until it is READY"
            )));
        }
        if key == "terminated" {
            let value = over.then(|| net.ended_by_itself());
            return Ok(Literal {
                net: id.0,
                question: Question::Terminated,
                value,
                last: over,
            });
        }
        let Some(entry) = net.out_entry(key) else {
            return Err(unknown(format!("{id} has no value `{key}`")));
        };
        if entry.ty != Type::scalar(Element::Bool) || !entry.report {
            return Err(unknown(format!(
                "{id}.{key} is no Boolean value that the net reports"
            )));
        }
        let question = Question::Value(entry.at());
        let value = if over { net.out_bool(&entry) } else { None };
        Ok(Literal {
            net: id.0,
            question,
            value,
            last: over,
        })
    }

    /// Sends the final answers about an ended net: a rule that reached its thread after the end does not have them.
    pub(super) fn answer_rules(&mut self, ended: NetId) {
        let active = self.rules.values();
        let active = active.filter(|entry| entry.state == RuleState::Active);
        let asked = active.flat_map(|entry| &entry.asked);
        let asked: BTreeSet<_> = asked.filter(|(net, _)| *net == ended).cloned().collect();
        for (net, key) in asked {
            let Ok(literal) = self.literal(&net.to_string(), &key) else {
                continue;
            };
            if self.command(Command::Answer(literal)).is_err() {
                tracing::error!(%net, "the net thread takes no more requests");
            }
        }
    }

    /// A rule waits in one more thread.
    pub(super) fn rule_added(&mut self, id: u32) {
        let Some(entry) = self.rules.get_mut(&RuleId(id)) else {
            return;
        };
        entry.unanswered = entry.unanswered.saturating_sub(1);
        if entry.unanswered > 0 || !matches!(entry.adding, Some(None)) {
            return;
        }
        entry.adding = Some(Some(Ok(())));
        for net in entry.request.start.clone() {
            if let Some(net) = self.nets.get_mut(&net) {
                net.become_scheduled();
            }
        }
    }

    /// One thread rejected a rule: it waits in none.
    pub(super) fn rule_refused(&mut self, rule: &Rule, why: RuleRefusal) {
        let error = match why {
            RuleRefusal::TooMany => {
                let bound = crate::executor::rules::RULES_MAX;
                Error::TooMany {
                    what: "waiting rules",
                    bound,
                }
            }
            RuleRefusal::Halted => self.stopped(),
            RuleRefusal::TooLong => Error::TooMany {
                what: "literals, operations and nets of all waiting rules",
                bound: crate::executor::rules::WORK_MAX,
            },
            RuleRefusal::ResourceInUse(n) | RuleRefusal::ResourceTwice(n) => {
                Error::NotSchedulable {
                    resource: self.resource_name(n),
                }
            }
            RuleRefusal::NotWaiting(net) => {
                let net = NetId(net);
                let state = self.nets.get(&net).map_or(NetState::Unloaded, Net::state);
                let what = CROSSED;
                Error::WrongState { net, state, what }
            }
        };
        if let Some(entry) = self.rules.get_mut(&RuleId(rule.id)) {
            entry.unanswered = entry.unanswered.saturating_sub(1);
            entry.adding = Some(Some(Err(error)));
        }
        self.rule_over(rule, RuleState::Inactive);
    }

    /// A rule has finished waiting in one of its threads.
    pub(super) fn rule_done(&mut self, rule: &Rule) {
        self.rule_over(rule, rule.state);
    }

    fn rule_over(&mut self, rule: &Rule, state: RuleState) {
        if state != RuleState::Fired {
            self.release(rule);
        }
        let why = rule.failure.map(|failure| self.failure(failure));
        let Some(entry) = self.rules.get_mut(&RuleId(rule.id)) else {
            return;
        };
        entry.why = entry.why.take().or(why);
        entry.outcome = worse(entry.outcome, state);
        entry.waiting = entry.waiting.saturating_sub(1);
        if entry.waiting > 0 {
            return;
        }
        entry.state = entry.outcome;
        if entry.state == RuleState::FireFailed {
            let why = entry
                .why
                .as_deref()
                .unwrap_or("a net of another thread could not start");
            tracing::warn!(rule = rule.id, why, "rule could not start its nets");
        }
    }

    /// Why a rule did not start its nets, for users.
    fn failure(&self, failure: Failure) -> String {
        let device = |number: usize| {
            let device = self.devices.get(number);
            device.map_or_else(|| number.to_string(), |device| device.name.clone())
        };
        match failure {
            Failure::DeviceChanged(number) => format!(
                "device `{}` had a fault, an emergency stop or a position jump, or was enabled, after \
                 the net was scheduled; schedule it again",
                device(number)
            ),
            Failure::DeviceNotReady(number) => {
                format!("device `{}` does not follow commands", device(number))
            }
            Failure::ResourceInUse(number) => {
                format!("another net holds `{}`", self.resource_name(number))
            }
            Failure::NotWaiting(net) => format!("{} was started or taken away before", NetId(net)),
            Failure::TooMany => "too many nets run".to_owned(),
            Failure::Overload => {
                "all nets together would cost more in a cycle than nets may".to_owned()
            }
        }
    }

    /// Requests the nets of a rule back that no other waiting rule starts.
    fn release(&mut self, rule: &Rule) {
        for net in &rule.orders().start {
            if self
                .command(Command::Unschedule {
                    net: *net,
                    always: false,
                })
                .is_err()
            {
                tracing::error!(net, "the net thread takes no more requests");
            }
        }
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
