//! Synchronization rules: when a condition over values of nets becomes true, nets are stopped,
//! cancelled and started between two cycles, all at once. It evaluates no net and does not parse
//! text: conditions are compiled before. If the nets of a rule are in several threads, each thread has a
//! part, and the parts exchange their state through [`shared`].
//!
//! The cost of a cycle is bounded by the work of the rules, [`WORK_MAX`], not by its product with the number of
//! nets: each net that a rule names has a slot in the net table for constant-time lookup.

mod fire;
mod keep;
mod net_table;
pub mod shared;

use crate::executor::{ResourceSet, Running};
use crate::stop_channel::Generation;
use fire::answer;
use net_table::{NetTable, Slot};
use shared::{Decision, Part};

/// Maximum number of waiting rules of one thread.
pub const RULES_MAX: usize = 1024;
/// Maximum work of all waiting rules of one thread per cycle: literals, operations, and
/// nets that they stop, cancel and start. Of a rule in several threads, literals count in each.
pub const WORK_MAX: usize = 8192;
/// Maximum number of scheduled nets.
pub const SCHEDULED_MAX: usize = 1024;
/// Maximum number of Boolean operations of one condition.
pub const CONDITION_MAX: usize = 256;

/// A step of a condition, for a stack machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Push this truth value.
    Constant(bool),
    /// Push the value of the literal of that number.
    Literal(usize),
    /// Replace the top by its negation.
    Not,
    /// Replace the two on top by their conjunction.
    And,
    /// Replace the two on top by their disjunction.
    Or,
}

/// The property of a net that a literal tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// The Boolean out value that lies at this word of the out-box.
    Value(usize),
    /// Whether the net has ended by itself.
    Terminated,
}

/// A literal of a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Literal {
    /// The net it is about.
    pub net: u32,
    /// The tested property.
    pub question: Question,
    /// The answer; `None` is unknown.
    pub value: Option<bool>,
    /// Whether the answer can never change again.
    pub last: bool,
}

/// State of a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuleState {
    /// It waits for its condition.
    Active,
    /// Its condition became true and its actions were executed.
    Fired,
    /// Its condition became true, but a net could not be started; nothing was done.
    FireFailed,
    /// Its condition can never become true any more.
    Inactive,
}

/// Why a rule whose condition became true, or could become so, did not start its nets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// This device had a fault, an emergency stop or a position jump, or was enabled, after the net was scheduled.
    DeviceChanged(usize),
    /// This device does not follow commands.
    DeviceNotReady(usize),
    /// Another running net holds this resource.
    ResourceInUse(usize),
    /// This net no longer waits for the rule.
    NotWaiting(u32),
    /// Too many nets run.
    TooMany,
    /// All nets together would exceed the budget of a cycle.
    Overload,
}

/// Actions of a rule on nets of one thread.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NetActions {
    /// Nets that it ends.
    pub stop: Vec<u32>,
    /// Nets that it asks to cancel.
    pub cancel: Vec<u32>,
    /// Nets that it starts, in this order.
    pub start: Vec<u32>,
}

/// A synchronization rule.
#[derive(Debug)]
pub struct Rule {
    /// Its number.
    pub id: u32,
    /// The condition's literals.
    literals: Vec<Literal>,
    /// The condition.
    steps: Vec<Step>,
    /// Its actions in this thread.
    orders: NetActions,
    /// Shared state with its parts in other threads; `None` if it has a single part.
    pub part: Option<Part>,
    /// Stop generation under which it was requested.
    pub requested: Generation,
    /// Its state.
    pub state: RuleState,
    /// Why it failed, if the cause is in this thread.
    pub failure: Option<Failure>,
    /// Resources reserved for the nets that it starts.
    reserved: ResourceSet,
    /// The slots of the nets it names, while it waits: of literals, then of nets to stop, cancel, start.
    slots: Box<[Slot]>,
    /// Whether a literal changed since the condition was evaluated.
    changed: bool,
}

/// Three-valued truth (Kleene): whether a term is true, and whether it is false. Neither is "unknown"; both is
/// "can become either".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Truth {
    yes: bool,
    no: bool,
}

impl Truth {
    /// The present or possible values of a literal.
    fn ever(literal: &Literal) -> Self {
        if literal.last {
            return literal.value.into();
        }
        Self {
            yes: true,
            no: true,
        }
    }
}

impl From<Option<bool>> for Truth {
    fn from(value: Option<bool>) -> Self {
        Self {
            yes: value == Some(true),
            no: value == Some(false),
        }
    }
}

impl Rule {
    /// A waiting rule.
    #[must_use]
    pub fn new(id: u32, literals: Vec<Literal>, steps: Vec<Step>, mut orders: NetActions) -> Self {
        for nets in [&mut orders.stop, &mut orders.cancel] {
            nets.sort_unstable();
            nets.dedup();
        }
        let NetActions {
            stop,
            cancel,
            start,
        } = &orders;
        let named = literals.len() + stop.len() + cancel.len() + start.len();
        Self {
            id,
            literals,
            steps,
            orders,
            part: None,
            requested: Generation::default(),
            state: RuleState::Active,
            failure: None,
            reserved: ResourceSet::default(),
            slots: vec![0; named].into_boxed_slice(),
            changed: true,
        }
    }

    /// Its actions in this thread.
    #[must_use]
    pub const fn orders(&self) -> &NetActions {
        &self.orders
    }

    /// The nets it names, in the order of its slots.
    fn names(&self) -> impl Iterator<Item = u32> {
        let NetActions {
            stop,
            cancel,
            start,
        } = &self.orders;
        let asked = self.literals.iter().map(|literal| literal.net);
        asked.chain(stop.iter().chain(cancel).chain(start).copied())
    }

    /// Slots of the nets from which it hands over: it waits for them or stops them.
    fn followed(&self) -> &[Slot] {
        self.slots_between(0, self.literals.len() + self.orders.stop.len())
    }

    fn stopped(&self) -> &[Slot] {
        self.slots_between(self.literals.len(), self.orders.stop.len())
    }

    fn cancelled(&self) -> &[Slot] {
        let first = self.literals.len() + self.orders.stop.len();
        self.slots_between(first, self.orders.cancel.len())
    }

    fn started(&self) -> &[Slot] {
        let count = self.orders.start.len();
        self.slots_between(self.slots.len().saturating_sub(count), count)
    }

    fn slots_between(&self, first: usize, count: usize) -> &[Slot] {
        self.slots.get(first..first + count).unwrap_or_default()
    }

    /// The truth of the condition with literals as `answer` says; unknown if it is malformed.
    fn evaluate(&self, answer: impl Fn(&Literal) -> Truth) -> Truth {
        let mut stack = [Truth::default(); CONDITION_MAX];
        let mut top = 0_usize;
        for step in &self.steps {
            let operands = match step {
                Step::Constant(_) | Step::Literal(_) => 0,
                Step::Not => 1,
                Step::And | Step::Or => 2,
            };
            let Some(base) = top.checked_sub(operands) else {
                return Truth::default();
            };
            let Some([a, b]) = stack.get_mut(base..base + 2) else {
                return Truth::default();
            };
            *a = match step {
                Step::Constant(value) => Some(*value).into(),
                Step::Literal(number) => {
                    self.literals.get(*number).map(&answer).unwrap_or_default()
                }
                Step::Not => Truth {
                    yes: a.no,
                    no: a.yes,
                },
                Step::And => Truth {
                    yes: a.yes && b.yes,
                    no: a.no || b.no,
                },
                Step::Or => Truth {
                    yes: a.yes || b.yes,
                    no: a.no && b.no,
                },
            };
            top = base + 1;
        }
        stack[0]
    }

    /// Whether the condition is true now.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.evaluate(|literal| literal.value.into()).yes
    }

    /// Whether the condition may still become true.
    #[must_use]
    pub fn can_hold(&self) -> bool {
        self.evaluate(Truth::ever).yes
    }

    /// Values without which the condition cannot become true any more, by net and question.
    #[must_use]
    pub fn needs(&self) -> Vec<((u32, Question), bool)> {
        let open = self.literals.iter().filter(|literal| !literal.last);
        let asked = open.map(|literal| (literal.net, literal.question));
        let both = asked.flat_map(|asked| [(asked, true), (asked, false)]);
        let is_needed = |(asked, value): &((u32, Question), bool)| {
            let otherwise = |literal: &Literal| {
                if (literal.net, literal.question) == *asked {
                    Some(!value).into()
                } else {
                    Truth::ever(literal)
                }
            };
            !self.evaluate(otherwise).yes
        };
        both.filter(is_needed).collect()
    }

    /// Whether it fires now.
    fn is_due(&self) -> bool {
        match &self.part {
            Some(part) => part.shared().decision() == Decision::Fire,
            None => self.changed && self.holds(),
        }
    }

    /// Deactivates the rule in all threads without firing; returns the state of this part.
    pub(super) fn give_up(&self) -> RuleState {
        let decided = self
            .part
            .as_ref()
            .map(|p| p.shared().decide(Decision::Never));
        // Other parts may already have the decision to fire; this one cannot.
        match decided {
            None | Some(Decision::Never) => RuleState::Inactive,
            Some(Decision::Open | Decision::Fire | Decision::Fail) => RuleState::FireFailed,
        }
    }

    /// Whether it starts a net in any thread.
    fn starts_any(&self) -> bool {
        !self.orders.start.is_empty() || self.part.as_ref().is_some_and(Part::starts)
    }

    /// Its work per cycle.
    fn work(&self) -> usize {
        let parts = self.part.as_ref().map_or(1, Part::count);
        let nets = self.slots.len() - self.literals.len();
        self.literals.len() * parts + self.steps.len() + nets
    }
}

/// Why a rule was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuleRefusal {
    /// Too many rules wait.
    TooMany,
    /// The work of the waiting rules would exceed [`WORK_MAX`].
    TooLong,
    /// A net that it starts needs this resource, which is held by a net that it does not follow or
    /// kept for another rule.
    ResourceInUse(usize),
    /// Two nets that it starts need this resource.
    ResourceTwice(usize),
    /// A net that it starts, by its number, is no longer scheduled.
    NotWaiting(u32),
    /// The controller is stopped, or was stopped after the request.
    Halted,
}

/// A rule that no thread accepts: its parts in other threads become inactive.
#[must_use]
pub fn refused(mut rule: Box<Rule>) -> Box<Rule> {
    rule.state = rule.give_up();
    rule
}

/// Rules and scheduled nets of an executor.
#[expect(
    clippy::vec_box,
    reason = "they move in and out as boxes; a cycle neither allocates nor frees any"
)]
#[derive(Debug)]
pub(super) struct Rules {
    waiting: Vec<Box<Rule>>,
    /// Scheduled nets.
    scheduled: Vec<Box<Running>>,
    /// The nets that the waiting rules name.
    nets_named: NetTable,
    /// Total work of `waiting`.
    work: usize,
    /// Number of rules in `waiting` that no longer wait.
    over: usize,
}

impl Rules {
    pub(super) fn new() -> Self {
        Self {
            waiting: Vec::with_capacity(RULES_MAX),
            scheduled: Vec::with_capacity(SCHEDULED_MAX),
            nets_named: NetTable::default(),
            work: 0,
            over: 0,
        }
    }

    /// Work per cycle.
    pub(super) const fn work(&self) -> usize {
        self.work
    }

    /// Index of a slot's net in `running`.
    fn running_at(&self, slot: Slot, running: &[Box<Running>]) -> Option<usize> {
        let (id, at) = self.nets_named.running(slot);
        running.get(at).filter(|net| net.id == id).map(|_| at)
    }

    /// Index of a slot's net in `scheduled`.
    fn scheduled_at(&self, slot: Slot) -> Option<usize> {
        let (id, at) = self.nets_named.scheduled(slot);
        let net = self.scheduled.get(at).filter(|net| net.id == id);
        net.map(|_| at)
    }

    /// Updates the positions of nets that rules name.
    fn seat(&mut self, running: &[Box<Running>]) {
        for (at, net) in running.iter().enumerate() {
            self.nets_named.set_running_index(net.id, at);
        }
        for (at, net) in self.scheduled.iter().enumerate() {
            self.nets_named.set_scheduled_index(net.id, at);
        }
    }

    /// Whether a rule in several threads may still start a net here in place of this one.
    pub(super) fn may_still_succeed(&self, id: u32) -> bool {
        let Some(slot) = self.nets_named.find(id) else {
            return false;
        };
        self.waiting.iter().any(|rule| {
            rule.state == RuleState::Active
                && rule.part.is_some()
                && !rule.orders.start.is_empty()
                && rule.followed().contains(&slot)
        })
    }

    /// Removes a scheduled net.
    fn clear_scheduled_index(&mut self, at: usize) -> Box<Running> {
        let net = self.scheduled.swap_remove(at);
        if let Some(moved) = self.scheduled.get(at) {
            self.nets_named.set_scheduled_index(moved.id, at);
        }
        net
    }

    /// Deactivates all rules in all threads.
    pub(super) fn halt(&mut self) {
        for at in 0..self.waiting.len() {
            if self.waiting[at].state == RuleState::Active {
                self.waiting[at].give_up();
                self.retire(at, RuleState::FireFailed);
            }
        }
    }

    /// Deactivates a rule.
    fn retire(&mut self, at: usize, state: RuleState) {
        let rule = &mut self.waiting[at];
        if rule.state != RuleState::Active {
            return;
        }
        rule.state = state;
        self.over += 1;
        if rule.starts_any() {
            let followed = rule.followed().iter();
            followed.for_each(|slot| self.nets_named.follow(*slot, false));
        }
    }
}

#[cfg(test)]
mod tests;
