//! Synchronization rules: when a condition over values of nets becomes true, nets are stopped,
//! cancelled and started between two cycles, all at once. It evaluates nothing itself and knows
//! no text: conditions come here compiled. Of a rule whose nets are in several threads each has a
//! part, and [`shared`] is between them.
//!
//! What a cycle costs is bounded by what rules name, [`WORK_MAX`], and not by that times the number of
//! nets: each net that a rule names has a slot on the roll, by which it is found at once.

mod fire;
mod keep;
mod roll;
pub mod shared;

use crate::executor::{ResourceSet, Running};
use crate::stop_channel::Generation;
use fire::answer;
use roll::{Roll, Slot};
use shared::{Decision, Part};

/// Most rules that wait at once in one thread.
pub const RULES_MAX: usize = 1024;
/// Most that the waiting rules of one thread look at in a cycle, all together: literals, operations, and
/// nets that they stop, cancel and start. Of a rule in several threads, literals count in each.
pub const WORK_MAX: usize = 8192;
/// Most nets that wait for rules to start them.
pub const SCHEDULED_MAX: usize = 1024;
/// Most Boolean operations of one condition.
pub const CONDITION_MAX: usize = 256;

/// A step of a condition, for a stack machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Push this truth.
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

/// What a literal of a condition asks of a net.
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
    /// What it asks.
    pub question: Question,
    /// The answer; `None` is unknown.
    pub value: Option<bool>,
    /// Whether the answer can never change again.
    pub last: bool,
}

/// What became of a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuleState {
    /// It waits for its condition.
    Active,
    /// Its condition became true and it did what it says.
    Fired,
    /// Its condition became true, but a net could not be started; nothing was done.
    FireFailed,
    /// Its condition can never become true any more.
    Inactive,
}

/// Why a rule whose condition became true, or could become so, did not start its nets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// This device had a fault or an emergency stop, or began to follow commands, after the net was scheduled.
    DeviceChanged(usize),
    /// This device does not follow commands.
    DeviceNotReady(usize),
    /// Another running net holds this resource.
    ResourceInUse(usize),
    /// This net does not wait for it any more.
    NotWaiting(u32),
    /// Too many nets run.
    TooMany,
    /// All nets together would cost more in a cycle than nets may.
    Overload,
}

/// What a rule does to nets of one thread.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Orders {
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
    /// What it does in this thread.
    orders: Orders,
    /// What joins it to its parts in other threads; `None` if it is whole.
    pub part: Option<Part>,
    /// Under which stop of the controller it was requested.
    pub requested: Generation,
    /// What became of it.
    pub state: RuleState,
    /// Why it failed, if the reason lies in this thread.
    pub failure: Option<Failure>,
    /// What the nets that it starts need: kept for them.
    reserved: ResourceSet,
    /// The slots of the nets it names, while it waits: of literals, then of nets to stop, cancel, start.
    slots: Box<[Slot]>,
    /// Whether a literal changed since the condition was evaluated.
    changed: bool,
}

/// Whether something is true, and whether it is false. Neither is "unknown" (Kleene); both is
/// "can become either".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Truth {
    yes: bool,
    no: bool,
}

impl Truth {
    /// What a literal is or may become.
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
    /// A rule that waits.
    #[must_use]
    pub fn new(id: u32, literals: Vec<Literal>, steps: Vec<Step>, mut orders: Orders) -> Self {
        for nets in [&mut orders.stop, &mut orders.cancel] {
            nets.sort_unstable();
            nets.dedup();
        }
        let Orders {
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

    /// What it does in this thread.
    #[must_use]
    pub const fn orders(&self) -> &Orders {
        &self.orders
    }

    /// The nets it names, in the order of its slots.
    fn names(&self) -> impl Iterator<Item = u32> {
        let Orders {
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

    /// Whether it is to fire now.
    fn is_due(&self) -> bool {
        match &self.part {
            Some(part) => part.shared().decision() == Decision::Fire,
            None => self.changed && self.holds(),
        }
    }

    /// Ends the wait for good without firing, in all threads; says what becomes of this part.
    pub(super) fn give_up(&self) -> RuleState {
        let decided = self
            .part
            .as_ref()
            .map(|p| p.shared().decide(Decision::Never));
        // Other parts may have been told to fire already; this one cannot.
        match decided {
            None | Some(Decision::Never) => RuleState::Inactive,
            Some(Decision::Open | Decision::Fire | Decision::Fail) => RuleState::FireFailed,
        }
    }

    /// Whether it starts a net, be it in another thread.
    fn starts_any(&self) -> bool {
        !self.orders.start.is_empty() || self.part.as_ref().is_some_and(Part::starts)
    }

    /// How much of it is looked at in a cycle.
    fn work(&self) -> usize {
        let parts = self.part.as_ref().map_or(1, Part::count);
        let nets = self.slots.len() - self.literals.len();
        self.literals.len() * parts + self.steps.len() + nets
    }
}

/// Why a rule was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RuleRefusal {
    /// Too many rules wait.
    TooMany,
    /// The waiting rules would look at more than [`WORK_MAX`] things in a cycle.
    TooLong,
    /// A net that it starts needs this resource, which is held by a net that it does not follow or
    /// kept for another rule.
    ResourceInUse(usize),
    /// Two nets that it starts need this resource.
    ResourceTwice(usize),
    /// A net that it starts, by its number, does not wait for that any more.
    NotWaiting(u32),
    /// The controller is stopped, or was after the rule was requested.
    Halted,
}

/// A rule that no thread takes: its parts in others do nothing any more.
#[must_use]
pub fn refused(mut rule: Box<Rule>) -> Box<Rule> {
    rule.state = rule.give_up();
    rule
}

/// What the executor knows of rules.
#[expect(
    clippy::vec_box,
    reason = "they come and go as boxes; a cycle neither makes nor frees any"
)]
#[derive(Debug)]
pub(super) struct Rules {
    waiting: Vec<Box<Rule>>,
    /// Nets that rules start, until they do.
    scheduled: Vec<Box<Running>>,
    /// The nets that `waiting` name.
    roll: Roll,
    /// The work of all that are in `waiting`.
    work: usize,
    /// How many in `waiting` do not wait any more.
    over: usize,
}

impl Rules {
    pub(super) fn new() -> Self {
        Self {
            waiting: Vec::with_capacity(RULES_MAX),
            scheduled: Vec::with_capacity(SCHEDULED_MAX),
            roll: Roll::default(),
            work: 0,
            over: 0,
        }
    }

    /// How much is looked at in a cycle.
    pub(super) const fn work(&self) -> usize {
        self.work
    }

    /// Where a net of that slot is in `running`, if it is.
    fn running_at(&self, slot: Slot, running: &[Box<Running>]) -> Option<usize> {
        let (id, at) = self.roll.running(slot);
        running.get(at).filter(|net| net.id == id).map(|_| at)
    }

    /// Where a net of that slot is in `scheduled`, if it is.
    fn scheduled_at(&self, slot: Slot) -> Option<usize> {
        let (id, at) = self.roll.scheduled(slot);
        let net = self.scheduled.get(at).filter(|net| net.id == id);
        net.map(|_| at)
    }

    /// Notes where the nets are that rules name.
    fn seat(&mut self, running: &[Box<Running>]) {
        for (at, net) in running.iter().enumerate() {
            self.roll.seat_running(net.id, at);
        }
        for (at, net) in self.scheduled.iter().enumerate() {
            self.roll.seat_scheduled(net.id, at);
        }
    }

    /// Whether a rule that is decided in several threads may still start a net here in place of this one.
    pub(super) fn may_still_succeed(&self, id: u32) -> bool {
        let Some(slot) = self.roll.find(id) else {
            return false;
        };
        self.waiting.iter().any(|rule| {
            rule.state == RuleState::Active
                && rule.part.is_some()
                && !rule.orders.start.is_empty()
                && rule.followed().contains(&slot)
        })
    }

    /// Takes a scheduled net out of its place.
    fn unseat_scheduled(&mut self, at: usize) -> Box<Running> {
        let net = self.scheduled.swap_remove(at);
        if let Some(moved) = self.scheduled.get(at) {
            self.roll.seat_scheduled(moved.id, at);
        }
        net
    }

    /// Ends the wait of all rules: none of them fires any more, in no thread.
    pub(super) fn halt(&mut self) {
        for at in 0..self.waiting.len() {
            if self.waiting[at].state == RuleState::Active {
                self.waiting[at].give_up();
                self.retire(at, RuleState::FireFailed);
            }
        }
    }

    /// Ends the wait of a rule.
    fn retire(&mut self, at: usize, state: RuleState) {
        let rule = &mut self.waiting[at];
        if rule.state != RuleState::Active {
            return;
        }
        rule.state = state;
        self.over += 1;
        if rule.starts_any() {
            let followed = rule.followed().iter();
            followed.for_each(|slot| self.roll.follow(*slot, false));
        }
    }
}

#[cfg(test)]
mod tests;
