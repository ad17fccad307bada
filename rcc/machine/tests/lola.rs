//! The machine of `examples/machine` with its six components: their nets are evaluated in the order of the machine, values cross
//! between them in the same cycle.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod bench;

use bench::Bench;
use takt_machine::machine::Graph;
use takt_machine::{Control, Phase, Program, Status, Value};

#[test]
fn lola_visits_its_states_in_order() {
    let mut bench = Bench::lola();
    bench.machine.control(0, Control::Activate).unwrap();
    bench.machine.control(0, Control::Start).unwrap();
    let mut visited: Vec<(String, u32)> = Vec::new();
    let mut moved = 0.0_f64;
    for cycle in 0..5_000 {
        bench.cycle();
        let state = bench.machine.state(0).unwrap_or_default().to_owned();
        if visited.last().is_none_or(|(last, _)| *last != state) {
            visited.push((state, cycle));
        }
        moved = moved.max(bench.number("robot", "sens_pos", 0));
        if bench.machine.status(0) != Status::Active {
            break;
        }
    }
    assert_eq!(bench.machine.failure(0), None);
    let states: Vec<&str> = visited.iter().map(|(state, _)| state.as_str()).collect();
    let expected = [
        "StartRobot",
        "CalibrateOffsets",
        "InitializationSequence",
        "MoveRobot",
        "StopRobot",
    ];
    assert_eq!(states, expected, "{visited:?}");
    assert_eq!(bench.machine.status(0), Status::Finished);
    assert_eq!(bench.machine.variable("runs"), Some(Value::Int(1)));
    assert!((0.7..0.85).contains(&moved), "joint 0 reached {moved} rad");
    for member in &bench.members {
        assert!(!matches!(
            member.phase,
            Phase::Running | Phase::RunTimeError
        ));
    }
}

#[test]
fn lola_earlier_use_shortens_the_path() {
    let mut bench = Bench::lola();
    for name in ["was_calibrated", "was_initialized"] {
        assert!(bench.machine.set_parameter(name, Value::Bool(true)));
    }
    assert!(!bench.machine.set_parameter("runs", Value::Int(1)));
    let visited = bench.run(2_000);
    assert_eq!(visited, ["StartRobot", "MoveRobot", "StopRobot"]);
}

#[test]
fn lola_abort_and_stop_end_in_final_state() {
    for after in [1, 10, 40, 80, 200, 500, 600] {
        for is_event in [true, false] {
            let mut bench = Bench::lola();
            bench.machine.control(0, Control::Activate).unwrap();
            bench.machine.control(0, Control::Start).unwrap();
            for _ in 0..after {
                bench.cycle();
            }
            if is_event {
                bench.machine.raise(1);
            } else {
                bench.machine.control(0, Control::Stop).unwrap();
            }
            for _ in 0..100 {
                bench.cycle();
            }
            assert_eq!(bench.machine.state(0), Some("StopRobot"), "after {after}");
            assert_eq!(bench.machine.status(0), Status::Finished);
            let running = bench
                .members
                .iter()
                .any(|member| member.phase == Phase::Running);
            assert!(!running, "after {after}");
        }
    }
}

#[test]
fn lola_component_error_leads_to_final_state() {
    let mut bench = Bench::lola();
    bench.machine.control(0, Control::Activate).unwrap();
    bench.machine.control(0, Control::Start).unwrap();
    for _ in 0..5 {
        bench.cycle();
    }
    // The calibration is refused.
    bench.refuses_calls = true;
    for _ in 0..200 {
        bench.cycle();
    }
    assert_eq!(bench.machine.state(0), Some("StopRobot"));
    assert!(bench.machine.failure(0).is_some());
}

#[test]
fn lola_graph_marks_its_state() {
    let bench = Bench::lola();
    let program: &Program = bench.machine.program();
    let graph: Graph = program.graph(0, Some(3)).unwrap();
    assert!(graph.nodes[0].is_initial && graph.nodes[4].is_final && graph.nodes[3].is_current);
    // 15 transitions; those between the same two states are one edge with a label each.
    let labels: Vec<usize> = graph.edges.iter().map(|edge| edge.labels.len()).collect();
    assert_eq!((labels.len(), labels.iter().sum::<usize>()), (10, 15));
    let dot = graph.dot();
    assert!(
        dot.contains("s3 -> s4 [label=\"on abort\\non error\\ntrajectory.finished\"]"),
        "{dot}"
    );
    assert!(
        dot.contains("s3 [label=\"MoveRobot\", style=\"rounded,filled\""),
        "{dot}"
    );
    let svg = graph.svg();
    assert_eq!(svg.matches("#fdf1dc").count(), 1);
    assert_eq!(svg.matches("marker-end").count(), 10);
    assert_eq!(svg.matches("font-size=\"10\"").count(), 15);
    assert_eq!(program.graph(1, None), None);
}
