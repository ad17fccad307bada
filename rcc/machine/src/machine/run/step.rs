//! One step of each machine: which program is executed, and which transition is made.
//!
//! 1. A requested stop: exit program of the state, entry program of the final state.
//! 2. An unfinished entry program continues; nothing else happens in that step.
//! 3. Events: the first transition `on` a pending event whose condition is true. A run program under way ends there.
//! 4. A requested state: the first transition to it without event whose condition is true.
//! 5. In automatic mode, or for a single step: the run program. Once it has ended, the conditions in the order of the text; for
//!    the first that is true the transition is made. If there is none, the handle program.
//!
//! A transition: precondition of the target (if it is not true, the failure program, and the search continues), transition
//! program, exit program of the old state, entry program of the new one. To the current state: the transition program alone.
//! At most one transition is made in a step.

use super::evaluate::Flow;
use super::{Cause, Failure, Machine, Mode, Outcome, Peers, Stage};
use crate::machine::code::{Code, ERROR_EVENT, Status};
use crate::value::Value;

/// A program failed; the machine has recorded it.
struct Failed;

type Stepped<T> = Result<T, Failed>;

/// Which transitions are examined.
#[derive(Clone, Copy)]
enum Search {
    /// Those on these events.
    Events(u64),
    /// Those without event to a state.
    To(usize),
    /// Those without event.
    Conditions,
}

/// The surroundings of a step.
struct Around<'p> {
    peers: &'p mut dyn Peers,
    now: i64,
}

impl Machine {
    /// One step of the machine and of those inside, at time `now`, ns.
    pub fn step(&mut self, peers: &mut dyn Peers, now: i64) -> Outcome {
        self.outcome = Outcome::default();
        let mut around = Around { peers, now };
        for machine in 0..self.runs.len() {
            // A failure is recorded where it happens.
            let _ = self.step_one(machine, &mut around);
        }
        self.outcome
    }

    /// The net of a component ended with an error: the error of the outermost machine, in its present state.
    pub fn component_failed(&mut self, component: usize) {
        if self.status(0) == Status::Active {
            let at = usize::MAX;
            let _: Stepped<()> = self.fail(0, Cause::Component(component), at);
        }
    }

    /// Ends the machine and those inside where they are, as failed.
    pub fn halt(&mut self, cause: Cause) {
        for run in &mut self.runs {
            if run.status == Status::Active {
                run.status = Status::Failed;
                run.failure = Some(Failure {
                    cause,
                    state: run.state,
                    at: (0, 0),
                });
            }
        }
    }

    fn step_one(&mut self, machine: usize, around: &mut Around<'_>) -> Stepped<()> {
        let Some(run) = self.runs.get_mut(machine) else {
            return Ok(());
        };
        if run.status != Status::Active {
            return Ok(());
        }
        if run.is_stopping {
            run.is_stopping = false;
            return self.stop(machine, around);
        }
        let is_single = run.steps > 0;
        if run.is_paused && !is_single {
            return Ok(());
        }
        run.steps = run.steps.saturating_sub(1);
        match run.stage {
            Stage::Begin => return self.begin(machine, around),
            Stage::Entering(at) => {
                let flow = self.execute(machine, at, around.peers, around.now);
                return self.entered(machine, flow);
            }
            Stage::Ready | Stage::Running(_) => {}
        }
        let Some(run) = self.runs.get_mut(machine) else {
            return Ok(());
        };
        let events = std::mem::take(&mut run.events);
        let requested = run.requested.take();
        let is_automatic = run.mode == Mode::Automatic || is_single;
        if events != 0 {
            if self.search(machine, Search::Events(events), around)? {
                return Ok(());
            }
            if events & (1 << ERROR_EVENT) != 0 {
                // The state listens to errors, but its condition is not true.
                self.set_status(machine, Status::Failed);
                return Ok(());
            }
        }
        if let Some(state) = requested
            && self.search(machine, Search::To(state), around)?
        {
            return Ok(());
        }
        if is_automatic {
            return self.automatic(machine, around);
        }
        Ok(())
    }

    fn set_status(&mut self, machine: usize, status: Status) {
        if let Some(run) = self.runs.get_mut(machine) {
            run.status = status;
        }
    }

    fn set_stage(&mut self, machine: usize, stage: Stage) {
        if let Some(run) = self.runs.get_mut(machine) {
            run.stage = stage;
        }
    }

    fn current(&self, machine: usize) -> usize {
        self.runs.get(machine).map_or(0, |run| run.state)
    }

    /// A code of the present state.
    fn code(
        &self,
        machine: usize,
        code: impl Fn(&crate::machine::code::StateCode) -> Code,
    ) -> Code {
        let state = self.current(machine);
        self.program.state(machine, state).and_then(code)
    }

    fn automatic(&mut self, machine: usize, around: &mut Around<'_>) -> Stepped<()> {
        let at = match self.runs.get(machine).map(|run| run.stage) {
            Some(Stage::Running(at)) => Some(at),
            _ => self
                .code(machine, |state| state.run)
                .map(|(first, _)| first),
        };
        if let Some(at) = at {
            match self.execute(machine, at, around.peers, around.now) {
                Flow::Yielded(at) => {
                    self.set_stage(machine, Stage::Running(at));
                    return Ok(());
                }
                Flow::Done(_) => self.set_stage(machine, Stage::Ready),
                Flow::Failed(cause, at) => return self.fail(machine, cause, at),
            }
        }
        if self.search(machine, Search::Conditions, around)? {
            return Ok(());
        }
        let handle = self.code(machine, |state| state.handle);
        self.run_whole(machine, handle, around)?;
        let state = self.current(machine);
        let is_last = self
            .program
            .machines
            .get(machine)
            .is_some_and(|m| m.last == state);
        let is_end = self
            .program
            .state(machine, state)
            .is_some_and(|s| s.transitions.is_empty());
        if is_last && is_end {
            self.set_status(machine, Status::Finished);
        }
        Ok(())
    }

    /// Makes the first transition that is possible; returns whether there was one.
    fn search(&mut self, machine: usize, search: Search, around: &mut Around<'_>) -> Stepped<bool> {
        let program = std::sync::Arc::clone(&self.program);
        let current = self.current(machine);
        let Some(state) = program.state(machine, current) else {
            return Ok(false);
        };
        for transition in &state.transitions {
            let is_examined = match (search, transition.event) {
                (Search::Events(events), Some(event)) => events & (1 << event) != 0,
                (Search::To(target), None) => transition.target == target,
                (Search::Conditions, None) => true,
                (Search::Events(_), None) | (Search::To(_) | Search::Conditions, Some(_)) => false,
            };
            if !is_examined || !self.is_true(machine, transition.condition, around)? {
                continue;
            }
            let is_self = transition.target == current;
            let target = program.state(machine, transition.target);
            let precondition = target.and_then(|state| state.precondition);
            if !is_self && !self.is_true(machine, precondition, around)? {
                self.run_whole(machine, transition.failure, around)?;
                continue;
            }
            self.run_whole(machine, transition.program, around)?;
            self.outcome.transitions += 1;
            if is_self {
                self.set_stage(machine, Stage::Ready);
            } else {
                self.change(machine, transition.target, around)?;
            }
            return Ok(true);
        }
        Ok(false)
    }

    /// Whether a condition is true; one that is not given is.
    fn is_true(&mut self, machine: usize, code: Code, around: &mut Around<'_>) -> Stepped<bool> {
        let Some((first, _)) = code else {
            return Ok(true);
        };
        match self.execute(machine, first, around.peers, around.now) {
            Flow::Done(value) => Ok(value == Some(Value::Bool(true))),
            Flow::Yielded(at) => self.fail(machine, Cause::Code, at).map(|()| false),
            Flow::Failed(cause, at) => self.fail(machine, cause, at).map(|()| false),
        }
    }

    /// Executes a program that finishes in one step.
    fn run_whole(&mut self, machine: usize, code: Code, around: &mut Around<'_>) -> Stepped<()> {
        let Some((first, _)) = code else {
            return Ok(());
        };
        match self.execute(machine, first, around.peers, around.now) {
            Flow::Done(_) => Ok(()),
            Flow::Yielded(at) => self.fail(machine, Cause::Code, at),
            Flow::Failed(cause, at) => self.fail(machine, cause, at),
        }
    }

    fn begin(&mut self, machine: usize, around: &mut Around<'_>) -> Stepped<()> {
        let initial = self.program.machines.get(machine).map_or(0, |m| m.initial);
        if let Some(run) = self.runs.get_mut(machine) {
            run.state = initial;
        }
        let precondition = self.code(machine, |state| state.precondition);
        if !self.is_true(machine, precondition, around)? {
            let at = precondition.map_or(0, |(first, _)| first);
            return self.fail(machine, Cause::Precondition, at);
        }
        self.enter(machine, around)
    }

    fn stop(&mut self, machine: usize, around: &mut Around<'_>) -> Stepped<()> {
        let last = self.program.machines.get(machine).map_or(0, |m| m.last);
        let stage = self.runs.get(machine).map(|run| run.stage);
        if stage == Some(Stage::Begin) {
            self.set_status(machine, Status::Inactive);
            return Ok(());
        }
        if let Some(run) = self.runs.get_mut(machine) {
            // The final state completes by itself.
            (run.mode, run.is_paused) = (Mode::Automatic, false);
        }
        if self.current(machine) == last {
            return Ok(());
        }
        self.outcome.transitions += 1;
        self.change(machine, last, around)
    }

    fn change(&mut self, machine: usize, target: usize, around: &mut Around<'_>) -> Stepped<()> {
        let exit = self.code(machine, |state| state.exit);
        self.run_whole(machine, exit, around)?;
        if let Some(run) = self.runs.get_mut(machine) {
            run.state = target;
        }
        self.enter(machine, around)
    }

    fn enter(&mut self, machine: usize, around: &mut Around<'_>) -> Stepped<()> {
        let Some((first, _)) = self.code(machine, |state| state.entry) else {
            self.set_stage(machine, Stage::Ready);
            return Ok(());
        };
        let flow = self.execute(machine, first, around.peers, around.now);
        self.entered(machine, flow)
    }

    fn entered(&mut self, machine: usize, flow: Flow) -> Stepped<()> {
        match flow {
            Flow::Done(_) => self.set_stage(machine, Stage::Ready),
            Flow::Yielded(at) => self.set_stage(machine, Stage::Entering(at)),
            Flow::Failed(cause, at) => return self.fail(machine, cause, at),
        }
        Ok(())
    }

    /// Records an error. If the state listens to `error`, it is examined in the next step; else the machine fails.
    fn fail<T>(&mut self, machine: usize, cause: Cause, at: usize) -> Stepped<T> {
        let program = std::sync::Arc::clone(&self.program);
        let place = program
            .places
            .get(at)
            .map_or((0, 0), |place| (place.start, place.end));
        let Some(run) = self.runs.get_mut(machine) else {
            return Err(Failed);
        };
        run.failure = Some(Failure {
            cause,
            state: run.state,
            at: place,
        });
        let transitions = program
            .state(machine, run.state)
            .map(|state| &state.transitions);
        let listens = |t: &crate::machine::code::TransitionCode| t.event == Some(ERROR_EVENT);
        if transitions.is_some_and(|transitions| transitions.iter().any(listens)) {
            run.events |= 1 << ERROR_EVENT;
            run.stage = Stage::Ready;
        } else {
            run.status = Status::Failed;
        }
        Err(Failed)
    }
}
