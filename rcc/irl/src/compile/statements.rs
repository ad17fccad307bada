//! Statements other than motions.

use super::scope::{Symbol, Value};
use super::{Block, Checked, Code, Compiler};
use crate::code::Opcode;
use crate::diagnostic::Diagnostic;
use crate::tree::{Expr, ExprKind, Name, Span, Statement, StatementKind};
use crate::types::Type;

impl Compiler<'_> {
    pub(super) fn statements(&mut self, statements: &[Statement]) {
        for statement in statements {
            let depth = self.emitter.depth();
            // Each reports its errors itself, and the next ones are checked nevertheless.
            let _ = self.statement(statement);
            let now = self.emitter.depth();
            self.emitter.pop(now.saturating_sub(depth));
        }
    }

    fn statement(&mut self, statement: &Statement) -> Checked<()> {
        let at = &statement.at;
        self.emitter.at(at);
        match &statement.kind {
            StatementKind::Move(motion) => self.motion(motion, at),
            StatementKind::Assign(to, value) => self.assign(to, value),
            StatementKind::Call(name, arguments) => self.call_statement(name, arguments, at),
            StatementKind::Seq(statements) => {
                self.statements(statements);
                Ok(())
            }
            StatementKind::Par(branches) => self.par(branches, at),
            StatementKind::If(branches, otherwise) => self.if_(branches, otherwise),
            StatementKind::Case(of, branches, default) => {
                self.case(of, branches, default.as_deref(), at)
            }
            StatementKind::For {
                variable,
                from,
                to,
                step,
                body,
            } => self.for_(variable, [Some(from), Some(to), step.as_ref()], body, at),
            StatementKind::While(condition, body) => {
                let start = self.emitter.here();
                self.value_as(condition, &Type::Bool)?;
                let end = self.emitter.unless();
                self.loop_body(body);
                self.emitter.jump(start);
                self.emitter.patch(end);
                self.end_loop();
                Ok(())
            }
            StatementKind::Repeat(body, condition) => {
                let start = self.emitter.here();
                self.loop_body(body);
                self.emitter.at(&condition.at);
                let checked = self.value_as(condition, &Type::Bool);
                let again = self.emitter.unless();
                if let Some(jump) = self.emitter.code.get_mut(again) {
                    jump.a = start;
                }
                self.end_loop();
                checked
            }
            StatementKind::WaitSec(time) => {
                self.emitter.op(Opcode::Sync);
                self.value_as(time, &Type::Real)?;
                self.emitter.op(Opcode::Wait);
                self.emitter.pop(1);
                Ok(())
            }
            StatementKind::WaitFor(condition, timeout) => {
                self.wait_for(condition, timeout.as_ref(), at)
            }
            StatementKind::SignalEvent(name) => self.signal_event(name),
            StatementKind::Return(value) => self.return_(value.as_ref(), at),
            StatementKind::Exit => self.exit(at),
            StatementKind::Pause => {
                self.emitter.op(Opcode::Sync);
                self.emitter.op(Opcode::Pause);
                Ok(())
            }
            StatementKind::Halt => {
                self.emitter.op(Opcode::Halt);
                Ok(())
            }
        }
    }

    fn assign(&mut self, to: &Expr, value: &Expr) -> Checked<()> {
        if let ExprKind::Name(name) = &to.kind
            && let Some(Symbol::Signal(number, is_written)) = self.scopes.get(name).cloned()
        {
            if !is_written {
                let cause = format!("`{name}` is an input");
                return Err(self.error(Code::ReadOnly, &to.at, cause));
            }
            let number = u32::try_from(number).unwrap_or(0);
            let ty = self.signal_type(number);
            self.value_as(value, &ty)?;
            self.fits_signal(number, name, value)?;
            self.emitter.at(&to.at);
            self.emitter.op(Opcode::Sync);
            self.emitter.emit(Opcode::Out, number, 0, 0);
            self.emitter.pop(1);
            return Ok(());
        }
        let place = self.writable(to)?;
        if place.ty == Type::Event || place.ty.is("robot") {
            let cause = format!("a value of type {} cannot be assigned", place.ty.shown());
            return Err(self.error(Code::ReadOnly, &to.at, cause));
        }
        self.value_as(value, &place.ty)?;
        self.emitter.at(&to.at);
        let words = place.ty.words();
        match place.at {
            Some(at) => self.emitter.store(at, words),
            None => {
                self.emitter.emit(Opcode::Put, words, 0, 0);
                self.emitter.pop(words + 1);
            }
        }
        Ok(())
    }

    /// Whether a constant fits the bits of an output.
    fn fits_signal(&mut self, number: u32, name: &str, value: &Expr) -> Checked<()> {
        let signal = self.system.signals.get(number as usize);
        let bits = signal.map_or(0, |signal| signal.bits);
        match self.fold(value) {
            Some(Value::Int(constant)) if bits > 0 && constant >> bits.min(62) != 0 => {
                let most = (1_i64 << bits.min(62)) - 1;
                let cause = format!("{constant} does not fit `{name}`, which takes 0 to {most}");
                Err(self.error(Code::Range, &value.at, cause))
            }
            _ => Ok(()),
        }
    }

    fn call_statement(&mut self, name: &Name, arguments: &[Expr], at: &Span) -> Checked<()> {
        match self.scopes.get(&name.text).cloned() {
            Some(Symbol::Routine(routine)) if routine.result.is_none() => {
                self.call(&routine, arguments, at).map(|_| ())
            }
            Some(Symbol::Routine(_)) => {
                let cause = format!("the value of function `{}` is not used", name.text);
                Err(self.error(Code::WrongKind, at, cause))
            }
            Some(Symbol::Unfinished) => {
                let cause = format!("`{}` calls itself", name.text);
                let found = Diagnostic::new(Code::Recursion, name.at.clone(), cause)
                    .hint("the memory of a program is bounded when it is compiled: use a loop");
                Err(self.report(found))
            }
            Some(_) => {
                let cause = format!("`{}` is no procedure", name.text);
                Err(self.error(Code::WrongKind, &name.at, cause))
            }
            None => Err(self.unknown(name)),
        }
    }

    fn if_(&mut self, branches: &[(Expr, Vec<Statement>)], otherwise: &[Statement]) -> Checked<()> {
        let mut ends = Vec::new();
        let mut result = Ok(());
        for (condition, statements) in branches {
            self.emitter.at(&condition.at);
            let checked = self.value_as(condition, &Type::Bool);
            result = result.and(checked);
            let next = self.emitter.unless();
            self.statements(statements);
            ends.push(self.emitter.jump(0));
            self.emitter.patch(next);
        }
        self.statements(otherwise);
        ends.into_iter().for_each(|end| self.emitter.patch(end));
        result
    }

    fn case(
        &mut self,
        of: &Expr,
        branches: &[(Vec<Expr>, Vec<Statement>)],
        default: Option<&[Statement]>,
        at: &Span,
    ) -> Checked<()> {
        let ty = self.value(of)?;
        if !matches!(ty, Type::Int | Type::Char) {
            let cause = format!(
                "`case` needs a value of type int or char, this one is {}",
                ty.shown()
            );
            return Err(self.error(Code::Type, &of.at, cause));
        }
        let slot = self.slot(1, at)?;
        self.emitter.store(slot, 1);
        let mut ends = Vec::new();
        let mut labels_seen: Vec<i64> = Vec::new();
        for (labels, statements) in branches {
            for (number, label) in labels.iter().enumerate() {
                let value = match (self.fold(label), &ty) {
                    (Some(Value::Int(value)), Type::Int) => value,
                    (Some(Value::Text(text)), Type::Char) if text.chars().count() == 1 => {
                        text.chars().next().map_or(0, |c| i64::from(u32::from(c)))
                    }
                    _ => {
                        let cause = format!("a constant of type {} is required here", ty.shown());
                        self.error(Code::NotConstant, &label.at, cause);
                        continue;
                    }
                };
                if labels_seen.contains(&value) {
                    let cause = format!("`when {value}` is given twice");
                    self.error(Code::Twice, &label.at, cause);
                }
                labels_seen.push(value);
                self.emitter.load(slot, 1);
                self.emitter.int(value);
                self.emitter.binary(Opcode::CompareInt, 0);
                if number > 0 {
                    self.emitter.binary(Opcode::Or, 0);
                }
            }
            let next = self.emitter.unless();
            self.statements(statements);
            ends.push(self.emitter.jump(0));
            self.emitter.patch(next);
        }
        self.statements(default.unwrap_or_default());
        ends.into_iter().for_each(|end| self.emitter.patch(end));
        Ok(())
    }

    /// `parts` are the first value, the last one and the step.
    #[expect(
        clippy::too_many_lines,
        reason = "one sequence: values, test, body, step"
    )]
    fn for_(
        &mut self,
        variable: &Name,
        parts: [Option<&Expr>; 3],
        body: &[Statement],
        at: &Span,
    ) -> Checked<()> {
        let name = Expr {
            kind: ExprKind::Name(variable.text.clone()),
            at: variable.at.clone(),
        };
        let place = self.writable(&name)?;
        let (Some(counter), true) = (place.at, place.ty.is_number()) else {
            let cause =
                "the variable of a loop is one of type int or real, and no out or inout parameter";
            return Err(self.error(Code::Type, &variable.at, cause));
        };
        let ty = place.ty;
        let is_real = ty == Type::Real;
        let [from, to, step] = parts;
        if let Some(from) = from {
            self.value_as(from, &ty)?;
        }
        let last = self.slot(1, at)?;
        let each = self.slot(1, at)?;
        if let Some(to) = to {
            self.value_as(to, &ty)?;
            self.emitter.store(last, 1);
        }
        if step
            .and_then(|step| self.fold(step)?.number())
            .is_some_and(|step| step.abs() < f64::MIN_POSITIVE)
        {
            return Err(self.error(Code::Range, at, "a step of 0 never ends the loop"));
        }
        match step {
            Some(step) => self.value_as(step, &ty)?,
            None if is_real => self.emitter.real(1.0),
            None => self.emitter.int(1),
        }
        self.emitter.store(each, 1);
        self.emitter.store(counter, 1);
        let compare = if is_real {
            Opcode::CompareReal
        } else {
            Opcode::CompareInt
        };
        let start = self.emitter.here();
        // Upwards while not beyond the end, or downwards.
        for (number, [direction, beyond]) in [[5, 3], [2, 5]].into_iter().enumerate() {
            self.emitter.load(each, 1);
            if is_real {
                self.emitter.real(0.0);
            } else {
                self.emitter.int(0);
            }
            self.emitter.binary(compare, direction);
            self.emitter.load(counter, 1);
            self.emitter.load(last, 1);
            self.emitter.binary(compare, beyond);
            self.emitter.binary(Opcode::And, 0);
            if number > 0 {
                self.emitter.binary(Opcode::Or, 0);
            }
        }
        let end = self.emitter.unless();
        self.loop_body(body);
        self.emitter.at(at);
        self.emitter.load(counter, 1);
        self.emitter.load(each, 1);
        let add = if is_real {
            Opcode::AddReal
        } else {
            Opcode::AddInt
        };
        self.emitter.binary(add, 0);
        self.emitter.store(counter, 1);
        self.emitter.jump(start);
        self.emitter.patch(end);
        self.end_loop();
        Ok(())
    }

    fn loop_body(&mut self, body: &[Statement]) {
        self.block.loops.push(Vec::new());
        self.statements(body);
    }

    fn end_loop(&mut self) {
        for jump in self.block.loops.pop().unwrap_or_default() {
            self.emitter.patch(jump);
        }
    }

    fn exit(&mut self, at: &Span) -> Checked<()> {
        let jump = self.emitter.jump(0);
        match self.block.loops.last_mut() {
            Some(jumps) => {
                jumps.push(jump);
                Ok(())
            }
            None => {
                let found = Diagnostic::new(
                    Code::Misplaced,
                    at.clone(),
                    "`exit` leaves a loop, and this is none",
                )
                .hint("`return` leaves a routine, `halt` ends the program");
                Err(self.report(found))
            }
        }
    }

    fn return_(&mut self, value: Option<&Expr>, at: &Span) -> Checked<()> {
        if self.block.is_branch {
            let cause = "`return` cannot leave a branch of `par`";
            return Err(self.error(Code::Misplaced, at, cause));
        }
        if self.block.routine.is_none() {
            // It ends the program, as post-processors write it.
            self.emitter.op(Opcode::Sync);
            self.emitter.op(Opcode::Halt);
            return match value {
                None => Ok(()),
                Some(value) => {
                    Err(self.error(Code::Misplaced, &value.at, "a program returns no value"))
                }
            };
        }
        match (self.block.result.clone(), value) {
            (None, None) => {
                self.emitter.op(Opcode::Return);
                Ok(())
            }
            (Some(ty), Some(value)) => {
                self.value_as(value, &ty)?;
                self.emitter.at(at);
                self.emitter.emit(Opcode::Return, ty.words(), 0, 0);
                self.emitter.pop(ty.words());
                Ok(())
            }
            (Some(ty), None) => {
                let cause = format!("`return` needs a value of type {} here", ty.shown());
                Err(self.error(Code::Type, at, cause))
            }
            (None, Some(value)) => {
                Err(self.error(Code::Type, &value.at, "a procedure returns no value"))
            }
        }
    }

    fn signal_event(&mut self, name: &Name) -> Checked<()> {
        let expr = Expr {
            kind: ExprKind::Name(name.text.clone()),
            at: name.at.clone(),
        };
        let place = self.place(&expr)?;
        if place.ty != Type::Event {
            let cause = format!("`{}` is no event", name.text);
            let found = Diagnostic::new(Code::Type, name.at.clone(), cause)
                .hint("declare it: `var name: event;`");
            return Err(self.report(found));
        }
        self.emitter.op(Opcode::Sync);
        match place.at {
            Some(at) => {
                self.emitter.int(1);
                self.emitter.store(at, 1);
            }
            None => {
                self.emitter.int(1);
                self.emitter.emit(Opcode::Put, 1, 0, 0);
                self.emitter.pop(2);
            }
        }
        Ok(())
    }

    /// Whether an expression is a variable of type event.
    fn is_event(&self, expr: &Expr) -> bool {
        matches!(&expr.kind, ExprKind::Name(name)
            if matches!(self.scopes.get(name), Some(Symbol::Variable(v)) if v.ty == Type::Event))
    }

    fn wait_for(&mut self, condition: &Expr, timeout: Option<&Expr>, at: &Span) -> Checked<()> {
        self.emitter.op(Opcode::Sync);
        self.emitter.op(Opcode::SetTimedOut);
        let deadline = match timeout {
            None => None,
            Some(timeout) => {
                self.value_as(timeout, &Type::Real)?;
                self.emitter.op(Opcode::Now);
                self.emitter.push(1);
                self.emitter.binary(Opcode::AddReal, 0);
                let slot = self.slot(1, at)?;
                self.emitter.store(slot, 1);
                Some(slot)
            }
        };
        let start = self.emitter.here();
        if self.is_event(condition) {
            let place = self.place(condition)?;
            if let Some(at) = place.at {
                self.emitter.address(at);
            }
            self.emitter.op(Opcode::Take);
        } else {
            self.value_as(condition, &Type::Bool)?;
        }
        let wait = self.emitter.unless();
        let mut ends = vec![self.emitter.jump(0)];
        self.emitter.patch(wait);
        if let Some(deadline) = deadline {
            self.emitter.op(Opcode::Now);
            self.emitter.push(1);
            self.emitter.load(deadline, 1);
            self.emitter.binary(Opcode::CompareReal, 5);
            let wait = self.emitter.unless();
            self.emitter.emit(Opcode::SetTimedOut, 1, 0, 0);
            ends.push(self.emitter.jump(0));
            self.emitter.patch(wait);
        }
        self.emitter.op(Opcode::Yield);
        self.emitter.jump(start);
        ends.into_iter().for_each(|end| self.emitter.patch(end));
        Ok(())
    }

    fn par(&mut self, branches: &[Statement], at: &Span) -> Checked<()> {
        self.emitter.op(Opcode::Sync);
        let forks: Vec<usize> = branches
            .iter()
            .map(|_| self.emitter.emit(Opcode::Fork, 0, 0, 0))
            .collect();
        self.emitter.op(Opcode::Join);
        let around = self.emitter.jump(0);
        let (mut moved, mut threads) = (0, 0);
        let mut shared = None;
        for (branch, fork) in branches.iter().zip(forks) {
            self.emitter.patch(fork);
            let depth = self.emitter.fresh();
            let inner = Block {
                locals: self.block.locals,
                routine: self.block.routine,
                is_branch: true,
                ..Block::default()
            };
            let outer = std::mem::replace(&mut self.block, inner);
            self.statements(std::slice::from_ref(branch));
            self.emitter.op(Opcode::Sync);
            self.emitter.op(Opcode::End);
            let inner = std::mem::replace(&mut self.block, outer);
            let deepest = self.emitter.resume(depth);
            self.stack = self.stack.max(deepest);
            self.block.locals = inner.locals;
            self.block.calls = self.block.calls.max(inner.calls);
            threads += inner.threads + 1;
            if moved & inner.robots != 0 {
                shared.get_or_insert_with(|| (branch.at.clone(), moved & inner.robots));
            }
            moved |= inner.robots;
        }
        self.emitter.patch(around);
        self.block.threads = self.block.threads.max(threads);
        self.block.robots |= moved;
        let Some((place, robots)) = shared else {
            return Ok(());
        };
        let robot = self.system.robots.get(robots.trailing_zeros() as usize);
        let name = robot.map_or("", |robot| robot.name.as_str());
        let cause = format!("another branch of this `par` moves robot `{name}` too");
        let found = Diagnostic::new(Code::SharedRobot, place, cause)
            .hint("one branch moves a robot; join its motions by `seq … endseq`");
        let _ = at;
        Err(self.report(found))
    }
}
