//! Every cell of a machine's own life: in each situation each request, event and step, and what the next step executes. The table
//! is written by hand from docs/machine.md.

use super::tests::Rig;
use crate::machine::Control;
use crate::value::Value;

/// Programs log: entry of A 1 and 2 (2 ms later), run 3 and 4, handle 5, exit 6, transition to B 7, on `e` to B 8; of B 11 to 14, to Z 15;
/// of Z 21, 22 and 23.
const MACHINE: &str = "event e; event f;
  initial state A { entry { log 1; if c.level == 1.0 { wait 2ms; log 2; } }
    run { log 3; if c.level == 2.0 { wait 2ms; log 4; } } handle { log 5; } exit { log 6; }
    transition if c.flag to B { log 7; } transition on e to B { log 8; } }
  state B { entry { log 11; } run { log 12; } handle { log 13; } exit { log 14; } transition to Z { log 15; } }
  final state Z { entry { log 21; } run { log 22; } handle { log 23; } }";

/// Columns.
#[derive(Clone, Copy, Debug)]
enum Input {
    /// None.
    Step,
    /// The condition of the transition to B becomes true.
    Condition,
    /// The event that the state A listens to.
    Event,
    /// An event that no state listens to.
    Unheard,
    /// State B is requested, and the condition of its transition is true.
    Enter,
    /// State B is requested, and the condition of its transition is not true.
    EnterInVain,
    Control(Control),
    /// The net of the component ends with an error.
    Error,
    /// The controller is stopped.
    Halt,
}

const INPUTS: [Input; 15] = [
    Input::Step,
    Input::Condition,
    Input::Event,
    Input::Unheard,
    Input::Enter,
    Input::EnterInVain,
    Input::Control(Control::Activate),
    Input::Control(Control::Start),
    Input::Control(Control::Reactive),
    Input::Control(Control::Pause),
    Input::Control(Control::Step),
    Input::Control(Control::Stop),
    Input::Control(Control::Deactivate),
    Input::Error,
    Input::Halt,
];

/// Rows: how a machine comes there. Columns: after each input, the state behind the next step, what that step executed, and status or mode.
/// `-` before it: the request is refused, and the step is as without it.
const TABLE: &[(&str, [&str; 15])] = &[
    (
        "inactive",
        [
            "-[] inactive",
            "-[] inactive",
            "-[] inactive",
            "-[] inactive",
            "-[] inactive",
            "-[] inactive",
            "A[1] reactive",
            "- -[] inactive",
            "- -[] inactive",
            "- -[] inactive",
            "- -[] inactive",
            "- -[] inactive",
            "- -[] inactive",
            "-[] inactive",
            "-[] inactive",
        ],
    ),
    (
        "activated",
        [
            "A[1] reactive",
            "A[1] reactive",
            "A[1] reactive",
            "A[1] reactive",
            "A[1] reactive",
            "A[1] reactive",
            "- A[1] reactive",
            "A[1] automatic",
            "A[1] reactive",
            "A[] paused",
            "A[1] reactive",
            "-[] inactive",
            "- A[1] reactive",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "activated automatic",
        [
            "A[1] automatic",
            "A[1] automatic",
            "A[1] automatic",
            "A[1] automatic",
            "A[1] automatic",
            "A[1] automatic",
            "- A[1] automatic",
            "A[1] automatic",
            "A[1] reactive",
            "A[] paused",
            "A[1] automatic",
            "-[] inactive",
            "- A[1] automatic",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "activated paused",
        [
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "- A[] paused",
            "A[1] automatic",
            "A[1] reactive",
            "A[] paused",
            "A[1] paused",
            "-[] inactive",
            "- A[] paused",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "entering activated step",
        [
            "A[] reactive",
            "A[] reactive",
            "A[] reactive",
            "A[] reactive",
            "A[] reactive",
            "A[] reactive",
            "- A[] reactive",
            "A[] automatic",
            "A[] reactive",
            "A[] paused",
            "A[] reactive",
            "Z[6 21] automatic",
            "- A[] reactive",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "entering activated step automatic",
        [
            "A[] automatic",
            "A[] automatic",
            "A[] automatic",
            "A[] automatic",
            "A[] automatic",
            "A[] automatic",
            "- A[] automatic",
            "A[] automatic",
            "A[] reactive",
            "A[] paused",
            "A[] automatic",
            "Z[6 21] automatic",
            "- A[] automatic",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "entering activated step automatic paused",
        [
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "- A[] paused",
            "A[] automatic",
            "A[] reactive",
            "A[] paused",
            "A[] paused",
            "Z[6 21] automatic",
            "- A[] paused",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "activated step",
        [
            "A[] reactive",
            "A[] reactive",
            "B[8 6 11] reactive",
            "A[] reactive",
            "B[7 6 11] reactive",
            "A[] reactive",
            "- A[] reactive",
            "A[3 5] automatic",
            "A[] reactive",
            "A[] paused",
            "A[3 5] reactive",
            "Z[6 21] automatic",
            "- A[] reactive",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "activated step automatic",
        [
            "A[3 5] automatic",
            "B[3 7 6 11] automatic",
            "B[8 6 11] automatic",
            "A[3 5] automatic",
            "B[7 6 11] automatic",
            "A[3 5] automatic",
            "- A[3 5] automatic",
            "A[3 5] automatic",
            "A[] reactive",
            "A[] paused",
            "A[3 5] automatic",
            "Z[6 21] automatic",
            "- A[3 5] automatic",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "activated step automatic paused",
        [
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "- A[] paused",
            "A[3 5] automatic",
            "A[] reactive",
            "A[] paused",
            "A[3 5] paused",
            "Z[6 21] automatic",
            "- A[] paused",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "running activated step automatic step",
        [
            "A[] automatic",
            "A[] automatic",
            "B[8 6 11] automatic",
            "A[] automatic",
            "B[7 6 11] automatic",
            "A[] automatic",
            "- A[] automatic",
            "A[] automatic",
            "A[] reactive",
            "A[] paused",
            "A[] automatic",
            "Z[6 21] automatic",
            "- A[] automatic",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "running activated step automatic step paused",
        [
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "A[] paused",
            "- A[] paused",
            "A[] automatic",
            "A[] reactive",
            "A[] paused",
            "A[] paused",
            "Z[6 21] automatic",
            "- A[] paused",
            "A[] failed",
            "A[] failed",
        ],
    ),
    (
        "activated step stopped step",
        [
            "Z[22 23] finished",
            "Z[22 23] finished",
            "Z[22 23] finished",
            "Z[22 23] finished",
            "Z[22 23] finished",
            "Z[22 23] finished",
            "- Z[22 23] finished",
            "Z[22 23] finished",
            "Z[] reactive",
            "Z[] paused",
            "Z[22 23] finished",
            "Z[] automatic",
            "- Z[22 23] finished",
            "Z[] failed",
            "Z[] failed",
        ],
    ),
    (
        "activated step stopped step step",
        [
            "Z[] finished",
            "Z[] finished",
            "Z[] finished",
            "Z[] finished",
            "Z[] finished",
            "Z[] finished",
            "A[1] reactive",
            "- Z[] finished",
            "- Z[] finished",
            "- Z[] finished",
            "- Z[] finished",
            "- Z[] finished",
            "-[] inactive",
            "Z[] finished",
            "Z[] finished",
        ],
    ),
];

/// A machine in that situation.
fn situation(name: &str) -> Rig {
    let mut rig = super::tests::rig_of(MACHINE);
    let slow = |rig: &mut Rig, level| rig.peers.level = Some(Value::Double(level));
    for word in name.split(' ') {
        match word {
            "inactive" => {}
            "activated" => rig.control(Control::Activate),
            "entering" => slow(&mut rig, 1.0),
            "running" => slow(&mut rig, 2.0),
            "step" => drop(rig.step()),
            "automatic" => rig.control(Control::Start),
            "paused" => rig.control(Control::Pause),
            "stopped" => rig.control(Control::Stop),
            "failed" => rig.machine.halt(super::Cause::Halted),
            other => panic!("{other}"),
        }
    }
    rig
}

/// The next step after an input: the log, the state, and how the machine is then.
fn cell(name: &str, input: Input) -> String {
    let mut rig = situation(name);
    let mut refused = "";
    match input {
        Input::Step => {}
        Input::Condition => rig.peers.flag = Some(Value::Bool(true)),
        Input::Event => rig.machine.raise(1),
        Input::Unheard => rig.machine.raise(2),
        Input::Enter => {
            rig.peers.flag = Some(Value::Bool(true));
            rig.machine.request_state(0, 1);
        }
        Input::EnterInVain => rig.machine.request_state(0, 1),
        Input::Control(control) => {
            if rig.machine.control(0, control).is_err() {
                refused = "- ";
            }
        }
        Input::Error => rig.machine.component_failed(0),
        Input::Halt => rig.machine.halt(super::Cause::Halted),
    }
    let (log, state) = rig.step();
    let log: Vec<String> = log.iter().map(ToString::to_string).collect();
    let log = log.join(" ");
    let machine = &rig.machine;
    let how = match machine.status(0) {
        super::Status::Active if machine.is_paused(0) => "paused",
        super::Status::Active => machine.mode(0).word(),
        status @ (super::Status::Inactive | super::Status::Finished | super::Status::Failed) => {
            status.word()
        }
    };
    format!("{refused}{state}[{log}] {how}")
}

#[test]
fn machine_every_cell_is_as_documented() {
    for (name, expected) in TABLE {
        for (input, expected) in INPUTS.into_iter().zip(expected) {
            assert_eq!(cell(name, input), *expected, "{name}: {input:?}");
        }
    }
}
