//! Variables and their components: where they are, and whether they can be assigned.

use super::scope::{Symbol, Value};
use super::{Checked, Code, Compiler};
use crate::code::Opcode;
use crate::diagnostic::{Diagnostic, did_you_mean};
use crate::tree::{Expr, ExprKind, Name};
use crate::types::Type;

/// A variable or a component of one.
#[derive(Debug)]
pub(super) struct Place {
    pub(super) ty: Type,
    /// Scope and word; `None` if its address is on the stack.
    pub(super) at: Option<(u32, u32)>,
    pub(super) is_constant: bool,
    /// Whether it is read from a robot, which must be at rest then.
    pub(super) is_measured: bool,
}

impl Compiler<'_> {
    /// Finds a place, and emits its address if that is computed.
    pub(super) fn place(&mut self, expr: &Expr) -> Checked<Place> {
        match &expr.kind {
            ExprKind::Name(text) => {
                let name = Name {
                    text: text.clone(),
                    at: expr.at.clone(),
                };
                match self.scopes.get(text).cloned() {
                    Some(Symbol::Variable(variable)) => {
                        if variable.is_reference {
                            self.emitter.load(variable.at, 1);
                        }
                        Ok(Place {
                            ty: variable.ty,
                            at: (!variable.is_reference).then_some(variable.at),
                            is_constant: variable.is_constant,
                            is_measured: false,
                        })
                    }
                    Some(_) => {
                        let cause = format!("`{text}` is no variable");
                        Err(self.error(Code::WrongKind, &expr.at, cause))
                    }
                    None => Err(self.unknown(&name)),
                }
            }
            ExprKind::Field(of, field) => self.field(of, field),
            ExprKind::Index(of, indices) => self.index(of, indices, expr),
            _ => {
                let cause = "a variable is required here, not an expression";
                Err(self.error(Code::WrongKind, &expr.at, cause))
            }
        }
    }

    fn field(&mut self, of: &Expr, field: &Name) -> Checked<Place> {
        let place = self.place(of)?;
        let Type::Record(record) = &place.ty else {
            let cause = format!("{} has no components", place.ty.shown());
            return Err(self.error(Code::Type, &field.at, cause));
        };
        let found = record.fields.iter().find(|(name, ..)| *name == field.text);
        let Some((_, ty, offset)) = found else {
            let known = record.fields.iter().map(|(name, ..)| name.as_str());
            let hint = did_you_mean(&field.text, known);
            let cause = format!("{} has no component `{}`", record.name, field.text);
            let found = Diagnostic::new(Code::UnknownName, field.at.clone(), cause);
            return Err(self.report(found.hint(hint)));
        };
        let is_actual = record.name == "robot" && field.text.ends_with("_act");
        if place.at.is_none() && *offset > 0 {
            self.emitter.int(i64::from(*offset));
            self.emitter.binary(Opcode::AddInt, 0);
        }
        Ok(Place {
            ty: ty.clone(),
            at: place.at.map(|(scope, at)| (scope, at + offset)),
            is_constant: place.is_constant || is_actual,
            is_measured: place.is_measured || is_actual,
        })
    }

    fn index(&mut self, of: &Expr, indices: &[Expr], whole: &Expr) -> Checked<Place> {
        let mut place = self.place(of)?;
        let Type::Array(array) = &place.ty else {
            let cause = format!("{} has no elements", place.ty.shown());
            return Err(self.error(Code::Type, &of.at, cause));
        };
        let array = std::rc::Rc::clone(array);
        if array.ranges.len() != indices.len() {
            let (found, needed) = (indices.len(), array.ranges.len());
            let cause = format!("{found} indices, but the array has {needed}");
            return Err(self.error(Code::Count, &whole.at, cause));
        }
        let mut stride = place.ty.words();
        for (index, (first, count)) in indices.iter().zip(&array.ranges) {
            stride /= (*count).max(1);
            let constant = match self.fold(index) {
                Some(Value::Int(value)) => {
                    let offset = value - i64::from(*first);
                    let offset = u32::try_from(offset).ok().filter(|offset| offset < count);
                    let Some(offset) = offset else {
                        let last = i64::from(*first) + i64::from(*count) - 1;
                        let cause =
                            format!("index {value}; this array goes from {first} to {last}");
                        return Err(self.error(Code::Range, &index.at, cause));
                    };
                    Some(offset * stride)
                }
                _ => None,
            };
            if let (Some(offset), Some((scope, at))) = (constant, place.at) {
                place.at = Some((scope, at + offset));
                continue;
            }
            if let Some(at) = place.at.take() {
                self.emitter.address(at);
            }
            self.value_as(index, &Type::Int)?;
            self.emitter.at(&index.at);
            self.emitter
                .emit(Opcode::Index, first.cast_unsigned(), *count, stride);
            self.emitter.pop(1);
        }
        place.ty = array.of.clone();
        Ok(place)
    }

    /// Emits the value of a place.
    pub(super) fn read(&mut self, place: &Place) {
        let words = place.ty.words();
        match place.at {
            Some(at) => {
                if place.is_measured {
                    self.emitter.op(Opcode::Sync);
                }
                self.emitter.load(at, words);
            }
            None => {
                self.emitter.emit(Opcode::Fetch, words, 0, 0);
                self.emitter.pop(1);
                self.emitter.push(words);
            }
        }
    }

    /// A place that can be assigned.
    pub(super) fn writable(&mut self, expr: &Expr) -> Checked<Place> {
        let place = self.place(expr)?;
        if place.is_constant {
            let cause = if place.is_measured {
                "the actual position of a robot cannot be assigned"
            } else {
                "a constant cannot be assigned"
            };
            return Err(self.error(Code::ReadOnly, &expr.at, cause));
        }
        Ok(place)
    }

    /// Emits the address of a variable.
    pub(super) fn reference(&mut self, expr: &Expr, ty: &Type) -> Checked<()> {
        let place = self.writable(expr)?;
        if let Some(at) = place.at {
            self.emitter.address(at);
        }
        if place.ty == *ty {
            return Ok(());
        }
        let cause = format!(
            "a variable of type {} is required here, this one is {}",
            ty.shown(),
            place.ty.shown()
        );
        Err(self.error(Code::Type, &expr.at, cause))
    }
}
