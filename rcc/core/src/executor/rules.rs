//! Synchronization rules: when a condition over values of nets becomes true, nets are stopped,
//! cancelled and started between two cycles, all at once. It evaluates nothing itself and knows
//! no text: conditions come here compiled. Of a rule whose nets are in several threads each has a
//! part, and [`shared`] is between them.

#![expect(clippy::borrowed_box, reason = "what lists of boxes lend")]

pub mod shared;

use crate::executor::{End, Executor, ResourceSet, Running};
use shared::{Decision, Part};

/// Most rules that wait at once in one thread.
pub const RULES_MAX: usize = 1024;
/// Most that the waiting rules of one thread look at in a cycle, all together: literals, operations, and
/// nets that they stop, cancel and start.
pub const WORK_MAX: usize = 8192;
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

/// A synchronization rule.
#[derive(Debug)]
pub struct Rule {
    /// Its number.
    pub id: u32,
    /// The condition's literals.
    pub literals: Vec<Literal>,
    /// The condition.
    pub steps: Vec<Step>,
    /// Nets of this thread that it ends.
    pub stop: Vec<u32>,
    /// Nets of this thread that it asks to cancel.
    pub cancel: Vec<u32>,
    /// Nets of this thread that it starts.
    pub start: Vec<u32>,
    /// What joins it to its parts in other threads; `None` if it is whole.
    pub part: Option<Part>,
    /// What became of it.
    pub state: RuleState,
    /// What the nets that it starts need: kept for them.
    pub(super) reserved: ResourceSet,
}

/// Whether something is true, and whether it is false. Neither is "unknown" (Kleene); both is
/// "can become either".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Truth {
    yes: bool,
    no: bool,
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
    pub fn new(id: u32, literals: Vec<Literal>, steps: Vec<Step>) -> Self {
        Self {
            id,
            literals,
            steps,
            stop: Vec::new(),
            cancel: Vec::new(),
            start: Vec::new(),
            part: None,
            state: RuleState::Active,
            reserved: ResourceSet::default(),
        }
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
        let open = Truth {
            yes: true,
            no: true,
        };
        self.evaluate(|literal| {
            if literal.last {
                literal.value.into()
            } else {
                open
            }
        })
        .yes
    }

    /// Whether it is to fire now.
    fn is_due(&self) -> bool {
        match &self.part {
            Some(part) => part.shared().decision() == Decision::Fire,
            None => self.holds(),
        }
    }

    /// Ends the wait for good without firing, in all threads.
    fn give_up(&mut self) {
        let decided = self
            .part
            .as_ref()
            .map(|p| p.shared().decide(Decision::Never));
        // Other parts may have been told to fire already; this one cannot.
        self.state = match decided {
            None | Some(Decision::Never) => RuleState::Inactive,
            Some(Decision::Open | Decision::Fire | Decision::Fail) => RuleState::FireFailed,
        };
    }

    /// Whether it starts a net, be it in another thread.
    fn starts_any(&self) -> bool {
        !self.start.is_empty() || self.part.as_ref().is_some_and(Part::starts)
    }

    /// How much of it is looked at in a cycle.
    fn work(&self) -> usize {
        let nets = self.stop.len() + self.cancel.len() + self.start.len();
        self.literals.len() + self.steps.len() + nets
    }

    /// Whether the rule hands over from this net: it stops it or waits for it.
    fn follows(&self, net: u32) -> bool {
        self.stop.contains(&net) || self.literals.iter().any(|l| l.net == net)
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
}

/// What the executor knows of rules.
#[expect(
    clippy::vec_box,
    reason = "they come and go as boxes; a cycle neither makes nor frees any"
)]
#[derive(Debug, Default)]
pub(super) struct Rules {
    waiting: Vec<Box<Rule>>,
    /// Nets that rules start, until they do.
    scheduled: Vec<Box<Running>>,
}

impl Rules {
    pub(super) fn new() -> Self {
        Self {
            waiting: Vec::with_capacity(RULES_MAX),
            scheduled: Vec::with_capacity(super::RUNNING_MAX),
        }
    }
}

impl Executor {
    /// Takes a net that rules may start.
    ///
    /// # Errors
    /// If there is no room for it.
    pub fn schedule(&mut self, net: Box<Running>) -> Result<(), Box<Running>> {
        if self.rules.scheduled.len() == super::RUNNING_MAX {
            return Err(net);
        }
        self.rules.scheduled.push(net);
        Ok(())
    }

    /// Gives back a scheduled net: always, or only if no rule waits to start it. Rules that lose it
    /// can do nothing any more.
    pub fn take_unscheduled(&mut self, id: u32, always: bool) -> Option<Box<Running>> {
        let waits =
            |rule: &&mut Box<Rule>| rule.state == RuleState::Active && rule.start.contains(&id);
        let mut waiting = self.rules.waiting.iter_mut().filter(waits).peekable();
        if !always && waiting.peek().is_some() {
            return None;
        }
        waiting.for_each(|rule| rule.give_up());
        let at = self.rules.scheduled.iter().position(|net| net.id == id)?;
        Some(self.rules.scheduled.remove(at))
    }

    /// Takes a rule. What its nets need is kept for them from now on, but for nets that it follows.
    ///
    /// # Errors
    /// If it cannot be kept; the rule comes back with the reason, and its parts in other threads do
    /// nothing any more.
    pub fn add_rule(&mut self, mut rule: Box<Rule>) -> Result<(), (Box<Rule>, RuleRefusal)> {
        match self.reserve(&rule) {
            Ok(reserved) => rule.reserved = reserved,
            Err(refusal) => {
                rule.give_up();
                return Err((rule, refusal));
            }
        }
        for literal in rule.literals.iter_mut().filter(|l| !l.last) {
            let net = self.running.iter().find(|net| net.id == literal.net);
            if let Some(net) = net {
                answer(literal, net, None);
            }
        }
        self.rules.waiting.push(rule);
        Ok(())
    }

    /// What is to be kept for a new rule.
    fn reserve(&self, rule: &Rule) -> Result<ResourceSet, RuleRefusal> {
        if self.rules.waiting.len() == RULES_MAX {
            return Err(RuleRefusal::TooMany);
        }
        let others = self.rules.waiting.iter().map(|other| other.work());
        if others.sum::<usize>() + rule.work() > WORK_MAX {
            return Err(RuleRefusal::TooLong);
        }
        let mut wanted = ResourceSet::default();
        for net in self
            .rules
            .scheduled
            .iter()
            .filter(|net| rule.start.contains(&net.id))
        {
            if let Some(twice) = wanted.common(&net.resources) {
                return Err(RuleRefusal::ResourceTwice(twice));
            }
            wanted.add(&net.resources);
        }
        let claim = self.claim(rule, wanted);
        for net in self.running.iter().filter(|net| !rule.follows(net.id)) {
            if let Some(held) = claim.common(&net.resources) {
                return Err(RuleRefusal::ResourceInUse(held));
            }
        }
        // Alternatives of one predecessor may want the same: only one of them will come to run.
        let stranger = |other: &&Box<Rule>| {
            !rule
                .stop
                .iter()
                .chain(rule.literals.iter().map(|l| &l.net))
                .any(|n| other.follows(*n))
        };
        for other in self.rules.waiting.iter().filter(stranger) {
            if let Some(kept) = claim.common(&self.claim(other, other.reserved)) {
                return Err(RuleRefusal::ResourceInUse(kept));
            }
        }
        Ok(wanted)
    }

    /// What a rule that wants this claims now: not what scheduled nets that it follows will bring.
    fn claim(&self, rule: &Rule, mut wanted: ResourceSet) -> ResourceSet {
        let scheduled = self.rules.scheduled.iter();
        for net in scheduled.filter(|net| rule.follows(net.id)) {
            wanted.remove(&net.resources);
        }
        wanted
    }

    /// The lowest resource of a net that is kept for other nets.
    pub(super) fn kept(&self, net: &Running) -> Option<usize> {
        let others = self
            .rules
            .waiting
            .iter()
            .filter(|rule| !rule.start.contains(&net.id) && !rule.follows(net.id));
        others
            .map(|rule| self.claim(rule, rule.reserved))
            .find_map(|kept| net.resources.common(&kept))
    }

    /// Tells each running net whether a successor waits for it; calls `changed` where that is new.
    /// Called before each cycle.
    pub fn announce_takeovers(&mut self, mut changed: impl FnMut(u32, bool)) {
        let waiting = &self.rules.waiting;
        if waiting.is_empty() && !self.running.iter().any(|net| net.takeover) {
            return;
        }
        for net in &mut self.running {
            let waits = |rule: &Box<Rule>| {
                rule.state == RuleState::Active && rule.starts_any() && rule.follows(net.id)
            };
            let waits = self.rules.waiting.iter().any(waits);
            if std::mem::replace(&mut net.takeover, waits) != waits {
                changed(net.id, waits);
            }
        }
    }

    /// Brings the literals up to date and fires the rules that hold. Called after each cycle,
    /// before nets that ended are taken out: what they held passes to their successors, which are
    /// evaluated from the next cycle on.
    pub fn fire_rules(&mut self) {
        if self.rules.waiting.is_empty() {
            return;
        }
        for rule in &mut self.rules.waiting {
            for literal in rule.literals.iter_mut().filter(|l| !l.last) {
                if let Some(net) = self.running.iter().find(|net| net.id == literal.net) {
                    answer(literal, net, net.end);
                }
            }
        }
        self.consult();
        // Those that start nothing cannot fail, and may free what others need.
        for starts in [false, true] {
            for i in 0..self.rules.waiting.len() {
                let rule = &self.rules.waiting[i];
                let due = rule.state == RuleState::Active && rule.is_due();
                if due && rule.start.is_empty() != starts {
                    self.fire(i);
                }
            }
        }
        for rule in &mut self.rules.waiting {
            let whole = rule.part.is_none();
            if whole && rule.state == RuleState::Active && !rule.can_hold() {
                rule.state = RuleState::Inactive;
            }
        }
    }

    /// Does what was decided about rules in several threads since the last cycle. Called before each
    /// cycle; returns whether nets may have been changed.
    pub fn fire_decided(&mut self) -> bool {
        let mut any = false;
        for i in 0..self.rules.waiting.len() {
            let rule = &self.rules.waiting[i];
            let decided = rule.state == RuleState::Active && rule.part.is_some() && rule.is_due();
            if decided {
                self.fire(i);
                any = true;
            }
        }
        any
    }

    /// Exchanges literals of rules in several threads, and decides about those that are decided here.
    fn consult(&mut self) {
        for i in 0..self.rules.waiting.len() {
            let rule = &self.rules.waiting[i];
            if rule.part.is_none() || rule.state != RuleState::Active {
                continue;
            }
            let able = self.is_able(i);
            let rule = &mut *self.rules.waiting[i];
            let Some(part) = &rule.part else {
                continue;
            };
            part.exchange(&mut rule.literals, able);
            if part.is_to_decide() {
                if rule.holds() {
                    part.decide_to_fire();
                } else if !rule.can_hold() {
                    part.shared().decide(Decision::Never);
                }
            }
            match part.shared().decision() {
                Decision::Open | Decision::Fire => {}
                Decision::Fail => rule.state = RuleState::FireFailed,
                Decision::Never => rule.state = RuleState::Inactive,
            }
        }
    }

    /// Whether the nets that a rule starts here could start now.
    fn is_able(&self, number: usize) -> bool {
        let rule = &self.rules.waiting[number];
        let ending = |net: &Running| net.end.is_some() || rule.stop.contains(&net.id);
        let mut held = ResourceSet::default();
        for net in self.running.iter().filter(|net| !ending(net)) {
            held.add(&net.resources);
        }
        let starts = |net: &&Box<Running>| rule.start.contains(&net.id);
        let found = self.rules.scheduled.iter().filter(starts).count();
        let blocked = self.rules.scheduled.iter().filter(starts).any(|net| {
            let device = |d: &(usize, u64)| self.devices.get(d.0).is_none_or(|v| !v.is_ready());
            net.resources.common(&held).is_some() || net.devices.iter().any(device)
        });
        let room = self.running.len() + found <= super::RUNNING_MAX;
        !blocked && room && found == rule.start.len()
    }

    fn fire(&mut self, number: usize) {
        if !self.is_able(number) {
            self.rules.waiting[number].state = RuleState::FireFailed;
            return;
        }
        let rule = &self.rules.waiting[number];
        for net in &mut self.running {
            if rule.stop.contains(&net.id) {
                net.end = net.end.or(Some(End::Stopped));
            }
            if rule.cancel.contains(&net.id) && !net.cancel {
                (net.cancel, net.fresh_cancel) = (true, true);
            }
        }
        self.rules.waiting[number].state = RuleState::Fired;
        let mut at = 0;
        while at < self.rules.scheduled.len() {
            let id = self.rules.scheduled[at].id;
            if !self.rules.waiting[number].start.contains(&id) {
                at += 1;
                continue;
            }
            let mut net = self.rules.scheduled.remove(at);
            net.fresh = true;
            self.start_by_rule(net);
        }
    }

    /// Takes out one rule that no longer waits, if `take` accepts it.
    pub fn take_rule(&mut self, take: impl FnOnce(Box<Rule>) -> Result<(), Box<Rule>>) -> bool {
        let done = |rule: &Box<Rule>| rule.state != RuleState::Active;
        let Some(at) = self.rules.waiting.iter().position(done) else {
            return false;
        };
        let rule = self.rules.waiting.remove(at);
        match take(rule) {
            Ok(()) => true,
            Err(rule) => {
                self.rules.waiting.insert(at, rule);
                false
            }
        }
    }

    /// Answers for good what waiting rules ask of a net that had ended before they came.
    pub fn answer_for_good(&mut self, told: Literal) {
        let literals = self.rules.waiting.iter_mut();
        let literals = literals.flat_map(|rule| &mut rule.literals);
        let asked = |l: &&mut Literal| !l.last && (l.net, l.question) == (told.net, told.question);
        literals.filter(asked).for_each(|literal| *literal = told);
    }

    /// Tells rules that a net will never run again, or never did.
    pub fn forget(&mut self, id: u32) {
        for rule in &mut self.rules.waiting {
            for literal in rule.literals.iter_mut().filter(|l| l.net == id) {
                literal.last = true;
            }
        }
    }
}

/// Answers a literal from its net, which has just ended if there is an `end`.
fn answer(literal: &mut Literal, net: &Running, end: Option<End>) {
    literal.value = match literal.question {
        Question::Value(at) => net.plan.out_bool(at),
        Question::Terminated => end.map(|end| end == End::Terminated),
    };
    literal.last = end.is_some();
}

#[cfg(test)]
mod tests;
