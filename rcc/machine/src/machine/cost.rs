//! The bound on the operations of one step: the longest way from where a program may begin or continue to where it yields or
//! ends, added up over what a step may execute.

use crate::machine::code::{Code, MachineCode, Op, Program, StateCode};
use crate::machine::parse::DEPTH_MAX;

/// Sets the bound of a program.
pub(super) fn bound(program: &mut Program) {
    let longest = longest(&program.ops);
    let segment = |code: Code| -> usize {
        let Some((first, end)) = code else {
            return 0;
        };
        let after_yield = (first..end).filter(|at| program.ops.get(*at) == Some(&Op::Yield));
        let starts = after_yield.map(|at| at + 1).chain([first]);
        starts
            .filter_map(|at| longest.get(at).copied())
            .max()
            .unwrap_or(0)
    };
    let (mut worst, mut names) = (0, Vec::new());
    for machine in &program.machines {
        let costs = machine
            .states
            .iter()
            .map(|state| (step(machine, state, &segment), state));
        if let Some((cost, state)) = costs.max_by_key(|(cost, _)| *cost) {
            worst += cost;
            names.push(state.name.clone());
        }
    }
    program.worst = worst;
    program.worst_at = names.join(", ");
}

/// The bound of one step in a state.
fn step(machine: &MachineCode, state: &StateCode, segment: &impl Fn(Code) -> usize) -> usize {
    let entry = |target: usize| machine.states.get(target).map_or(0, |s| segment(s.entry));
    let precondition = |target: usize| {
        machine
            .states
            .get(target)
            .map_or(0, |s| segment(s.precondition))
    };
    let examined = state.transitions.iter().map(|t| {
        // Events, a requested state and the conditions: each transition is examined twice at most.
        2 * (segment(t.condition) + precondition(t.target) + segment(t.failure))
    });
    let made = state.transitions.iter();
    let made = made.map(|t| segment(t.program) + segment(state.exit) + entry(t.target));
    let stopped = segment(state.exit) + entry(machine.last);
    let made = made.max().unwrap_or(0).max(segment(state.handle));
    let settled = segment(state.run) + examined.sum::<usize>() + made;
    let begun = segment(state.precondition) + segment(state.entry);
    settled.max(stopped).max(begun)
}

/// By operation, how many are executed from there to the end of the step. Ways lead backwards only behind a yield, so
/// jumps to earlier operations are resolved by a second pass over the text in reverse.
fn longest(ops: &[Op]) -> Vec<usize> {
    let mut longest = vec![0_usize; ops.len()];
    // Each pass settles one more level of backward jumps; loops nest at most as deep as blocks.
    for _ in 0..=DEPTH_MAX + 1 {
        let before = longest.clone();
        for (at, op) in ops.iter().enumerate().rev() {
            let next = |to: usize| longest.get(to).copied().unwrap_or(0);
            let rest = match op {
                Op::Yield | Op::End | Op::TimedOut => 0,
                Op::Jump(target) => next(*target),
                Op::Unless(target) => next(*target).max(next(at + 1)),
                Op::Push(_)
                | Op::Load(_)
                | Op::Store(_)
                | Op::Read { .. }
                | Op::Is(..)
                | Op::InState(..)
                | Op::IsStatus(..)
                | Op::Has
                | Op::Unary(_)
                | Op::Binary(_)
                | Op::Widen
                | Op::Limit(_)
                | Op::IsOver
                | Op::Write { .. }
                | Op::Set { .. }
                | Op::Request(..)
                | Op::IsSettled(_)
                | Op::Call { .. }
                | Op::IsDone
                | Op::Raise(_)
                | Op::Control(..) => next(at + 1),
            };
            if let Some(slot) = longest.get_mut(at) {
                *slot = rest + 1;
            }
        }
        if longest == before {
            break;
        }
    }
    longest
}
