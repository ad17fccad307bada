//! A synchronization rule: its condition, its actions in one thread, and its state. Which rules wait and when they
//! fire is decided by the executor.

use std::sync::Arc;

use super::gate::Gate;
use super::limits::CONDITION_MAX;
use super::literal::{Literal, Question, Step};
use super::net_table::Slot;
use super::shared::{Decision, Part};
use crate::executor::resources::ResourceSet;
use crate::stop_channel::Generation;

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
    /// The thread missed the cycle in which the nets were to begin.
    Late,
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
    pub(super) literals: Vec<Literal>,
    /// The condition.
    steps: Vec<Step>,
    /// Its actions in this thread.
    pub(super) orders: NetActions,
    /// Shared state with its parts in other threads; `None` if it has a single part.
    pub part: Option<Part>,
    /// Its nets begin when this is due; `None` if they begin when the condition holds. Not with parts in other threads.
    pub gate: Option<Arc<Gate>>,
    /// Stop generation under which it was requested.
    pub requested: Generation,
    /// Its state.
    pub state: RuleState,
    /// Why it failed, if the cause is in this thread.
    pub failure: Option<Failure>,
    /// Resources reserved for the nets that it starts.
    pub(super) reserved: ResourceSet,
    /// The slots of the nets it names, while it waits: of literals, then of nets to stop, cancel, start.
    pub(super) slots: Box<[Slot]>,
    /// Whether a literal changed since the condition was evaluated.
    pub(super) changed: bool,
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
            gate: None,
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
    pub(super) fn names(&self) -> impl Iterator<Item = u32> {
        let NetActions {
            stop,
            cancel,
            start,
        } = &self.orders;
        let asked = self.literals.iter().map(|literal| literal.net);
        asked.chain(stop.iter().chain(cancel).chain(start).copied())
    }

    /// Slots of the nets from which it hands over: it waits for them or stops them.
    pub(super) fn followed(&self) -> &[Slot] {
        self.slots_between(0, self.literals.len() + self.orders.stop.len())
    }

    pub(super) fn stopped(&self) -> &[Slot] {
        self.slots_between(self.literals.len(), self.orders.stop.len())
    }

    pub(super) fn cancelled(&self) -> &[Slot] {
        let first = self.literals.len() + self.orders.stop.len();
        self.slots_between(first, self.orders.cancel.len())
    }

    pub(super) fn started(&self) -> &[Slot] {
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

    /// Whether it fires now, unless it has a gate.
    pub(super) fn is_due(&self) -> bool {
        if self.gate.is_some() {
            return false;
        }
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
    pub(super) fn starts_any(&self) -> bool {
        !self.orders.start.is_empty() || self.part.as_ref().is_some_and(Part::starts)
    }

    /// Its work per cycle.
    pub(super) fn work(&self) -> usize {
        let parts = self.part.as_ref().map_or(1, Part::count);
        let nets = self.slots.len() - self.literals.len();
        self.literals.len() * parts + self.steps.len() + nets
    }
}

/// Why a rule was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuleError {
    /// Too many rules wait.
    TooMany,
    /// The work of the waiting rules would exceed [`WORK_MAX`](super::WORK_MAX).
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
pub fn rejected(mut rule: Box<Rule>) -> Box<Rule> {
    rule.state = rule.give_up();
    rule
}
