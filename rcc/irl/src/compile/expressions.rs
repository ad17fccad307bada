//! Expressions: their types, their constants and their code.

use std::rc::Rc;

use super::scope::{Routine, Symbol, Value};
use super::{Checked, Code, Compiler};
use crate::builtin;
use crate::code::Opcode;
use crate::diagnostic::Diagnostic;
use crate::tree::{Binary, Expr, ExprKind, Name, Span, Unary};
use crate::types::{Record, Type};

impl Compiler<'_> {
    /// The value of an expression, if it is known when the program is compiled.
    pub(super) fn fold(&self, expr: &Expr) -> Option<Value> {
        Some(match &expr.kind {
            ExprKind::Int(value) => Value::Int(*value),
            ExprKind::Real(value) => Value::Real(*value),
            ExprKind::Bool(value) => Value::Bool(*value),
            ExprKind::Text(text) => Value::Text(text.clone()),
            ExprKind::Name(name) => match self.scopes.get(name)? {
                Symbol::Constant(value) => value.clone(),
                _ => return None,
            },
            ExprKind::Unary(Unary::Negate, of) => match self.fold(of)? {
                Value::Int(value) => Value::Int(-value),
                Value::Real(value) => Value::Real(-value),
                Value::Bool(_) | Value::Text(_) => return None,
            },
            ExprKind::Unary(Unary::Not, of) => match self.fold(of)? {
                Value::Bool(value) => Value::Bool(!value),
                _ => return None,
            },
            ExprKind::Binary(operator, left, right) => {
                fold_binary(*operator, &self.fold(left)?, &self.fold(right)?)?
            }
            _ => return None,
        })
    }

    /// Emits a value of exactly this type; whole numbers become real where needed.
    pub(super) fn value_as(&mut self, expr: &Expr, ty: &Type) -> Checked<()> {
        if let (ExprKind::Tuple(parts), Type::Record(record)) = (&expr.kind, ty) {
            return self.components(record, parts, &expr.at);
        }
        if let (ExprKind::Text(text), Type::Char) = (&expr.kind, ty) {
            let mut letters = text.chars();
            if let (Some(letter), None) = (letters.next(), letters.next()) {
                self.emitter.int(i64::from(u32::from(letter)));
                return Ok(());
            }
        }
        let found = self.value(expr)?;
        if found == *ty {
            return Ok(());
        }
        if found == Type::Int && *ty == Type::Real {
            self.emitter.op(Opcode::ToReal);
            return Ok(());
        }
        let cause = format!(
            "a value of type {} is required here, this one is {}",
            ty.shown(),
            found.shown()
        );
        let mut wrong = Diagnostic::new(Code::Type, expr.at.clone(), cause);
        if found == Type::Real && *ty == Type::Int {
            wrong = wrong.hint("`round(x)` and `trunc(x)` convert");
        }
        Err(self.report(wrong))
    }

    /// Emits a value and returns its type.
    pub(super) fn value(&mut self, expr: &Expr) -> Checked<Type> {
        match &expr.kind {
            ExprKind::Int(value) => {
                self.emitter.int(*value);
                Ok(Type::Int)
            }
            ExprKind::Real(value) => {
                self.emitter.real(*value);
                Ok(Type::Real)
            }
            ExprKind::Bool(value) => {
                self.emitter.int(i64::from(*value));
                Ok(Type::Bool)
            }
            ExprKind::Text(text) => {
                let number = self.text(text);
                self.emitter.int(number);
                Ok(Type::Text)
            }
            ExprKind::Name(name) => self.named(name, expr),
            ExprKind::Field(..) | ExprKind::Index(..) => {
                let place = self.place(expr)?;
                self.read(&place);
                self.no_event(&place.ty, &expr.at)?;
                Ok(place.ty)
            }
            ExprKind::Call(name, arguments) => self.call_value(name, arguments, expr),
            ExprKind::Tuple(parts) => {
                // Three numbers are a position; a position and an orientation are a pose.
                let name = if parts.len() == 3 { "position" } else { "pose" };
                let Some(Symbol::Type(Type::Record(record))) = self.scopes.get(name).cloned()
                else {
                    return Err(self.error(Code::Type, &expr.at, "this list has no type"));
                };
                self.components(&record, parts, &expr.at)?;
                Ok(Type::Record(record))
            }
            ExprKind::Unary(operator, of) => self.unary(*operator, of, &expr.at),
            ExprKind::Binary(operator, left, right) => self.binary(*operator, left, right, expr),
        }
    }

    fn no_event(&mut self, ty: &Type, at: &Span) -> Checked<()> {
        if *ty == Type::Event {
            let cause = "an event has no value";
            let found = Diagnostic::new(Code::Type, at.clone(), cause)
                .hint("`wait for` waits for it, `signal event` sets it");
            return Err(self.report(found));
        }
        Ok(())
    }

    fn named(&mut self, name: &str, expr: &Expr) -> Checked<Type> {
        self.emitter.at(&expr.at);
        match self.scopes.get(name).cloned() {
            Some(Symbol::Constant(value)) => {
                let kind = match value {
                    Value::Int(value) => ExprKind::Int(value),
                    Value::Real(value) => ExprKind::Real(value),
                    Value::Bool(value) => ExprKind::Bool(value),
                    Value::Text(text) => ExprKind::Text(text),
                };
                let at = expr.at.clone();
                self.value(&Expr { kind, at })
            }
            Some(Symbol::Signal(number, _)) => {
                self.emitter.op(Opcode::Sync);
                let number = u32::try_from(number).unwrap_or(0);
                self.emitter.emit(Opcode::In, number, 0, 0);
                self.emitter.push(1);
                Ok(self.signal_type(number))
            }
            Some(Symbol::Routine(routine)) => self.call(&routine, &[], &expr.at),
            None if name == "timed_out" => {
                self.emitter.op(Opcode::TimedOut);
                self.emitter.push(1);
                Ok(Type::Bool)
            }
            _ => {
                let place = self.place(expr)?;
                self.no_event(&place.ty, &expr.at)?;
                self.read(&place);
                Ok(place.ty)
            }
        }
    }

    pub(super) fn signal_type(&self, number: u32) -> Type {
        use crate::spec::SignalKind;
        let signal = self.system.signals.get(number as usize);
        match signal.map(|signal| signal.kind) {
            Some(SignalKind::Analog) => Type::Real,
            Some(SignalKind::Binary) => Type::Int,
            Some(SignalKind::Digital) | None => Type::Bool,
        }
    }

    /// Emits the components of a record; those at the end may be missing where that has a meaning.
    fn components(&mut self, record: &Rc<Record>, parts: &[Expr], at: &Span) -> Checked<()> {
        let optional = match record.name.as_str() {
            "mainjoint" | "addjoint" | "joint" | "robtarget" => 1,
            _ => record.fields.len(),
        };
        if !(optional..=record.fields.len()).contains(&parts.len()) {
            let (found, needed) = (parts.len(), record.fields.len());
            let cause = format!(
                "{found} values, but {} has {needed} components",
                record.name
            );
            return Err(self.error(Code::Count, at, cause));
        }
        for (part, (_, ty, _)) in parts.iter().zip(&record.fields) {
            self.value_as(part, ty)?;
        }
        for (name, ty, _) in record.fields.iter().skip(parts.len()) {
            if name == "status" {
                self.emitter.int(-1);
                continue;
            }
            // Axes that are not given are not numbers: a robot that has them refuses the target.
            for _ in 0..ty.words() {
                match ty {
                    Type::Array(_) => self.emitter.int(0),
                    _ => self.emitter.real(f64::NAN),
                }
            }
        }
        Ok(())
    }

    fn call_value(&mut self, name: &Name, arguments: &[Expr], expr: &Expr) -> Checked<Type> {
        match self.scopes.get(&name.text).cloned() {
            Some(Symbol::Routine(routine)) => {
                if routine.result.is_none() {
                    let cause = format!("procedure `{}` has no value", name.text);
                    return Err(self.error(Code::WrongKind, &name.at, cause));
                }
                return self.call(&routine, arguments, &expr.at);
            }
            Some(Symbol::Type(Type::Record(record))) if record.name != "robot" => {
                // As post-processors write it: status and both turns of a target, one after the other.
                if let ("robtarget", [pose, status, first, second, rest @ ..]) =
                    (record.name.as_str(), arguments)
                {
                    return self.flat_target(&record, [pose, status, first, second], rest, expr);
                }
                self.components(&record, arguments, &expr.at)?;
                return Ok(Type::Record(record));
            }
            Some(Symbol::Unfinished) => {
                let cause = format!("`{}` calls itself", name.text);
                let found = Diagnostic::new(Code::Recursion, name.at.clone(), cause)
                    .hint("the memory of a program is bounded when it is compiled: use a loop");
                return Err(self.report(found));
            }
            Some(_) => {
                let cause = format!("`{}` is no function", name.text);
                return Err(self.error(Code::WrongKind, &name.at, cause));
            }
            None => {}
        }
        self.call_builtin(name, arguments, expr)
    }

    fn flat_target(
        &mut self,
        record: &Rc<Record>,
        head: [&Expr; 4],
        rest: &[Expr],
        expr: &Expr,
    ) -> Checked<Type> {
        let pose = record.fields.first().map(|(_, ty, _)| ty.clone());
        let joints = record.fields.last().map(|(_, ty, _)| ty.clone());
        let (Some(pose), Some(joints)) = (pose, joints) else {
            return Err(super::Reported);
        };
        let [first, numbers @ ..] = head;
        self.value_as(first, &pose)?;
        for number in numbers {
            self.value_as(number, &Type::Int)?;
        }
        match rest {
            [] => (0..joints.words()).for_each(|_| self.emitter.real(f64::NAN)),
            [one] => self.value_as(one, &joints)?,
            _ => {
                let cause = "a robtarget has a pose, a status, two turns and an addjoint";
                return Err(self.error(Code::Count, &expr.at, cause));
            }
        }
        Ok(Type::Record(Rc::clone(record)))
    }

    fn call_builtin(&mut self, name: &Name, arguments: &[Expr], expr: &Expr) -> Checked<Type> {
        let named = |(_, s): &(usize, &builtin::Signature)| s.name == name.text;
        let known: Vec<_> = builtin::ALL.iter().enumerate().filter(named).collect();
        let Some((mut number, mut signature)) = known.first().copied() else {
            return Err(self.unknown(name));
        };
        if signature.arguments.len() != arguments.len() {
            let needed = signature.arguments.len();
            let cause = format!(
                "{} arguments, but `{}` has {needed}",
                arguments.len(),
                name.text
            );
            return Err(self.error(Code::Count, &expr.at, cause));
        }
        if let ([only], true) = (arguments, known.len() > 1) {
            // `abs` exists for both numbers.
            let ty = self.value(only)?;
            let fitting = known.iter().find(|(_, s)| s.arguments == [ty.shown()]);
            if let Some(fitting) = fitting {
                (number, signature) = *fitting;
            } else {
                let cause = format!("`{}` has no value for {}", name.text, ty.shown());
                return Err(self.error(Code::Type, &only.at, cause));
            }
        } else {
            for (argument, ty) in arguments.iter().zip(signature.arguments) {
                let ty = self.type_named(ty);
                self.value_as(argument, &ty)?;
            }
        }
        self.emitter.at(&expr.at);
        Ok(self.builtin(number, signature))
    }

    fn type_named(&self, name: &str) -> Type {
        match self.scopes.get(name) {
            Some(Symbol::Type(ty)) => ty.clone(),
            _ => crate::types::predefined()
                .into_iter()
                .find(|(known, _)| known == name)
                .map_or(Type::Real, |(_, ty)| ty),
        }
    }

    fn builtin(&mut self, number: usize, signature: &builtin::Signature) -> Type {
        let number = u32::try_from(number).unwrap_or(u32::MAX);
        self.emitter.emit(Opcode::Builtin, number, 0, 0);
        let words = |ty: &str| u32::try_from(builtin::words_of(ty)).unwrap_or(0);
        let arguments = signature.arguments.iter().map(|ty| words(ty)).sum();
        self.emitter.pop(arguments);
        self.emitter.push(words(signature.result));
        self.type_named(signature.result)
    }

    /// Emits a call; the type of its value, `int` for none.
    pub(super) fn call(
        &mut self,
        routine: &Rc<Routine>,
        arguments: &[Expr],
        at: &Span,
    ) -> Checked<Type> {
        if arguments.len() != routine.parameters.len() {
            let (found, needed) = (arguments.len(), routine.parameters.len());
            let cause = format!("{found} arguments, but `{}` has {needed}", routine.name);
            return Err(self.error(Code::Count, at, cause));
        }
        let before = self.emitter.depth();
        for (argument, (by_reference, ty)) in arguments.iter().zip(&routine.parameters) {
            if *by_reference {
                self.reference(argument, ty)?;
            } else {
                self.value_as(argument, ty)?;
            }
        }
        self.emitter.at(at);
        let words = self.emitter.depth() - before;
        self.emitter.emit(Opcode::Call, routine.entry, words, 0);
        self.emitter.reserve(routine.stack);
        self.emitter.pop(words);
        self.emitter
            .push(routine.result.as_ref().map_or(0, Type::words));
        self.block.calls = self.block.calls.max(routine.calls);
        self.block.threads = self.block.threads.max(routine.threads);
        self.block.robots |= routine.robots;
        Ok(routine.result.clone().unwrap_or(Type::Int))
    }

    fn unary(&mut self, operator: Unary, of: &Expr, at: &Span) -> Checked<Type> {
        let ty = self.value(of)?;
        self.emitter.at(at);
        match (operator, &ty) {
            (Unary::Negate, Type::Int) => self.emitter.op(Opcode::NegInt),
            (Unary::Negate, Type::Real) => self.emitter.op(Opcode::NegReal),
            (Unary::Not, Type::Bool) => self.emitter.op(Opcode::Not),
            (Unary::Negate, ty) if ty.is("position") => return self.operator("- position", at),
            _ => {
                let symbol = if operator == Unary::Not { "not" } else { "-" };
                let cause = format!("`{symbol}` has no meaning for {}", ty.shown());
                return Err(self.error(Code::Type, at, cause));
            }
        }
        Ok(ty)
    }

    fn operator(&mut self, name: &str, at: &Span) -> Checked<Type> {
        self.emitter.at(at);
        let found = builtin::ALL
            .iter()
            .enumerate()
            .find(|(_, s)| s.name == name);
        match found {
            Some((number, signature)) => Ok(self.builtin(number, signature)),
            None => Err(self.error(Code::Type, at, "this operator does not exist")),
        }
    }

    fn binary(
        &mut self,
        operator: Binary,
        left: &Expr,
        right: &Expr,
        expr: &Expr,
    ) -> Checked<Type> {
        let mut a = self.value(left)?;
        let mut b = self.value(right)?;
        let is_division = operator == Binary::Divide;
        if a.is_number() && b.is_number() && (a != b || is_division) {
            if a == Type::Int {
                self.emitter.op(Opcode::SwapToReal);
                a = Type::Real;
            }
            if b == Type::Int {
                self.emitter.op(Opcode::ToReal);
                b = Type::Real;
            }
        }
        self.emitter.at(&expr.at);
        if let Some(ty) = self.scalar_operator(operator, &a, &b) {
            return Ok(ty);
        }
        let name = format!("{} {} {}", a.shown(), operator.symbol(), b.shown());
        if builtin::ALL.iter().any(|s| s.name == name) {
            return self.operator(&name, &expr.at);
        }
        if operator == Binary::Compose && a.is("orientation") && b.is("orientation") {
            return self.operator("orimult", &expr.at);
        }
        let cause = format!(
            "`{}` has no meaning for {} and {}",
            operator.symbol(),
            a.shown(),
            b.shown()
        );
        Err(self.error(Code::Type, &expr.at, cause))
    }

    fn scalar_operator(&mut self, operator: Binary, a: &Type, b: &Type) -> Option<Type> {
        if a != b {
            return None;
        }
        let relation = match operator {
            Binary::Equal => Some(0),
            Binary::Differs => Some(1),
            Binary::Less => Some(2),
            Binary::LessEqual => Some(3),
            Binary::Greater => Some(4),
            Binary::GreaterEqual => Some(5),
            _ => None,
        };
        if let Some(relation) = relation {
            let opcode = match a {
                Type::Real => Opcode::CompareReal,
                Type::Int | Type::Char => Opcode::CompareInt,
                Type::Bool | Type::Text if relation < 2 => Opcode::CompareInt,
                _ => return None,
            };
            self.emitter.binary(opcode, relation);
            return Some(Type::Bool);
        }
        let opcode = match (operator, a) {
            (Binary::Or, Type::Bool) => Opcode::Or,
            (Binary::Exor, Type::Bool) => Opcode::Exor,
            (Binary::And, Type::Bool) => Opcode::And,
            (Binary::Add, Type::Int) => Opcode::AddInt,
            (Binary::Subtract, Type::Int) => Opcode::SubInt,
            (Binary::Multiply, Type::Int) => Opcode::MulInt,
            (Binary::Div, Type::Int) => Opcode::DivInt,
            (Binary::Mod, Type::Int) => Opcode::ModInt,
            (Binary::Add, Type::Real) => Opcode::AddReal,
            (Binary::Subtract, Type::Real) => Opcode::SubReal,
            (Binary::Multiply, Type::Real) => Opcode::MulReal,
            (Binary::Divide, Type::Real) => Opcode::DivReal,
            _ => return None,
        };
        self.emitter.binary(opcode, 0);
        Some(a.clone())
    }
}

fn fold_binary(operator: Binary, left: &Value, right: &Value) -> Option<Value> {
    if let (Value::Int(a), Value::Int(b)) = (left, right) {
        let value = match operator {
            Binary::Add => a.checked_add(*b),
            Binary::Subtract => a.checked_sub(*b),
            Binary::Multiply => a.checked_mul(*b),
            Binary::Div => a.checked_div(*b),
            Binary::Mod => a.checked_rem(*b),
            _ => None,
        };
        let value = value.filter(|value| i32::try_from(*value).is_ok());
        if value.is_some() || operator != Binary::Divide {
            return value.map(Value::Int);
        }
    }
    let (a, b) = (left.number()?, right.number()?);
    let value = match operator {
        Binary::Add => a + b,
        Binary::Subtract => a - b,
        Binary::Multiply => a * b,
        Binary::Divide => a / b,
        _ => return None,
    };
    value.is_finite().then_some(Value::Real(value))
}
