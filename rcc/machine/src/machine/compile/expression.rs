//! Expressions: a value is left on the stack.

use takt_net::Quantity;
use takt_net::value::text::TextValue as _;

use super::Compiler;
use crate::diagnostic::suggest;
use crate::lifecycle::Phase;
use crate::machine::code::{Op, STACK_MAX, Status};
use crate::machine::tree::{Binary, Expression, ExpressionKind, Member, Unary};
use crate::syntax::Name;
use crate::value::{Kind, Value};

impl Compiler<'_> {
    /// Compiles an expression that must have this kind; an int becomes a double where one is needed.
    pub(super) fn typed(&mut self, expression: &Expression, kind: Kind) {
        self.typed_as(expression, kind, Quantity::Any);
    }

    pub(super) fn typed_as(&mut self, expression: &Expression, kind: Kind, quantity: Quantity) {
        let Some(found) = self.expression(expression, quantity) else {
            return;
        };
        if kind == Kind::Double && found == Kind::Int {
            self.emit(Op::Widen);
        } else if found != kind {
            let cause = format!("this is {found}, but {kind} is expected");
            let hint = match kind {
                Kind::Bool => "compare it, such as `x > 0`",
                Kind::Int | Kind::Double | Kind::Text => "write a value of that type",
            };
            self.found.error(expression.at.clone(), cause, hint);
        }
    }

    fn push(&mut self, op: Op, expression: &Expression) {
        self.depth += 1;
        if self.depth == STACK_MAX {
            let cause = "this expression is too long".to_owned();
            let hint = "split it with a variable";
            self.found.error(expression.at.clone(), cause, hint);
        }
        self.emit(op);
    }

    /// The kind of the value; none if an error was recorded.
    fn expression(&mut self, expression: &Expression, quantity: Quantity) -> Option<Kind> {
        match &expression.kind {
            ExpressionKind::Constant(value) => {
                self.push(Op::Push(*value), expression);
                Some(value.kind())
            }
            ExpressionKind::Quoted(text) => match f64::parse_as(text, quantity) {
                Ok(value) => {
                    self.push(Op::Push(Value::Double(value)), expression);
                    Some(Kind::Double)
                }
                Err(error) => {
                    let hint = "write a number with its unit, such as `'30deg'`";
                    self.found.error(expression.at.clone(), error.message, hint);
                    None
                }
            },
            ExpressionKind::Variable(name) => {
                let variable = self.variable(name)?;
                self.push(Op::Load(variable), expression);
                self.program.variables.get(variable).map(|v| v.kind)
            }
            ExpressionKind::Member(member) => self.read(member, expression),
            ExpressionKind::Is(name, word) => self.is(name, word, expression),
            ExpressionKind::In(name, state) => {
                let machine = self.machine_of(name)?;
                let states = self.state_names.get(machine)?;
                let Some(index) = states.iter().position(|s| *s == state.text) else {
                    let hint = suggest(&state.text, states.iter().map(String::as_str));
                    let cause = format!("machine `{}` has no state `{}`", name.text, state.text);
                    self.found.error(state.at.clone(), cause, hint);
                    return None;
                };
                self.push(Op::InState(machine, index), expression);
                Some(Kind::Bool)
            }
            ExpressionKind::Has(inner) => {
                self.expression(inner, Quantity::Any)?;
                self.emit(Op::Has);
                Some(Kind::Bool)
            }
            ExpressionKind::Unary(Unary::Not, inner) => {
                self.typed(inner, Kind::Bool);
                self.emit(Op::Unary(Unary::Not));
                Some(Kind::Bool)
            }
            ExpressionKind::Unary(Unary::Negate, inner) => {
                let kind = self.expression(inner, quantity)?;
                if kind == Kind::Bool {
                    self.mismatch(expression, "`-` needs a number");
                    return None;
                }
                self.emit(Op::Unary(Unary::Negate));
                Some(kind)
            }
            ExpressionKind::Binary(operator, left, right) => {
                self.binary(*operator, left, right, expression, quantity)
            }
        }
    }

    fn mismatch(&mut self, expression: &Expression, cause: &str) {
        let hint = "`and`, `or`, `not` take bool; arithmetic and `<` take int and double";
        self.found.error(expression.at.clone(), cause, hint);
    }

    fn binary(
        &mut self,
        operator: Binary,
        left: &Expression,
        right: &Expression,
        whole: &Expression,
        quantity: Quantity,
    ) -> Option<Kind> {
        let is_comparison = matches!(
            operator,
            Binary::Equal
                | Binary::NotEqual
                | Binary::Less
                | Binary::LessEqual
                | Binary::Greater
                | Binary::GreaterEqual
        );
        let inner = if is_comparison {
            let of_left = self.quantity(left);
            if of_left == Quantity::Any {
                self.quantity(right)
            } else {
                of_left
            }
        } else {
            quantity
        };
        let a = self.expression(left, inner);
        let widen_at = self.program.ops.len();
        let b = self.expression(right, inner);
        self.depth = self.depth.saturating_sub(1);
        let (a, b) = (a?, b?);
        let is_logic = matches!(operator, Binary::And | Binary::Or);
        if is_logic || a == Kind::Bool || b == Kind::Bool {
            let is_equality = matches!(operator, Binary::Equal | Binary::NotEqual);
            if (a, b) != (Kind::Bool, Kind::Bool) || !(is_logic || is_equality) {
                self.mismatch(whole, &format!("this operator does not take {a} and {b}"));
                return None;
            }
            self.emit(Op::Binary(operator));
            return Some(Kind::Bool);
        }
        let kind = if a == Kind::Double || b == Kind::Double {
            Kind::Double
        } else {
            Kind::Int
        };
        if kind == Kind::Double && a == Kind::Int {
            // Behind the left operand; expressions have no jumps, so nothing else moves.
            self.program.ops.insert(widen_at, Op::Widen);
            self.program.places.insert(widen_at, left.at.clone());
        }
        if kind == Kind::Double && b == Kind::Int {
            self.emit(Op::Widen);
        }
        self.emit(Op::Binary(operator));
        Some(if is_comparison { Kind::Bool } else { kind })
    }

    /// What a value measures, if its declaration states it.
    fn quantity(&self, expression: &Expression) -> Quantity {
        let ExpressionKind::Member(member) = &expression.kind else {
            return Quantity::Any;
        };
        let members = &self.program.members;
        let component = members.iter().find(|m| m.name == member.owner.text);
        let port = component.and_then(|m| m.component.port(&member.name.text));
        port.map_or(Quantity::Any, |port| port.declared.quantity)
    }

    pub(super) fn variable(&mut self, name: &Name) -> Option<usize> {
        let variables = &self.program.variables;
        let index = variables
            .iter()
            .position(|variable| variable.name == name.text);
        if index.is_none() {
            let hint = suggest(&name.text, variables.iter().map(|v| v.name.as_str()));
            let cause = format!("there is no variable `{}`", name.text);
            self.found.error(name.at.clone(), cause, hint);
        }
        index
    }

    fn read(&mut self, member: &Member, expression: &Expression) -> Option<Kind> {
        let (component, port) = self.port(member)?;
        let shape = self
            .program
            .members
            .get(component)?
            .component
            .ports
            .get(port)?
            .declared
            .shape;
        let element = self.element(member, shape.len)?;
        let op = Op::Read {
            component,
            port,
            element,
        };
        self.push(op, expression);
        Some(shape.kind)
    }

    /// The element of an array that a member names; an error is recorded if it is none.
    pub(super) fn element(&mut self, member: &Member, len: Option<u32>) -> Option<usize> {
        let name = &member.name.text;
        let (cause, hint) = match (member.index, len) {
            (None, None) => return Some(0),
            (Some(index), Some(len)) if index < len => return usize::try_from(index).ok(),
            (Some(index), Some(len)) => (
                format!("`{name}` has {len} elements, so there is no [{index}]"),
                "the first element is [0]",
            ),
            (None, Some(_)) => (
                format!("`{name}` is an array"),
                "name an element, such as `[0]`",
            ),
            (Some(_), None) => (format!("`{name}` is no array"), "remove the index"),
        };
        self.found.error(member.at(), cause, hint);
        None
    }

    pub(super) fn machine_of(&mut self, name: &Name) -> Option<usize> {
        let machines = &self.program.machines;
        let index = machines
            .iter()
            .position(|machine| machine.name == name.text);
        if index.is_none() {
            let hint = suggest(
                &name.text,
                machines.iter().map(|machine| machine.name.as_str()),
            );
            let cause = format!("there is no machine `{}`", name.text);
            self.found.error(name.at.clone(), cause, hint);
        }
        index
    }

    fn is(&mut self, name: &Name, word: &Name, expression: &Expression) -> Option<Kind> {
        let is_machine = self
            .program
            .machines
            .iter()
            .any(|machine| machine.name == name.text);
        let op = if is_machine {
            let machine = self.machine_of(name)?;
            let status = Status::ALL
                .into_iter()
                .find(|status| status.word() == word.text);
            status.map(|status| Op::IsStatus(machine, status))
        } else {
            let component = self.member(name)?;
            let phase = Phase::ALL
                .into_iter()
                .find(|phase| phase.word() == word.text);
            phase.map(|phase| Op::Is(component, phase))
        };
        let Some(op) = op else {
            let hint = if is_machine {
                suggest(&word.text, Status::ALL.map(Status::word))
            } else {
                suggest(&word.text, Phase::ALL.map(Phase::word))
            };
            let cause = format!("there is no state `{}` of `{}`", word.text, name.text);
            self.found.error(word.at.clone(), cause, hint);
            return None;
        };
        self.push(op, expression);
        Some(Kind::Bool)
    }
}
