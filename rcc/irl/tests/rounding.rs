//! Random corners, rounded: no joint is too fast where the exact motion is within its limits, and speed, corner and end are kept.

#![allow(
    clippy::unwrap_used,
    reason = "tests and their helpers fail by panicking"
)]

mod common;

use common::{Run, TWO, run};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use takt_irl::{Phase, System};

/// A line of a path, relative to where it begins.
#[derive(Clone, Copy, Debug)]
struct Line {
    length_mm: f64,
    /// Turn against the line before, deg: 0 goes straight on, 180 back.
    turn_deg: f64,
    /// About which it turns, deg.
    plane_deg: f64,
    c_cp: f64,
    speed: f64,
    acc: f64,
}

fn line() -> impl Strategy<Value = Line> {
    let turn = prop_oneof![3 => 0.0..180.0, 1 => Just(180.0), 1 => Just(90.0), 1 => 170.0..180.0];
    let round = prop_oneof![1 => Just(20.0), 3 => 0.1..60.0];
    let values = (
        5.0..90.0,
        turn,
        0.0..360.0,
        round,
        100.0..800.0,
        400.0..6000.0,
    );
    values.prop_map(|(length_mm, turn_deg, plane_deg, c_cp, speed, acc)| Line {
        length_mm,
        turn_deg,
        plane_deg,
        c_cp,
        speed,
        acc,
    })
}

/// Increments of a path in the tool.
fn increments(lines: &[Line]) -> Vec<[f64; 3]> {
    let mut direction = nalgebra::Vector3::new(0.0_f64, 1.0, 0.0);
    let next = |line: &Line| {
        let other = if direction.x.abs() < 0.9 {
            nalgebra::Vector3::x()
        } else {
            nalgebra::Vector3::y()
        };
        let side = direction.cross(&other).normalize();
        let spin = nalgebra::Rotation3::from_scaled_axis(direction * line.plane_deg.to_radians());
        let axis = spin * side;
        let turn = nalgebra::Rotation3::from_scaled_axis(axis * line.turn_deg.to_radians());
        direction = turn * direction;
        (direction * line.length_mm).into()
    };
    lines.iter().map(next).collect()
}

fn program(robot: &str, lines: &[Line], is_rounded: bool) -> String {
    let mut text = "program t; begin\n".to_owned();
    for (line, [x, y, z]) in lines.iter().zip(increments(lines)) {
        let round = if is_rounded { line.c_cp } else { 0.0 };
        text += &format!(
            "move_inc lin ({x:.6}, {y:.6}, {z:.6}) act_rob := \"{robot}\" speed := {:.3} acc := {:.3} c_cp := {round:.3};\n",
            line.speed, line.acc
        );
    }
    text + "endprogram;\n"
}

/// Largest speed of a joint relative to its limit.
fn fastest(run: &Run) -> f64 {
    let system = System::parse(TWO).unwrap();
    let joints = system.robots.iter().flat_map(|robot| robot.joints.clone());
    let limits: Vec<f64> = joints.map(|joint| joint.speed.to_radians()).collect();
    let steps = run.path.windows(2).flat_map(|pair| {
        let rates = pair[1]
            .iter()
            .zip(&pair[0])
            .map(|(b, a)| (b - a).abs() / 1e-3);
        rates.zip(&limits).map(|(rate, limit)| rate / limit)
    });
    steps.fold(0.0, f64::max)
}

#[test]
fn random_corners_never_exceed_joint_speeds() {
    let mut runner = TestRunner::new(Config::with_cases(cases()));
    let robots = prop_oneof![Just("tx90"), Just("lwr")];
    let paths = (robots, prop::collection::vec(line(), 2..5));
    let checked = std::cell::Cell::new(0);
    let result = runner.run(&paths, |(robot, lines)| {
        let exact = run(&program(robot, &lines, false));
        // Where the exact motion is near the limit or out of reach, the rounded one may be, too.
        if exact.fault.is_some() || fastest(&exact) > 0.8 {
            return Ok(());
        }
        checked.set(checked.get() + 1);
        let text = program(robot, &lines, true);
        let rounded = run(&text);
        prop_assert_eq!(
            (rounded.phase, rounded.fault),
            (Phase::Ended, None),
            "{}",
            text
        );
        prop_assert!(fastest(&rounded) <= 1.0, "{}: {}", text, fastest(&rounded));
        let ends = [&exact, &rounded].map(|run| run.path.last().unwrap().clone());
        let off = ends[0].iter().zip(&ends[1]).map(|(a, b)| (a - b).abs());
        let off = off.fold(0.0, f64::max);
        prop_assert!(off < 1e-4, "{}: {} rad off its end", text, off);
        prop_assert!(
            rounded.path.len() <= exact.path.len() + 2,
            "{}: slower than exact",
            text
        );
        Ok(())
    });
    result.unwrap();
    assert!(
        checked.get() > cases() / 4,
        "{} of {}",
        checked.get(),
        cases()
    );
}

/// More with `TAKT_CORNERS`.
fn cases() -> u32 {
    let given = std::env::var("TAKT_CORNERS").ok();
    given.and_then(|text| text.parse().ok()).unwrap_or(24)
}
