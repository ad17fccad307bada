//! Motions at a part of the speed: what they stop with, and how they come down from a faster motion before them.

use super::*;
use crate::motion::bounds::State;
use crate::motion::course::{Course, Geometry as _, WHOLE};
use crate::motion::ptp::JointLine;

const SPEED: f64 = 0.08;
/// Of the frame: 0.02 m/s at that speed.
const LIMITS: &str = "Velocity='0.25',Acceleration='1',Jerk='10',RotVelocity='0.5',RotAcceleration='2.5',RotJerk='25'";
const JOINTS: &str = "Velocity='[0.25]',Acceleration='[1]',Jerk='[10]'";

/// Every kind of motion along 0.2 m or rad, with its limits and the family of its value.
fn kinds() -> [(&'static str, String, &'static str); 4] {
    let to = "{pos:{x:0.2}}";
    [
        (
            "Ptp",
            format!("From='[0,0]',To='[0.2,0.1]',{JOINTS}"),
            "Core::DoubleArray",
        ),
        (
            "Lin",
            format!("From='{{}}',To='{to}',{LIMITS}"),
            "World::Frame",
        ),
        (
            "Circ",
            format!("From='{{}}',Via='{{pos:{{x:0.1,y:0.1}}}}',To='{to}',{LIMITS}"),
            "World::Frame",
        ),
        (
            "Spline",
            format!("Points='[{{}},{to}]',{LIMITS}"),
            "World::Frame",
        ),
    ]
}

fn place(run: &Run) -> Vector3<f64> {
    let frame = || run.frames.last().map(|frame| frame.translation.vector);
    let joints = || {
        run.joints
            .last()
            .map(|joints| Vector3::new(joints[0], 0.0, 0.0))
    };
    frame().or_else(joints).expect("a cycle")
}

/// Cycles and way from a request for rest until the motion rests; `cycles` after its start.
fn stop(net: &str, cycles: usize, (key, value): (&str, &str)) -> (usize, f64) {
    let mut run = Run::new(net);
    (0..cycles).for_each(|_| run.step());
    let from = place(&run);
    run.fixture.write(key, value);
    let mut last = from;
    for cycle in 0..5_000 {
        run.step();
        let now = place(&run);
        if (now - last).norm() < 1e-12 {
            return (cycle, (now - from).norm());
        }
        last = now;
    }
    panic!("it does not rest");
}

#[test]
fn slow_motion_stops_within_whole_limits() {
    for (kind, parameters, ty) in kinds() {
        let slow = net(kind, &format!("{parameters},Speed='{SPEED}'"), ty);
        for request in [("s", "true"), ("o", "0")] {
            // After 4 s it moves at its constant speed.
            let (cycles, way) = stop(&slow, 4_000, request);
            // From v = 0.02 m/s with a jerk of 10 m/s³: 2 √(v/j) = 0.09 s and half of v in the mean.
            assert!(cycles < 95, "{kind} {request:?}: {cycles} cycles");
            assert!(way < 1.1e-3, "{kind} {request:?}: {way} m");
        }
    }
}

#[test]
fn slow_motion_goes_on_after_hold() {
    for (kind, parameters, ty) in kinds() {
        let text = net(kind, &format!("{parameters},Speed='0.2'"), ty);
        let mut run = Run::new(&text);
        (0..2_000).for_each(|_| run.step());
        run.fixture.write("o", "0");
        // Amid braking.
        (0..60).for_each(|_| run.step());
        run.fixture.write("o", "1");
        let run = run.finish();
        let back = run
            .progress
            .windows(2)
            .map(|pair| pair[0] - pair[1])
            .fold(0.0, f64::max);
        assert!(back < 1e-9, "{kind}: it returns by {back:e}");
    }
}

/// The same motion at half of the speed takes twice the time, and has a quarter of the acceleration.
#[test]
fn speed_scales_time_of_undisturbed_motion() {
    for (kind, parameters, ty) in kinds() {
        let whole = Run::new(&net(kind, &parameters, ty))
            .finish()
            .progress
            .len();
        let half = Run::new(&net(kind, &format!("{parameters},Speed='0.5'"), ty)).finish();
        let half = half.progress.len();
        assert!(
            half.abs_diff(2 * whole) < 12,
            "{kind}: {half} cycles, not twice {whole}"
        );
    }
}

#[test]
fn slow_motion_brakes_from_faster_one_within_whole_limits() {
    let of = |kind: &str, from: &str, more: &str| {
        format!("Motion::{kind}({from},{more},Speed='{SPEED}')")
    };
    let frame = "f=World::FrameValue(),v=World::TwistValue(Value='{vel:{x:0.25}}'),";
    let joints = "f=Core::DoubleArrayNetcommIn(Key='f',Value='[0]'),v=Core::DoubleArrayNetcommIn(Key='g',Value='[0.25]'),";
    let from = "inFrom=f.outValue,inFromVelocity=v.outValue";
    let lines = [
        (
            frame,
            of("Lin", from, &format!("To='{{pos:{{x:0.2}}}}',{LIMITS}")),
            "World::Frame",
        ),
        (
            joints,
            of("Ptp", from, &format!("To='[0.2]',{JOINTS}")),
            "Core::DoubleArray",
        ),
    ];
    for (values, motion, ty) in lines {
        let text = format!(
            "{values}m={motion},w1={ty}NetcommOut(inValue=m.outPosition,Key='p'),\
             w2={}NetcommOut(inValue=m.outVelocity,Key='v'),\
             w3=Core::DoubleNetcommOut(inValue=m.outProgress,Key='u'),\
             w4=Core::BooleanNetcommOut(inValue=m.outDone,Key='d')",
            ty.replace("Frame", "Twist")
        );
        let mut run = Run::new(&text);
        (0..900).for_each(|_| run.step());
        // From 0.25 m/s, 1 m/s² and 10 m/s³ take 0.33 s and 41 mm, half of them twice as long. Gentle ones take 40 s.
        let speed = run.velocities.last().expect("a cycle")[0];
        assert!(speed < 0.0201, "{motion}: {speed} m/s after 0.9 s");
        let run = run.finish();
        let farthest = run
            .positions()
            .iter()
            .chain(&run.series_of_first())
            .map(|it| it.x)
            .fold(0.0, f64::max);
        assert!(farthest < 0.2 + 1e-9, "{motion}: {farthest}");
    }
}

impl Run {
    fn series_of_first(&self) -> Vec<Vector3<f64>> {
        if self.joints.is_empty() {
            Vec::new()
        } else {
            self.series(0)
        }
    }
}

/// Joints in motion coast to rest within their limits, from where they are commanded.
#[test]
fn coasting_joints_brake_from_commanded_positions() {
    let text = format!(
        "f=Core::DoubleArrayNetcommIn(Key='f',Value='[0.5,0.5]'),v=Core::DoubleArrayNetcommIn(Key='g',Value='[0.25,0.25]'),\
         m=Motion::Coast(inFrom=f.outValue,inFromVelocity=v.outValue,{JOINTS}),\
         w=Core::DoubleArrayNetcommOut(inValue=m.outPosition,Key='p')"
    );
    let mut fixture = Fixture::new(&text, &Arm::default());
    let (mut way, mut last) = (0.0, 0.25 * PERIOD_S);
    for cycle in 0..500 {
        fixture.step();
        let joints: Vec<f64> = parse_array(&fixture.read("p"), 8).expect("joints");
        let step = joints[1] - 0.5;
        assert!(
            step <= last + 1e-12 && step >= -1e-12,
            "{cycle}: {step} after {last}"
        );
        assert!(
            (last - step) / PERIOD_S.powi(2) < 1.01,
            "{cycle}: {step} after {last}"
        );
        (way, last) = (way + step, step);
    }
    // v²/2a and v a/2j.
    assert!((way - (0.031_25 + 0.012_5)).abs() < 1e-4, "{way}");
    assert!(last.abs() < 1e-12);
}

/// Two joints whose motion is replaced every so many cycles by one to a goal that swings between ±0.3 rad, so often a second, the
/// second joint more often: how far they get.
fn farthest_of_replaced(speed: f64, every: usize, swings: f64) -> f64 {
    let whole = Bounds {
        velocity: 1.963,
        acceleration: 4.0,
        jerk: 20.0,
    };
    let bounds = [whole.at_speed(speed); 2];
    let (mut states, mut cycle) = ([State::default(); 2], 0_u32);
    let mut farthest = 0.0_f64;
    while cycle < 8_000 {
        let turn = f64::from(cycle) * 1e-3 * swings * std::f64::consts::TAU;
        let goal = [turn, 1.3 * turn].map(|turn| 0.3 * turn.sin());
        let from = states.map(|state| state.position);
        let mut line = JointLine::new(from.into(), goal.into(), bounds.into(), speed);
        let course = Course::new(line.along(WHOLE), speed, 1e-3).expect("a plan");
        let mut course = course.with_lead(2, 1e-3);
        line.begin(&mut course, &states, 1.0);
        for _ in 0..every {
            let progress = course.step(1.0, false);
            states = [0, 1].map(|joint| line.at(joint, progress, course.lead()));
            let far = states.map(|state| state.position.abs());
            farthest = far.into_iter().fold(farthest, f64::max);
            cycle += 1;
        }
    }
    farthest
}

/// Each begins in the state of the one before it, and brakes at once where its goal is behind.
#[test]
fn motions_that_replace_each_other_do_not_run_away() {
    for swings in [0.1, 0.3, 0.6, 2.0] {
        for speed in [1.0, 0.5, 0.3] {
            for every in [1, 10, 20, 45, 100, 200] {
                let far = farthest_of_replaced(speed, every, swings);
                // A joint at 2 rad/s stops within 1 rad with half of its limits.
                assert!(
                    far < 0.7,
                    "{swings} Hz at {speed}, each {every} cycles: {far:.3} rad"
                );
            }
        }
    }
}
