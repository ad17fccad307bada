//! The syntax tree of a machine. Names are not resolved here.

use std::ops::Range;

use crate::syntax::Name;
use crate::value::{Kind, Value};

#[derive(Debug, Default)]
pub(crate) struct Machine {
    pub(crate) name: String,
    pub(crate) at: Range<usize>,
    pub(crate) components: Vec<Component>,
    pub(crate) connections: Vec<(Member, Member)>,
    pub(crate) order: Option<(Range<usize>, Vec<Name>)>,
    pub(crate) variables: Vec<Variable>,
    pub(crate) events: Vec<Name>,
    pub(crate) machines: Vec<Machine>,
    /// `stop on end within`: where, and the time, ns.
    pub(crate) end: Option<(Range<usize>, i64)>,
    pub(crate) states: Vec<State>,
}

#[derive(Debug)]
pub(crate) struct Component {
    pub(crate) name: Name,
    pub(crate) file: String,
    pub(crate) file_at: Range<usize>,
    pub(crate) is_configured: bool,
    pub(crate) is_started: bool,
}

/// `component.port` with an index into an array.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    pub(crate) owner: Name,
    pub(crate) name: Name,
    pub(crate) index: Option<u32>,
}

impl Member {
    pub(crate) fn at(&self) -> Range<usize> {
        self.owner.at.start..self.name.at.end
    }
}

#[derive(Debug)]
pub(crate) struct Variable {
    pub(crate) name: Name,
    pub(crate) kind: Kind,
    pub(crate) initial: Value,
    pub(crate) is_parameter: bool,
}

#[derive(Debug)]
pub(crate) struct State {
    pub(crate) name: Name,
    pub(crate) is_initial: bool,
    pub(crate) is_final: bool,
    pub(crate) precondition: Option<Expression>,
    pub(crate) entry: Option<Block>,
    pub(crate) run: Option<Block>,
    pub(crate) handle: Option<Block>,
    pub(crate) exit: Option<Block>,
    pub(crate) transitions: Vec<Transition>,
}

#[derive(Debug)]
pub(crate) struct Transition {
    pub(crate) event: Option<Name>,
    pub(crate) condition: Option<Expression>,
    pub(crate) target: Name,
    pub(crate) program: Option<Block>,
    pub(crate) failure: Option<Block>,
}

pub(crate) type Block = Vec<Statement>;

#[derive(Debug)]
pub(crate) struct Statement {
    pub(crate) kind: StatementKind,
    pub(crate) at: Range<usize>,
}

/// A time limit, ns, and what to do after it.
pub(crate) type Within = Option<(i64, Option<Block>)>;

#[derive(Debug)]
pub(crate) enum StatementKind {
    Assign(Name, Expression),
    Write(Member, Expression),
    /// Several properties at once.
    Set(Name, Vec<(Name, Expression)>),
    /// `start servo`: a component or a machine.
    Request(Name, Name),
    Call(Member, Vec<Expression>),
    /// A call, and what to wait for: its completion, or a condition.
    Do(Member, Vec<Expression>, Option<Expression>, Within),
    Wait(i64),
    WaitFor(Expression, Within),
    If(Expression, Block, Block),
    While(Expression, Block),
    Yield,
    Raise(Name),
}

#[derive(Debug)]
pub(crate) struct Expression {
    pub(crate) kind: ExpressionKind,
    pub(crate) at: Range<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unary {
    Not,
    Negate,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Binary {
    Or,
    And,
    Equal,
    NotEqual,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
}

#[derive(Debug)]
pub(crate) enum ExpressionKind {
    Constant(Value),
    /// A number with a unit.
    Quoted(String),
    Variable(Name),
    Member(Member),
    /// `servo is running`, `homing is finished`.
    Is(Name, Name),
    /// `homing in Search`.
    In(Name, Name),
    /// Whether it is not null.
    Has(Box<Expression>),
    Unary(Unary, Box<Expression>),
    Binary(Binary, Box<Expression>, Box<Expression>),
}
