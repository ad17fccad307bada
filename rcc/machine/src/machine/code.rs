//! The bounded code of a machine: flat operations on a small stack. Every program ends; every loop yields, so one step
//! executes each operation a bounded number of times.

use std::ops::Range;

use crate::component::Component;
use crate::lifecycle::{Phase, Request};
use crate::machine::tree::{Binary, Unary};
use crate::value::{Kind, Value};

/// Most values on the stack.
pub(crate) const STACK_MAX: usize = 64;
/// Most operations of a program.
pub(crate) const OPERATIONS_MAX: usize = 50_000;
/// Most events of a program, with `error`.
pub(crate) const EVENTS_MAX: usize = 64;
/// The event of an error of the machine.
pub(crate) const ERROR_EVENT: usize = 0;

/// One operation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Op {
    Push(Value),
    Load(usize),
    Store(usize),
    Read {
        component: usize,
        port: usize,
        element: usize,
    },
    Is(usize, Phase),
    InState(usize, usize),
    IsStatus(usize, Status),
    Has,
    Unary(Unary),
    Binary(Binary),
    /// An int as a double.
    Widen,
    /// Pops; continues elsewhere unless it was true.
    Unless(usize),
    Jump(usize),
    /// Ends the step; continues here in the next one.
    Yield,
    /// Sets the time limit of what follows, ns from now.
    Limit(i64),
    /// Whether the time limit is over.
    IsOver,
    Write {
        component: usize,
        port: usize,
    },
    /// Pops a value for each property, the last one first.
    Set {
        component: usize,
        first: usize,
        count: usize,
    },
    Request(usize, Request),
    /// Whether the requested configuration or unloading is complete.
    IsSettled(usize),
    Call {
        component: usize,
        operation: usize,
        arguments: usize,
    },
    /// Whether the last call is complete.
    IsDone,
    Raise(usize),
    Control(usize, Control),
    /// A time limit without `else`.
    TimedOut,
    End,
}

/// What a parent, an operator or a program can request of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Control {
    /// Enter the initial state, in reactive mode.
    Activate,
    /// Automatic mode; also ends a pause.
    Start,
    /// Reactive mode: transitions by events and requests only; also ends a pause.
    Reactive,
    /// Do nothing until another request.
    Pause,
    /// One step as in automatic mode.
    Step,
    /// Enter the final state from wherever it is.
    Stop,
    /// Make a machine that ended inactive.
    Deactivate,
}

impl Control {
    /// All requests.
    pub const ALL: [Self; 7] = [
        Self::Activate,
        Self::Start,
        Self::Reactive,
        Self::Pause,
        Self::Step,
        Self::Stop,
        Self::Deactivate,
    ];

    /// The name in machines.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Activate => "activate",
            Self::Start => "start",
            Self::Reactive => "reactive",
            Self::Pause => "pause",
            Self::Step => "step",
            Self::Stop => "stop",
            Self::Deactivate => "deactivate",
        }
    }
}

/// Whether a machine works.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Status {
    /// In no state.
    #[default]
    Inactive,
    /// In one of its states.
    Active,
    /// In its final state, with all its programs ended.
    Finished,
    /// An error that no transition handles; it stays in its state.
    Failed,
}

impl Status {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Inactive, Self::Active, Self::Finished, Self::Failed];

    /// The name in machines.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finished => "finished",
            Self::Failed => "failed",
        }
    }
}

/// A component of a machine.
#[derive(Clone, Debug)]
pub struct Member {
    /// Its name in the machine.
    pub name: String,
    /// Its file, as written in the machine.
    pub file: String,
    /// Its declaration and net.
    pub component: Component,
    /// Whether it is configured before the machine is activated.
    pub is_configured: bool,
    /// Whether it is started before the machine is activated.
    pub is_started: bool,
}

/// A connection: from an out port to an in port, as indexes of component and port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Connection {
    /// Component and port that is read.
    pub from: (usize, usize),
    /// Component and port that is written.
    pub to: (usize, usize),
}

/// A variable of a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Its name.
    pub name: String,
    /// Its type.
    pub kind: Kind,
    /// Its value when the machine is loaded.
    pub initial: Value,
    /// Whether it may be set when the machine is loaded.
    pub is_parameter: bool,
}

/// A program or expression: its first operation, and the one behind its last.
pub(crate) type Code = Option<(usize, usize)>;

#[derive(Clone, Debug)]
pub(crate) struct TransitionCode {
    pub(crate) event: Option<usize>,
    pub(crate) condition: Code,
    pub(crate) target: usize,
    pub(crate) program: Code,
    pub(crate) failure: Code,
    pub(crate) at: Range<usize>,
    /// Its condition as text.
    pub(crate) label: String,
}

#[derive(Clone, Debug)]
pub(crate) struct StateCode {
    pub(crate) name: String,
    pub(crate) precondition: Code,
    pub(crate) entry: Code,
    pub(crate) run: Code,
    pub(crate) handle: Code,
    pub(crate) exit: Code,
    pub(crate) transitions: Vec<TransitionCode>,
    pub(crate) at: Range<usize>,
}

#[derive(Clone, Debug)]
pub(crate) struct MachineCode {
    pub(crate) name: String,
    pub(crate) at: Range<usize>,
    pub(crate) initial: usize,
    pub(crate) last: usize,
    pub(crate) states: Vec<StateCode>,
}

/// A checked machine, ready to be stepped.
#[derive(Clone, Debug)]
pub struct Program {
    pub(crate) members: Vec<Member>,
    pub(crate) connections: Vec<Connection>,
    /// Components in the order of their evaluation.
    pub(crate) order: Vec<usize>,
    pub(crate) variables: Vec<Variable>,
    pub(crate) events: Vec<String>,
    /// The machine itself, then the machines inside.
    pub(crate) machines: Vec<MachineCode>,
    /// Longest time of its stop at its end.
    pub(crate) end: Option<std::time::Duration>,
    pub(crate) ops: Vec<Op>,
    /// The bytes of the text behind each operation.
    pub(crate) places: Vec<Range<usize>>,
    pub(crate) worst: usize,
    pub(crate) worst_ns: u64,
    pub(crate) worst_at: String,
}

impl Program {
    /// The name of the machine.
    #[must_use]
    pub fn name(&self) -> &str {
        self.machines.first().map_or("", |machine| &machine.name)
    }

    /// Its components, in the order of the text.
    #[must_use]
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// Its connections.
    #[must_use]
    pub fn connections(&self) -> &[Connection] {
        &self.connections
    }

    /// Components in the order in which they are evaluated in a cycle.
    #[must_use]
    pub fn order(&self) -> &[usize] {
        &self.order
    }

    /// Its variables and parameters.
    #[must_use]
    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// Its events; the first is `error`.
    #[must_use]
    pub fn events(&self) -> &[String] {
        &self.events
    }

    /// Names of the machine and of the machines inside.
    pub fn machines(&self) -> impl Iterator<Item = &str> {
        self.machines.iter().map(|machine| machine.name.as_str())
    }

    /// Names of the states of a machine; 0 is the outermost one.
    pub fn states(&self, machine: usize) -> impl Iterator<Item = &str> {
        let machine = self.machines.get(machine);
        machine
            .into_iter()
            .flat_map(|m| m.states.iter().map(|state| state.name.as_str()))
    }

    /// Whether the end of the machine stops it: its final state is entered, and may take so long until it ends where it is.
    #[must_use]
    pub const fn stop_on_end(&self) -> Option<std::time::Duration> {
        self.end
    }

    /// Number of operations of all programs.
    #[must_use]
    pub fn operations(&self) -> usize {
        self.ops.len()
    }

    /// Upper bound on the operations of one step.
    #[must_use]
    pub const fn worst_step(&self) -> usize {
        self.worst
    }

    /// Upper bound on the time of one step with its connections, by the declared costs of its operations.
    #[must_use]
    pub const fn worst_time(&self) -> std::time::Duration {
        std::time::Duration::from_nanos(self.worst_ns)
    }

    /// The states of the longest step, outermost machine first.
    #[must_use]
    pub fn worst_states(&self) -> &str {
        &self.worst_at
    }

    pub(crate) fn state(&self, machine: usize, state: usize) -> Option<&StateCode> {
        self.machines.get(machine)?.states.get(state)
    }
}
