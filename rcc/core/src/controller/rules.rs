//! Synchronization rules as programs give them: conditions as text, nets by identifier. Watching
//! them is the net thread's business.
//!
//! ```text
//! or   = and { "|" and }      and  = not { "&" not }      not = [ "!" ] atom
//! atom = "t" | net "." key | net ".terminated" | "(" or ")"
//! ```
//! `key` is that of a Boolean value which the net reports, such as `outdone`. `terminated`, an
//! addition of Takt, is true once the net has ended by itself: "schedule after" of Vistein et al.
//! 2014, section 5.3.

use std::collections::HashMap;
use std::fmt;
use std::str::FromStr;

use takt_net::{Element, Type};

use crate::controller::desk::Desk;
use crate::controller::{Controller, NetId, NetState};
use crate::error::Error;
use crate::executor::rules::{
    CONDITION_MAX, Literal, Question, Rule, RuleRefusal, RuleState, Step,
};
use crate::executor::thread::Command;

/// Rules that are remembered; the oldest that no longer wait are forgotten first.
const RULES_KEPT: usize = 4096;
/// Parentheses inside one another.
const DEPTH_MAX: usize = 64;

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
    /// The word for it on the wire.
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
    /// What it is, for people.
    pub description: String,
}

/// A rule as programs see it.
#[derive(Clone, Debug)]
pub struct RuleInfo {
    /// Its identifier.
    pub id: RuleId,
    /// What was asked for.
    pub request: RuleRequest,
    /// What became of it.
    pub state: RuleState,
}

/// A rule at the desk.
#[derive(Debug)]
pub(super) struct RuleEntry {
    request: RuleRequest,
    pub(super) state: RuleState,
    /// Set while the net thread has not answered, and then to its answer.
    adding: Option<Option<Result<(), Error>>>,
}

impl Controller {
    /// Installs a synchronization rule. The nets that it starts become `Scheduled`, and what they
    /// need is kept for them. It fires at most once, between two cycles.
    ///
    /// # Errors
    /// If the condition is wrong, a net is not in a state for it, or what a net needs cannot be
    /// kept.
    pub fn schedule(&self, request: RuleRequest) -> Result<RuleId, Error> {
        let mut desk = self.inner.lock();
        let id = desk.install(request)?;
        self.inner.announce(&desk);
        self.inner.wait_for(desk, |desk| desk.installed(id))??;
        Ok(id)
    }

    /// A rule; `None` if there never was one or it was forgotten.
    #[must_use]
    pub fn rule(&self, id: RuleId) -> Option<RuleInfo> {
        let desk = self.inner.lock();
        let entry = desk.rules.get(&id)?;
        Some(RuleInfo {
            id,
            request: entry.request.clone(),
            state: entry.state,
        })
    }

    /// The rules in which a net occurs.
    #[must_use]
    pub fn rules_of(&self, net: NetId) -> Vec<RuleInfo> {
        let desk = self.inner.lock();
        let occurs = |entry: &&RuleEntry| {
            let RuleRequest {
                condition,
                stop,
                cancel,
                start,
                ..
            } = &entry.request;
            let listed = stop.iter().chain(cancel).chain(start).any(|n| *n == net);
            listed || names(condition).any(|name| name.parse() == Ok(net))
        };
        let entries = desk.rules.iter().filter(|(_, entry)| occurs(entry));
        let info = |(id, entry): (&RuleId, &RuleEntry)| RuleInfo {
            id: *id,
            request: entry.request.clone(),
            state: entry.state,
        };
        entries.map(info).collect()
    }
}

/// The words of a condition.
fn names(condition: &str) -> impl Iterator<Item = &str> {
    condition
        .split(|c: char| !is_name(c))
        .filter(|word| !word.is_empty())
}

const fn is_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, ':' | '_')
}

impl Desk {
    fn install(&mut self, request: RuleRequest) -> Result<RuleId, Error> {
        let condition = Parser::parse(&request.condition)?;
        let mut literals = Vec::with_capacity(condition.literals.len());
        for (net, key) in &condition.literals {
            literals.push(self.literal(net, key)?);
        }
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
            if !matches!(state, NetState::Ready | NetState::Scheduled) || twice || net.is_starting()
            {
                let what = "a rule can only start a net that is READY or SCHEDULED, and once";
                return Err(Error::WrongState {
                    net: *id,
                    state,
                    what,
                });
            }
        }
        let id = self.next_rule();
        let numbers = |nets: &[NetId]| nets.iter().map(|n| n.0).collect::<Vec<_>>();
        let mut rule = Box::new(Rule::new(id.0, literals, condition.steps));
        rule.stop = numbers(&request.stop);
        rule.cancel = numbers(&request.cancel);
        rule.start = numbers(&request.start);
        for net in &request.start {
            if let Some(running) = self.net(*net)?.hand_to_rules() {
                self.command(Command::Schedule(running))?;
            }
        }
        self.command(Command::AddRule(rule))?;
        let entry = RuleEntry {
            request,
            state: RuleState::Active,
            adding: Some(None),
        };
        self.rules.insert(id, entry);
        self.forget_old_rules();
        Ok(id)
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

    /// A rule waits now.
    pub(super) fn rule_added(&mut self, id: u32) {
        if let Some(entry) = self.rules.get_mut(&RuleId(id)) {
            entry.adding = Some(Some(Ok(())));
            for net in entry.request.start.clone() {
                if let Some(net) = self.nets.get_mut(&net) {
                    net.become_scheduled();
                }
            }
        }
    }

    /// A rule could not be kept.
    pub(super) fn rule_refused(&mut self, rule: &Rule, why: RuleRefusal) {
        let error = match why {
            RuleRefusal::TooMany => {
                let bound = crate::executor::rules::RULES_MAX;
                Error::TooMany {
                    what: "waiting rules",
                    bound,
                }
            }
            RuleRefusal::ResourceInUse(n) | RuleRefusal::ResourceTwice(n) => {
                Error::NotSchedulable {
                    resource: self.resource_name(n),
                }
            }
        };
        self.release(rule);
        if let Some(entry) = self.rules.get_mut(&RuleId(rule.id)) {
            entry.state = RuleState::Inactive;
            entry.adding = Some(Some(Err(error)));
        }
    }

    /// A rule no longer waits.
    pub(super) fn rule_done(&mut self, rule: &Rule) {
        if rule.state != RuleState::Fired {
            self.release(rule);
        }
        if let Some(entry) = self.rules.get_mut(&RuleId(rule.id)) {
            entry.state = rule.state;
            if rule.state == RuleState::FireFailed {
                tracing::warn!(rule = rule.id, "rule could not start its nets");
            }
        }
    }

    /// Asks for the nets of a rule back that no other rule waits with.
    fn release(&mut self, rule: &Rule) {
        for net in &rule.start {
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

/// A condition before its nets are known.
#[derive(Debug, Default)]
struct Condition {
    /// Net and key by literal.
    literals: Vec<(String, String)>,
    steps: Vec<Step>,
}

struct Parser<'t> {
    text: &'t str,
    at: usize,
    condition: Condition,
    known: HashMap<(&'t str, &'t str), usize>,
}

impl<'t> Parser<'t> {
    fn parse(text: &'t str) -> Result<Condition, Error> {
        let mut parser = Self {
            text,
            at: 0,
            condition: Condition::default(),
            known: HashMap::new(),
        };
        parser.or(DEPTH_MAX)?;
        if parser.peek().is_some() {
            return Err(parser.expected("`&`, `|` or the end"));
        }
        if parser.condition.steps.len() > CONDITION_MAX {
            let bound = CONDITION_MAX;
            return Err(Error::TooMany {
                what: "operations in a condition",
                bound,
            });
        }
        Ok(parser.condition)
    }

    fn peek(&mut self) -> Option<char> {
        let rest = self.text.get(self.at..)?.trim_start();
        self.at = self.text.len() - rest.len();
        rest.chars().next()
    }

    fn eat(&mut self, c: char) -> bool {
        let is = self.peek() == Some(c);
        self.at += if is { c.len_utf8() } else { 0 };
        is
    }

    fn expected(&mut self, expected: &str) -> Error {
        let found = self
            .peek()
            .map_or_else(|| "the end".to_owned(), |c| format!("`{c}`"));
        let column = self.text[..self.at].chars().count() + 1;
        Error::Condition {
            what: format!("column {column}: {expected} is expected here, not {found}"),
        }
    }

    fn or(&mut self, depth: usize) -> Result<(), Error> {
        self.and(depth)?;
        while self.eat('|') {
            self.and(depth)?;
            self.condition.steps.push(Step::Or);
        }
        Ok(())
    }

    fn and(&mut self, depth: usize) -> Result<(), Error> {
        self.not(depth)?;
        while self.eat('&') {
            self.not(depth)?;
            self.condition.steps.push(Step::And);
        }
        Ok(())
    }

    fn not(&mut self, depth: usize) -> Result<(), Error> {
        let negated = self.eat('!');
        self.atom(depth)?;
        if negated {
            self.condition.steps.push(Step::Not);
        }
        Ok(())
    }

    fn atom(&mut self, depth: usize) -> Result<(), Error> {
        if self.eat('(') {
            if depth == 0 {
                return Err(self.expected("fewer parentheses inside one another"));
            }
            self.or(depth - 1)?;
            return if self.eat(')') {
                Ok(())
            } else {
                Err(self.expected("`)`"))
            };
        }
        let net = self.name();
        if net.is_empty() {
            return Err(self.expected("`t`, `net.key`, `!` or `(`"));
        }
        if self.eat('.') {
            let key = self.name();
            if key.is_empty() {
                return Err(self.expected("a key such as `outdone`, or `terminated`,"));
            }
            let literals = &mut self.condition.literals;
            let number = *self.known.entry((net, key)).or_insert_with(|| {
                literals.push((net.to_owned(), key.to_owned()));
                literals.len() - 1
            });
            self.condition.steps.push(Step::Literal(number));
        } else if net == "t" {
            self.condition.steps.push(Step::Constant(true));
        } else {
            return Err(self.expected("`.` and a key"));
        }
        Ok(())
    }

    fn name(&mut self) -> &'t str {
        self.peek();
        let rest = &self.text[self.at..];
        let end = rest.find(|c: char| !is_name(c)).unwrap_or(rest.len());
        self.at += end;
        &rest[..end]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn fault(text: &str) -> String {
        Parser::parse(text).unwrap_err().to_string()
    }

    #[test]
    fn conditions_bind_as_usual() {
        let condition = Parser::parse("!rpinet0.outa & (t | rpinet1.outb)|rpinet0.outa").unwrap();
        let literal = Step::Literal;
        assert_eq!(
            condition.steps,
            [
                literal(0),
                Step::Not,
                Step::Constant(true),
                literal(1),
                Step::Or,
                Step::And,
                literal(0),
                Step::Or
            ]
        );
        assert_eq!(condition.literals.len(), 2);
    }

    #[test]
    fn faults_name_the_column() {
        assert!(fault("a b c").contains("column 3: `.` and a key is expected here, not `b`"));
        assert!(fault("").contains("column 1"));
        assert!(fault("(t").contains("`)` is expected here, not the end"));
        assert!(fault("t &").contains("column 4"));
        assert!(fault(&"(".repeat(100_000)).contains("fewer parentheses"));
        assert!(fault(&"t|".repeat(300)).contains("column 601"));
        assert!(fault(&format!("{}t", "t|".repeat(300))).contains("at most 256"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_without_panic(text in "[a-c.t()!&| ä]{0,40}") {
            let _ = Parser::parse(&text);
        }
    }
}
