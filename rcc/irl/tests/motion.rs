//! Motions of programs: they arrive, keep limits, round, stop on their path, and allocate nothing.

#![allow(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod common;

use common::{Run, TWO, run};
use takt_irl::{Control, FaultKind, Machine, Phase, Program, System, compile};
use takt_tests::{Allocations, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const PALLETIZE: &str = include_str!("../../../examples/irl/palletize.irl");

/// Largest speed of each joint relative to its limit, and the largest step of it from one cycle to the next.
fn worst(run: &Run) -> (f64, f64) {
    let system = System::parse(TWO).unwrap();
    let joints: Vec<_> = system
        .robots
        .iter()
        .flat_map(|r| r.joints.clone())
        .collect();
    let (mut speed, mut change) = (0.0_f64, 0.0_f64);
    for triple in run.path.windows(3) {
        for (i, joint) in joints.iter().enumerate() {
            let v = [1, 2].map(|k| (triple[k][i] - triple[k - 1][i]).to_degrees() / 1e-3);
            speed = speed.max(v[1].abs() / joint.speed);
            change = change.max((v[1] - v[0]).abs() / (joint.acceleration * 1e-3));
        }
    }
    (speed, change)
}

#[test]
fn ptp_arrives_within_limits() {
    let text = "program t; move ptp mainjoint(10,20,80,5,50,6) act_rob:=\"tx90\" speed_ptp:=0.5 acc_ptp:=0.5; endprogram;";
    let run = run(text);
    assert_eq!(run.phase, Phase::Ended);
    let end: Vec<f64> = run.path.last().unwrap()[..6]
        .iter()
        .map(|q| q.to_degrees())
        .collect();
    for (found, wanted) in end.iter().zip([10.0, 20.0, 80.0, 5.0, 50.0, 6.0]) {
        assert!((found - wanted).abs() < 1e-9, "{end:?}");
    }
    let (speed, acceleration) = worst(&run);
    assert!(speed <= 0.5 + 1e-6, "{speed}");
    assert!(acceleration <= 0.5 + 1e-3, "{acceleration}");
}

#[test]
fn time_attribute_sets_duration() {
    let text = "program t; var a: real; begin move ptp mainjoint(10,20,80,5,50,6) act_rob:=\"tx90\" time:=3; endprogram;";
    let cycles = run(text).path.len();
    assert!((2_999..=3_004).contains(&cycles), "{cycles}");
    let text = "program t; move_inc lin (0, 0, -50) act_rob:=\"tx90\" time:=2; endprogram;";
    let cycles = run(text).path.len();
    assert!((1_999..=2_004).contains(&cycles), "{cycles}");
}

#[test]
fn line_is_straight_and_returns() {
    let text = "program t; var p, q: pose; begin
        p := tx90.r_pose_act; q := p; q.pos.x := p.pos.x + 100; q.pos.z := p.pos.z - 50;
        move lin q act_rob:=\"tx90\" speed:=200; move lin p act_rob:=\"tx90\" speed:=200; endprogram;";
    let run = run(text);
    assert_eq!((run.phase, run.fault), (Phase::Ended, None));
    let error = (0..6).map(|i| (run.path[0][i] - run.path.last().unwrap()[i]).abs());
    assert!(error.fold(0.0, f64::max) < 1e-6);
}

#[test]
fn rounded_motions_reach_same_end() {
    let text = |round: &str| {
        format!(
            "program t; begin
            move_inc lin (0, 100, 0) act_rob:=\"tx90\" {round}; move_inc lin (0, 0, -100) act_rob:=\"tx90\" {round};
            move_inc lin (0, -100, 0) act_rob:=\"tx90\"; endprogram;"
        )
    };
    let (exact, rounded) = (run(&text("")), run(&text("c_cp:=20")));
    assert_eq!(rounded.fault, None);
    assert_ne!(rounded.path, exact.path);
    let ends = [&exact, &rounded].map(|run| run.path.last().unwrap().clone());
    for (a, b) in ends[0].iter().zip(&ends[1]) {
        assert!((a - b).abs() < 1e-5, "{ends:?}");
    }
    let (speed, acceleration) = worst(&rounded);
    assert!(speed < 1.0 && acceleration < 3.0, "{speed} {acceleration}");
}

#[test]
fn ptp_and_line_round_into_each_other() {
    let text = "program t; begin
        move_inc ptp mainjoint(20,0,0,0,0,0) act_rob:=\"tx90\" c_ptp:=0.3;
        move_inc lin (0, 60, 0) act_rob:=\"tx90\" c_cp:=20;
        move_inc ptp mainjoint(-20,0,0,0,0,0) act_rob:=\"tx90\"; endprogram;";
    let run = run(text);
    assert_eq!((run.phase, run.fault), (Phase::Ended, None));
    let (speed, acceleration) = worst(&run);
    assert!(speed < 1.0 && acceleration < 3.0, "{speed} {acceleration}");
}

#[test]
fn circle_passes_auxiliary_point() {
    let text = "program t; var p: position; x: real; begin
        p := tx90.r_pose_act.pos;
        move circle p + position(50, 50, 0), p + position(100, 0, 0) act_rob:=\"tx90\" speed:=150;
        x := tx90.r_pose_act.pos.x - p.x; endprogram;";
    let run = run(text);
    assert_eq!((run.phase, run.fault), (Phase::Ended, None));
    assert!((run.value("x") - 100.0).abs() < 1e-3, "{}", run.value("x"));
    let text = "program t; var p: position; begin p := tx90.r_pose_act.pos;
        move circle p + position(50, 0, 0), p + position(100, 0, 0) act_rob:=\"tx90\"; endprogram;";
    assert_eq!(common::run(text).fault.unwrap().kind, FaultKind::NoPath);
}

#[test]
fn unreachable_line_stops_before_its_end() {
    // Both ends are reachable, the middle is inside the arm.
    let text = "program t; var d: orientation; begin d := orivang(position(0, 1, 0), 180);
        move ptp pose((0, 600, 300), d) act_rob:=\"tx90\"; move lin pose((0, -600, 300), d) act_rob:=\"tx90\" speed:=400; endprogram;";
    let run = run(text);
    assert_eq!(run.phase, Phase::Failed);
    let kind = run.fault.unwrap().kind;
    assert!(
        matches!(kind, FaultKind::Unreachable | FaultKind::JointSpeed),
        "{kind:?}"
    );
    assert_eq!(run.fault.unwrap().at.line, 2);
    let (speed, acceleration) = worst(&run);
    assert!(
        speed <= 1.06 && acceleration <= 20.0,
        "{speed} {acceleration}"
    );
}

#[test]
fn stop_and_pause_hold_motions() {
    let text = "program t; move ptp mainjoint(90,20,80,5,50,6) act_rob:=\"tx90\"; endprogram;";
    let stopped = Run::new(text).to_end(|cycle| Control {
        stop: cycle == 300,
        ..Control::default()
    });
    assert_eq!(stopped.phase, Phase::Ended);
    assert!(stopped.path.last().unwrap()[0].to_degrees() < 60.0);
    assert!(worst(&stopped).1 <= 1.01);
    let plain = run(text);
    let paused = Run::new(text).to_end(|cycle| Control {
        pause: (300..1_000).contains(&cycle),
        ..Control::default()
    });
    assert!(paused.path.len() > plain.path.len() + 500);
    assert_eq!(paused.path.last(), plain.path.last());
}

#[test]
fn shared_robot_is_a_fault_at_run_time() {
    // Through a procedure the compiler sees it too; waiting branches take turns.
    let text = "program t; var e: event; begin par
        seq move_inc ptp mainjoint(5,0,0,0,0,0) act_rob:=\"tx90\"; signal event e; endseq
        seq wait for e; move_inc ptp mainjoint(0,0,5,0,0,0,0) act_rob:=\"lwr\"; endseq endpar endprogram;";
    assert_eq!(run(text).fault, None);
}

#[test]
fn palletizing_fills_pallet_without_allocations() {
    let run = run(PALLETIZE);
    assert_eq!((run.phase, run.fault), (Phase::Ended, None));
    assert!((run.value("done") - 6.0).abs() < 1e-9);
    assert!(worst(&run).0 <= 1.05);
    let mut machine = Run::new(PALLETIZE).machine;
    let allocations = Allocations::count();
    for _ in 0..20_000 {
        machine.cycle(Control::default());
    }
    assert_eq!(allocations.end(), 0);
    assert_eq!(machine.phase(), Phase::Ended);
}

#[test]
fn runs_of_one_program_are_equal() {
    let (a, b) = (run(PALLETIZE), run(PALLETIZE));
    assert_eq!(a.path, b.path);
}

#[test]
fn program_of_paper_moves_all_joints() {
    let text = include_str!("../../../examples/irl/lola15.irl");
    let spec = include_str!("../../../examples/irl/lola15.spc");
    let program = compile(text, &System::parse(spec).unwrap(), spec)
        .unwrap()
        .program;
    let program = Program::decode(&program.encode()).unwrap();
    let period = std::time::Duration::from_millis(5);
    let mut machine = Machine::new(program.into(), &[], period, 500).unwrap();
    while machine.cycle(Control::default()) == Phase::Running {}
    let end: Vec<f64> = machine
        .positions(0)
        .iter()
        .map(|q| q.to_degrees().round())
        .collect();
    assert_eq!(end, [45.0, -45.0, 45.0, 0.0, 0.0, 0.0]);
}

/// Positions of the tool of the first arm, mm.
fn tool_path(run: &Run) -> Vec<[f64; 3]> {
    let arm = takt_motion::kinematics::named("staubli_tx90").unwrap();
    let tool = takt_net::Frame::translation(0.0, 0.0, 0.1);
    let at = |joints: &Vec<f64>| {
        let frame = arm.forward(&joints[..6]) * tool;
        let p = frame.translation.vector * 1000.0;
        [p.x, p.y, p.z]
    };
    run.path.iter().map(at).collect()
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

#[test]
fn rounding_is_faster_and_stays_near_corner() {
    for (speed, acc) in [(100, 1000), (500, 2000)] {
        let corner = |round: &str| {
            let attributes = format!("act_rob:=\"tx90\" speed:={speed} acc:={acc}");
            run(&format!(
                "program t; begin move_inc lin (0, 100, 0) {attributes} {round};
                move_inc lin (0, 0, -100) {attributes}; endprogram;"
            ))
        };
        let exact = corner("");
        let path = tool_path(&exact);
        let start = path[0];
        let turn = path
            .iter()
            .find(|p| distance(p, &start) > 100.0 - 1e-6)
            .unwrap();
        let mut last = exact.path.len();
        for round in [5.0, 40.0] {
            let rounded = corner(&format!("c_cp:={round}"));
            assert_eq!(rounded.fault, None);
            let cycles = rounded.path.len();
            assert!(
                cycles <= last,
                "{speed} mm/s, {round} mm: {cycles}, not {last}"
            );
            last = cycles;
            let path = tool_path(&rounded);
            let nearest = path
                .iter()
                .map(|p| distance(p, turn))
                .fold(f64::INFINITY, f64::min);
            assert!(
                nearest <= round,
                "{speed} mm/s: {nearest} mm from the corner"
            );
            let steps = path.windows(2).map(|p| distance(&p[1], &p[0]) / 1e-3);
            let fastest = steps.fold(0.0, f64::max);
            assert!(fastest <= f64::from(speed) * 1.001, "{fastest} mm/s");
        }
        assert!(
            last + 50 < exact.path.len(),
            "{last} of {}",
            exact.path.len()
        );
    }
}
