//! Declarations: constants, types, variables, signals, routines and the records of robots.

use std::rc::Rc;

use super::scope::{Routine, Symbol, Value, Variable};
use super::{Block, Checked, Code, Compiler};
use crate::builtin;
use crate::code::{GLOBAL, Opcode, Scalar};
use crate::diagnostic::{Diagnostic, did_you_mean};
use crate::spec::Direction;
use crate::tree::{self, Declaration, Expr, Name, Span, TypeExpr};
use crate::types::{Array, Record, Type, WORDS_MAX};

/// Most elements of an array that can be observed.
const OBSERVED_MAX: usize = 4096;

impl Compiler<'_> {
    /// The record of each robot, with the defaults of the specification.
    pub(super) fn system_variables(&mut self, at: &Span) {
        let Some(Symbol::Type(ty)) = self.scopes.get("robot").cloned() else {
            return;
        };
        let robots: Vec<_> = self.system.robots.clone();
        for robot in robots {
            let Ok(slot) = self.slot(ty.words(), at) else {
                return;
            };
            self.robot_records.push(slot.1);
            let numbers = [
                robot.speed,
                robot.acceleration,
                robot.speed_ori,
                robot.speed_ptp,
                robot.acc_ptp,
                0.0,
                0.0,
            ];
            let frames =
                [robot.base, robot.tool].map(|six| builtin::of_frame(&builtin::of_six(&six)));
            let frames = frames.into_iter().flatten().flatten().map(f64::from_bits);
            for (at, value) in (slot.1..).zip(numbers.into_iter().chain(frames)) {
                self.emitter.real(value);
                self.emitter.store((GLOBAL, at), 1);
            }
            self.observe(&robot.name, &ty, slot.1);
            let variable = Variable {
                ty: ty.clone(),
                at: slot,
                is_reference: false,
                is_constant: false,
            };
            self.scopes.declare(&robot.name, Symbol::Variable(variable));
        }
    }

    /// Lists the components of a global variable.
    fn observe(&mut self, name: &str, ty: &Type, at: u32) {
        if self.variables.len() >= OBSERVED_MAX {
            return;
        }
        let scalar = match ty {
            Type::Int | Type::Char | Type::Text => Scalar::Int,
            Type::Real => Scalar::Real,
            Type::Bool | Type::Event => Scalar::Bool,
            Type::Record(record) => {
                for (field, ty, offset) in &record.fields {
                    self.observe(&format!("{name}.{field}"), ty, at + offset);
                }
                return;
            }
            Type::Array(array) => {
                let [(first, count)] = *array.ranges else {
                    return;
                };
                for i in 0..count.min(64) {
                    let number = i64::from(first) + i64::from(i);
                    let name = format!("{name}[{number}]");
                    self.observe(&name, &array.of, at + i * array.of.words());
                }
                return;
            }
        };
        self.variables.push(crate::code::Variable {
            name: name.to_owned(),
            at,
            scalar,
        });
    }

    fn declare(&mut self, name: &Name, symbol: Symbol) {
        if !self.scopes.declare(&name.text, symbol) {
            let cause = format!("`{}` is declared twice", name.text);
            self.error(Code::Twice, &name.at, cause);
        }
    }

    pub(super) fn declaration(&mut self, declaration: &Declaration) {
        // Each reports its errors itself, and the next ones are checked nevertheless.
        let _ = match declaration {
            Declaration::Const(name, ty, value) => self.constant(name, ty.as_ref(), value),
            Declaration::Type(name, ty) => self.type_declaration(name, ty),
            Declaration::Var(names, ty, value) => self.variables(names, ty, value.as_ref()),
            Declaration::Signal { is_out, name, of } => self.signal(*is_out, name, of),
            Declaration::Routine(routine) => self.routine(routine),
        };
    }

    fn constant(&mut self, name: &Name, ty: Option<&TypeExpr>, value: &Expr) -> Checked<()> {
        let ty = ty.map(|ty| self.resolve(ty)).transpose()?;
        let folded = self.fold(value);
        let symbol = match (folded, &ty) {
            (Some(Value::Int(value)), Some(Type::Real)) => Some(Value::Real(value as f64)),
            (Some(Value::Int(value)), Some(Type::Int) | None) => Some(Value::Int(value)),
            (Some(Value::Real(value)), Some(Type::Real) | None) => Some(Value::Real(value)),
            (Some(Value::Bool(value)), Some(Type::Bool) | None) => Some(Value::Bool(value)),
            (Some(Value::Text(value)), Some(Type::Text) | None) => Some(Value::Text(value)),
            _ => None,
        };
        if let Some(value) = symbol {
            self.declare(name, Symbol::Constant(value));
            return Ok(());
        }
        // Other values are computed when the program begins.
        self.emitter.at(&value.at);
        let ty = match ty {
            Some(ty) => {
                self.value_as(value, &ty)?;
                ty
            }
            None => self.value(value)?,
        };
        self.new_variable(name, ty, true, true)
    }

    /// Declares a variable; with `is_set`, its value is on the stack.
    fn new_variable(
        &mut self,
        name: &Name,
        ty: Type,
        is_set: bool,
        is_constant: bool,
    ) -> Checked<()> {
        let words = ty.words();
        let at = self.slot(words, &name.at)?;
        if is_set {
            self.emitter.store(at, words);
        }
        if at.0 == GLOBAL {
            self.observe(&name.text, &ty, at.1);
        }
        let variable = Variable {
            ty,
            at,
            is_reference: false,
            is_constant,
        };
        self.declare(name, Symbol::Variable(variable));
        Ok(())
    }

    fn type_declaration(&mut self, name: &Name, ty: &TypeExpr) -> Checked<()> {
        let mut resolved = self.resolve(ty)?;
        if let (Type::Record(record), TypeExpr::Record(_)) = (&resolved, ty) {
            resolved = Type::Record(Rc::new(Record {
                name: name.text.clone(),
                fields: record.fields.clone(),
                words: record.words,
            }));
        }
        self.declare(name, Symbol::Type(resolved));
        Ok(())
    }

    fn variables(&mut self, names: &[Name], ty: &TypeExpr, value: Option<&Expr>) -> Checked<()> {
        let ty = self.resolve(ty)?;
        for name in names {
            if let Some(value) = value {
                self.emitter.at(&value.at);
                self.value_as(value, &ty)?;
            }
            self.new_variable(name, ty.clone(), value.is_some(), false)?;
        }
        Ok(())
    }

    fn signal(&mut self, is_out: bool, name: &Name, of: &Expr) -> Checked<()> {
        let Some(Value::Text(wanted)) = self.fold(of) else {
            let cause = "a signal is named by a text: the name that it has in the specification";
            return Err(self.error(Code::NotConstant, &of.at, cause));
        };
        let wanted = wanted.to_ascii_lowercase();
        let signals = &self.system.signals;
        let Some(number) = signals.iter().position(|s| s.name == wanted) else {
            let hint = did_you_mean(&wanted, signals.iter().map(|s| s.name.as_str()));
            let cause = format!("the system specification has no signal `{wanted}`");
            let found = Diagnostic::new(Code::UnknownName, of.at.clone(), cause);
            return Err(self.report(found.hint(hint)));
        };
        let is_written = signals
            .get(number)
            .is_some_and(|s| s.direction == Direction::Out);
        if is_written != is_out {
            let cause = format!("signal `{wanted}` has the other direction in the specification");
            return Err(self.error(Code::WrongKind, &of.at, cause));
        }
        self.declare(name, Symbol::Signal(number, is_out));
        Ok(())
    }

    /// The type that an expression of types means.
    pub(super) fn resolve(&mut self, ty: &TypeExpr) -> Checked<Type> {
        match ty {
            TypeExpr::Named(name) => match self.scopes.get(&name.text) {
                Some(Symbol::Type(ty)) if !ty.is("robot") => Ok(ty.clone()),
                Some(_) => {
                    let cause = format!("`{}` is no type", name.text);
                    Err(self.error(Code::WrongKind, &name.at, cause))
                }
                None => Err(self.unknown(name)),
            },
            TypeExpr::Array(ranges, of) => {
                let of = self.resolve(of)?;
                let mut bounds = Vec::new();
                for (from, to) in ranges {
                    let (first, last) = (self.whole(from)?, self.whole(to)?);
                    let count = i64::from(last) - i64::from(first) + 1;
                    let Some(count) = u32::try_from(count).ok().filter(|count| *count > 0) else {
                        let at = from.at.start..to.at.end;
                        let cause = format!("the range {first}..{last} is empty");
                        return Err(self.error(Code::Range, &at, cause));
                    };
                    bounds.push((first, count));
                }
                let ty = Type::Array(Rc::new(Array { ranges: bounds, of }));
                if ty.words() > WORDS_MAX {
                    let at = ranges.first().map_or(0..0, |(from, _)| from.at.clone());
                    let cause = format!("the array takes more than {WORDS_MAX} words of 8 bytes");
                    return Err(self.error(Code::Bound, &at, cause));
                }
                Ok(ty)
            }
            TypeExpr::Record(fields) => {
                let mut placed: Vec<(String, Type, u32)> = Vec::new();
                let mut words = 0_u32;
                for (names, ty) in fields {
                    let ty = self.resolve(ty)?;
                    for name in names {
                        if placed.iter().any(|(known, ..)| *known == name.text) {
                            let cause = format!("component `{}` is declared twice", name.text);
                            self.error(Code::Twice, &name.at, cause);
                        }
                        placed.push((name.text.clone(), ty.clone(), words));
                        words = words.saturating_add(ty.words());
                        if words > WORDS_MAX {
                            let cause =
                                format!("the record takes more than {WORDS_MAX} words of 8 bytes");
                            return Err(self.error(Code::Bound, &name.at, cause));
                        }
                    }
                }
                Ok(Type::Record(Rc::new(Record {
                    name: "record".to_owned(),
                    fields: placed,
                    words,
                })))
            }
        }
    }

    fn whole(&mut self, expr: &Expr) -> Checked<i32> {
        match self.fold(expr) {
            Some(Value::Int(value)) => i32::try_from(value)
                .map_err(|_| self.error(Code::Range, &expr.at, "this number is too large")),
            _ => Err(self.error(
                Code::NotConstant,
                &expr.at,
                "the bounds of an array are whole numbers that are known when the program is compiled",
            )),
        }
    }

    #[expect(
        clippy::too_many_lines,
        reason = "one sequence: scope, parameters, body, frame"
    )]
    fn routine(&mut self, tree: &tree::Routine) -> Checked<()> {
        if self.block.locals.is_some() {
            let cause = "routines are declared in the program, not within another routine";
            return Err(self.error(Code::Misplaced, &tree.name.at, cause));
        }
        self.declare(&tree.name, Symbol::Unfinished);
        self.emitter.at(&tree.name.at);
        let around = self.emitter.jump(0);
        let entry = self.emitter.here();
        self.scopes.open();
        let outer = std::mem::take(&mut self.block);
        let depth = self.emitter.fresh();
        let mut parameters = Vec::new();
        let mut words = 0;
        for parameter in &tree.parameters {
            let Ok(ty) = self.resolve(&parameter.ty) else {
                continue;
            };
            let variable = Variable {
                ty: ty.clone(),
                at: (crate::code::LOCAL, words),
                is_reference: parameter.by_reference,
                is_constant: false,
            };
            words += if parameter.by_reference {
                1
            } else {
                ty.words()
            };
            parameters.push((parameter.by_reference, ty));
            self.declare(&parameter.name, Symbol::Variable(variable));
        }
        let result = tree.result.as_ref().map(|ty| self.resolve(ty));
        let result = result.and_then(Result::ok);
        self.block = Block {
            locals: Some(words),
            result: result.clone(),
            routine: Some(self.routines.len()),
            ..Block::default()
        };
        let enter = self.emitter.emit(Opcode::Enter, 0, 0, 0);
        for declaration in &tree.body.declarations {
            self.declaration(declaration);
        }
        self.statements(&tree.body.statements);
        self.emitter.at(&tree.name.at);
        if result.is_some() {
            self.emitter.emit(Opcode::Trap, 0, 0, 0);
        } else {
            self.emitter.emit(Opcode::Return, 0, 0, 0);
        }
        let locals = self.block.locals.unwrap_or(words) - words;
        if let Some(enter) = self.emitter.code.get_mut(enter) {
            enter.a = locals;
        }
        let deepest = self.emitter.resume(depth);
        self.scopes.close();
        let block = std::mem::replace(&mut self.block, outer);
        let routine = Rc::new(Routine {
            name: tree.name.text.clone(),
            parameters,
            result,
            entry,
            stack: deepest.saturating_add(locals),
            calls: block.calls + 1,
            threads: block.threads,
            robots: block.robots,
        });
        self.routines.push(Rc::clone(&routine));
        self.scopes
            .declare(&tree.name.text, Symbol::Routine(routine));
        self.emitter.patch(around);
        Ok(())
    }

    pub(super) fn unknown(&mut self, name: &Name) -> super::Reported {
        let builtins = builtin::ALL.iter().map(|s| s.name);
        let hint = did_you_mean(&name.text, self.scopes.names().chain(builtins));
        let cause = format!("`{}` is not declared", name.text);
        self.report(Diagnostic::new(Code::UnknownName, name.at.clone(), cause).hint(hint))
    }
}
