//! Installing synchronization rules: their nets are checked, cycle time is reserved, each thread gets its part, and the
//! threads' answers are applied. The threads fire the rules.

use std::sync::Arc;

use takt_net::{Element, Type};

use crate::controller::Controller;
use crate::controller::admission::forest::Succession;
use crate::controller::nets::{Change, HandOver, Net, Nets};
use crate::controller::registry::Registry;
use crate::controller::rules::condition::Parser;
use crate::controller::rules::{RuleId, RuleInfo, RuleRequest};
use crate::error::Error;
use crate::executor::rules::shared::{Part, Shared};
use crate::executor::rules::{
    Failure, Gate, Literal, NetActions, Question, RULES_MAX, Rule, RuleError, RuleState, Step,
    WORK_MAX,
};
use crate::executor::thread::Command;
use crate::ids::{NetId, NetState};

/// Maximum length of a condition, bytes.
const CONDITION_BYTES: usize = 16 << 10;
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
        self.schedule_behind(&request, None)
    }

    /// As [`Self::schedule`], with a gate that opens later.
    pub(super) fn schedule_behind(
        &self,
        request: &RuleRequest,
        gate: Option<&Arc<Gate>>,
    ) -> Result<RuleId, Error> {
        let first = self.install(request.clone(), gate);
        let Err(Error::WrongState {
            state: NetState::Ready | NetState::Scheduled,
            hint: CROSSED,
            ..
        }) = first
        else {
            return first;
        };
        // A net that an earlier rule released may still be in transfer: two cycles later it is here.
        let slowest = self.inner.lock().threads.slowest();
        std::thread::sleep(2 * slowest);
        self.install(request.clone(), gate)
    }

    fn install(&self, request: RuleRequest, gate: Option<&Arc<Gate>>) -> Result<RuleId, Error> {
        let mut registry = self.inner.lock();
        let id = registry.install(request, gate)?;
        self.inner.announce(&registry);
        self.inner
            .wait_for(registry, |registry| registry.rules.installed(id))??;
        Ok(id)
    }

    /// A rule; `None` if it does not exist or was dropped.
    #[must_use]
    pub fn rule(&self, id: RuleId) -> Option<RuleInfo> {
        self.inner.lock().rules.info(id)
    }

    /// The state of a rule. The final state is kept for the latest 262,144 rules, much longer than the rules themselves;
    /// `None` if there was no such rule.
    #[must_use]
    pub fn rule_state(&self, id: RuleId) -> Option<RuleState> {
        self.inner.lock().rules.state(id)
    }

    /// The rules in which a net occurs.
    #[must_use]
    pub fn rules_of(&self, net: NetId) -> Vec<RuleInfo> {
        self.inner.lock().rules.naming(net)
    }

    /// The states of all rules that are kept.
    #[must_use]
    pub fn rule_states(&self) -> Vec<RuleState> {
        self.inner.lock().rules.states()
    }
}

impl Registry {
    pub(super) fn install(
        &mut self,
        mut request: RuleRequest,
        gate: Option<&Arc<Gate>>,
    ) -> Result<RuleId, Error> {
        self.permission.check_start()?;
        if request.condition.len() > CONDITION_BYTES {
            let (item, bound) = ("bytes of a condition", CONDITION_BYTES);
            return Err(Error::TooMany { item, bound });
        }
        for nets in [&mut request.stop, &mut request.cancel] {
            nets.sort_unstable();
            nets.dedup();
        }
        let condition = Parser::parse(&request.condition)?;
        let mut literals = Vec::with_capacity(condition.literals.len());
        for (net, key) in &condition.literals {
            literals.push(literal(&mut self.nets, net, key)?);
        }
        self.check_nets(&request)?;
        let threads = self.threads_of(&request, &literals);
        let (steps, actions) = (condition.steps.clone(), NetActions::default());
        let whole = Rule::new(0, literals.clone(), steps, actions);
        let RuleRequest { stop, start, .. } = &request;
        let succession = Succession::of(&whole, stop, start, threads.len() == 1);
        let budget = |thread| self.threads.budget(thread);
        let waiting = &self.rules;
        self.admission
            .check_rule(&self.nets, waiting, budget, &succession, start)?;
        let condition_of = (&literals[..], &condition.steps[..]);
        let id = self.give_to_threads(&request, condition_of, &threads, gate)?;
        let asked = condition.literals.into_iter();
        let asked = asked.filter_map(|(net, key)| Some((net.parse().ok()?, key)));
        let asked = asked.collect();
        self.rules
            .add(id, request, asked, succession, threads.len());
        Ok(id)
    }

    /// Sends a rule to the threads that it concerns, and the nets that it starts to theirs.
    fn give_to_threads(
        &mut self,
        request: &RuleRequest,
        (literals, steps): (&[Literal], &[Step]),
        threads: &[usize],
        gate: Option<&Arc<Gate>>,
    ) -> Result<RuleId, Error> {
        // The commands below must arrive, or a net would be lost.
        self.threads.check_capacity(request.start.len() + 1)?;
        let id = self.rules.next_id();
        let starts = !request.start.is_empty();
        let requested = self.permission.generation();
        let shared = (threads.len() > 1).then(|| Arc::new(self.share(threads, literals, starts)));
        for net in &request.start {
            if let Some(HandOver::Schedule(mut running)) =
                self.nets.change(*net, Change::HandToRules)
            {
                running.requested = requested;
                self.command(Command::Schedule(running))?;
            }
        }
        for (number, thread) in threads.iter().enumerate() {
            let of_thread = |nets: &[NetId]| -> Vec<u32> {
                let nets = nets.iter().map(|net| net.0);
                nets.filter(|net| self.nets.thread_of(*net) == *thread)
                    .collect()
            };
            let orders = NetActions {
                stop: of_thread(&request.stop),
                cancel: of_thread(&request.cancel),
                start: of_thread(&request.start),
            };
            let mut rule = Box::new(Rule::new(id.0, literals.to_vec(), steps.to_vec(), orders));
            rule.requested = requested;
            rule.gate = gate.cloned();
            rule.part = shared.clone().map(|shared| Part::new(shared, number));
            self.threads.send(*thread, Command::AddRule(rule))?;
        }
        Ok(id)
    }

    /// Checks that all nets of a rule are in the right state.
    fn check_nets(&mut self, request: &RuleRequest) -> Result<(), Error> {
        for id in request.stop.iter().chain(&request.cancel) {
            let state = self.nets.find(*id)?.state();
            if matches!(
                state,
                NetState::Loading | NetState::Rejected | NetState::Unloaded
            ) {
                let hint = "a rule can only stop or cancel a net that could run";
                return Err(Error::WrongState {
                    net: *id,
                    state,
                    hint,
                });
            }
        }
        for id in &request.start {
            let net = self.nets.find(*id)?;
            net.check_free(*id)?;
            let state = net.state();
            let twice = request.start.iter().filter(|other| *other == id).count() > 1;
            if !matches!(state, NetState::Ready | NetState::Scheduled) || twice || net.is_starting()
            {
                let hint = "a rule can only start a net that is READY or SCHEDULED, and once";
                return Err(Error::WrongState {
                    net: *id,
                    state,
                    hint,
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
        let mut threads: Vec<_> = done_to
            .chain(asked)
            .map(|n| self.nets.thread_of(n))
            .collect();
        threads.sort_unstable();
        threads.dedup();
        if threads.is_empty() {
            threads.push(0);
        }
        threads
    }

    /// The shared part of a rule in several threads. The fastest thread with a literal decides.
    fn share(&self, threads: &[usize], literals: &[Literal], starts: bool) -> Shared {
        let part = |net: u32| threads.iter().position(|t| *t == self.nets.thread_of(net));
        let owned = literals.iter().map(|literal| {
            let owner = part(literal.net).filter(|_| !literal.last);
            (*literal, owner)
        });
        let owned: Vec<_> = owned.collect();
        let period = |part: &usize| self.threads.period(threads[*part]);
        let answering = owned.iter().filter_map(|(_, owner)| *owner);
        let decider = answering.min_by_key(period);
        let decider = decider.or_else(|| (0..threads.len()).min_by_key(period));
        Shared::new(&owned, threads.len(), decider.unwrap_or(0), starts)
    }

    /// Sends the final answers about an ended net: a rule that reached its thread after the end does not have them.
    pub(super) fn answer_rules(&mut self, ended: NetId) {
        for key in self.rules.asked_of(ended) {
            let Ok(literal) = literal(&mut self.nets, &ended.to_string(), &key) else {
                continue;
            };
            if self.command(Command::Answer(literal)).is_err() {
                tracing::error!(net = %ended, "the net thread takes no more requests");
            }
        }
    }

    /// A rule waits in one more thread.
    pub(super) fn rule_added(&mut self, id: u32) {
        for net in self.rules.accepted(RuleId(id)) {
            self.nets.change(net, Change::Schedule);
        }
    }

    /// One thread rejected a rule: it waits in none.
    pub(super) fn rule_rejected(&mut self, rule: &Rule, why: RuleError) {
        let error = match why {
            RuleError::TooMany => Error::TooMany {
                item: "waiting rules",
                bound: RULES_MAX,
            },
            RuleError::Halted => self.permission.stopped(),
            RuleError::TooLong => Error::TooMany {
                item: "literals, operations and nets of all waiting rules",
                bound: WORK_MAX,
            },
            RuleError::ResourceInUse(n) => {
                let orders = rule.orders();
                let own = orders.start.iter().chain(&orders.stop);
                let own: Vec<_> = own.copied().map(NetId).collect();
                Error::NotSchedulable {
                    resource: self.nets.resource_name(n),
                    holder: self.nets.holder_text(n, &own),
                }
            }
            RuleError::ResourceTwice(n) => Error::NeededTwice {
                resource: self.nets.resource_name(n),
            },
            RuleError::NotWaiting(net) => {
                let net = NetId(net);
                let state = self.nets.get(net).map_or(NetState::Unloaded, Net::state);
                let hint = CROSSED;
                Error::WrongState { net, state, hint }
            }
        };
        self.rules.rejected(RuleId(rule.id), error);
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
        let why = rule.failure.map(|failure| self.failure(failure, rule));
        if let Some(why) = self.rules.ended(RuleId(rule.id), state, why) {
            tracing::warn!(rule = rule.id, why, "rule could not start its nets");
        }
    }

    /// Why a rule did not start its nets, for users.
    fn failure(&self, failure: Failure, rule: &Rule) -> String {
        let device = |number: usize| {
            let device = self.devices.table.get(number);
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
                let started: Vec<_> = rule.orders().start.iter().copied().map(NetId).collect();
                let holder = self.nets.holder_text(number, &started);
                format!("{holder} holds {}", self.nets.resource_name(number))
            }
            Failure::NotWaiting(net) => format!("{} was started or taken away before", NetId(net)),
            Failure::TooMany => "too many nets run".to_owned(),
            Failure::Late => {
                "the host stalled: the net thread missed the cycle in which the nets were to begin"
                    .to_owned()
            }
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

/// A literal of a condition, with the answer that is known already.
fn literal(nets: &mut Nets, name: &str, key: &str) -> Result<Literal, Error> {
    let unknown = |why: String| Error::Condition { why };
    let id: NetId = name
        .parse()
        .map_err(|_| unknown(format!("there is no net `{name}`")))?;
    let net = nets
        .find(id)
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
