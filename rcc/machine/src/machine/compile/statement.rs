//! Statements. A statement that may take several steps is refused in programs that must finish in one, and a loop must
//! yield in each turn.

use super::Compiler;
use crate::component::{Declared, Operation};
use crate::diagnostic::suggest;
use crate::lifecycle::Request;
use crate::machine::code::{Control, Op};
use crate::machine::tree::{Block, Expression, Member, Statement, StatementKind, Within};
use crate::syntax::Name;
use crate::value::{Kind, Value};

impl Compiler<'_> {
    pub(super) fn block(&mut self, block: &Block, may_yield: bool) {
        for statement in block {
            self.at = statement.at.clone();
            self.depth = 0;
            self.statement(statement, may_yield);
        }
    }

    #[expect(clippy::too_many_lines, reason = "one arm for each statement")]
    fn statement(&mut self, statement: &Statement, may_yield: bool) {
        if !may_yield && takes_steps(&statement.kind) {
            let cause = "this statement cannot finish in one step";
            let hint = "exit, handle, transition and failure programs finish in one step; move it to entry or run";
            self.found.error(statement.at.clone(), cause, hint);
        }
        match &statement.kind {
            StatementKind::Assign(name, value) => {
                let Some(variable) = self.variable(name) else {
                    return;
                };
                let declared = self.program.variables.get(variable);
                let (kind, is_parameter) =
                    declared.map_or((Kind::Bool, false), |v| (v.kind, v.is_parameter));
                if is_parameter {
                    let cause = format!("`{}` is a parameter and does not change", name.text);
                    self.found
                        .error(name.at.clone(), cause, "declare it as `var`");
                }
                self.typed(value, kind);
                self.emit(Op::Store(variable));
            }
            StatementKind::Write(member, value) => self.write(member, value),
            StatementKind::Set(name, values) => self.set(name, values),
            StatementKind::Request(verb, target) => self.request(verb, target),
            StatementKind::Call(operation, arguments) => {
                self.call(operation, arguments);
            }
            StatementKind::Do(operation, arguments, until, within) => {
                self.call(operation, arguments);
                self.limit(within);
                let top = self.emit(Op::Yield);
                match until {
                    Some(condition) => self.typed(condition, Kind::Bool),
                    None => {
                        self.emit(Op::IsDone);
                    }
                }
                self.until(top, within, may_yield);
            }
            StatementKind::Wait(time) => {
                self.emit(Op::Limit(*time));
                let top = self.emit(Op::Yield);
                self.emit(Op::IsOver);
                self.emit(Op::Unless(top));
            }
            StatementKind::WaitFor(condition, within) => {
                self.limit(within);
                let skip = self.emit(Op::Jump(0));
                let top = self.emit(Op::Yield);
                self.land(skip);
                self.typed(condition, Kind::Bool);
                self.until(top, within, may_yield);
            }
            StatementKind::If(condition, then, otherwise) => {
                self.typed(condition, Kind::Bool);
                let skip = self.emit(Op::Unless(0));
                self.block(then, may_yield);
                if otherwise.is_empty() {
                    self.land(skip);
                } else {
                    let end = self.emit(Op::Jump(0));
                    self.land(skip);
                    self.block(otherwise, may_yield);
                    self.land(end);
                }
            }
            StatementKind::While(condition, body) => {
                if !always_yields(body) {
                    let cause = "this loop may not finish in a step";
                    let hint = "add `yield;` or a wait that every turn reaches";
                    self.found.error(condition.at.clone(), cause, hint);
                }
                let top = self.program.ops.len();
                self.typed(condition, Kind::Bool);
                let end = self.emit(Op::Unless(0));
                self.block(body, may_yield);
                self.emit(Op::Jump(top));
                self.land(end);
            }
            StatementKind::Yield => {
                self.emit(Op::Yield);
            }
            StatementKind::Raise(name) => {
                if let Some(event) = self.event(name) {
                    self.emit(Op::Raise(event));
                }
            }
        }
    }

    fn limit(&mut self, within: &Within) {
        if let Some((time, _)) = within {
            self.emit(Op::Limit(*time));
        }
    }

    /// Continues if the value on the stack is true, else at `top`, until the time limit.
    fn until(&mut self, top: usize, within: &Within, may_yield: bool) {
        let Some((_, otherwise)) = within else {
            self.emit(Op::Unless(top));
            return;
        };
        let unless = self.emit(Op::Unless(0));
        let end = self.emit(Op::Jump(0));
        self.land(unless);
        self.emit(Op::IsOver);
        self.emit(Op::Unless(top));
        match otherwise {
            Some(block) => self.block(block, may_yield),
            None => {
                self.emit(Op::TimedOut);
            }
        }
        self.land(end);
    }

    fn write(&mut self, member: &Member, value: &Expression) {
        let Some(component) = self.member(&member.owner) else {
            return;
        };
        let Some(declared) = self.program.members.get(component) else {
            return;
        };
        let name = &member.name.text;
        let properties = &declared.component.properties;
        if let Some(index) = properties.iter().position(|p| p.declared.name == *name) {
            if member.index.is_some() {
                let hint = "set the whole array in a property file";
                self.found
                    .error(member.at(), "an element of a property cannot be set", hint);
            }
            self.property(component, index, &member.name, value);
            self.emit(Op::Set {
                component,
                first: index,
                count: 1,
            });
            return;
        }
        let ports = &declared.component.ports;
        let Some(port) = ports.iter().position(|p| p.declared.name == *name) else {
            let known = properties.iter().map(|p| p.declared.name.as_str());
            let known = known.chain(ports.iter().map(|p| p.declared.name.as_str()));
            let cause = format!("`{}` has no property or port `{name}`", member.owner.text);
            let hint = suggest(name, known);
            self.found.error(member.name.at.clone(), cause, hint);
            return;
        };
        let Some(declared) = ports.get(port).cloned() else {
            return;
        };
        let is_connected = self
            .program
            .connections
            .iter()
            .any(|c| c.to == (component, port));
        if declared.is_output || is_connected || declared.declared.shape.len.is_some() {
            let cause = format!("port `{name}` cannot be written by the machine");
            let hint = "a machine writes in ports of single values that are not connected";
            self.found.error(member.name.at.clone(), cause, hint);
        }
        self.typed_as(
            value,
            declared.declared.shape.kind,
            declared.declared.quantity,
        );
        self.emit(Op::Write { component, port });
    }

    /// Pushes the index of a property and its value.
    fn property(&mut self, component: usize, index: usize, name: &Name, value: &Expression) {
        let Some(member) = self.program.members.get(component) else {
            return;
        };
        let Some(property) = member.component.properties.get(index) else {
            return;
        };
        let Declared {
            shape,
            quantity,
            range,
            ..
        } = property.declared;
        if shape.kind == Kind::Text || shape.len.is_some() {
            let cause = format!("property `{}` is {shape}", name.text);
            let hint = "a machine sets single values; use a property file for others";
            self.found.error(name.at.clone(), cause, hint);
            return;
        }
        let before = self.program.ops.len();
        self.typed_as(value, shape.kind, quantity);
        let constant = match self.program.ops.get(before..) {
            Some([Op::Push(value)] | [Op::Push(value), Op::Widen]) => value.number(),
            _ => None,
        };
        if let (Some(number), Some((low, high))) = (constant, range)
            && !(low..=high).contains(&number)
        {
            let cause = format!(
                "{number} is not in the range {low} to {high} of `{}`",
                name.text
            );
            self.found
                .error(value.at.clone(), cause, "write a value of that range");
        }
    }

    fn set(&mut self, name: &Name, values: &[(Name, Expression)]) {
        let Some(component) = self.member(name) else {
            return;
        };
        for (count, (property, value)) in values.iter().enumerate() {
            let Some(member) = self.program.members.get(component) else {
                return;
            };
            let properties = &member.component.properties;
            let Some(index) = properties
                .iter()
                .position(|p| p.declared.name == property.text)
            else {
                let hint = suggest(
                    &property.text,
                    properties.iter().map(|p| p.declared.name.as_str()),
                );
                let cause = format!("`{}` has no property `{}`", name.text, property.text);
                self.found.error(property.at.clone(), cause, hint);
                continue;
            };
            if values
                .iter()
                .take(count)
                .any(|(earlier, _)| earlier.text == property.text)
            {
                let cause = format!("`{}` is set twice", property.text);
                self.found
                    .error(property.at.clone(), cause, "remove one of them");
            }
            // The index is pushed below its value.
            let number = i32::try_from(index).unwrap_or(0);
            self.emit(Op::Push(Value::Int(number)));
            self.depth += 1;
            self.property(component, index, property, value);
        }
        self.depth = 0;
        if values.len() * 2 > crate::machine::code::STACK_MAX / 2 {
            let hint = "set at most 16 properties at once";
            self.found
                .error(self.at.clone(), "these are too many properties", hint);
        }
        // `first` is out of range: the indexes are on the stack.
        self.emit(Op::Set {
            component,
            first: usize::MAX,
            count: values.len(),
        });
    }

    fn request(&mut self, verb: &Name, target: &Name) {
        if self
            .program
            .machines
            .iter()
            .any(|machine| machine.name == target.text)
        {
            let Some(machine) = self.machine_of(target) else {
                return;
            };
            let control = Control::ALL
                .into_iter()
                .find(|control| control.word() == verb.text);
            match control {
                Some(control) => {
                    self.emit(Op::Control(machine, control));
                }
                None => {
                    let cause = format!("a machine cannot {}", verb.text);
                    let hint = suggest(&verb.text, Control::ALL.map(Control::word));
                    self.found.error(verb.at.clone(), cause, hint);
                }
            }
            return;
        }
        let Some(component) = self.member(target) else {
            return;
        };
        let requests = [
            Request::Start,
            Request::Stop,
            Request::Configure,
            Request::Cleanup,
            Request::Recover,
        ];
        let Some(request) = requests
            .into_iter()
            .find(|request| request.word() == verb.text)
        else {
            let cause = format!("a component cannot {}", verb.text);
            let hint = suggest(&verb.text, requests.map(Request::word));
            self.found.error(verb.at.clone(), cause, hint);
            return;
        };
        self.emit(Op::Request(component, request));
        if matches!(request, Request::Configure | Request::Cleanup) {
            let top = self.emit(Op::Yield);
            self.emit(Op::IsSettled(component));
            self.emit(Op::Unless(top));
        }
    }

    fn call(&mut self, member: &Member, arguments: &[Expression]) {
        let Some(component) = self.member(&member.owner) else {
            return;
        };
        let Some(declared) = self.program.members.get(component) else {
            return;
        };
        let operations = &declared.component.operations;
        let name = &member.name.text;
        let Some(operation) = operations
            .iter()
            .position(|operation| operation.name == *name)
        else {
            let hint = suggest(
                name,
                operations.iter().map(|operation| operation.name.as_str()),
            );
            let cause = format!("`{}` has no operation `{name}`", member.owner.text);
            self.found.error(member.name.at.clone(), cause, hint);
            return;
        };
        let Some(Operation {
            arguments: expected,
            ..
        }) = operations.get(operation).cloned()
        else {
            return;
        };
        if expected.len() != arguments.len() {
            let cause = format!(
                "`{name}` takes {} arguments, not {}",
                expected.len(),
                arguments.len()
            );
            let names: Vec<&str> = expected
                .iter()
                .map(|argument| argument.name.as_str())
                .collect();
            self.found.error(
                member.at(),
                cause,
                format!("its arguments are ({})", names.join(", ")),
            );
            return;
        }
        for (declared, value) in expected.iter().zip(arguments) {
            self.typed_as(value, declared.shape.kind, declared.quantity);
        }
        self.emit(Op::Call {
            component,
            operation,
            arguments: arguments.len(),
        });
    }
}

/// Whether a statement itself may end a step.
fn takes_steps(kind: &StatementKind) -> bool {
    match kind {
        StatementKind::Do(..)
        | StatementKind::Wait(_)
        | StatementKind::WaitFor(..)
        | StatementKind::Yield
        | StatementKind::While(..) => true,
        StatementKind::Request(verb, _) => matches!(verb.text.as_str(), "configure" | "cleanup"),
        StatementKind::Assign(..)
        | StatementKind::Write(..)
        | StatementKind::Set(..)
        | StatementKind::Call(..)
        | StatementKind::If(..)
        | StatementKind::Raise(_) => false,
    }
}

/// Whether each way through a block ends the step at least once.
fn always_yields(block: &Block) -> bool {
    block.iter().any(|statement| match &statement.kind {
        StatementKind::Do(..) | StatementKind::Wait(_) | StatementKind::Yield => true,
        StatementKind::Request(verb, _) => matches!(verb.text.as_str(), "configure" | "cleanup"),
        StatementKind::If(_, then, otherwise) => always_yields(then) && always_yields(otherwise),
        StatementKind::Assign(..)
        | StatementKind::Write(..)
        | StatementKind::Set(..)
        | StatementKind::Call(..)
        | StatementKind::While(..)
        | StatementKind::WaitFor(..)
        | StatementKind::Raise(_) => false,
    })
}
