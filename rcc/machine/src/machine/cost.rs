//! The bound on the operations of one step: the longest way from where a program may begin or continue to where it yields or
//! ends, added up over what a step may execute.

use crate::machine::code::{Code, MachineCode, Op, Program, StateCode};
use crate::machine::parse::DEPTH_MAX;

/// Cost of a step of one machine beside its programs, ns: the test of its components, and its publication.
const STEP_NS: u64 = 300;
/// Cost of each component and each variable in a step, ns.
const MEMBER_NS: u64 = 25;
/// Cost of each connection in a cycle, ns, and of each value that it passes.
const CONNECTION_NS: u64 = 40;
const PASSED_NS: u64 = 3;
/// Cost of executing a program or condition, ns, beside its operations.
const PROGRAM_NS: u64 = 60;

/// Bound on the cost of an operation, ns. The benchmark `step` measures a fifth of it, up to 11 ns for an operation with a component
/// that answers from memory; what a component costs in a controller is added.
const fn nanos(op: &Op) -> u64 {
    match op {
        // Checks resources and devices, and moves nets.
        Op::Request(..) => 2_000,
        Op::Set { count, .. } => 120 + 60 * *count as u64,
        Op::Call { arguments, .. } => 150 + 60 * *arguments as u64,
        Op::Read { .. } | Op::Write { .. } | Op::IsDone => 60,
        Op::Push(_)
        | Op::Load(_)
        | Op::Store(_)
        | Op::Is(..)
        | Op::InState(..)
        | Op::IsStatus(..)
        | Op::Has
        | Op::Unary(_)
        | Op::Binary(_)
        | Op::Widen
        | Op::Unless(_)
        | Op::Jump(_)
        | Op::Yield
        | Op::Limit(_)
        | Op::IsOver
        | Op::IsSettled(_)
        | Op::Raise(_)
        | Op::Control(..)
        | Op::TimedOut
        | Op::End => 20,
    }
}

/// Sets the bounds of a program: operations and time.
pub(super) fn bound(program: &mut Program) {
    program.worst = worst(program, 0, |_| 1).0;
    program.worst_at = worst(program, 0, |_| 1).1;
    let per_program = usize::try_from(PROGRAM_NS).unwrap_or(usize::MAX);
    let weight = |op: &Op| usize::try_from(nanos(op)).unwrap_or(usize::MAX);
    let operations = worst(program, per_program, weight).0;
    let members = program.members.len() + program.variables.len();
    let passed = program.connections.iter().map(|connection| {
        let port = program.members.get(connection.from.0);
        let port = port.and_then(|m| m.component.ports.get(connection.from.1));
        u64::from(port.and_then(|port| port.declared.shape.len).unwrap_or(1))
    });
    let passed: u64 = passed.map(|words| CONNECTION_NS + PASSED_NS * words).sum();
    let around = STEP_NS * program.machines.len() as u64 + MEMBER_NS * members as u64 + passed;
    program.worst_ns = around.saturating_add(operations as u64);
}

/// The bound of a step by the weight of each operation and of each program, and the states with the longest one.
fn worst(program: &Program, per_program: usize, weight: impl Fn(&Op) -> usize) -> (usize, String) {
    let longest = longest(&program.ops, weight);
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
            + per_program
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
    (worst, names.join(", "))
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
fn longest(ops: &[Op], weight: impl Fn(&Op) -> usize) -> Vec<usize> {
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
                *slot = rest + weight(op);
            }
        }
        if longest == before {
            break;
        }
    }
    longest
}
