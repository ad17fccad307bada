//! A machine as programs see it, published by its thread after each step.

use takt_machine::lifecycle::Phase;
use takt_machine::machine::{Failure, Machine, Mode, Outcome, Status};
use takt_machine::{Program, Value};
use takt_rt::Nanos;

/// Where a machine, or one inside, is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MachineState {
    /// Whether it works.
    pub status: Status,
    /// Its mode.
    pub mode: Mode,
    /// Whether it is paused.
    pub is_paused: bool,
    /// The number of its state; `None` while it is inactive.
    pub state: Option<usize>,
    /// Its last error.
    pub failure: Option<Failure>,
}

impl MachineState {
    /// Its status and the number of its state plus 1, which is 0 while it is inactive.
    #[must_use]
    pub fn word(&self) -> u64 {
        let state = self.state.map_or(0, |state| state as u64 + 1);
        (self.status as u64) | (state << 8)
    }
}

/// A machine after a step.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineView {
    /// The machine and those inside.
    pub machines: Box<[MachineState]>,
    /// By component, the state of its life cycle.
    pub phases: Box<[Phase]>,
    /// By component, its running net.
    pub nets: Box<[Option<u32>]>,
    /// By component and property, its single value.
    pub properties: Box<[Box<[Option<Value>]>]>,
    /// Variables and parameters.
    pub variables: Box<[Value]>,
    /// The last step.
    pub outcome: Outcome,
    /// Number of steps.
    pub steps: u64,
    /// Number of transitions.
    pub transitions: u64,
    /// The longest step, what interrupted it included.
    pub longest: Nanos,
}

impl MachineView {
    pub(super) fn new(program: &Program) -> Self {
        let members = program.members().iter();
        let properties = members
            .clone()
            .map(|member| vec![None; member.component.properties.len()].into());
        let variables = program.variables().iter();
        Self {
            machines: program
                .machines()
                .map(|_| MachineState::default())
                .collect(),
            phases: members.clone().map(|_| Phase::default()).collect(),
            nets: members.map(|_| None).collect(),
            properties: properties.collect(),
            variables: variables.map(|variable| variable.initial).collect(),
            outcome: Outcome::default(),
            steps: 0,
            transitions: 0,
            longest: Nanos::ZERO,
        }
    }

    /// Counts a step.
    pub(super) fn stepped(&mut self, outcome: Outcome, took: Nanos) {
        self.outcome = outcome;
        self.steps += 1;
        self.transitions += u64::from(outcome.transitions);
        self.longest = self.longest.max(took);
    }

    /// Copies the present state; all lengths are those of the program.
    pub(super) fn copy<'s>(
        &mut self,
        machine: &Machine,
        slots: impl Iterator<Item = (Phase, Option<u32>, &'s Box<[Option<Value>]>)>,
    ) {
        for (number, state) in self.machines.iter_mut().enumerate() {
            *state = MachineState {
                status: machine.status(number),
                mode: machine.mode(number),
                is_paused: machine.is_paused(number),
                state: machine.state_index(number),
                failure: machine.failure(number),
            };
        }
        let of_components = self.phases.iter_mut().zip(&mut self.nets);
        let of_components = of_components.zip(&mut self.properties);
        for (((phase, net), values), slot) in of_components.zip(slots) {
            (*phase, *net) = (slot.0, slot.1);
            values.copy_from_slice(slot.2);
        }
        self.variables.copy_from_slice(machine.variables());
    }

    /// Copies another view of the same machine, without allocation.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.machines.copy_from_slice(&other.machines);
        self.phases.copy_from_slice(&other.phases);
        self.nets.copy_from_slice(&other.nets);
        for (own, values) in self.properties.iter_mut().zip(&other.properties) {
            own.copy_from_slice(values);
        }
        self.variables.copy_from_slice(&other.variables);
        (self.outcome, self.steps) = (other.outcome, other.steps);
        (self.transitions, self.longest) = (other.transitions, other.longest);
    }
}
