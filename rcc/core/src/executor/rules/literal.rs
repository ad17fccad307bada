//! Conditions of rules, compiled: steps of a stack machine over literals, each a question about one net. Their text
//! is parsed elsewhere.

use takt_net::Plan;

use crate::executor::life::End;

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

impl Literal {
    /// Answers it from its net, which has just ended if there is an `end`; returns whether the answer
    /// changed.
    pub(super) fn answer(&mut self, plan: &Plan, end: Option<End>) -> bool {
        let value = match self.question {
            Question::Value(at) => plan.out_bool(at),
            Question::Terminated => end.map(|end| end == End::Terminated),
        };
        let before = (self.value, self.last);
        (self.value, self.last) = (value, end.is_some());
        before != (self.value, self.last)
    }
}
