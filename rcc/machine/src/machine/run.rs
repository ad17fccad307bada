//! The interpreter: one call of [`Machine::step`] each period. It does not allocate, and each step is bounded by
//! [`Program::worst_step`]. Components are reached through [`Peers`]; who runs them is decided elsewhere.

mod evaluate;
mod step;

use std::sync::Arc;

use crate::lifecycle::{Phase, Request, Unsuitable};
use crate::machine::code::{Control, EVENTS_MAX, Program, Status};
use crate::value::Value;

/// The components as a machine uses them. No method may block or allocate: what takes longer is only requested.
/// Components, ports, properties and operations are numbered as in the [`Program`].
pub trait Peers {
    /// State of the life cycle.
    fn phase(&self, component: usize) -> Phase;

    /// The value of a port, or of an element of its array; null if nothing has written it.
    fn read(&self, component: usize, port: usize, element: usize) -> Option<Value>;

    /// Writes an in port.
    ///
    /// # Errors
    /// If it cannot be written.
    fn write(&mut self, component: usize, port: usize, value: Value) -> Result<(), Refused>;

    /// Sets properties: all of them, or none.
    ///
    /// # Errors
    /// If one of them cannot be set.
    fn set(&mut self, component: usize, values: &[(usize, Value)]) -> Result<(), Refused>;

    /// Requests a change of the life cycle. `start` and `stop` act at once, between two cycles; `configure` and `cleanup` are
    /// complete once [`Self::is_settled`].
    ///
    /// # Errors
    /// If its state does not allow it.
    fn request(&mut self, component: usize, request: Request) -> Result<(), Refused>;

    /// Whether the last `configure` or `cleanup` is complete.
    ///
    /// # Errors
    /// If it failed.
    fn is_settled(&self, component: usize) -> Result<bool, Refused>;

    /// Calls an operation.
    ///
    /// # Errors
    /// If the component does not run, or an argument is out of range.
    fn call(
        &mut self,
        component: usize,
        operation: usize,
        arguments: &[Value],
    ) -> Result<Ticket, Refused>;

    /// Whether a call is complete.
    ///
    /// # Errors
    /// If the component no longer runs.
    fn is_done(&self, ticket: Ticket) -> Result<bool, Refused>;
}

/// A call of an operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ticket {
    /// The component.
    pub component: usize,
    /// The operation.
    pub operation: usize,
    /// Number of the call.
    pub number: u32,
}

/// Why a component refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refused {
    /// Its state does not allow the request.
    #[error("{0}")]
    Phase(#[from] Unsuitable),
    /// A property is not live, and the component runs.
    #[error(
        "the property cannot change while the component runs\nhint: stop the component first, or declare it `live`"
    )]
    NotLive,
    /// A value is null, not finite or out of its range.
    #[error("the value is null, not finite or out of its range\nhint: check the value before")]
    Value,
    /// The component does not run.
    #[error("the component does not run\nhint: start it first")]
    NotRunning,
    /// No net of it is ready: it was started several times within the time that loading takes.
    #[error(
        "no net of the component is ready\nhint: each start needs a net, and it takes some milliseconds to load the next; wait before another start"
    )]
    NotReady,
    /// Another component of the machine holds a resource of it.
    #[error(
        "another running component of the machine holds a resource that it needs\nhint: stop that component first"
    )]
    InUse,
    /// A device that it commands does not follow commands.
    #[error(
        "a device that it commands does not follow commands\nhint: wait until it is operational"
    )]
    Device,
    /// Its net or its properties have errors.
    #[error("the component could not be configured\nhint: the log names the errors of its net")]
    NotConfigured,
    /// There is no such component, port or operation: the peers are those of another program.
    #[error("there is no such member\nhint: load the machine again")]
    Unknown,
}

/// Why a machine cannot continue.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Cause {
    /// A component refused.
    #[error("{0}")]
    Refused(#[from] Refused),
    /// An int exceeds 32 bits.
    #[error("the result does not fit into an int\nhint: compute with double")]
    Overflow,
    /// An int divided by 0.
    #[error("an int is divided by 0\nhint: check the divisor before")]
    DivisionByZero,
    /// A null value stored.
    #[error("the value is null\nhint: check it with `has` before")]
    Null,
    /// A time limit without `else`.
    #[error(
        "the time limit is over\nhint: handle it with `else {{ … }}` or a transition `on error`"
    )]
    TimedOut,
    /// The initial state refused to be entered.
    #[error(
        "the precondition of the initial state is not true\nhint: fulfil it before the machine is activated"
    )]
    Precondition,
    /// A machine refused a request.
    #[error("{0}")]
    Control(#[from] ControlRefused),
    /// The net of a component ended with an error.
    #[error(
        "the net of a component ended with an error\nhint: the log names the net and the cause; handle it with a transition `on error`"
    )]
    Component(usize),
    /// The controller was stopped.
    #[error("the controller was stopped\nhint: release the stop and load the machine again")]
    Halted,
    /// The code is not that of a checked program.
    #[error("the code of the machine is damaged\nhint: compile it again")]
    Code,
}

/// An error of a machine, and where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Failure {
    /// The cause.
    pub cause: Cause,
    /// The state.
    pub state: usize,
    /// First and last byte of the statement in the text.
    pub at: (usize, usize),
}

/// A request that a machine cannot fulfil now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{}` is not possible while the machine is {}\nhint: {}", .control.word(), .status.word(), self.remedy())]
pub struct ControlRefused {
    /// The request.
    pub control: Control,
    /// The status of the machine.
    pub status: Status,
}

impl ControlRefused {
    const fn remedy(self) -> &'static str {
        match (self.status, self.control) {
            (Status::Active, Control::Activate) => "it is active already",
            (Status::Active, _) => "stop it first",
            (Status::Inactive, Control::Deactivate) => "it is inactive already",
            (Status::Inactive | Status::Finished | Status::Failed, _) => "activate it first",
        }
    }
}

/// How an active machine leaves its states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// By events and requests only; run and handle programs are not executed.
    #[default]
    Reactive,
    /// By its conditions, too.
    Automatic,
}

impl Mode {
    /// The name on the wire.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Reactive => "reactive",
            Self::Automatic => "automatic",
        }
    }
}

/// Where in its state a machine is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stage {
    /// It enters its initial state in the next step.
    #[default]
    Begin,
    /// Its entry program continues there.
    Entering(usize),
    /// Entered; the run program begins with the next step.
    Ready,
    /// The run program continues there.
    Running(usize),
}

#[derive(Clone, Debug, Default)]
struct Run {
    status: Status,
    mode: Mode,
    is_paused: bool,
    steps: u32,
    is_stopping: bool,
    requested: Option<usize>,
    state: usize,
    stage: Stage,
    /// Pending events, a bit each.
    events: u64,
    deadline: i64,
    ticket: Option<Ticket>,
    failure: Option<Failure>,
}

/// What a step changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Transitions of all machines in this step.
    pub transitions: u32,
    /// Executed operations.
    pub operations: usize,
}

/// A program with its variables and states.
#[derive(Clone, Debug)]
pub struct Machine {
    program: Arc<Program>,
    variables: Box<[Value]>,
    runs: Box<[Run]>,
    outcome: Outcome,
}

const _: () = assert!(EVENTS_MAX <= 64, "events are bits of a word");

impl Machine {
    /// A machine in no state, with the initial values of its variables.
    #[must_use]
    pub fn new(program: Arc<Program>) -> Self {
        Self {
            variables: program.variables.iter().map(|v| v.initial).collect(),
            runs: program.machines.iter().map(|_| Run::default()).collect(),
            program,
            outcome: Outcome::default(),
        }
    }

    /// The program.
    #[must_use]
    pub const fn program(&self) -> &Arc<Program> {
        &self.program
    }

    /// Sets a parameter before the machine is activated. Returns whether there is such a parameter of this kind.
    pub fn set_parameter(&mut self, name: &str, value: Value) -> bool {
        let variables = &self.program.variables;
        let index = variables
            .iter()
            .position(|v| v.is_parameter && v.name == name && v.kind == value.kind());
        let slot = index.and_then(|index| self.variables.get_mut(index));
        slot.map(|slot| *slot = value).is_some()
    }

    /// Sets a parameter by its number in [`Program::variables`]. Returns whether there is such a parameter of this kind, and
    /// the machine is not active.
    pub fn set_parameter_at(&mut self, index: usize, value: Value) -> bool {
        let declared = self.program.variables.get(index);
        let is_fitting = declared.is_some_and(|v| v.is_parameter && v.kind == value.kind());
        let slot = self.variables.get_mut(index);
        let is_active = self
            .runs
            .first()
            .is_some_and(|run| run.status == Status::Active);
        slot.filter(|_| is_fitting && !is_active)
            .map(|slot| *slot = value)
            .is_some()
    }

    /// The value of a variable or parameter.
    #[must_use]
    pub fn variable(&self, name: &str) -> Option<Value> {
        let index = self.program.variables.iter().position(|v| v.name == name)?;
        self.variables.get(index).copied()
    }

    /// The values of all variables and parameters, in the order of [`Program::variables`].
    #[must_use]
    pub const fn variables(&self) -> &[Value] {
        &self.variables
    }

    /// The status of a machine; 0 is the outermost one.
    #[must_use]
    pub fn status(&self, machine: usize) -> Status {
        self.runs
            .get(machine)
            .map_or(Status::Inactive, |run| run.status)
    }

    /// The mode of a machine.
    #[must_use]
    pub fn mode(&self, machine: usize) -> Mode {
        self.runs
            .get(machine)
            .map_or(Mode::Reactive, |run| run.mode)
    }

    /// Whether a machine is paused.
    #[must_use]
    pub fn is_paused(&self, machine: usize) -> bool {
        self.runs.get(machine).is_some_and(|run| run.is_paused)
    }

    /// The number of the state in which a machine is or ended; none while it is inactive.
    #[must_use]
    pub fn state_index(&self, machine: usize) -> Option<usize> {
        let run = self.runs.get(machine)?;
        (run.status != Status::Inactive).then_some(run.state)
    }

    /// The name of that state.
    #[must_use]
    pub fn state(&self, machine: usize) -> Option<&str> {
        let state = self.state_index(machine)?;
        self.program
            .state(machine, state)
            .map(|state| state.name.as_str())
    }

    /// The error of a machine, the last one.
    #[must_use]
    pub fn failure(&self, machine: usize) -> Option<Failure> {
        self.runs.get(machine)?.failure
    }

    /// Raises an event in all machines. It is examined in the next step of each active machine, once it has entered its
    /// state; one to which that state does not listen is dropped then.
    pub fn raise(&mut self, event: usize) {
        let bit = 1_u64
            .checked_shl(u32::try_from(event).unwrap_or(64))
            .unwrap_or(0);
        for run in self
            .runs
            .iter_mut()
            .filter(|run| run.status == Status::Active)
        {
            run.events |= bit;
        }
    }

    /// Requests a state. In the next step the machine makes the first transition to it whose condition is true, in either
    /// mode; if there is none, nothing happens.
    pub fn request_state(&mut self, machine: usize, state: usize) {
        if let Some(run) = self.runs.get_mut(machine) {
            run.requested = Some(state);
        }
    }

    /// Requests a change of a machine; what it executes is executed in the next step.
    ///
    /// # Errors
    /// If its status does not allow it.
    pub fn control(&mut self, machine: usize, control: Control) -> Result<(), ControlRefused> {
        let Some(run) = self.runs.get_mut(machine) else {
            let status = Status::Inactive;
            return Err(ControlRefused { control, status });
        };
        let is_active = run.status == Status::Active;
        let refused = Err(ControlRefused {
            control,
            status: run.status,
        });
        match control {
            Control::Activate if is_active => return refused,
            Control::Activate => {
                *run = Run {
                    status: Status::Active,
                    ..Run::default()
                };
            }
            Control::Deactivate if is_active || run.status == Status::Inactive => return refused,
            Control::Deactivate => run.status = Status::Inactive,
            _ if !is_active => return refused,
            Control::Start => {
                run.mode = Mode::Automatic;
                run.is_paused = false;
            }
            Control::Reactive => {
                run.mode = Mode::Reactive;
                run.is_paused = false;
            }
            Control::Pause => run.is_paused = true,
            Control::Step => run.steps = run.steps.saturating_add(1),
            Control::Stop => run.is_stopping = true,
        }
        Ok(())
    }
}

#[cfg(test)]
mod cells;
#[cfg(test)]
pub(super) mod tests;
