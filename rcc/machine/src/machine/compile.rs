//! Syntax tree to code: names, types and the statements a program may have. Paths through the states are checked elsewhere.

mod expression;
mod statement;

use std::ops::Range;
use std::time::Duration;

use crate::component::Component;
use crate::diagnostic::{Diagnostics, suggest};
use crate::machine::code::{
    Code, Connection, ERROR_EVENT, EVENTS_MAX, MachineCode, Member, OPERATIONS_MAX, Op, Program,
    StateCode, TransitionCode, Variable,
};
use crate::machine::tree;
use crate::syntax::Name;
use crate::value::Kind;

/// A stop at the end of a machine takes less than this: clients wait 30 s for a reply.
const END_MAX: Duration = Duration::from_secs(20);

/// Where the component files of a machine are.
pub trait Library {
    /// The text of a component file, or why it cannot be read.
    ///
    /// # Errors
    /// If there is no such file.
    fn component(&self, file: &str) -> Result<String, String>;
}

impl<F: Fn(&str) -> Result<String, String>> Library for F {
    fn component(&self, file: &str) -> Result<String, String> {
        self(file)
    }
}

pub(super) fn compile(
    tree: &tree::Machine,
    text: &str,
    library: &dyn Library,
    found: Diagnostics,
) -> (Program, Diagnostics) {
    let mut compiler = Compiler {
        text,
        found,
        program: Program {
            members: Vec::new(),
            connections: Vec::new(),
            order: Vec::new(),
            variables: Vec::new(),
            events: vec!["error".to_owned()],
            machines: Vec::new(),
            end: None,
            ops: Vec::new(),
            places: Vec::new(),
            worst: 0,
            worst_ns: 0,
            worst_at: String::new(),
        },
        kinds_known: Vec::new(),
        state_names: Vec::new(),
        at: 0..0,
        depth: 0,
    };
    compiler.declare(tree, library);
    compiler.end(tree);
    compiler.machine_names(tree);
    let mut index = 0;
    compiler.machines(tree, &mut index);
    if compiler.program.ops.len() > OPERATIONS_MAX {
        let cause = format!(
            "the machine has {} operations; at most {OPERATIONS_MAX} are allowed",
            compiler.program.ops.len()
        );
        compiler.found.error(tree.at.clone(), cause, "split it");
    }
    (compiler.program, compiler.found)
}

struct Compiler<'t> {
    text: &'t str,
    found: Diagnostics,
    program: Program,
    /// Names in use and what they are.
    kinds_known: Vec<(String, &'static str)>,
    /// By machine, its states.
    state_names: Vec<Vec<String>>,
    /// The statement that is being compiled.
    at: Range<usize>,
    /// Values on the stack.
    depth: usize,
}

impl Compiler<'_> {
    fn declare(&mut self, tree: &tree::Machine, library: &dyn Library) {
        self.claim(&tree.name, &tree.at, "machine");
        for component in &tree.components {
            self.claim(&component.name.text, &component.name.at, "component");
            self.component(component, library);
        }
        for variable in &tree.variables {
            self.claim(&variable.name.text, &variable.name.at, "variable");
            self.program.variables.push(Variable {
                name: variable.name.text.clone(),
                kind: variable.kind,
                initial: variable.initial,
                is_parameter: variable.is_parameter,
            });
        }
        for event in &tree.events {
            self.claim(&event.text, &event.at, "event");
            if self.program.events.len() == EVENTS_MAX {
                let cause = format!("at most {} events are allowed", EVENTS_MAX - 1);
                self.found.error(event.at.clone(), cause, "use fewer");
            }
            self.program.events.push(event.text.clone());
        }
        for machine in &tree.machines {
            self.declare(machine, library);
        }
        for (from, to) in &tree.connections {
            self.connect(from, to);
        }
        if let Some((at, names)) = &tree.order {
            self.order(at, names);
        }
    }

    fn end(&mut self, tree: &tree::Machine) {
        let nanos = tree.end.as_ref().map(|(_, nanos)| nanos.unsigned_abs());
        let time = nanos.map(Duration::from_nanos);
        if let Some((at, _)) = &tree.end
            && time >= Some(END_MAX)
        {
            let hint = "lost clients and the shutdown of the controller wait for it";
            let cause = format!("the end of a machine may take less than {END_MAX:?}");
            self.found.error(at.clone(), cause, hint);
        }
        self.program.end = time;
        let mut inside: Vec<&tree::Machine> = tree.machines.iter().collect();
        while let Some(machine) = inside.pop() {
            if let Some((at, _)) = &machine.end {
                let cause = "a machine inside ends with the outer one".to_owned();
                let hint = "write `stop on end` in the outermost machine, and stop this one in its final state";
                self.found.error(at.clone(), cause, hint);
            }
            inside.extend(&machine.machines);
        }
    }

    fn claim(&mut self, name: &str, at: &Range<usize>, kind: &'static str) {
        let earlier = self.kinds_known.iter().find(|(known, _)| known == name);
        if let Some((_, earlier)) = earlier {
            let cause = format!("`{name}` is declared twice: it is a {earlier}");
            self.found.error(at.clone(), cause, "rename one of them");
        } else if name == self.program.events.get(ERROR_EVENT).map_or("", |e| e) {
            let cause = "`error` is the event of errors".to_owned();
            self.found.error(at.clone(), cause, "choose another name");
        }
        self.kinds_known.push((name.to_owned(), kind));
    }

    fn component(&mut self, tree: &tree::Component, library: &dyn Library) {
        let at = tree.file_at.clone();
        let text = library.component(&tree.file);
        let component = match text.map(|text| (Component::parse(&text), text)) {
            Ok((Ok((component, _)), _)) => component,
            Ok((Err(errors), text)) => {
                for error in errors.all() {
                    let (line, column) = error.location(&text);
                    let cause = format!("{}:{line}:{column}: {}", tree.file, error.text);
                    self.found.error(at.clone(), cause, &error.hint);
                }
                return self.unknown(tree);
            }
            Err(why) => {
                let cause = format!("cannot read {}: {why}", tree.file);
                self.found
                    .error(at, cause, "files are relative to that of the machine");
                return self.unknown(tree);
            }
        };
        self.program.members.push(Member {
            name: tree.name.text.clone(),
            file: tree.file.clone(),
            component,
            is_configured: tree.is_configured,
            is_started: tree.is_started,
        });
    }

    /// A component whose file has errors: its members are not reported as unknown.
    fn unknown(&mut self, tree: &tree::Component) {
        self.kinds_known.push((tree.name.text.clone(), "unread"));
    }

    fn connect(&mut self, from: &tree::Member, to: &tree::Member) {
        let [Some(source), Some(sink)] = [from, to].map(|member| self.port(member)) else {
            return;
        };
        let port = |(component, port): (usize, usize)| {
            let component = self.program.members.get(component)?;
            component.component.ports.get(port)
        };
        let (Some(output), Some(input)) = (port(source), port(sink)) else {
            return;
        };
        let at = from.owner.at.start..to.name.at.end;
        let hint = "a connection is `connect writer.out_port -> reader.in_port;`";
        let text = if !output.is_output {
            format!("`{}` is an in port", from.name.text)
        } else if input.is_output {
            format!("`{}` is an out port", to.name.text)
        } else if output.declared.shape != input.declared.shape {
            format!(
                "`{}` is {}, but `{}` is {}",
                from.name.text, output.declared.shape, to.name.text, input.declared.shape
            )
        } else if output.declared.quantity != input.declared.quantity {
            format!(
                "`{}` has the unit {}, but `{}` has {}",
                from.name.text, output.declared.quantity, to.name.text, input.declared.quantity
            )
        } else if self.program.connections.iter().any(|c| c.to == sink) {
            format!("`{}.{}` is connected twice", to.owner.text, to.name.text)
        } else {
            self.program.connections.push(Connection {
                from: source,
                to: sink,
            });
            return;
        };
        self.found.error(at, text, hint);
    }

    fn order(&mut self, at: &Range<usize>, names: &[Name]) {
        let mut order = Vec::new();
        for name in names {
            if let Some(component) = self.member(name) {
                if order.contains(&component) {
                    let cause = format!("`{}` is given twice", name.text);
                    self.found
                        .error(name.at.clone(), cause, "remove one of them");
                }
                order.push(component);
            }
        }
        let members = self.program.members.iter().enumerate();
        let missing = members
            .filter(|(i, _)| !order.contains(i))
            .map(|(_, m)| m.name.clone());
        let missing: Vec<String> = missing.collect();
        if !missing.is_empty() {
            let cause = format!("the order lacks {}", missing.join(", "));
            self.found
                .error(at.clone(), cause, "name every component once");
        }
        self.program.order = order;
    }

    /// The component of that name; an error is recorded if there is none.
    fn member(&mut self, name: &Name) -> Option<usize> {
        let members = &self.program.members;
        let index = members.iter().position(|member| member.name == name.text);
        if index.is_none() && !self.is_unread(&name.text) {
            let hint = suggest(
                &name.text,
                members.iter().map(|member| member.name.as_str()),
            );
            let cause = format!("there is no component `{}`", name.text);
            self.found.error(name.at.clone(), cause, hint);
        }
        index
    }

    fn is_unread(&self, name: &str) -> bool {
        self.kinds_known
            .iter()
            .any(|(known, kind)| known == name && *kind == "unread")
    }

    fn port(&mut self, member: &tree::Member) -> Option<(usize, usize)> {
        let component = self.member(&member.owner)?;
        let ports = &self.program.members.get(component)?.component.ports;
        let port = ports
            .iter()
            .position(|port| port.declared.name == member.name.text);
        if port.is_none() {
            let hint = suggest(
                &member.name.text,
                ports.iter().map(|port| port.declared.name.as_str()),
            );
            let cause = format!("`{}` has no port `{}`", member.owner.text, member.name.text);
            self.found.error(member.name.at.clone(), cause, hint);
        }
        Some((component, port?))
    }

    fn event(&mut self, name: &Name) -> Option<usize> {
        let events = &self.program.events;
        let event = events.iter().position(|event| *event == name.text);
        if event.is_none() {
            let hint = suggest(&name.text, events.iter().map(String::as_str));
            let cause = format!("there is no event `{}`", name.text);
            self.found.error(name.at.clone(), cause, hint);
        }
        event
    }

    /// Machines are numbered from outside to inside, in the order of the text.
    fn machine_names(&mut self, tree: &tree::Machine) {
        let states = tree.states.iter().map(|state| state.name.text.clone());
        self.state_names.push(states.collect());
        self.program.machines.push(MachineCode {
            name: tree.name.clone(),
            at: tree.at.clone(),
            initial: 0,
            last: 0,
            states: Vec::new(),
        });
        for machine in &tree.machines {
            self.machine_names(machine);
        }
    }

    fn machines(&mut self, tree: &tree::Machine, next: &mut usize) {
        let index = *next;
        *next += 1;
        let mut states = Vec::new();
        for (number, state) in tree.states.iter().enumerate() {
            if tree
                .states
                .iter()
                .take(number)
                .any(|s| s.name.text == state.name.text)
            {
                let cause = format!("state `{}` is declared twice", state.name.text);
                self.found
                    .error(state.name.at.clone(), cause, "rename one of them");
            }
            states.push(self.state(index, state));
        }
        let initial = self.only(tree, "initial", |state| state.is_initial);
        let last = self.only(tree, "final", |state| state.is_final);
        if let Some(machine) = self.program.machines.get_mut(index) {
            machine.states = states;
            machine.initial = initial;
            machine.last = last;
        }
        if index == 0 && tree.order.is_none() {
            self.program.order = (0..self.program.members.len()).collect();
        }
        for machine in &tree.machines {
            self.machines(machine, next);
        }
    }

    fn only(
        &mut self,
        tree: &tree::Machine,
        word: &str,
        is: impl Fn(&tree::State) -> bool,
    ) -> usize {
        let mut chosen = tree
            .states
            .iter()
            .enumerate()
            .filter(|(_, state)| is(state));
        let first = chosen.next();
        if let Some((_, second)) = chosen.next() {
            let cause = format!("`{}` is a second {word} state", second.name.text);
            let hint = format!("a machine has exactly one {word} state");
            self.found.error(second.name.at.clone(), cause, hint);
        }
        if first.is_none() {
            let cause = format!("machine `{}` has no {word} state", tree.name);
            let hint = format!("write `{word} state Name {{ … }}`");
            self.found.error(tree.at.clone(), cause, hint);
        }
        first.map_or(0, |(index, _)| index)
    }

    fn state(&mut self, machine: usize, state: &tree::State) -> StateCode {
        let transitions = state.transitions.iter();
        let transitions: Vec<_> = transitions
            .filter_map(|t| self.transition(machine, t))
            .collect();
        StateCode {
            name: state.name.text.clone(),
            precondition: self.condition(state.precondition.as_ref()),
            entry: self.program(state.entry.as_ref(), true),
            run: self.program(state.run.as_ref(), true),
            handle: self.program(state.handle.as_ref(), false),
            exit: self.program(state.exit.as_ref(), false),
            transitions,
            at: state.name.at.clone(),
        }
    }

    fn transition(&mut self, machine: usize, tree: &tree::Transition) -> Option<TransitionCode> {
        let event = tree.event.as_ref().map(|event| self.event(event));
        let condition = self.condition(tree.condition.as_ref());
        let program = self.program(tree.program.as_ref(), false);
        let failure = self.program(tree.failure.as_ref(), false);
        let names = self.state_names.get(machine)?;
        let Some(target) = names.iter().position(|name| *name == tree.target.text) else {
            let hint = suggest(&tree.target.text, names.iter().map(String::as_str));
            let cause = format!("there is no state `{}`", tree.target.text);
            self.found.error(tree.target.at.clone(), cause, hint);
            return None;
        };
        let mut label = String::new();
        if let Some(event) = &tree.event {
            label = format!("on {}", event.text);
        }
        if let Some(condition) = &tree.condition {
            let text = self.text.get(condition.at.clone()).unwrap_or_default();
            let words: Vec<&str> = text.split_whitespace().collect();
            let blank = if label.is_empty() { "" } else { " " };
            label = format!("{label}{blank}{}", words.join(" "));
        }
        Some(TransitionCode {
            event: match event {
                None => None,
                Some(event) => Some(event?),
            },
            condition,
            target,
            program,
            failure,
            at: tree.target.at.clone(),
            label,
        })
    }

    fn condition(&mut self, condition: Option<&tree::Expression>) -> Code {
        let condition = condition?;
        let first = self.program.ops.len();
        self.at = condition.at.clone();
        self.typed(condition, Kind::Bool);
        self.emit(Op::End);
        self.depth = 0;
        Some((first, self.program.ops.len()))
    }

    fn program(&mut self, block: Option<&tree::Block>, may_yield: bool) -> Code {
        let block = block.filter(|block| !block.is_empty())?;
        let first = self.program.ops.len();
        self.block(block, may_yield);
        self.emit(Op::End);
        Some((first, self.program.ops.len()))
    }

    fn emit(&mut self, op: Op) -> usize {
        self.program.ops.push(op);
        self.program.places.push(self.at.clone());
        self.program.ops.len() - 1
    }

    /// Sets the target of a jump to the next operation.
    fn land(&mut self, jump: usize) {
        let here = self.program.ops.len();
        if let Some(Op::Unless(target) | Op::Jump(target)) = self.program.ops.get_mut(jump) {
            *target = here;
        }
    }
}
