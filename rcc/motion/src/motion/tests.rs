//! Motions in nets, checked by their outputs: velocity, acceleration and jerk are computed from
//! differences of positions alone.

mod blends;
mod coupled;
mod departures;
mod elbow;
mod plans;
mod slow;

use nalgebra::{UnitQuaternion, Vector3};
use takt_net::value::text::{TextValue, format_array, parse_array};
use takt_net::{Frame, Twist};
use takt_tests::Random;

use super::bounds::Bounds;
use crate::fixture::{Arm, Fixture, PERIOD_S};

/// Longest run of a test, cycles.
const MOST: usize = 20_000;

fn some(random: &mut Random, count: usize, min: f64, max: f64) -> Vec<f64> {
    (0..count).map(|_| random.between(min, max)).collect()
}

fn text<T: TextValue>(value: T) -> String {
    let mut text = String::new();
    value.format(&mut text);
    text
}

fn list(values: &[f64]) -> String {
    let mut text = String::new();
    format_array(values.iter().copied(), &mut text);
    text
}

/// A net of one motion, its controls as `NetcommIn`, its outputs of the type family `ty` as
/// `NetcommOut`.
fn net(motion: &str, parameters: &str, ty: &str) -> String {
    format!(
        "o=Core::DoubleNetcommIn(Key='o',Value='1'),s=Core::BooleanNetcommIn(Key='s'),\
         r=Core::BooleanNetcommIn(Key='r'),\
         m=Motion::{motion}(inOverride=o.outValue,inStop=s.outValue,inReset=r.outValue,{parameters}),\
         w1={ty}NetcommOut(inValue=m.outPosition,Key='p'),\
         w2={}NetcommOut(inValue=m.outVelocity,Key='v'),\
         w3=Core::DoubleNetcommOut(inValue=m.outProgress,Key='u'),\
         w4=Core::BooleanNetcommOut(inValue=m.outDone,Key='d')",
        ty.replace("Frame", "Twist")
    )
}

struct Run {
    fixture: Fixture,
    is_cartesian: bool,
    joints: Vec<Vec<f64>>,
    frames: Vec<Frame>,
    velocities: Vec<Vec<f64>>,
    progress: Vec<f64>,
}

impl Run {
    fn new(text: &str) -> Self {
        Self {
            fixture: Fixture::new(text, &Arm::default()),
            is_cartesian: text.contains("World::Frame"),
            joints: Vec::new(),
            frames: Vec::new(),
            velocities: Vec::new(),
            progress: Vec::new(),
        }
    }

    fn step(&mut self) {
        self.fixture.step();
        let (position, velocity) = (self.fixture.read("p"), self.fixture.read("v"));
        if self.is_cartesian {
            let twist = Twist::parse(&velocity).expect("a twist");
            self.frames.push(Frame::parse(&position).expect("a frame"));
            let values = twist.vel.iter().chain(&twist.rot).copied();
            self.velocities.push(values.collect());
        } else {
            self.joints
                .push(parse_array(&position, 32).expect("joints"));
            self.velocities
                .push(parse_array(&velocity, 32).expect("velocities"));
        }
        self.progress
            .push(f64::parse(&self.fixture.read("u")).expect("progress"));
    }

    fn is_done(&self) -> bool {
        self.fixture.read("d") == "true"
    }

    /// Runs until the motion is over, and some cycles more.
    fn finish(mut self) -> Self {
        while !self.is_done() {
            self.step();
            assert!(self.progress.len() < MOST, "the motion does not end");
        }
        (0..5).for_each(|_| self.step());
        assert!(self.is_done());
        self
    }

    fn series(&self, joint: usize) -> Vec<Vector3<f64>> {
        let positions = self.joints.iter().map(|j| Vector3::new(j[joint], 0.0, 0.0));
        positions.collect()
    }

    fn positions(&self) -> Vec<Vector3<f64>> {
        self.frames.iter().map(|f| f.translation.vector).collect()
    }
}

/// First differences, per s.
fn rates(values: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let pairs = values.windows(2);
    pairs.map(|pair| (pair[1] - pair[0]) / PERIOD_S).collect()
}

fn largest(values: &[Vector3<f64>]) -> f64 {
    values.iter().map(Vector3::norm).fold(0.0, f64::max)
}

/// Asserts that velocities, and their differences, are within bounds, and returns which part of
/// each bound is used. Before the first and after the last value, the velocity counts as constant.
fn assert_bounded(velocities: &[Vector3<f64>], bounds: Bounds, context: &str) -> [f64; 3] {
    let mut velocities = velocities.to_vec();
    velocities.insert(0, Vector3::zeros());
    velocities.insert(0, Vector3::zeros());
    velocities.extend([Vector3::zeros(); 2]);
    assert_used(&velocities, bounds, [1e-6, 1e-5, 1e-3], context)
}

/// Asserts that each bound is kept but for its tolerance; returns the largest used part of each.
fn assert_used(
    velocities: &[Vector3<f64>],
    bounds: Bounds,
    tolerances: [f64; 3],
    context: &str,
) -> [f64; 3] {
    let accelerations = rates(velocities);
    let jerks = rates(&accelerations);
    let used = [
        largest(velocities) / bounds.velocity,
        largest(&accelerations) / bounds.acceleration,
        largest(&jerks) / bounds.jerk,
    ];
    let names = ["velocity", "acceleration", "jerk"];
    for ((part, tolerance), name) in used.iter().zip(tolerances).zip(names) {
        assert!(
            *part < 1.0 + tolerance,
            "{context}: {name} {used:?} of {bounds:?}"
        );
    }
    used
}

/// A random Ptp: its net, ends and bounds by joint.
struct RandomPtp {
    net: String,
    from: Vec<f64>,
    to: Vec<f64>,
    bounds: Vec<Bounds>,
}

fn random_ptp(random: &mut Random, joints: usize) -> RandomPtp {
    let from = some(random, joints, -2.0, 2.0);
    let to = some(random, joints, -2.0, 2.0);
    let velocity = some(random, joints, 0.5, 2.0);
    let acceleration = some(random, joints, 1.0, 10.0);
    let jerk = some(random, joints, 5.0, 100.0);
    let parameters = format!(
        "From='{}',To='{}',Velocity='{}',Acceleration='{}',Jerk='{}'",
        list(&from),
        list(&to),
        list(&velocity),
        list(&acceleration),
        list(&jerk)
    );
    let bounds = |i| Bounds {
        velocity: velocity[i],
        acceleration: acceleration[i],
        jerk: jerk[i],
    };
    RandomPtp {
        net: net("Ptp", &parameters, "Core::DoubleArray"),
        bounds: (0..joints).map(bounds).collect(),
        from,
        to,
    }
}

impl RandomPtp {
    /// Asserts that all joints are within their bounds and on the straight line; returns the
    /// largest used part of each bound.
    fn assert_kept(&self, run: &Run) -> [f64; 3] {
        let mut most = [0.0_f64; 3];
        for (joint, bounds) in self.bounds.iter().enumerate() {
            let used = assert_bounded(&rates(&run.series(joint)), *bounds, &self.net);
            most = std::array::from_fn(|i| most[i].max(used[i]));
        }
        for (position, part) in run.joints.iter().zip(&run.progress) {
            for (joint, position) in position.iter().enumerate() {
                let (from, to) = (self.from[joint], self.to[joint]);
                let off = (position - from - (to - from) * part).abs();
                assert!(off < 1e-12, "joint {joint} leaves the line by {off}");
            }
        }
        most
    }
}

#[test]
fn ptp_keeps_and_uses_joint_limits() {
    let mut random = Random::new(1);
    for joints in [1, 2, 6, 7, 1, 3, 7] {
        let ptp = random_ptp(&mut random, joints);
        let run = Run::new(&ptp.net).finish();
        assert_eq!(run.joints.first(), Some(&ptp.from));
        assert_eq!(run.joints.last(), Some(&ptp.to));
        let used = ptp.assert_kept(&run);
        assert!(used[2] > 0.95 && used.iter().any(|u| *u > 0.9), "{used:?}");
        let is_forward = run.progress.windows(2).all(|pair| pair[0] <= pair[1]);
        assert!(is_forward && run.progress.last() == Some(&1.0));
    }
}

#[test]
fn ptp_takes_shortest_time() {
    // 1 rad: acceleration and jerk add V/A + A/J to D/V.
    let parameters = "To='[1,0.5]',Velocity='[0.5]',Acceleration='[1]',Jerk='[10]'";
    let run = Run::new(&net("Ptp", parameters, "Core::DoubleArray")).finish();
    let moving = run.progress.iter().filter(|part| **part < 1.0).count();
    assert!((2600..=2601).contains(&moving), "{moving}");
}

#[test]
fn velocity_output_matches_positions() {
    let ptp = random_ptp(&mut Random::new(5), 3);
    let run = Run::new(&ptp.net).finish();
    for joint in 0..3 {
        let differences = rates(&run.series(joint));
        for (i, difference) in differences.iter().enumerate() {
            let mean = (run.velocities[i][joint] + run.velocities[i + 1][joint]) / 2.0;
            assert!(
                (mean - difference.x).abs() < 1e-4,
                "{i}: {mean} {}",
                difference.x
            );
        }
    }
}

#[test]
fn ptp_under_any_override_keeps_limits_and_line() {
    let mut random = Random::new(2);
    for number in 0..12 {
        let ptp = random_ptp(&mut random, 2);
        let mut run = Run::new(&ptp.net);
        for cycle in 0..1500 {
            if cycle % [1, 7, 50, 211][number % 4] == 0 {
                let speed = random.between(-0.3, 1.3);
                run.fixture.write("o", &text(speed));
            }
            run.step();
        }
        run.fixture.write("o", "1");
        let run = run.finish();
        assert_eq!(run.joints.last(), Some(&ptp.to));
        ptp.assert_kept(&run);
        for (i, pair) in run.progress.windows(2).enumerate() {
            assert!(
                pair[0] <= pair[1],
                "{number} {i} back by {}",
                pair[0] - pair[1]
            );
        }
    }
}

#[test]
fn lower_override_lowers_speed() {
    let parameters = "To='[1]',Velocity='[0.5]',Acceleration='[1]',Jerk='[10]'";
    let mut run = Run::new(&net("Ptp", parameters, "Core::DoubleArray"));
    run.fixture.write("o", "0.5");
    let run = run.finish();
    let fastest = run.velocities.iter().map(|v| v[0]).fold(0.0, f64::max);
    assert!((fastest - 0.25).abs() < 1e-9, "{fastest}");
}

#[test]
fn motion_without_override_holds_and_resumes() {
    for nothing in ["0", "nan", "-1", "0.0009"] {
        let ptp = random_ptp(&mut Random::new(3), 2);
        let mut run = Run::new(&ptp.net);
        (0..100).for_each(|_| run.step());
        run.fixture.write("o", nothing);
        (0..3000).for_each(|_| run.step());
        assert!(!run.is_done(), "{nothing}");
        let at_rest = run.velocities.last().expect("a velocity");
        assert!(at_rest.iter().all(|v| *v == 0.0), "{nothing}: {at_rest:?}");
        run.fixture.write("o", "1");
        let run = run.finish();
        assert_eq!(run.joints.last(), Some(&ptp.to), "{nothing}");
        ptp.assert_kept(&run);
    }
}

#[test]
fn stop_brakes_on_path_within_limits() {
    let mut random = Random::new(4);
    for stop_at in [0, 1, 3, 40, 200, 500, 900, 1300] {
        let ptp = random_ptp(&mut random, 3);
        let mut run = Run::new(&ptp.net);
        for _ in 0..stop_at {
            run.step();
        }
        run.fixture.write("s", "true");
        let mut run = run.finish();
        ptp.assert_kept(&run);
        let rest = run.joints.last().expect("a position").clone();
        run.fixture.write("s", "false");
        (0..50).for_each(|_| run.step());
        assert_eq!(run.joints.last(), Some(&rest));
        assert!(run.is_done());
        run.fixture.write("r", "true");
        run.step();
        assert_eq!(run.joints.last(), Some(&ptp.from));
        assert!(!run.is_done());
        run.fixture.write("r", "false");
        assert_eq!(run.finish().joints.last(), Some(&ptp.to));
    }
}

#[test]
fn motion_without_length_is_done_at_once() {
    let run = Run::new(&net("Ptp", "From='[1,2]',To='[1,2]'", "Core::DoubleArray"));
    let mut run = run.finish();
    assert_eq!(run.joints[0], [1.0, 2.0]);
    assert_eq!(run.progress.len(), 6, "one cycle, and those after it");
    run.fixture.write("r", "true");
    run.step();
    assert!(run.is_done());
    let frames = Run::new(&net("Circ", "To='{}'", "World::Frame"))
        .finish()
        .frames;
    assert_eq!(frames.len(), 6);
    for tiny in ["1e-3", "1e-6", "1e-9", "1e-12", "1e-15"] {
        let parameters = format!("From='[0]',To='[{tiny}]'");
        let run = Run::new(&net("Ptp", &parameters, "Core::DoubleArray")).finish();
        assert_eq!(
            run.joints.last(),
            Some(&vec![f64::parse(tiny).expect("a number")])
        );
    }
}

fn cartesian_bounds() -> [Bounds; 2] {
    let translation = Bounds {
        velocity: 0.4,
        acceleration: 1.5,
        jerk: 20.0,
    };
    let rotation = Bounds {
        velocity: 1.0,
        acceleration: 4.0,
        jerk: 60.0,
    };
    [translation, rotation]
}

fn cartesian(motion: &str, frames: &[(&str, Frame)]) -> String {
    let mut parameters = String::new();
    for (prefix, bounds) in ["", "Rot"].iter().zip(cartesian_bounds()) {
        parameters += &format!(
            "{prefix}Velocity='{}',{prefix}Acceleration='{}',{prefix}Jerk='{}',",
            bounds.velocity, bounds.acceleration, bounds.jerk
        );
    }
    for (name, frame) in frames {
        parameters += &format!("{name}='{}',", text(*frame));
    }
    net(motion, parameters.trim_end_matches(','), "World::Frame")
}

fn random_frame(random: &mut Random, reach: f64) -> Frame {
    let position = Vector3::from_vec(some(random, 3, -reach, reach));
    let turn = Vector3::from_vec(some(random, 3, -1.5, 1.5));
    Frame::from_parts(position.into(), UnitQuaternion::from_scaled_axis(turn))
}

/// Asserts that translation and rotation of a run are within their bounds.
fn assert_cartesian(run: &Run, context: &str) -> [[f64; 3]; 2] {
    let [translation, rotation] = cartesian_bounds();
    let turns = run.frames.windows(2).map(|pair| {
        let turn = pair[1].rotation * pair[0].rotation.inverse();
        turn.scaled_axis() / PERIOD_S
    });
    let turns: Vec<_> = turns.collect();
    // Quaternions of neighbouring cycles differ by less than their precision: 1e-16 / dt³.
    [
        assert_bounded(&rates(&run.positions()), translation, context),
        assert_bounded(&turns, rotation, context),
    ]
}

#[test]
fn lin_is_straight_and_keeps_limits() {
    let mut random = Random::new(6);
    for reach in [0.5, 0.5, 0.01, 0.0] {
        let (from, to) = (
            random_frame(&mut random, reach),
            random_frame(&mut random, reach),
        );
        let text = cartesian("Lin", &[("From", from), ("To", to)]);
        let run = Run::new(&text).finish();
        let used = assert_cartesian(&run, &text);
        let most = used.as_flattened().iter().copied().fold(0.0, f64::max);
        assert!(most > 0.95, "{used:?}");
        let (start, end) = (run.frames[0], run.frames[run.frames.len() - 1]);
        // The text form has Euler angles, so ends are exact to rounding only.
        assert!((end.translation.vector - to.translation.vector).norm() < 1e-12);
        assert!(end.rotation.angle_to(&to.rotation) < 1e-7);
        let (displacement, turn) = (
            to.translation.vector - from.translation.vector,
            from.rotation.angle_to(&to.rotation),
        );
        for (frame, part) in run.frames.iter().zip(&run.progress) {
            let off = frame.translation.vector - start.translation.vector - displacement * *part;
            assert!(off.norm() < 1e-12, "off the line by {}", off.norm());
            let turned = start.rotation.angle_to(&frame.rotation);
            assert!(
                (turned - turn * part).abs() < 1e-6,
                "{turned} at {part} of {turn}"
            );
        }
    }
}

#[test]
fn circ_stays_on_circle_and_keeps_limits() {
    let mut random = Random::new(7);
    for (radius, via, to) in [
        (0.3, 0.5, 1.0),
        (0.1, 2.0, 5.5),
        (0.02, 1.0, 2.0),
        (2.0, 0.2, 0.3),
    ] {
        let base = random_frame(&mut random, 0.5);
        let on_circle = |angle: f64, turn: f64| {
            let at = Vector3::new(radius * angle.cos(), radius * angle.sin(), 0.0);
            base * Frame::new(at, Vector3::new(turn, 0.0, 0.0))
        };
        let (start, end) = (on_circle(0.0, 0.0), on_circle(to, 0.7));
        let frames = [("From", start), ("Via", on_circle(via, 0.1)), ("To", end)];
        let text = cartesian("Circ", &frames);
        let run = Run::new(&text).finish();
        let used = assert_cartesian(&run, &text);
        let most = used.as_flattened().iter().copied().fold(0.0, f64::max);
        assert!(most > 0.5, "far below the limits: {used:?}");
        for (frame, part) in run.frames.iter().zip(&run.progress) {
            let local = base.inverse_transform_point(&frame.translation.vector.into());
            assert!(local.z.abs() < 1e-9 && (local.coords.norm() - radius).abs() < 1e-9);
            let expected = on_circle(to * part, 0.0).translation.vector;
            let off = (frame.translation.vector - expected).norm();
            assert!(off < 1e-9, "off by {off} at {part}");
        }
        let last = run.frames[run.frames.len() - 1];
        assert!((last.translation.vector - end.translation.vector).norm() < 1e-9);
        for (i, velocity) in rates(&run.positions()).iter().enumerate() {
            let mean = |k: usize| (run.velocities[i][k] + run.velocities[i + 1][k]) / 2.0;
            let expected = Vector3::new(mean(0), mean(1), mean(2));
            assert!((expected - velocity).norm() < 1e-4, "{expected} {velocity}");
        }
    }
}

#[test]
fn stop_on_arc_stays_on_arc_within_limits() {
    let on_circle = |angle: f64| Frame::translation(0.3 * angle.cos(), 0.3 * angle.sin(), 0.2);
    let frames = [
        ("From", on_circle(0.0)),
        ("Via", on_circle(1.0)),
        ("To", on_circle(3.0)),
    ];
    let text = cartesian("Circ", &frames);
    for stop_at in [10, 300, 900] {
        let mut run = Run::new(&text);
        for cycle in 0..stop_at {
            if cycle == 100 {
                run.fixture.write("o", "0.6");
            }
            run.step();
        }
        run.fixture.write("s", "true");
        let run = run.finish();
        assert_cartesian(&run, &text);
        let last = run.frames[run.frames.len() - 1].translation.vector;
        assert!((last.xy().norm() - 0.3).abs() < 1e-12 && (last.z - 0.2).abs() < 1e-12);
        assert!(run.progress.last().is_some_and(|part| *part < 1.0));
    }
}

fn tracking(parameters: &str) -> String {
    format!(
        "g=Core::DoubleArrayNetcommIn(Key='g',Value='[0,1]'),s=Core::BooleanNetcommIn(Key='s'),\
         r=Core::BooleanNetcommIn(Key='r'),\
         m=Motion::Track(inGoal=g.outValue,inStop=s.outValue,inReset=r.outValue,{parameters}),\
         u=Core::DoubleValue(),\
         w1=Core::DoubleArrayNetcommOut(inValue=m.outPosition,Key='p'),\
         w2=Core::DoubleArrayNetcommOut(inValue=m.outVelocity,Key='v'),\
         w3=Core::DoubleNetcommOut(inValue=u.outValue,Key='u'),\
         w4=Core::BooleanNetcommOut(inValue=m.outDone,Key='d')"
    )
}

const TRACK: &str = "From='[0,1]',Velocity='[1,0.5]',Acceleration='[4,2]',Jerk='[50]'";

fn assert_tracked(run: &Run) {
    for (joint, (velocity, acceleration)) in [(1.0, 4.0), (0.5, 2.0)].into_iter().enumerate() {
        let bounds = Bounds {
            velocity,
            acceleration,
            jerk: 50.0,
        };
        assert_bounded(&rates(&run.series(joint)), bounds, "Track");
    }
}

#[test]
fn track_reaches_goals_within_limits() {
    let mut random = Random::new(8);
    for every in [1, 2, 13, 100, 700] {
        let mut run = Run::new(&tracking(TRACK));
        run.step();
        assert_eq!(run.joints[0], [0.0, 1.0]);
        for cycle in 0..2000 {
            if cycle % every == 0 {
                let goals = some(&mut random, 2, -1.0, 1.0);
                run.fixture.write("g", &list(&goals));
            }
            run.step();
        }
        run.fixture.write("g", "[0.25,-0.5]");
        run.step();
        let run = run.finish();
        assert_eq!(
            run.joints.last().map(Vec::as_slice),
            Some(&[0.25, -0.5][..])
        );
        assert_tracked(&run);
    }
}

#[test]
fn track_follows_moving_goal() {
    let mut run = Run::new(&tracking(TRACK));
    let mut farthest: f64 = 0.0;
    for cycle in 0..6000 {
        let goal = 0.5 * (f64::from(cycle) * PERIOD_S).sin();
        run.fixture.write("g", &list(&[goal, 1.0]));
        run.step();
        if cycle > 1000 {
            let lag = run.joints.last().expect("a position")[0] - goal;
            farthest = farthest.max(lag.abs());
        }
    }
    run.fixture.write("g", "[0,1]");
    run.step();
    let run = run.finish();
    assert_tracked(&run);
    assert!(farthest < 0.15, "{farthest}");
}

#[test]
fn track_override_limits_speed_and_zero_holds() {
    let overridden = tracking(&format!("inOverride=o.outValue,{TRACK}"));
    let net = format!("o=Core::DoubleNetcommIn(Key='o',Value='0.5'),{overridden}");
    let mut run = Run::new(&net);
    run.fixture.write("g", "[3,1]");
    (0..1500).for_each(|_| run.step());
    let fastest = |run: &Run, from: usize| {
        let joints = run.joints[from..].windows(2);
        let speeds = joints.map(|pair| (pair[1][0] - pair[0][0]).abs() / PERIOD_S);
        speeds.fold(0.0, f64::max)
    };
    let half = fastest(&run, 1);
    assert!(half < 0.5 + 1e-9 && half > 0.45, "{half}");
    run.fixture.write("o", "0");
    (0..1000).for_each(|_| run.step());
    let len = run.joints.len();
    assert!(fastest(&run, len - 300) < 1e-12, "it stands still");
    assert!(run.joints[len - 1][0] < 2.5, "on its way");
    run.fixture.write("o", "1");
    run.step();
    let run = run.finish();
    assert_eq!(run.joints.last().map(Vec::as_slice), Some(&[3.0, 1.0][..]));
    assert!(fastest(&run, len) > 0.9);
    assert_tracked(&run);
}

#[test]
fn track_ignores_invalid_goal() {
    let mut run = Run::new(&tracking(TRACK));
    run.fixture.write("g", "[0.5,0]");
    (0..10).for_each(|_| run.step());
    run.fixture.write("g", "[nan,2e6]");
    run.step();
    let run = run.finish();
    assert_eq!(run.joints.last().map(Vec::as_slice), Some(&[0.5, 0.0][..]));
    assert_tracked(&run);
}

#[test]
fn track_stop_brakes_all_joints_within_limits() {
    let mut run = Run::new(&tracking(TRACK));
    run.fixture.write("g", "[2,-1]");
    (0..300).for_each(|_| run.step());
    run.fixture.write("s", "true");
    run.step();
    let mut run = run.finish();
    assert_tracked(&run);
    let rest = run.joints.last().expect("a position").clone();
    assert!(rest[0] > 0.05 && rest[0] < 1.0, "{rest:?}");
    run.fixture.write("s", "false");
    run.fixture.write("g", "[1,1]");
    (0..20).for_each(|_| run.step());
    assert_eq!(run.joints.last(), Some(&rest));
    run.fixture.write("r", "true");
    run.step();
    assert_eq!(run.joints.last().map(Vec::as_slice), Some(&[0.0, 1.0][..]));
}

fn fault(text: &str) -> String {
    match Fixture::load(text, &Arm::default()) {
        Ok(_) => panic!("the net has no faults: {text}"),
        Err(faults) => faults.join("\n"),
    }
}

#[test]
fn invalid_motion_parameters_are_rejected() {
    let ptp = |parameters: &str| fault(&net("Ptp", parameters, "Core::DoubleArray"));
    for (parameters, why) in [
        (
            "Velocity='[0]'",
            "`Velocity`: 0 is not a limit; it must be between",
        ),
        ("Acceleration='[-1]'", "`Acceleration`: -1 is not a limit"),
        ("Jerk='[nan]'", "`Jerk`: NaN is not a limit"),
        ("Jerk='[+inf]'", "`Jerk`: inf is not a limit"),
        (
            "From='[0,0,0]',To='[1,1]'",
            "`To`: 2 values, but the motion has 3 joints",
        ),
        (
            "To='[1,1,1]',Jerk='[1,2]'",
            "`Jerk`: 2 values, but the motion has 3 joints",
        ),
        ("To='[nan]'", "`To`: NaN is not a position"),
        ("From='[1e9]'", "`From`: 1000000000 is not a position"),
        (
            "From='[]',To='[]'",
            "`From`: a motion needs at least one joint",
        ),
    ] {
        let found = ptp(parameters);
        assert!(found.contains(why), "{parameters}: {found}");
    }
    let circ = |parameters: &str| fault(&net("Circ", parameters, "World::Frame"));
    for parameters in [
        "Via='{pos:{x:1}}',To='{pos:{x:2}}'",
        "Via='{pos:{x:1}}'",
        "To='{pos:{x:1}}'",
        "Via='{pos:{x:1}}',To='{pos:{x:1}}'",
    ] {
        let found = circ(parameters);
        assert!(
            found.contains("`Via`: From, Via and To lie on one line"),
            "{found}"
        );
    }
    assert!(circ("To='{pos:{x:nan}}'").contains("`To`: this frame is invalid"));
    assert!(circ("RotJerk='0'").contains("`RotJerk`: 0 is not a limit"));
    let found = fault(&tracking("From='[1,2,3]'"));
    assert!(
        found.contains("`From`: 3 values, but the motion has 2 joints"),
        "{found}"
    );
}
