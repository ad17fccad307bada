//! What can be seen before a machine runs: states that no transition leads to or that cannot reach the final one, and what
//! its paths do with components: started twice, before they are configured, or not stopped; ports read before anything
//! writes them.

mod paths;

use crate::diagnostic::Diagnostics;
use crate::machine::code::{Control, MachineCode, Op, Program, TransitionCode};

pub(super) fn check(program: &Program, found: &mut Diagnostics) {
    for (number, machine) in program.machines.iter().enumerate() {
        let inner = program
            .machines
            .iter()
            .skip(1)
            .any(|other| std::ptr::eq(other, machine));
        states(machine, found);
        if inner && !is_activated(program, number) {
            let cause = format!("machine `{}` is never activated", machine.name);
            let hint = format!("write `activate {};` in a state", machine.name);
            found.warning(machine.at.clone(), cause, hint);
        }
    }
    inputs(program, found);
    paths::check(program, found);
}

fn is_activated(program: &Program, machine: usize) -> bool {
    let activates = |op: &Op| matches!(op, Op::Control(m, Control::Activate) if *m == machine);
    program.ops.iter().any(activates)
}

fn states(machine: &MachineCode, found: &mut Diagnostics) {
    let count = machine.states.len();
    let targets = |state: usize| {
        let state = machine.states.get(state);
        state
            .into_iter()
            .flat_map(|s| s.transitions.iter().map(|t| t.target))
    };
    let mut reached = vec![false; count];
    let mut open = vec![machine.initial];
    while let Some(state) = open.pop() {
        if let Some(seen) = reached.get_mut(state).filter(|seen| !**seen) {
            *seen = true;
            open.extend(targets(state));
        }
    }
    let mut ends = vec![false; count];
    let mut changed = true;
    while changed {
        changed = false;
        for state in 0..count {
            let leads = state == machine.last
                || targets(state).any(|target| ends.get(target) == Some(&true));
            if let Some(end) = ends.get_mut(state).filter(|end| leads && !**end) {
                *end = true;
                changed = true;
            }
        }
    }
    let name = machine
        .states
        .get(machine.last)
        .map_or("", |state| &state.name);
    for (index, state) in machine.states.iter().enumerate() {
        if reached.get(index) == Some(&false) {
            let cause = format!("no path leads from the initial state to `{}`", state.name);
            let hint = format!("add a transition `to {}`, or remove the state", state.name);
            found.error(state.at.clone(), cause, hint);
        }
        if ends.get(index) == Some(&false) {
            let cause = format!(
                "no path leads from `{}` to the final state `{name}`",
                state.name
            );
            found.error(
                state.at.clone(),
                cause,
                format!("add a transition `to {name}`"),
            );
        }
        let always = |t: &&TransitionCode| t.event.is_none() && t.condition.is_none();
        let first = state.transitions.iter().position(|t| always(&t));
        let hidden = state
            .transitions
            .iter()
            .skip(first.map_or(count, |i| i + 1));
        for transition in hidden.filter(|t| t.event.is_none()) {
            let target = machine.states.get(transition.target);
            if target.is_none_or(|target| target.precondition.is_none()) && first.is_some() {
                let cause = "this transition is never examined: an earlier one has no condition";
                found.warning(
                    transition.at.clone(),
                    cause,
                    "give the earlier one an `if`, or move it behind",
                );
            }
        }
    }
}

/// In ports that the machine reads and nothing writes.
fn inputs(program: &Program, found: &mut Diagnostics) {
    let is_written = |component: usize, port: usize| {
        let connected = program
            .connections
            .iter()
            .any(|c| c.to == (component, port));
        connected || program.ops.contains(&Op::Write { component, port })
    };
    for (op, at) in program.ops.iter().zip(&program.places) {
        let Op::Read {
            component, port, ..
        } = *op
        else {
            continue;
        };
        let Some(member) = program.members.get(component) else {
            continue;
        };
        let Some(declared) = member.component.ports.get(port) else {
            continue;
        };
        if !declared.is_output && !is_written(component, port) {
            let name = format!("{}.{}", member.name, declared.declared.name);
            let cause = format!("`{name}` is read, but nothing writes it");
            found.error(
                at.clone(),
                cause,
                format!("connect it: `connect … -> {name};`"),
            );
        }
    }
}
