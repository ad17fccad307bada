//! States of components along all paths of the outermost machine. For each component a set of what it may be is carried
//! through programs and transitions until nothing changes. Components that a machine inside starts or stops are left out:
//! its steps interleave with those of the outer one.
#![expect(
    clippy::wildcard_enum_match_arm,
    reason = "most operations change no component"
)]

use crate::diagnostic::Diagnostics;
use crate::lifecycle::{Phase, Request};
use crate::machine::code::{Code, Op, Program};
use crate::machine::tree::Unary;

/// May be not configured.
const UNLOADED: u8 = 1;
/// May be stopped.
const STOPPED: u8 = 2;
/// May be running.
const RUNNING: u8 = 4;
/// May have run before, or runs.
const RAN: u8 = 8;

/// By component, what it may be.
type Set = Vec<u8>;

fn join(into: &mut Set, other: &Set) -> bool {
    let mut changed = false;
    for (a, b) in into.iter_mut().zip(other) {
        changed |= *a | b != *a;
        *a |= b;
    }
    changed
}

pub(super) fn check(program: &Program, found: &mut Diagnostics) {
    let Some(machine) = program.machines.first() else {
        return;
    };
    let paths = Paths {
        program,
        skipped: skipped(program),
    };
    let start = program.members.iter().map(|member| {
        if member.is_started {
            RUNNING | RAN
        } else if member.is_configured {
            STOPPED
        } else {
            UNLOADED
        }
    });
    let start: Set = start.collect();
    let nothing: Set = vec![0; program.members.len()];
    let mut ins = vec![nothing; machine.states.len()];
    if let Some(initial) = ins.get_mut(machine.initial) {
        join(initial, &start);
    }
    // Sets only grow, by at most four bits of each component and state.
    let mut changed = true;
    while changed {
        changed = false;
        for state in 0..machine.states.len() {
            let Some(before) = ins.get(state).cloned() else {
                continue;
            };
            for (target, set) in paths.state(state, &before, None).0 {
                changed |= ins.get_mut(target).is_some_and(|set_in| join(set_in, &set));
            }
        }
    }
    for (state, set) in ins.iter().enumerate() {
        let (_, after) = paths.state(state, set, Some(&mut *found));
        if state == machine.last {
            paths.left_running(state, &after, found);
        }
    }
}

/// Components that machines inside start or stop.
fn skipped(program: &Program) -> Vec<bool> {
    let mut skipped = vec![false; program.members.len()];
    let inner = program
        .machines
        .iter()
        .skip(1)
        .flat_map(|machine| &machine.states);
    for state in inner {
        let transitions = state
            .transitions
            .iter()
            .flat_map(|t| [t.program, t.failure]);
        let codes = [state.entry, state.run, state.handle, state.exit];
        for (first, end) in codes.into_iter().chain(transitions).flatten() {
            for op in program.ops.get(first..end).unwrap_or_default() {
                if let Op::Request(component, _) = op
                    && let Some(skip) = skipped.get_mut(*component)
                {
                    *skip = true;
                }
            }
        }
    }
    skipped
}

struct Paths<'p> {
    program: &'p Program,
    skipped: Vec<bool>,
}

impl Paths<'_> {
    /// The sets with which other states are entered, and the one at the end of this state.
    fn state(
        &self,
        state: usize,
        before: &Set,
        mut found: Option<&mut Diagnostics>,
    ) -> (Vec<(usize, Set)>, Set) {
        let Some(code) = self.program.state(0, state) else {
            return (Vec::new(), before.clone());
        };
        let last = self
            .program
            .machines
            .first()
            .map_or(0, |machine| machine.last);
        let mut out = Vec::new();
        let entry = self.flow(code.entry, before, found.as_deref_mut());
        // A run program may be left in the middle, and run and handle repeat.
        let mut around = entry.end.clone();
        let mut run = self.flow(code.run, &around, None);
        loop {
            let mut again = run.end.clone();
            for transition in &code.transitions {
                join(
                    &mut again,
                    &self.flow(transition.failure, &run.end, None).end,
                );
                if transition.target == state {
                    join(
                        &mut again,
                        &self.flow(transition.program, &run.any, None).end,
                    );
                }
            }
            let handled = self.flow(code.handle, &again, None).end;
            if !join(&mut around, &handled) && !join(&mut around, &again) {
                break;
            }
            run = self.flow(code.run, &around, None);
        }
        if found.is_some() {
            self.flow(code.run, &around, found.as_deref_mut());
            self.flow(code.handle, &run.end, found.as_deref_mut());
        }
        for transition in &code.transitions {
            let from = if transition.event.is_some() {
                &run.any
            } else {
                &run.end
            };
            self.flow(transition.condition, from, found.as_deref_mut());
            self.flow(transition.failure, from, found.as_deref_mut());
            let made = self
                .flow(transition.program, from, found.as_deref_mut())
                .end;
            if transition.target != state {
                let left = self.flow(code.exit, &made, found.as_deref_mut()).end;
                out.push((transition.target, left));
            }
        }
        if state != last {
            // A stop may come at any step.
            let mut any = entry.any;
            join(&mut any, &run.any);
            out.push((last, self.flow(code.exit, &any, None).end));
        }
        join(&mut run.end, &around);
        (
            out,
            if code.run.is_some() {
                self.flow(code.run, &around, None).end
            } else {
                entry.end
            },
        )
    }

    fn left_running(&self, state: usize, after: &Set, found: &mut Diagnostics) {
        let at = self
            .program
            .state(0, state)
            .map_or(0..0, |code| code.at.clone());
        for ((member, set), skip) in self.program.members.iter().zip(after).zip(&self.skipped) {
            if set & RUNNING != 0 && !skip {
                let name = &member.name;
                let cause =
                    format!("`{name}` is not stopped on a path to the end of the final state");
                let hint = format!(
                    "write `stop {name};` in its entry program; a component that does not run stays stopped"
                );
                found.error(at.clone(), cause, hint);
            }
        }
    }

    /// Carries a set through a program.
    fn flow(&self, code: Code, before: &Set, mut found: Option<&mut Diagnostics>) -> Flow {
        let Some((first, end)) = code else {
            return Flow {
                end: before.clone(),
                any: before.clone(),
            };
        };
        let nothing: Set = vec![0; before.len()];
        let mut sets = vec![nothing.clone(); end - first + 1];
        if let Some(set) = sets.get_mut(0) {
            set.clone_from(before);
        }
        let mut flow = Flow {
            end: nothing,
            any: before.clone(),
        };
        // Loops lead backwards; sets only grow, so this ends.
        let mut changed = true;
        while changed {
            changed = false;
            for at in first..end {
                let Some(set) = sets.get(at - first).cloned() else {
                    continue;
                };
                if set.iter().all(|bits| *bits == 0) && !set.is_empty() {
                    continue;
                }
                for (to, after) in self.after(at, set) {
                    let slot = to.checked_sub(first).and_then(|to| sets.get_mut(to));
                    changed |= slot.is_some_and(|slot| join(slot, &after));
                }
            }
        }
        for at in first..end {
            let (Some(op), Some(set)) = (self.program.ops.get(at), sets.get(at - first)) else {
                continue;
            };
            match op {
                Op::End => {
                    join(&mut flow.end, set);
                }
                Op::Yield => {
                    join(&mut flow.any, set);
                }
                _ => {}
            }
            if let Some(found) = found.as_deref_mut() {
                self.report(at, *op, set, found);
            }
        }
        let end = flow.end.clone();
        join(&mut flow.any, &end);
        flow
    }

    /// The sets behind an operation.
    fn after(&self, at: usize, mut set: Set) -> Vec<(usize, Set)> {
        match self.program.ops.get(at) {
            Some(Op::Jump(target)) => vec![(*target, set)],
            Some(Op::Unless(target)) => {
                let mut otherwise = set.clone();
                if let Some((component, phase, is_not)) = self.tested(at) {
                    let (yes, no) = if is_not {
                        (&mut otherwise, &mut set)
                    } else {
                        (&mut set, &mut otherwise)
                    };
                    let bit = match phase {
                        Phase::PreOperational => UNLOADED,
                        Phase::Stopped => STOPPED,
                        Phase::Running => RUNNING,
                        Phase::RunTimeError | Phase::FatalError => 0,
                    };
                    if bit != 0 {
                        narrow(yes, component, bit | RAN);
                        narrow(no, component, !bit);
                    }
                }
                vec![(at + 1, set), (*target, otherwise)]
            }
            Some(Op::End | Op::TimedOut) | None => Vec::new(),
            Some(Op::Request(component, request)) => {
                if let Some(bits) = set.get_mut(*component) {
                    let ran = *bits & RAN;
                    *bits = match request {
                        Request::Start | Request::Recover => RUNNING | RAN,
                        Request::Stop => ran | STOPPED | (*bits & UNLOADED),
                        Request::Configure => ran | STOPPED,
                        Request::Cleanup => ran | UNLOADED,
                        Request::Error | Request::Fatal => *bits,
                    };
                    if *request == Request::Stop && *bits & UNLOADED != 0 && ran == 0 {
                        *bits &= !STOPPED;
                        *bits |= UNLOADED;
                    }
                }
                vec![(at + 1, set)]
            }
            Some(_) => vec![(at + 1, set)],
        }
    }

    /// The test of a component right before a jump: component, state, whether it is negated.
    fn tested(&self, at: usize) -> Option<(usize, Phase, bool)> {
        let op = |back: usize| at.checked_sub(back).and_then(|at| self.program.ops.get(at));
        match (op(1), op(2)) {
            (Some(Op::Is(component, phase)), _) => Some((*component, *phase, false)),
            (Some(Op::Unary(Unary::Not)), Some(Op::Is(component, phase))) => {
                Some((*component, *phase, true))
            }
            _ => None,
        }
    }

    fn report(&self, at: usize, op: Op, set: &Set, found: &mut Diagnostics) {
        let place = self.program.places.get(at).cloned().unwrap_or(0..0);
        let member = |component: usize| self.program.members.get(component);
        let bits = |component: usize| {
            let skip = self.skipped.get(component) == Some(&true);
            set.get(component)
                .copied()
                .filter(|bits| !skip && *bits != 0)
        };
        match op {
            Op::Request(component, Request::Start) => {
                let (Some(member), Some(bits)) = (member(component), bits(component)) else {
                    return;
                };
                let name = &member.name;
                if bits & RUNNING != 0 {
                    let cause = format!("`{name}` is started twice on a path");
                    let hint = format!(
                        "start it where it cannot run, or write `if {name} is stopped {{ start {name}; }}`"
                    );
                    found.error(place, cause, hint);
                } else if bits & UNLOADED != 0 {
                    let cause = format!("`{name}` is started before it is configured on a path");
                    let hint =
                        format!("write `configure {name};` before, or declare it `configured`");
                    found.error(place, cause, hint);
                }
            }
            Op::Request(component, Request::Configure | Request::Cleanup) => {
                let (Some(member), Some(bits)) = (member(component), bits(component)) else {
                    return;
                };
                if bits & RUNNING != 0 {
                    let cause = format!("`{}` may run here", member.name);
                    found.error(
                        place,
                        cause,
                        format!("write `stop {};` before", member.name),
                    );
                }
            }
            Op::Read {
                component, port, ..
            } => {
                let (Some(member), Some(bits)) = (member(component), bits(component)) else {
                    return;
                };
                let Some(port) = member
                    .component
                    .ports
                    .get(port)
                    .filter(|port| port.is_output)
                else {
                    return;
                };
                if bits & (RAN | RUNNING) == 0 {
                    let name = &member.name;
                    let cause = format!(
                        "`{name}.{}` is read before anything writes it",
                        port.declared.name
                    );
                    let hint =
                        format!("`{name}` does not run on any path to here; start it before");
                    found.error(place, cause, hint);
                }
            }
            _ => {}
        }
    }
}

fn narrow(set: &mut Set, component: usize, bits: u8) {
    if let Some(slot) = set.get_mut(component) {
        *slot &= bits;
    }
}

/// What is possible at the end of a program, and wherever a step may end in it.
struct Flow {
    end: Set,
    any: Set,
}
