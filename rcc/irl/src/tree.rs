//! The syntax tree of a program. What its names mean is decided by the compiler.

use std::ops::Range;

/// Bytes of the text.
pub(crate) type Span = Range<usize>;

/// A name, in lower case, as L-IRL does not distinguish cases.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Name {
    pub(crate) text: String,
    pub(crate) at: Span,
}

#[derive(Debug)]
pub(crate) struct Program {
    pub(crate) name: Name,
    pub(crate) specification: Option<(String, Span)>,
    pub(crate) body: Body,
}

#[derive(Debug, Default)]
pub(crate) struct Body {
    pub(crate) declarations: Vec<Declaration>,
    pub(crate) statements: Vec<Statement>,
}

#[derive(Debug)]
pub(crate) enum Declaration {
    Const(Name, Option<TypeExpr>, Expr),
    Type(Name, TypeExpr),
    Var(Vec<Name>, TypeExpr, Option<Expr>),
    Signal { is_out: bool, name: Name, of: Expr },
    Routine(Box<Routine>),
}

#[derive(Debug)]
pub(crate) struct Routine {
    pub(crate) name: Name,
    pub(crate) parameters: Vec<Parameter>,
    pub(crate) result: Option<TypeExpr>,
    pub(crate) body: Body,
}

#[derive(Debug)]
pub(crate) struct Parameter {
    pub(crate) by_reference: bool,
    pub(crate) name: Name,
    pub(crate) ty: TypeExpr,
}

#[derive(Clone, Debug)]
pub(crate) enum TypeExpr {
    Named(Name),
    Array(Vec<(Expr, Expr)>, Box<TypeExpr>),
    Record(Vec<(Vec<Name>, TypeExpr)>),
}

#[derive(Debug)]
pub(crate) struct Statement {
    pub(crate) kind: StatementKind,
    pub(crate) at: Span,
}

#[derive(Debug)]
pub(crate) enum StatementKind {
    Move(Box<Move>),
    Assign(Expr, Expr),
    Call(Name, Vec<Expr>),
    Seq(Vec<Statement>),
    Par(Vec<Statement>),
    If(Vec<(Expr, Vec<Statement>)>, Vec<Statement>),
    Case(
        Expr,
        Vec<(Vec<Expr>, Vec<Statement>)>,
        Option<Vec<Statement>>,
    ),
    For {
        variable: Name,
        from: Expr,
        to: Expr,
        step: Option<Expr>,
        body: Vec<Statement>,
    },
    While(Expr, Vec<Statement>),
    Repeat(Vec<Statement>, Expr),
    WaitSec(Expr),
    WaitFor(Expr, Option<Expr>),
    SignalEvent(Name),
    Return(Option<Expr>),
    Exit,
    Pause,
    Halt,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PathKind {
    Ptp,
    Lin,
    Circle,
}

#[derive(Debug)]
pub(crate) struct Move {
    pub(crate) is_incremental: bool,
    pub(crate) path: PathKind,
    pub(crate) via: Option<Expr>,
    pub(crate) target: Expr,
    pub(crate) attributes: Vec<(Name, Expr)>,
}

#[derive(Clone, Debug)]
pub(crate) struct Expr {
    pub(crate) kind: ExprKind,
    pub(crate) at: Span,
}

#[derive(Clone, Debug)]
pub(crate) enum ExprKind {
    Int(i64),
    Real(f64),
    Text(String),
    Bool(bool),
    Name(String),
    Field(Box<Expr>, Name),
    Index(Box<Expr>, Vec<Expr>),
    Call(Name, Vec<Expr>),
    Tuple(Vec<Expr>),
    Unary(Unary, Box<Expr>),
    Binary(Binary, Box<Expr>, Box<Expr>),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unary {
    Negate,
    Not,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Binary {
    Or,
    Exor,
    And,
    Equal,
    Differs,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    Add,
    Subtract,
    Multiply,
    Divide,
    Div,
    Mod,
    Compose,
}

impl Binary {
    pub(crate) const fn symbol(self) -> &'static str {
        match self {
            Self::Or => "or",
            Self::Exor => "exor",
            Self::And => "and",
            Self::Equal => "=",
            Self::Differs => "<>",
            Self::Less => "<",
            Self::LessEqual => "<=",
            Self::Greater => ">",
            Self::GreaterEqual => ">=",
            Self::Add => "+",
            Self::Subtract => "-",
            Self::Multiply => "*",
            Self::Divide => "/",
            Self::Div => "div",
            Self::Mod => "mod",
            Self::Compose => "@",
        }
    }
}
