//! Motions that take over from others on their way: how much time that saves over stopping at the corner. Where the
//! first one already brakes there is nothing to save, and the two of them share the limits: that may cost a little.

use std::time::Duration;

use super::super::bounds::{Bounds, State};
use super::super::live::{FrameMotion, JointMotion};
use super::super::plan::{FrameBounds, FrameState, Route};
use super::*;

const PERIOD: Duration = Duration::from_millis(1);
const BOUNDS: FrameBounds = FrameBounds {
    translation: Bounds {
        velocity: 0.25,
        acceleration: 1.0,
        jerk: 10.0,
    },
    rotation: Bounds {
        velocity: 0.5,
        acceleration: 2.5,
        jerk: 25.0,
    },
};

/// Up to where the first motion brakes, taking over saves time; from there on it costs next to none.
fn assert_faster(share: f64, context: &str, part: f64) {
    let most = if part <= 0.8 { 0.96 } else { 1.035 };
    assert!(
        share < most,
        "{context}: {:.1} % of the time with a stop",
        100.0 * share
    );
}

/// Duration of two motions of a frame, s: with a hand-over at a part of the first one, and with a stop between them.
fn frames([a, b]: [Route; 2], start: Frame, part: f64) -> [f64; 2] {
    let mut motion = FrameMotion::new(PERIOD).unwrap();
    let Route::Line { to: corner } = a else {
        panic!("a line");
    };
    motion
        .begin(&FrameState::at_rest(start), &a, BOUNDS, 1.0)
        .unwrap();
    let first = motion.duration_s();
    let mut cycles = 0;
    while motion.step(1.0, false).progress < part {
        cycles += 1;
    }
    let state = motion.state();
    let mut run = |state: &FrameState| {
        motion.begin(state, &b, BOUNDS, 1.0).unwrap();
        let mut cycles = 0;
        while !motion.step(1.0, false).is_done {
            cycles += 1;
        }
        f64::from(cycles) * PERIOD.as_secs_f64()
    };
    let second = run(&state);
    let stopping = first + run(&FrameState::at_rest(corner));
    [f64::from(cycles) * PERIOD.as_secs_f64() + second, stopping]
}

#[test]
fn line_taken_over_saves_time_over_stop() {
    let start = Frame::translation(0.4, 0.0, 0.4);
    let corner = Frame::translation(0.64, 0.0, 0.4);
    for degrees in [0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0_f64] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let to = Frame::translation(0.64 + 0.24 * cos, 0.24 * sin, 0.4);
        for part in [0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99] {
            let routes = [Route::Line { to: corner }, Route::Line { to }];
            let [blended, stopping] = frames(routes, start, part);
            assert_faster(blended / stopping, &format!("{degrees}° at {part}"), part);
        }
    }
}

#[test]
fn joints_taken_over_save_time_over_stop() {
    let bounds = [BOUNDS.rotation; 2];
    for degrees in [0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0_f64] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let to = [0.5 + 0.5 * cos, 0.5 * sin];
        for part in [0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99] {
            let mut motion = JointMotion::new(2, PERIOD).unwrap();
            motion
                .begin(&[State::at_rest(0.0); 2], &[0.5, 0.0], &bounds, 1.0)
                .unwrap();
            let first = motion.duration_s();
            let mut cycles = 0;
            while motion.step(1.0, false).progress < part {
                cycles += 1;
            }
            let state = [motion.joint(0), motion.joint(1)];
            let mut run = |state: &[State]| {
                motion.begin(state, &to, &bounds, 1.0).unwrap();
                let mut cycles = 0;
                while !motion.step(1.0, false).is_done {
                    cycles += 1;
                }
                f64::from(cycles) * PERIOD.as_secs_f64()
            };
            let blended = f64::from(cycles) * 1e-3 + run(&state);
            let stopping = first + run(&[State::at_rest(0.5), State::at_rest(0.0)]);
            assert_faster(blended / stopping, &format!("{degrees}° at {part}"), part);
        }
    }
}
