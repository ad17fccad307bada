//! Semantics of machines: which programs are executed in which step, by a log that the programs write through an operation.

use std::sync::Arc;

use proptest::prelude::*;

use super::{Cause, Machine, Mode, Peers, Refused, Ticket};
use crate::lifecycle::{Phase, Request};
use crate::machine::{Control, Program, Status};
use crate::value::Value;

const COMPONENT: &str = "component C {
  property gain: int range 0 .. 9 default 1 live;
  property fixed: double default 0;
  in x: int;
  out flag: bool;
  out level: double;
  operation log(n: int);
  operation work() done flag;
}
{ g=Core::IntNetcommIn(Key='gain'), f=Core::DoubleValue(Value='$fixed'), x=Core::IntNetcommIn(Key='x'),
  l=Core::IntNetcommIn(Key='log'), n=Core::IntNetcommIn(Key='log_n'), w=Core::IntNetcommIn(Key='work'),
  b=Core::BooleanValue(), flag=Core::BooleanNetcommOut(inValue=b.outValue, Key='flag'),
  level=Core::DoubleNetcommOut(inValue=f.outValue, Key='level'), outTerminate=b.outValue }";

/// One component whose ports a test sets.
#[derive(Debug, Default)]
pub(super) struct Bench {
    phase: Phase,
    pub(super) flag: Option<Value>,
    pub(super) level: Option<Value>,
    log: Vec<i32>,
    set: Vec<(usize, Value)>,
    written: Option<Value>,
    is_settled: bool,
    is_done: bool,
}

impl Peers for Bench {
    fn phase(&self, _: usize) -> Phase {
        self.phase
    }

    fn read(&self, _: usize, port: usize, _: usize) -> Option<Value> {
        [self.written, self.flag, self.level]
            .get(port)
            .copied()
            .flatten()
    }

    fn write(&mut self, _: usize, _: usize, value: Value) -> Result<(), Refused> {
        self.written = Some(value);
        Ok(())
    }

    fn set(&mut self, _: usize, values: &[(usize, Value)]) -> Result<(), Refused> {
        if values.iter().any(|(_, value)| value.number() > Some(9.0)) {
            return Err(Refused::Value);
        }
        self.set.extend_from_slice(values);
        Ok(())
    }

    fn request(&mut self, _: usize, request: Request) -> Result<(), Refused> {
        self.phase = self.phase.after(request)?;
        Ok(())
    }

    fn is_settled(&self, _: usize) -> Result<bool, Refused> {
        Ok(self.is_settled)
    }

    fn call(
        &mut self,
        component: usize,
        operation: usize,
        arguments: &[Value],
    ) -> Result<Ticket, Refused> {
        if let (0, Some(Value::Int(n))) = (operation, arguments.first()) {
            self.log.push(*n);
        }
        Ok(Ticket {
            component,
            operation,
            number: 0,
        })
    }

    fn is_done(&self, _: Ticket) -> Result<bool, Refused> {
        Ok(self.is_done)
    }
}

pub(in crate::machine) fn library(_: &str) -> Result<String, String> {
    Ok(COMPONENT.to_owned())
}

pub(super) struct Rig {
    pub(super) machine: Machine,
    pub(super) peers: Bench,
    now: i64,
}

/// An active machine; `log N;` stands for a call of the log.
fn rig(states: &str) -> Rig {
    let mut rig = rig_of(states);
    rig.control(Control::Activate);
    rig
}

/// The same, inactive.
pub(super) fn rig_of(states: &str) -> Rig {
    let mut body = states.to_owned();
    for n in 0..100 {
        body = body.replace(&format!("log {n};"), &format!("call c.log({n});"));
    }
    // A machine inside that starts the component, never activated: paths of the outer one are then not examined.
    let inner = "machine unused { initial final state U { entry { start c; stop c; } } }";
    let text = format!("machine M {{ component c from \"c\" configured; {body} {inner} }}");
    let (program, _) = Program::compile(&text, &library)
        .map_err(|e| e.render("m", &text))
        .unwrap();
    Rig {
        machine: Machine::new(Arc::new(program)),
        peers: Bench {
            phase: Phase::Stopped,
            ..Bench::default()
        },
        now: 0,
    }
}

impl Rig {
    pub(super) fn control(&mut self, control: Control) {
        self.machine.control(0, control).unwrap();
    }

    /// One step; the log of it, and the state after it.
    pub(super) fn step(&mut self) -> (Vec<i32>, String) {
        self.now += 1_000_000;
        let outcome = self.machine.step(&mut self.peers, self.now);
        assert!(
            outcome.operations <= self.machine.program().worst_step(),
            "{outcome:?}"
        );
        let state = self.machine.state(0).unwrap_or("-").to_owned();
        (std::mem::take(&mut self.peers.log), state)
    }

    fn expect(&mut self, log: &[i32], state: &str) {
        assert_eq!(self.step(), (log.to_vec(), state.to_owned()));
    }

    fn cause(&self) -> Option<Cause> {
        self.machine.failure(0).map(|failure| failure.cause)
    }
}

/// Two states that log all their programs.
const TWO: &str = "var go: bool; var back: bool; event e;
  initial state A { entry { log 1; } run { log 2; } handle { log 3; } exit { log 4; }
    transition if go to B { log 5; } transition on e to B { log 6; } }
  final state B { entry { log 11; } run { log 12; } handle { log 13; } exit { log 14; }
    transition if back to A { log 15; } }";

fn two() -> Rig {
    let mut rig = rig(&TWO
        .replace("if go", "if c.flag")
        .replace("if back", "if not c.flag"));
    rig.expect(&[1], "A");
    rig
}

#[test]
fn automatic_mode_runs_then_handles_or_changes() {
    let mut rig = two();
    rig.control(Control::Start);
    rig.expect(&[2, 3], "A");
    rig.peers.flag = Some(Value::Bool(true));
    // Transition program, exit of the old state, entry of the new one, in one step.
    rig.expect(&[2, 5, 4, 11], "B");
    rig.expect(&[12, 13], "B");
    rig.peers.flag = Some(Value::Bool(false));
    rig.expect(&[12, 15, 14, 1], "A");
}

#[test]
fn reactive_mode_waits_for_events_and_requests() {
    let mut rig = two();
    rig.peers.flag = Some(Value::Bool(true));
    assert_eq!(rig.machine.mode(0), Mode::Reactive);
    rig.expect(&[], "A");
    rig.machine.raise(1);
    rig.expect(&[6, 4, 11], "B");
    rig.machine.request_state(0, 0);
    // The condition of the requested state is not true: nothing happens, now or later.
    rig.expect(&[], "B");
    rig.peers.flag = Some(Value::Bool(false));
    rig.expect(&[], "B");
    rig.machine.request_state(0, 0);
    rig.expect(&[15, 14, 1], "A");
}

#[test]
fn mode_changes_while_running() {
    let mut rig = two();
    rig.control(Control::Start);
    rig.expect(&[2, 3], "A");
    rig.control(Control::Reactive);
    rig.expect(&[], "A");
    rig.control(Control::Start);
    rig.expect(&[2, 3], "A");
    rig.control(Control::Pause);
    rig.machine.raise(1);
    rig.expect(&[], "A");
    rig.control(Control::Start);
    // The event of the pause is examined before the run program.
    rig.expect(&[6, 4, 11], "B");
}

#[test]
fn single_step_works_in_pause_and_reactive_mode() {
    let mut rig = two();
    rig.control(Control::Step);
    rig.control(Control::Step);
    rig.expect(&[2, 3], "A");
    rig.expect(&[2, 3], "A");
    rig.expect(&[], "A");
    rig.control(Control::Pause);
    rig.control(Control::Step);
    rig.expect(&[2, 3], "A");
    rig.expect(&[], "A");
}

#[test]
fn stop_enters_final_state_from_each_state() {
    let text = TWO.replace(" transition if back to A { log 15; }", "");
    let text = text
        .replace("go", "c.flag")
        .replace("var c.flag: bool; var back: bool;", "");
    let mut rig = rig(&text);
    rig.expect(&[1], "A");
    rig.control(Control::Stop);
    rig.expect(&[4, 11], "B");
    rig.expect(&[12, 13], "B");
    assert_eq!(rig.machine.status(0), Status::Finished);
    rig.expect(&[], "B");
    rig.control(Control::Deactivate);
    assert_eq!(rig.machine.state(0), None);
    rig.control(Control::Activate);
    rig.expect(&[1], "A");
}

#[test]
fn self_transition_runs_neither_exit_nor_entry() {
    let mut rig = rig(
        "initial state A { entry { log 1; } handle { log 2; } exit { log 3; }
        transition if c.flag to A { log 4; } transition to B; } final state B { }",
    );
    rig.control(Control::Start);
    rig.expect(&[1], "A");
    rig.peers.flag = Some(Value::Bool(true));
    rig.expect(&[4], "A");
    rig.expect(&[4], "A");
    rig.peers.flag = None;
    rig.expect(&[3], "B");
}

#[test]
fn precondition_veto_runs_failure_and_continues() {
    let mut rig = rig("initial state A { handle { log 9; }
        transition to B { log 1; } else { log 2; } transition if c.level > 1 to D { log 3; } }
        state B { precondition c.flag; transition to D; } final state D { }");
    rig.control(Control::Start);
    rig.expect(&[], "A");
    rig.expect(&[2, 9], "A");
    rig.peers.level = Some(Value::Double(2.0));
    rig.expect(&[2, 3], "D");
}

#[test]
fn only_first_true_transition_is_made() {
    let mut rig = rig(
        "initial state A { transition if false to D { log 1; } transition if true to B { log 2; }
        transition if true to D { log 3; } } state B { transition to D; } final state D { }",
    );
    rig.control(Control::Start);
    rig.expect(&[], "A");
    rig.expect(&[2], "B");
    rig.expect(&[], "D");
}

#[test]
fn event_ends_run_program_but_not_entry() {
    let mut rig = rig("event e; initial state A { entry { log 1; wait 2ms; log 2; } run { log 3; wait 5ms; log 4; }
        transition on e to D { log 5; } } final state D { }");
    rig.control(Control::Start);
    rig.expect(&[1], "A");
    rig.machine.raise(1);
    rig.expect(&[], "A");
    rig.expect(&[2], "A");
    // Raised while the entry program was under way, kept until it ended.
    rig.expect(&[5], "D");
    let mut rig = self::rig(
        "event e; event f; initial state A { run { log 3; wait 5ms; log 4; }
        transition on e to D { log 5; } } final state D { }",
    );
    rig.control(Control::Start);
    rig.expect(&[], "A");
    rig.expect(&[3], "A");
    rig.machine.raise(2);
    // No transition listens to `f`.
    rig.expect(&[], "A");
    rig.machine.raise(1);
    rig.expect(&[5], "D");
}

#[test]
fn waits_and_calls_take_their_steps() {
    let mut rig = rig("initial state A { entry { log 1; wait 3ms; log 2; wait for c.flag; log 3; do c.work(); log 4;
        do c.work() within 2ms else { log 5; } yield; log 6; while c.level < 2 { log 7; yield; } log 8; }
        transition to D; } final state D { }");
    for expected in [vec![1], vec![], vec![], vec![2], vec![]] {
        assert_eq!(rig.step().0, expected);
    }
    rig.peers.flag = Some(Value::Bool(true));
    rig.expect(&[3], "A");
    rig.expect(&[], "A");
    rig.peers.is_done = true;
    rig.expect(&[4], "A");
    rig.peers.is_done = false;
    rig.expect(&[], "A");
    rig.expect(&[5], "A");
    rig.peers.level = Some(Value::Double(1.0));
    rig.expect(&[6, 7], "A");
    rig.expect(&[7], "A");
    rig.peers.level = Some(Value::Double(2.0));
    rig.expect(&[8], "A");
}

#[test]
fn components_are_requested_and_awaited() {
    let mut rig = rig("initial state A { entry { configure c; log 1; start c; c.gain := 3;
        set c { gain := 4; fixed := 2; } c.x := 7; stop c; stop c; cleanup c; log 2; } transition to D; }
        final state D { }");
    rig.expect(&[], "A");
    rig.expect(&[], "A");
    rig.peers.is_settled = true;
    rig.expect(&[1], "A");
    let expected = [
        (0, Value::Int(3)),
        (0, Value::Int(4)),
        (1, Value::Double(2.0)),
    ];
    assert_eq!(
        (rig.peers.set.as_slice(), rig.peers.written),
        (&expected[..], Some(Value::Int(7)))
    );
    rig.expect(&[2], "A");
    assert_eq!(rig.peers.phase, Phase::PreOperational);
}

#[test]
fn error_without_transition_fails_machine_in_place() {
    for (statement, cause) in [
        ("n := 2147483647 + 1;", Cause::Overflow),
        ("n := 1 / n;", Cause::DivisionByZero),
        ("n := c.x;", Cause::Null),
        ("do c.work() within 0ms;", Cause::TimedOut),
        ("c.gain := 9 + n + 1;", Cause::Refused(Refused::Value)),
    ] {
        let mut rig = rig(&format!(
            "var n: int; initial state A {{ run {{ if false {{ c.x := 1; }} {statement} }} transition to D; }} final state D {{ }}"
        ));
        rig.control(Control::Start);
        for _ in 0..3 {
            rig.step();
        }
        assert_eq!(
            (rig.cause(), rig.machine.status(0)),
            (Some(cause), Status::Failed),
            "{statement}"
        );
        assert_eq!(rig.machine.state(0), Some("A"));
        assert!(rig.machine.control(0, Control::Start).is_err());
    }
}

#[test]
fn error_transition_leads_to_its_state() {
    let mut rig = rig(
        "var n: int; initial state A { run { n := 1 / n; } transition on error to D { log 1; } }
        final state D { }",
    );
    rig.control(Control::Start);
    rig.expect(&[], "A");
    rig.expect(&[], "A");
    rig.expect(&[1], "D");
    assert_eq!(rig.cause(), Some(Cause::DivisionByZero));
    rig.expect(&[], "D");
    assert_eq!(rig.machine.status(0), Status::Finished);
}

#[test]
fn machine_inside_is_controlled_by_outer_one() {
    let mut rig = rig("initial state A { entry { activate inner; start inner; log 1; } run { wait for inner is finished; log 2; }
        transition if inner in Z to D; } final state D { }
        machine inner { initial state Y { entry { log 21; } transition to Z; } final state Z { entry { log 22; } } }");
    rig.control(Control::Start);
    rig.expect(&[1, 21], "A");
    rig.expect(&[22], "A");
    rig.expect(&[], "A");
    rig.expect(&[2], "D");
    assert_eq!(rig.machine.state(1), Some("Z"));
}

#[test]
fn control_each_status_refuses_what_is_impossible() {
    for control in Control::ALL {
        let mut rig = two();
        assert_eq!(
            rig.machine.control(0, control).is_ok(),
            !matches!(control, Control::Activate | Control::Deactivate)
        );
        let mut inactive = Machine::new(Arc::clone(rig.machine.program()));
        let result = inactive.control(0, control);
        assert_eq!(result.is_ok(), control == Control::Activate);
        assert!(
            result
                .err()
                .is_none_or(|e| e.to_string().contains("\nhint: "))
        );
    }
}

#[test]
fn null_propagates_and_never_makes_transition() {
    let mut rig = rig("initial state A { handle { log 1; } transition if c.level > 0 to D; transition if not (c.level > 0) to D;
        transition if has c.level and c.flag to D; } final state D { }");
    rig.control(Control::Start);
    rig.expect(&[], "A");
    rig.expect(&[1], "A");
    rig.peers.level = Some(Value::Double(f64::NAN));
    rig.expect(&[], "D");
}

/// The rules in a few lines: states in a ring with conditions on the level, each program a number.
#[derive(Debug, Default)]
struct Model {
    state: usize,
    automatic: bool,
    paused: bool,
    steps: u32,
    event: bool,
    begun: bool,
}

impl Model {
    fn step(&mut self, flag: bool) -> Vec<i32> {
        let code = |n: usize| i32::try_from(n).unwrap();
        let enter = |to: usize| code(10 * to + 1);
        let single = self.steps > 0;
        if self.paused && !single {
            return Vec::new();
        }
        self.steps = self.steps.saturating_sub(1);
        if !self.begun {
            self.begun = true;
            return vec![enter(0)];
        }
        let here = 10 * self.state;
        if std::mem::take(&mut self.event) {
            let to = (self.state + 2) % 3;
            self.state = to;
            return vec![code(here + 6), code(here + 4), enter(to)];
        }
        if !(self.automatic || single) {
            return Vec::new();
        }
        if !flag {
            return vec![code(here + 2), code(here + 3)];
        }
        let to = (self.state + 1) % 3;
        self.state = to;
        vec![code(here + 2), code(here + 5), code(here + 4), enter(to)]
    }
}

proptest! {
    #[test]
    fn machine_random_requests_follow_model(inputs in prop::collection::vec(0..8_u8, 0..200)) {
        let mut states = "event e; ".to_owned();
        for n in 0..3 {
            let kind = ["initial", "", "final"][n];
            let (m, next, far) = (10 * n, (n + 1) % 3, (n + 2) % 3);
            states += &format!("{kind} state S{n} {{ entry {{ log {}; }} run {{ log {}; }} handle {{ log {}; }} exit {{ log {}; }}
                transition if c.flag to S{next} {{ log {}; }} transition on e to S{far} {{ log {}; }} }} ",
                m + 1, m + 2, m + 3, m + 4, m + 5, m + 6);
        }
        let mut rig = rig(&states);
        let mut model = Model::default();
        let mut flag = false;
        for input in inputs {
            match input {
                0 => { rig.control(Control::Start); model.automatic = true; model.paused = false; }
                1 => { rig.control(Control::Reactive); model.automatic = false; model.paused = false; }
                2 => { rig.control(Control::Pause); model.paused = true; }
                3 => { rig.control(Control::Step); model.steps += 1; }
                4 => { rig.machine.raise(1); model.event = true; }
                5 => { flag = !flag; rig.peers.flag = Some(Value::Bool(flag)); }
                _ => prop_assert_eq!(rig.step().0, model.step(flag)),
            }
        }
    }
}
