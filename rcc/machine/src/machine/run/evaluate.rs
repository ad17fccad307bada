//! Executes one program until it ends or yields.
#![expect(
    clippy::wildcard_enum_match_arm,
    reason = "operators and operations of another group are an error of the code"
)]

use super::{Cause, Machine, Peers};
use crate::lifecycle::{Phase, Request};
use crate::machine::code::{Op, STACK_MAX};
use crate::machine::tree::{Binary, Unary};
use crate::value::Value;

/// How a program came to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Flow {
    /// It ended, with the value of an expression.
    Done(Option<Value>),
    /// It continues there in the next step.
    Yielded(usize),
    /// It failed there.
    Failed(Cause, usize),
}

/// A bounded stack of values, null included.
struct Stack {
    values: [Option<Value>; STACK_MAX],
    len: usize,
}

impl Stack {
    fn push(&mut self, value: Option<Value>) -> Result<(), Cause> {
        let slot = self.values.get_mut(self.len).ok_or(Cause::Code)?;
        *slot = value;
        self.len += 1;
        Ok(())
    }

    fn pop(&mut self) -> Result<Option<Value>, Cause> {
        self.len = self.len.checked_sub(1).ok_or(Cause::Code)?;
        self.values.get(self.len).copied().ok_or(Cause::Code)
    }

    fn value(&mut self) -> Result<Value, Cause> {
        self.pop()?.ok_or(Cause::Null)
    }
}

/// What one operation does to the program counter.
enum Next {
    Forward,
    At(usize),
    Yield,
    End(Option<Value>),
}

impl Machine {
    pub(super) fn execute(
        &mut self,
        machine: usize,
        first: usize,
        peers: &mut dyn Peers,
        now: i64,
    ) -> Flow {
        let program = std::sync::Arc::clone(&self.program);
        let mut stack = Stack {
            values: [None; STACK_MAX],
            len: 0,
        };
        let mut pc = first;
        // Each loop yields, so no operation is executed twice; damaged code ends here.
        for _ in 0..=program.ops.len() {
            let Some(op) = program.ops.get(pc) else {
                return Flow::Failed(Cause::Code, pc);
            };
            self.outcome.operations += 1;
            match self.one(machine, *op, &mut stack, peers, now) {
                Ok(Next::Forward) => pc += 1,
                Ok(Next::At(target)) => pc = target,
                Ok(Next::Yield) => return Flow::Yielded(pc + 1),
                Ok(Next::End(value)) => return Flow::Done(value),
                Err(cause) => return Flow::Failed(cause, pc),
            }
        }
        Flow::Failed(Cause::Code, pc)
    }

    fn one(
        &mut self,
        machine: usize,
        op: Op,
        stack: &mut Stack,
        peers: &mut dyn Peers,
        now: i64,
    ) -> Result<Next, Cause> {
        match op {
            Op::Push(value) => stack.push(Some(value))?,
            Op::Load(index) => stack.push(self.variables.get(index).copied())?,
            Op::Store(index) => {
                let value = stack.value()?;
                *self.variables.get_mut(index).ok_or(Cause::Code)? = value;
            }
            Op::Read {
                component,
                port,
                element,
            } => stack.push(peers.read(component, port, element))?,
            Op::Is(component, phase) => {
                stack.push(Some(Value::Bool(peers.phase(component) == phase)))?;
            }
            Op::InState(other, state) => {
                stack.push(Some(Value::Bool(self.state_index(other) == Some(state))))?;
            }
            Op::IsStatus(other, status) => {
                stack.push(Some(Value::Bool(self.status(other) == status)))?;
            }
            Op::Has => {
                let value = stack.pop()?;
                stack.push(Some(Value::Bool(value.is_some())))?;
            }
            Op::Unary(operator) => {
                let value = stack.pop()?;
                stack.push(unary(operator, value)?)?;
            }
            Op::Binary(operator) => {
                let right = stack.pop()?;
                let left = stack.pop()?;
                stack.push(binary(operator, left, right)?)?;
            }
            Op::Widen => {
                let value = stack.pop()?;
                stack.push(value.and_then(Value::number).map(Value::Double))?;
            }
            Op::Unless(target) => {
                if stack.pop()? != Some(Value::Bool(true)) {
                    return Ok(Next::At(target));
                }
            }
            Op::Jump(target) => return Ok(Next::At(target)),
            Op::Yield => return Ok(Next::Yield),
            Op::End => {
                let value = if stack.len > 0 { stack.pop()? } else { None };
                return Ok(Next::End(value));
            }
            Op::TimedOut => return Err(Cause::TimedOut),
            Op::Raise(event) => self.raise(event),
            Op::Control(other, control) => self.control(other, control)?,
            Op::Limit(_)
            | Op::IsOver
            | Op::Write { .. }
            | Op::Set { .. }
            | Op::Request(..)
            | Op::IsSettled(_)
            | Op::Call { .. }
            | Op::IsDone => self.outside(machine, op, stack, peers, now)?,
        }
        Ok(Next::Forward)
    }

    /// Operations with time and components.
    fn outside(
        &mut self,
        machine: usize,
        op: Op,
        stack: &mut Stack,
        peers: &mut dyn Peers,
        now: i64,
    ) -> Result<(), Cause> {
        let run = self.runs.get_mut(machine).ok_or(Cause::Code)?;
        match op {
            Op::Limit(time) => run.deadline = now.saturating_add(time),
            Op::IsOver => stack.push(Some(Value::Bool(now >= run.deadline)))?,
            Op::Write { component, port } => {
                let value = stack.value()?;
                peers.write(component, port, value)?;
            }
            Op::Set {
                component,
                first,
                count,
            } => set(component, first, count, stack, peers)?,
            Op::Request(component, request) => {
                // To stop what does not run is no error, so that a final state can stop everything.
                let phase = peers.phase(component);
                let is_at_rest = !matches!(phase, Phase::Running | Phase::RunTimeError);
                if !(request == Request::Stop && is_at_rest) {
                    peers.request(component, request)?;
                }
            }
            Op::IsSettled(component) => {
                stack.push(Some(Value::Bool(peers.is_settled(component)?)))?;
            }
            Op::Call {
                component,
                operation,
                arguments,
            } => {
                let mut values = [Value::Bool(false); STACK_MAX];
                let values = values.get_mut(..arguments).ok_or(Cause::Code)?;
                for slot in values.iter_mut().rev() {
                    *slot = stack.value()?;
                }
                run.ticket = Some(peers.call(component, operation, values)?);
            }
            Op::IsDone => {
                let ticket = run.ticket.ok_or(Cause::Code)?;
                stack.push(Some(Value::Bool(peers.is_done(ticket)?)))?;
            }
            _ => return Err(Cause::Code),
        }
        Ok(())
    }
}

/// One property by its index, or several whose indexes are below their values.
fn set(
    component: usize,
    first: usize,
    count: usize,
    stack: &mut Stack,
    peers: &mut dyn Peers,
) -> Result<(), Cause> {
    if first != usize::MAX {
        let value = stack.value()?;
        return Ok(peers.set(component, &[(first, value)])?);
    }
    let mut values = [(0, Value::Bool(false)); STACK_MAX];
    let values = values.get_mut(..count).ok_or(Cause::Code)?;
    for slot in values.iter_mut().rev() {
        let value = stack.value()?;
        let Value::Int(index) = stack.value()? else {
            return Err(Cause::Code);
        };
        *slot = (usize::try_from(index).map_err(|_| Cause::Code)?, value);
    }
    Ok(peers.set(component, values)?)
}

fn unary(operator: Unary, value: Option<Value>) -> Result<Option<Value>, Cause> {
    let Some(value) = value else {
        return Ok(None);
    };
    Ok(Some(match (operator, value) {
        (Unary::Not, Value::Bool(value)) => Value::Bool(!value),
        (Unary::Negate, Value::Int(value)) => {
            Value::Int(value.checked_neg().ok_or(Cause::Overflow)?)
        }
        (Unary::Negate, Value::Double(value)) => Value::Double(-value),
        (Unary::Not, Value::Int(_) | Value::Double(_)) | (Unary::Negate, Value::Bool(_)) => {
            return Err(Cause::Code);
        }
    }))
}

/// Null makes the result null, except that `false and null` is false and `true or null` is true.
fn binary(
    operator: Binary,
    left: Option<Value>,
    right: Option<Value>,
) -> Result<Option<Value>, Cause> {
    let decides = match operator {
        Binary::And => Some(Value::Bool(false)),
        Binary::Or => Some(Value::Bool(true)),
        _ => None,
    };
    if decides.is_some() && (left == decides || right == decides) {
        return Ok(decides);
    }
    let (Some(left), Some(right)) = (left, right) else {
        return Ok(None);
    };
    match (left, right) {
        (Value::Bool(a), Value::Bool(b)) => logic(operator, a, b),
        (Value::Int(a), Value::Int(b)) => whole(operator, a, b),
        (Value::Double(a), Value::Double(b)) => real(operator, a, b),
        _ => Err(Cause::Code),
    }
    .map(Some)
}

fn logic(operator: Binary, a: bool, b: bool) -> Result<Value, Cause> {
    Ok(Value::Bool(match operator {
        Binary::And => a && b,
        Binary::Or => a || b,
        Binary::Equal => a == b,
        Binary::NotEqual => a != b,
        _ => return Err(Cause::Code),
    }))
}

fn whole(operator: Binary, a: i32, b: i32) -> Result<Value, Cause> {
    let divided = |result: Option<i32>| {
        let cause = if b == 0 {
            Cause::DivisionByZero
        } else {
            Cause::Overflow
        };
        result.map(Value::Int).ok_or(cause)
    };
    let sum = |result: Option<i32>| result.map(Value::Int).ok_or(Cause::Overflow);
    match operator {
        Binary::Add => sum(a.checked_add(b)),
        Binary::Subtract => sum(a.checked_sub(b)),
        Binary::Multiply => sum(a.checked_mul(b)),
        Binary::Divide => divided(a.checked_div(b)),
        Binary::Remainder => divided(a.checked_rem(b)),
        _ => compare(operator, a.partial_cmp(&b)),
    }
}

fn real(operator: Binary, a: f64, b: f64) -> Result<Value, Cause> {
    Ok(Value::Double(match operator {
        Binary::Add => a + b,
        Binary::Subtract => a - b,
        Binary::Multiply => a * b,
        Binary::Divide => a / b,
        Binary::Remainder => a % b,
        _ => return compare(operator, a.partial_cmp(&b)),
    }))
}

/// Compares two numbers; a NaN differs from each and is neither less nor greater.
fn compare(operator: Binary, order: Option<std::cmp::Ordering>) -> Result<Value, Cause> {
    use std::cmp::Ordering::{Equal, Greater, Less};
    Ok(Value::Bool(match operator {
        Binary::Equal => order == Some(Equal),
        Binary::NotEqual => order != Some(Equal),
        Binary::Less => order == Some(Less),
        Binary::LessEqual => matches!(order, Some(Less | Equal)),
        Binary::Greater => order == Some(Greater),
        Binary::GreaterEqual => matches!(order, Some(Greater | Equal)),
        _ => return Err(Cause::Code),
    }))
}
