//! Motions that begin in motion: in random states, beside their paths, and joining a line. Limits are checked as
//! elsewhere, by differences of positions alone, with the states before the first cycle added.

use super::super::bounds::State;
use super::*;

/// Positions before the first cycle of a coordinate in this state, oldest first.
fn history(state: State) -> [f64; 3] {
    [2.0, 1.0, 0.0].map(|cycles| {
        let time = cycles * PERIOD_S;
        state.position - state.velocity * time + state.acceleration * time * time / 2.0
    })
}

/// Asserts that positions are within bounds; returns the largest used part of each bound.
fn assert_kept(positions: &[Vector3<f64>], bounds: Bounds, context: &str) -> [f64; 3] {
    assert_used(&rates(positions), bounds, [1e-3, 1e-3, 5e-3], context)
}

/// A state from which the limits can be kept.
fn random_state(random: &mut Random, position: f64, bounds: Bounds) -> State {
    let acceleration = random.between(-0.7, 0.7) * bounds.acceleration;
    // What it gains until its acceleration is zero.
    // The deviation and the motion along the path share the jerk.
    let gained = acceleration.powi(2) / bounds.jerk;
    let most = (bounds.velocity - gained).max(0.0);
    let acceleration = if most > 0.0 { acceleration } else { 0.0 };
    State {
        position,
        velocity: random.between(-1.0, 1.0) * if most > 0.0 { most } else { bounds.velocity },
        acceleration,
    }
}

fn list_of(states: &[State], value: impl Fn(&State) -> f64) -> String {
    list(&states.iter().map(value).collect::<Vec<_>>())
}

/// The net of a motion of joints that begins in these states.
pub(super) fn departing(ptp: &RandomPtp, states: &[State]) -> String {
    let values = format!(
        "p0=Core::DoubleArrayNetcommIn(Key='p0',Value='{}'),v0=Core::DoubleArrayNetcommIn(Key='v0',Value='{}'),\
         a0=Core::DoubleArrayNetcommIn(Key='a0',Value='{}'),",
        list_of(states, |s| s.position),
        list_of(states, |s| s.velocity),
        list_of(states, |s| s.acceleration),
    );
    let ports = "inFrom=p0.outValue,inFromVelocity=v0.outValue,inFromAcceleration=a0.outValue,";
    format!(
        "{values}{}",
        ptp.net
            .replacen("(inOverride", &format!("({ports}inOverride"), 1)
    )
}

fn with_history(run: &Run, joint: usize, state: State) -> Vec<Vector3<f64>> {
    let before = history(state).map(|position| Vector3::new(position, 0.0, 0.0));
    before.into_iter().chain(run.series(joint)).collect()
}

#[test]
fn ptp_from_any_state_keeps_joint_limits() {
    let mut random = Random::new(21);
    for number in 0..9 {
        let joints = [1, 2, 7][number % 3];
        let ptp = random_ptp(&mut random, joints);
        let pairs = ptp.from.iter().zip(&ptp.bounds);
        let states: Vec<State> = pairs
            .map(|(from, b)| random_state(&mut random, *from, *b))
            .collect();
        let run = Run::new(&departing(&ptp, &states)).finish();
        assert_eq!(run.joints.last(), Some(&ptp.to), "{number}");
        for (joint, bounds) in ptp.bounds.iter().enumerate() {
            let context = format!("{number} joint {joint} {states:?} {}", ptp.net);
            assert_kept(&with_history(&run, joint, states[joint]), *bounds, &context);
        }
    }
}

#[test]
fn single_joint_from_any_state_takes_shortest_time() {
    let mut random = Random::new(22);
    for number in 0..5 {
        let ptp = random_ptp(&mut random, 1);
        let state = random_state(&mut random, ptp.from[0], ptp.bounds[0]);
        let run = Run::new(&departing(&ptp, &[state])).finish();
        let mut fastest = super::super::profile::Profile::new(0.0, ptp.bounds[0], PERIOD_S);
        assert!(fastest.begin(state, ptp.to[0], 1.0));
        let cycles = run
            .joints
            .iter()
            .filter(|joints| joints[0].to_bits() != ptp.to[0].to_bits())
            .count();
        let shortest = fastest.duration() / PERIOD_S;
        let forwards = (ptp.to[0] - ptp.from[0]) * state.velocity > 0.0;
        // Backwards, the way back to the start is a deviation with a part of the limits.
        let most = if forwards {
            shortest + 2.0
        } else {
            shortest * 2.0 + 50.0
        };
        let taken = u32::try_from(cycles).map(f64::from).expect("few cycles");
        assert!(
            taken <= most,
            "{number}: {taken} of {shortest} cycles, {state:?}"
        );
    }
}

#[test]
fn ptp_from_motion_stopped_or_slowed_keeps_limits() {
    let mut random = Random::new(23);
    for number in 0..8 {
        let ptp = random_ptp(&mut random, 3);
        let pairs = ptp.from.iter().zip(&ptp.bounds);
        let states: Vec<State> = pairs
            .map(|(from, b)| random_state(&mut random, *from, *b))
            .collect();
        let mut run = Run::new(&departing(&ptp, &states));
        let key = if number % 2 == 0 { "s" } else { "o" };
        for _ in 0..number * 50 {
            run.step();
        }
        run.fixture
            .write(key, if key == "s" { "true" } else { "0.3" });
        let run = run.finish();
        if key == "o" {
            assert_eq!(run.joints.last(), Some(&ptp.to), "{number}");
        }
        for (joint, bounds) in ptp.bounds.iter().enumerate() {
            let context = format!("{number} joint {joint} {states:?} {}", ptp.net);
            assert_kept(&with_history(&run, joint, states[joint]), *bounds, &context);
        }
    }
}

#[test]
fn ptp_from_state_beyond_limits_reaches_goal() {
    let mut random = Random::new(28);
    for number in 0..4 {
        let ptp = random_ptp(&mut random, 3);
        let state = |(from, bounds): (&f64, &Bounds)| State {
            position: *from,
            velocity: random.between(-3.0, 3.0) * bounds.velocity,
            acceleration: random.between(-2.0, 2.0) * bounds.acceleration,
        };
        let states: Vec<State> = ptp.from.iter().zip(&ptp.bounds).map(state).collect();
        let run = Run::new(&departing(&ptp, &states)).finish();
        assert_eq!(run.joints.last(), Some(&ptp.to), "{number}");
    }
}

#[test]
fn motion_waits_for_valid_state() {
    let ptp = random_ptp(&mut Random::new(24), 2);
    let rest = [State::at_rest(0.3), State::at_rest(-0.2)];
    let mut fixture = Fixture::new(&departing(&ptp, &rest), &Arm::default());
    fixture.write("v0", "[nan,0]");
    (0..5).for_each(|_| fixture.step());
    assert_eq!(
        (fixture.read("p"), fixture.read("d")),
        ("null".to_owned(), "false".to_owned())
    );
    fixture.write("v0", "[0,0]");
    fixture.step();
    fixture.step();
    assert_ne!(fixture.read("p"), "null");
}

/// Frame states from which the limits can be kept.
fn random_frame_state(random: &mut Random, frame: Frame) -> (Frame, [State; 6]) {
    let [translation, rotation] = cartesian_bounds();
    let part = 0.5;
    let mut states = [State::default(); 6];
    for (axis, state) in states.iter_mut().enumerate() {
        let bounds = if axis < 3 { translation } else { rotation };
        *state = State {
            position: 0.0,
            velocity: random.between(-part, part) * bounds.velocity,
            acceleration: random.between(-0.2, 0.2) * bounds.acceleration,
        };
    }
    (frame, states)
}

fn twist(states: &[State; 6], value: impl Fn(&State) -> f64) -> Twist {
    let [a, b, c, d, e, f] = states.each_ref().map(value);
    Twist {
        vel: Vector3::new(a, b, c),
        rot: Vector3::new(d, e, f),
    }
}

/// The net of a motion of a frame that begins in this state.
fn departing_frame(motion: &str, frame: Frame, states: &[State; 6]) -> String {
    let values = format!(
        "p0=World::FrameValue(Value='{}'),v0=World::TwistValue(Value='{}'),a0=World::TwistValue(Value='{}'),",
        text(frame),
        text(twist(states, |s| s.velocity)),
        text(twist(states, |s| s.acceleration)),
    );
    let ports = "inFrom=p0.outValue,inFromVelocity=v0.outValue,inFromAcceleration=a0.outValue,";
    format!(
        "{values}{}",
        motion.replacen("(inOverride", &format!("({ports}inOverride"), 1)
    )
}

/// Asserts that position and orientation are within their limits.
fn assert_frames_kept(run: &Run, frame: Frame, states: &[State; 6], context: &str) {
    let [translation, rotation] = cartesian_bounds();
    let past: Vec<[f64; 6]> = (0..3)
        .map(|i| states.each_ref().map(|state| history(*state)[i]))
        .collect();
    let before = past
        .iter()
        .map(|p| frame.translation.vector + Vector3::new(p[0], p[1], p[2]));
    let positions: Vec<_> = before.chain(run.positions()).collect();
    assert_kept(&positions, translation, context);
    let before = past
        .iter()
        .map(|p| UnitQuaternion::from_scaled_axis(Vector3::new(p[3], p[4], p[5])) * frame.rotation);
    let turns: Vec<_> = before
        .chain(run.frames.iter().map(|f| f.rotation))
        .collect();
    let turning: Vec<_> = turns
        .windows(2)
        .map(|pair| (pair[1] * pair[0].inverse()).scaled_axis() / PERIOD_S)
        .collect();
    let accelerations = rates(&turning);
    let jerks = rates(&accelerations);
    let used = [
        largest(&turning) / rotation.velocity,
        largest(&accelerations) / rotation.acceleration,
        largest(&jerks) / rotation.jerk,
    ];
    // A deviation of the orientation turns with that of the path, which no part of the limits is reserved for.
    assert!(
        used.iter().all(|part| *part < 1.1),
        "rotation {used:?} {context}"
    );
}

#[test]
fn lin_and_circ_from_any_state_keep_path_limits() {
    let mut random = Random::new(25);
    for number in 0..6 {
        let (from, to) = (
            random_frame(&mut random, 0.5),
            random_frame(&mut random, 0.5),
        );
        let via = random_frame(&mut random, 0.5);
        let (frame, states) = random_frame_state(&mut random, from);
        let net = if number % 2 == 0 {
            cartesian("Lin", &[("From", from), ("To", to)])
        } else {
            cartesian("Circ", &[("From", from), ("Via", via), ("To", to)])
        };
        let net = departing_frame(&net, frame, &states);
        let run = Run::new(&net).finish();
        let end = run.frames.last().expect("a frame");
        assert!(
            (end.translation.vector - to.translation.vector).norm() < 1e-9,
            "{number}"
        );
        assert!(end.rotation.angle_to(&to.rotation) < 1e-7, "{number}");
        assert_frames_kept(&run, frame, &states, &format!("{number} {net}"));
    }
}

/// Figure 1: from A towards C, left at B with full speed, on the line from C to E from D on.
#[test]
fn lin_joins_line_at_place_without_halt() {
    let at = |x: f64, y: f64| Frame::translation(x, y, 0.4);
    let (c, e) = (at(0.5, 0.0), at(0.5, 0.6));
    let speed = cartesian_bounds()[0].velocity;
    for (before, join, least) in [(0.15, 0.4, 0.35), (0.1, 0.3, 0.3), (0.2, 0.6, 0.35)] {
        let b = at(0.5 - before, 0.0);
        let mut states = [State::default(); 6];
        states[0].velocity = speed;
        let motion = cartesian("Lin", &[("From", c), ("To", e)]);
        let motion = motion.replacen("From=", &format!("Join='{join}',From="), 1);
        let net = departing_frame(&motion, b, &states);
        let run = Run::new(&net).finish();
        assert_frames_kept(&run, b, &states, &net);
        let end = run.frames.last().expect("a frame");
        assert!((end.translation.vector - e.translation.vector).norm() < 1e-9);
        for frame in &run.frames {
            let (x, y) = (frame.translation.x, frame.translation.y);
            assert!(y < join * 0.6 || (x - 0.5).abs() < 1e-9, "{y}: {x}");
        }
        let moving = run.velocities.iter().zip(&run.frames);
        let slowest = moving
            .filter(|(_, frame)| frame.translation.y < 0.4)
            .map(|(v, _)| Vector3::new(v[0], v[1], v[2]).norm())
            .fold(f64::INFINITY, f64::min);
        assert!(slowest > least * speed, "{join}: {slowest} of {speed}");
    }
}

#[test]
fn track_from_any_state_keeps_limits() {
    let mut random = Random::new(26);
    for number in 0..4 {
        let ptp = random_ptp(&mut random, 2);
        let pairs = ptp.from.iter().zip(&ptp.bounds);
        let states: Vec<State> = pairs
            .map(|(from, b)| random_state(&mut random, *from, *b))
            .collect();
        let limits = &ptp.net[ptp.net.find("Velocity=").expect("limits")..];
        let limits = &limits[..limits.find("),").expect("an end")];
        let net = format!(
            "g=Core::DoubleArrayNetcommIn(Key='g',Value='{}'),p0=Core::DoubleArrayNetcommIn(Key='p0',Value='{}'),\
             v0=Core::DoubleArrayNetcommIn(Key='v0',Value='{}'),a0=Core::DoubleArrayNetcommIn(Key='a0',Value='{}'),\
             m=Motion::Track(inGoal=g.outValue,inFrom=p0.outValue,inFromVelocity=v0.outValue,\
             inFromAcceleration=a0.outValue,{limits}),z=Core::DoubleValue(Value='0'),\
             w1=Core::DoubleArrayNetcommOut(inValue=m.outPosition,Key='p'),\
             w2=Core::DoubleArrayNetcommOut(inValue=m.outVelocity,Key='v'),\
             w3=Core::DoubleNetcommOut(inValue=z.outValue,Key='u'),w4=Core::BooleanNetcommOut(inValue=m.outDone,Key='d')",
            list(&ptp.to),
            list_of(&states, |s| s.position),
            list_of(&states, |s| s.velocity),
            list_of(&states, |s| s.acceleration),
        );
        let mut run = Run::new(&net);
        run.step();
        let run = run.finish();
        assert_eq!(run.joints.last(), Some(&ptp.to), "{number}");
        for (joint, bounds) in ptp.bounds.iter().enumerate() {
            assert_kept(&with_history(&run, joint, states[joint]), *bounds, &net);
        }
    }
}

#[test]
fn spline_passes_points_within_limits() {
    let mut random = Random::new(27);
    for number in 0..3 {
        let points: Vec<Frame> = (0..5).map(|_| random_frame(&mut random, 0.3)).collect();
        let texts: Vec<String> = points.iter().map(|frame| text(*frame)).collect();
        let tangents = if number % 3 == 0 {
            let twist = |_| {
                text(Twist {
                    vel: Vector3::from_vec(some(&mut random, 3, -0.5, 0.5)),
                    rot: Vector3::zeros(),
                })
            };
            format!(
                ",Tangents='[{}]'",
                (0..5).map(twist).collect::<Vec<_>>().join(",")
            )
        } else {
            String::new()
        };
        let net = cartesian("Spline", &[]);
        let parameters = format!("Points='[{}]'{tangents},Velocity=", texts.join(","));
        let net = net.replacen("Velocity=", &parameters, 1);
        let run = Run::new(&net).finish();
        assert_cartesian(&run, &net);
        for point in &points {
            let nearest = run
                .frames
                .iter()
                .map(|frame| {
                    let off = (frame.translation.vector - point.translation.vector).norm();
                    off.max(frame.rotation.angle_to(&point.rotation) * 0.1)
                })
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-3, "{number}: {nearest} from {point:?}");
        }
        let end = run.frames.last().expect("a frame");
        assert!((end.translation.vector - points[4].translation.vector).norm() < 1e-9);
    }
}

/// A line that takes over from another one before a corner, in the state that is commanded then: the time of both as part of
/// that with a stop at the corner.
fn hand_over(corner: f64, progress: f64) -> f64 {
    use crate::motion::plan::{FrameBounds, FrameState, Route, plan_frame};
    let bounds = |velocity, acceleration, jerk| Bounds {
        velocity,
        acceleration,
        jerk,
    };
    let bounds = FrameBounds {
        translation: bounds(0.25, 1.0, 10.0),
        rotation: bounds(0.5, 2.5, 25.0),
    };
    let period = std::time::Duration::from_millis(1);
    let line = |from: &FrameState, to: Frame| {
        plan_frame(from, &Route::Line { to }, bounds, period).expect("a plan")
    };
    let at = |x: f64, y: f64| Frame::translation(x, y, 0.4);
    let middle = at(0.12, 0.0);
    let end = at(0.12 + 0.12 * corner.cos(), 0.12 * corner.sin());
    let first = line(&FrameState::at_rest(at(0.0, 0.0)), middle);
    let stopping = first.duration() + line(&FrameState::at_rest(middle), end).duration();
    let over = first
        .first(|sample| sample.progress > progress)
        .expect("it gets there");
    let [before, now] = [over - period, over].map(|time| first.at(time));
    let mut state = FrameState::at_rest(now.frame);
    state.velocity = now.velocity;
    state.acceleration.vel = (now.velocity.vel - before.velocity.vel) / period.as_secs_f64();
    let blended = over + line(&state, end).duration();
    blended.as_secs_f64() / stopping.as_secs_f64()
}

/// Without a step of the acceleration: where the line before already brakes, that is taken back within the limit of the jerk.
#[test]
fn line_that_takes_over_saves_time_or_loses_little() {
    for degrees in [0.0, 60.0, 120.0, 180.0_f64] {
        for (progress, most) in [(0.5, 0.9), (0.8, 1.0), (0.9, 1.04), (0.99, 1.04)] {
            let part = hand_over(degrees.to_radians(), progress);
            assert!(part < most, "{degrees} deg, {progress}: {part}");
        }
    }
}
