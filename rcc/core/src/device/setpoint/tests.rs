//! The state machine cell by cell, interpolation, and properties over random streams of
//! set-points. Velocity and acceleration are differentiated again here.

#![expect(
    clippy::float_cmp,
    reason = "what is compared so must be equal to the bit"
)]
#![expect(clippy::cast_possible_truncation, reason = "times of some periods")]
#![expect(clippy::cast_possible_wrap, reason = "a few set-points")]

use std::f64::consts::TAU;

use proptest::prelude::*;

use super::*;

const VELOCITY_MAX: f64 = 1.9;
const ACCELERATION_MAX: f64 = 4.0;
const LIMITS: JointLimits = JointLimits {
    position_min: -3.0,
    position_max: 3.0,
    velocity_max: VELOCITY_MAX,
    acceleration_max: ACCELERATION_MAX,
};
/// Period of nets and of the robot.
const PERIOD: Nanos = Nanos(1_000_000);
const DT_S: f64 = 1e-3;

/// Set-points a period apart, the last at time 0.
fn stream(positions: &[f64]) -> JointSetPoints {
    let mut points = JointSetPoints::default();
    for (i, position) in (1_i64 - positions.len() as i64..).zip(positions) {
        let time = Nanos(i * PERIOD.0);
        points.advance(Some(SetPoint {
            time,
            position: *position,
        }));
    }
    points
}

fn in_mode(mode: Mode, velocity: f64) -> Joint {
    moving(mode, 0.0, velocity)
}

fn moving(mode: Mode, position: f64, velocity: f64) -> Joint {
    Joint {
        mode,
        stage: LastStage::moving(guarded(LIMITS), position, velocity),
        ..Joint::new(LIMITS)
    }
}

// Every cell of the state machine.

/// What comes in a sample, for a joint at position 0.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Input {
    None,
    /// Right where the joint is, but the net thread stalls.
    Stale,
    /// A single set-point at this position, rad.
    At(f64),
}

const HERE: Input = Input::At(0.0);
/// A step that the joint's speed allows, and its acceleration does not.
const WITHIN: Input = Input::At(0.0018);
/// A step that it does not allow, but near enough to begin.
const BEYOND: Input = Input::At(-0.019);
const FAR: Input = Input::At(0.1);
const LOST: Input = Input::At(-0.21);

#[test]
fn setpoint_state_machine_every_transition() {
    use Mode::{Approach, Follow, Held, Refused};
    let at_rest = [
        //        None  Stale    HERE     WITHIN    BEYOND    FAR       LOST
        (
            Held,
            [Held, Held, Follow, Approach, Approach, Refused, Refused],
        ),
        (
            Approach,
            [Held, Held, Follow, Approach, Approach, Approach, Refused],
        ),
        (
            Follow,
            [Held, Held, Follow, Approach, Approach, Approach, Refused],
        ),
        (
            Refused,
            [Held, Refused, Refused, Refused, Refused, Refused, Refused],
        ),
    ];
    let moving = [
        (
            Held,
            [Held, Held, Approach, Approach, Approach, Approach, Refused],
        ),
        (
            Approach,
            [Held, Held, Approach, Approach, Approach, Approach, Refused],
        ),
        (
            Follow,
            [Held, Held, Approach, Approach, Approach, Approach, Refused],
        ),
        (
            Refused,
            [Held, Refused, Refused, Refused, Refused, Refused, Refused],
        ),
    ];
    let inputs = [Input::None, Input::Stale, HERE, WITHIN, BEYOND, FAR, LOST];
    for (velocity, table) in [(0.0, at_rest), (0.5, moving)] {
        for (mode, row) in table {
            for (input, expected) in inputs.into_iter().zip(row) {
                let mut joint = in_mode(mode, velocity);
                let points = match input {
                    Input::None => JointSetPoints::default(),
                    Input::Stale => stream(&[0.0]),
                    Input::At(position) => stream(&[position]),
                };
                joint.sample(&points, input != Input::Stale, Nanos(0), DT_S);
                assert_eq!(
                    joint.mode(),
                    expected,
                    "{mode:?} at {velocity} rad/s, {input:?}"
                );
            }
        }
    }
}

#[test]
fn setpoint_moving_joint_follows_within_acceleration() {
    for (velocity, mode) in [
        (0.5, Mode::Follow),
        (0.504, Mode::Follow),
        (0.496, Mode::Follow),
        (0.52, Mode::Approach),
        (0.48, Mode::Approach),
    ] {
        let mut joint = in_mode(Mode::Follow, 0.5);
        let points = stream(&[0.0, velocity * DT_S]);
        joint.sample(&points, true, Nanos(0), DT_S);
        assert_eq!(joint.mode(), mode, "{velocity}");
        let change = (joint.motion().1 - 0.5).abs();
        assert!(change <= ACCELERATION_MAX * DT_S + 1e-9, "{velocity}");
    }
}

#[test]
fn setpoint_only_following_joint_has_acceleration_to_continue() {
    use Mode::{Approach, Follow, Held, Refused};
    let mut seen = Vec::new();
    let mut joint = Joint::new(LIMITS);
    let mut see = |joint: &Joint| {
        let ((.., acceleration), (.., continued)) = (joint.motion(), joint.continued());
        assert!(acceleration.abs() > 1.0, "{:?}", joint.mode());
        seen.push((joint.mode(), continued == acceleration, continued == 0.0));
    };
    // Set-points within its limits, beyond them, and none.
    joint.sample(&stream(&[0.0, 3e-6]), true, Nanos(0), DT_S);
    see(&joint);
    joint.sample(&stream(&[3e-6, 0.01]), true, Nanos(0), DT_S);
    see(&joint);
    joint.sample(&JointSetPoints::default(), true, Nanos(0), DT_S);
    see(&joint);
    let mut refused = moving(Refused, 0.0, 0.5);
    refused.sample(&stream(&[0.0]), true, Nanos(0), DT_S);
    see(&refused);
    let continues = (Follow, true, false);
    let others = [Approach, Held, Refused].map(|mode| (mode, false, true));
    assert_eq!(seen[0], continues);
    assert_eq!(seen[1..], others);
}

#[test]
fn setpoint_only_refused_joint_reports_error() {
    for mode in [Mode::Held, Mode::Approach, Mode::Follow] {
        assert_eq!(in_mode(mode, 0.0).error(), JointError::None);
    }
    assert_eq!(in_mode(Mode::Refused, 0.0).error(), JointError::Refused);
}

#[test]
fn setpoint_recovered_joint_waits_for_end_of_stream() {
    let mut joint = in_mode(Mode::Follow, 0.5);
    joint.rest_at(0.3, &stream(&[0.3]));
    assert_eq!(
        (joint.mode(), joint.motion()),
        (Mode::Refused, (0.3, 0.0, 0.0))
    );
    joint.rest_at(0.3, &JointSetPoints::default());
    assert_eq!(joint.mode(), Mode::Held);
}

#[test]
fn setpoint_joint_passing_target_is_not_following() {
    let mut joint = in_mode(Mode::Approach, 0.5);
    let next = (0.5 - ACCELERATION_MAX * DT_S) * DT_S;
    assert_eq!(joint.sample(&stream(&[next]), true, Nanos(0), DT_S), next);
    assert_eq!(joint.mode(), Mode::Approach);
}

#[test]
fn setpoint_zero_time_step_changes_nothing() {
    for mode in [Mode::Held, Mode::Approach, Mode::Follow, Mode::Refused] {
        for points in [JointSetPoints::default(), stream(&[0.001]), stream(&[0.5])] {
            let mut joint = in_mode(mode, 0.5);
            assert_eq!(joint.sample(&points, true, Nanos(0), 0.0), 0.0);
            assert_eq!((joint.mode(), joint.motion()), (mode, (0.0, 0.5, 0.0)));
        }
    }
}

#[test]
fn setpoint_extrapolation_stays_in_range() {
    let mut joint = moving(Mode::Follow, 2.9995, 1.0);
    let position = joint.sample(&stream(&[2.998, 2.999]), true, Nanos(5 * PERIOD.0), DT_S);
    assert_eq!(position, LIMITS.position_max);
}

// Interpolation.

#[test]
fn interpolation() {
    let one = stream(&[0.7]);
    let four = stream(&[0.1, 0.2, 0.4, 0.5]);
    // More were given than are kept.
    let five = stream(&[9.0, 0.1, 0.2, 0.4, 0.5]);
    let mut restarted = four;
    restarted.advance(None);
    restarted.advance(Some(SetPoint {
        time: Nanos(2 * PERIOD.0),
        position: 0.9,
    }));
    let mut twice = stream(&[0.1]);
    twice.advance(Some(SetPoint {
        time: Nanos(0),
        position: 0.2,
    }));
    for (name, points, periods, position, speed) in [
        ("one point, before it", &one, -1.0, 0.7, 0.0),
        ("one point, after it", &one, 3.0, 0.7, 0.0),
        ("before the oldest", &four, -3.5, 0.1, 100.0),
        ("before the oldest kept", &five, -3.5, 0.1, 100.0),
        ("at the oldest", &four, -3.0, 0.1, 100.0),
        ("between the oldest", &four, -2.5, 0.15, 100.0),
        ("between", &four, -1.75, 0.25, 200.0),
        (
            "at a point, with the speed behind it",
            &four,
            -1.0,
            0.4,
            100.0,
        ),
        ("at the newest", &four, 0.0, 0.5, 100.0),
        ("beyond the newest", &four, 2.0, 0.7, 100.0),
        (
            "a new run knows nothing of the one before",
            &restarted,
            1.0,
            0.9,
            0.0,
        ),
        ("two points at one time", &twice, 1.0, 0.2, 0.0),
    ] {
        let at = Nanos((periods * PERIOD.0 as f64) as i64);
        let (p, v) = interpolate(points, at, false);
        assert!(
            (p - position).abs() < 1e-12,
            "{name}: position {p}, not {position}"
        );
        assert!((v - speed).abs() < 1e-9, "{name}: speed {v}, not {speed}");
    }
}

#[test]
fn setpoint_sparse_interpolation_cuts_corners_by_parabolas() {
    let one = stream(&[0.7]);
    // Speeds of 100, 200 and 100 rad/s between them, from the first of the run on.
    let three = stream(&[0.1, 0.2, 0.4]);
    let four = stream(&[0.1, 0.2, 0.4, 0.5]);
    let mut uneven = stream(&[0.0, 0.1]);
    uneven.advance(Some(SetPoint {
        time: Nanos(3 * PERIOD.0),
        position: 0.1,
    }));
    for (name, points, periods, position, speed) in [
        ("one point", &one, 3.0, 0.7, 0.0),
        ("long before the first", &three, -3.0, 0.1, 0.0),
        (
            "before the first, from rest",
            &three,
            -2.25,
            0.1 + 0.025 / 8.0,
            25.0,
        ),
        ("at the first", &three, -2.0, 0.1 + 0.1 / 8.0, 50.0),
        ("half-way to the second", &three, -1.5, 0.15, 100.0),
        ("at the second", &three, -1.0, 0.2 + 0.1 / 8.0, 150.0),
        ("half-way to the newest", &three, -0.5, 0.3, 200.0),
        ("nearer to the newest", &three, -0.25, 0.35, 200.0),
        ("beyond the newest", &three, 1.0, 0.6, 200.0),
        ("before the oldest kept", &four, -3.5, 0.1, 100.0),
        ("at the oldest kept", &four, -3.0, 0.1, 100.0),
        ("at the third", &four, -1.0, 0.4 - 0.1 / 8.0, 150.0),
        (
            "at a corner of uneven lines",
            &uneven,
            0.0,
            0.1 - 0.1 / 8.0,
            50.0,
        ),
        ("half a short line behind it", &uneven, 0.5, 0.1, 0.0),
    ] {
        let at = Nanos((periods * PERIOD.0 as f64) as i64);
        let (p, v) = interpolate(points, at, true);
        assert!(
            (p - position).abs() < 1e-9,
            "{name}: position {p}, not {position}"
        );
        assert!((v - speed).abs() < 1e-6, "{name}: speed {v}, not {speed}");
    }
}

/// Sparse set-points that keep the limit by their own differences never need more between them.
#[test]
fn setpoint_sparse_stream_within_limits_passes_unchanged() {
    for (every, step) in [(2, 1), (4, 1), (10, 1), (100, 1), (1000, 1), (20, 4)] {
        let mut rig = Rig::every(every);
        // Speeds up and down at the joint's acceleration, differentiated over the period of the net.
        let (mut wanted, mut speed, mut direction) = (0.0_f64, 0.0_f64, 1.0);
        let period_s = every as f64 * DT_S;
        let mut positions = vec![0.0];
        for _ in 0..12_000 / every + 8 {
            let change = ACCELERATION_MAX * period_s * 0.999;
            // Enough to turn back before the end of the range.
            if speed * direction + change > 1.8 || wanted * direction > 1.0 {
                direction = -direction;
            }
            speed += change.min(1.8) * direction;
            speed = speed.clamp(-1.8, 1.8);
            wanted += speed * period_s;
            if wanted.abs() > 2.9 {
                break;
            }
            positions.push(wanted);
        }
        let mut followed = 0;
        for i in 0..positions.len() as i64 * every {
            let at = usize::try_from(i / every).unwrap();
            rig.sparse_cycle(positions[at], i);
            if i % step == 0 {
                let seen = rig.sample(Nanos(PERIOD.0 * step), Nanos(0));
                seen.check();
                followed += i64::from(seen.mode == Mode::Follow);
            }
        }
        assert_eq!(rig.joint.limited().cycles, 0, "every {every}");
        assert_eq!(
            followed,
            positions.len() as i64 * every / step,
            "every {every}"
        );
    }
}

/// Set-points on a triangle, so far apart: 632, 222 and 80 rad/s² left for the wire once.
#[test]
fn setpoint_triangles_keep_acceleration_limit() {
    for (every, slope) in [
        (1, 0.9),
        (4, 0.9),
        (20, 0.9),
        (100, 0.9),
        (1000, 0.9),
        (1000, 0.3),
    ] {
        let mut rig = Rig::every(every);
        let mut hardest = 0.0_f64;
        for i in 0..12_000_i64 {
            let n = i / every * every;
            // Two seconds up, two seconds down.
            let t = n as f64 * DT_S;
            let phase = t % 4.0;
            let position = slope * if phase < 2.0 { phase } else { 4.0 - phase };
            rig.sparse_cycle(position, i);
            let seen = rig.sample(PERIOD, Nanos(0));
            seen.check();
            hardest = hardest.max(seen.acceleration.abs());
        }
        assert!(hardest > 0.5, "every {every}: it did not move");
        let limited = rig.joint.limited();
        // At its corners the stream turns within a period.
        let turns_at = 2.0 * slope / (every as f64 * DT_S);
        let is_beyond = turns_at > ACCELERATION_MAX;
        assert_eq!(limited.onsets > 0, is_beyond, "every {every}: {limited:?}");
    }
}

// Motions. A net thread and a driver in virtual time, each with a period of its own.

/// How far the driver plays behind its clock.
const DELAY: Nanos = Nanos(PERIOD.0 * 3 / 2);
const STALE_AFTER: Nanos = Nanos(PERIOD.0 * 10 + DELAY.0);

struct Rig {
    joint: Joint,
    points: JointSetPoints,
    /// When the last cycle of nets began.
    net_time: Nanos,
    /// The robot's clock.
    now: Nanos,
    /// Position and velocity, differentiated here.
    last: (f64, f64),
}

/// What one sample was, as measured outside.
#[derive(Clone, Copy, Debug)]
struct Seen {
    dt_s: f64,
    mode: Mode,
    position: f64,
    velocity: f64,
    acceleration: f64,
    /// Where the set-points are at that time.
    target: f64,
}

impl Rig {
    fn new() -> Self {
        let points = JointSetPoints {
            period: PERIOD,
            ..JointSetPoints::default()
        };
        // The joint knows its cycle.
        let mut joint = Joint::new(LIMITS);
        joint.sample(&points, true, Nanos(0), DT_S);
        Self {
            joint,
            points,
            net_time: Nanos(0),
            now: Nanos(0),
            last: (0.0, 0.0),
        }
    }

    /// With a net that gives a set-point in one of so many cycles.
    fn every(cycles: i64) -> Self {
        let mut rig = Self::new();
        rig.points.period = Nanos(PERIOD.0 * cycles);
        rig
    }

    /// The cycle of that number of a net thread, in which a slower net gives a set-point, or its last one is in force.
    fn sparse_cycle(&mut self, position: f64, number: i64) {
        let every = self.points.period.0 / PERIOD.0;
        self.net_time += PERIOD;
        if number % every == 0 {
            self.command(self.net_time, Some(position));
        }
    }

    /// A cycle of nets.
    fn command(&mut self, time: Nanos, position: Option<f64>) {
        self.net_time = time;
        self.points
            .advance(position.map(|position| SetPoint { time, position }));
    }

    /// A cycle of the robot, `dt` after the last, in which its clock is off by `jitter`.
    fn sample(&mut self, dt: Nanos, jitter: Nanos) -> Seen {
        self.now += dt;
        let fresh = self.now - self.net_time <= STALE_AFTER;
        let delay = if self.points.period == PERIOD {
            DELAY
        } else {
            self.joint.delay(&self.points)
        };
        let (at, dt_s) = (self.now + jitter - delay, dt.0 as f64 * 1e-9);
        let position = self.joint.sample(&self.points, fresh, at, dt_s);
        let velocity = (position - self.last.0) / dt_s;
        let acceleration = (velocity - self.last.1) / dt_s;
        self.last = (position, velocity);
        let is_sparse = self.joint.is_sparse(self.points.period);
        let target = interpolate(&self.points, at, is_sparse).0;
        Seen {
            dt_s,
            mode: self.joint.mode(),
            position,
            velocity,
            acceleration,
            target,
        }
    }

    /// One cycle of both.
    fn cycle(&mut self, position: Option<f64>) -> Seen {
        self.command(self.net_time + PERIOD, position);
        self.sample(PERIOD, Nanos(0))
    }
}

impl Seen {
    fn check(&self) {
        assert!(self.position.is_finite(), "{self:?}");
        assert!(
            self.velocity.abs() <= VELOCITY_MAX * 1.002,
            "too fast: {self:?}"
        );
        let range = LIMITS.position_max;
        assert!(self.position.abs() <= range, "out of range: {self:?}");
        // Differences of positions of some rad by times of a tenth of a millisecond.
        let slack = ACCELERATION_MAX * 1e-6 + 1e-6;
        let limit = ACCELERATION_MAX;
        assert!(
            self.acceleration.abs() <= limit + slack,
            "too hard: {self:?}"
        );
    }
}

/// Follows `motion` from 0 on for a second, lets `gap` of cycles pass in which `without` happens,
/// then goes on with the motion. Returns how far the joint got beyond its target afterwards (rad),
/// and after how many cycles it was on it again.
fn catch_up(motion: impl Fn(f64) -> f64, gap: i64, without: impl Fn(&mut Rig)) -> (f64, i64) {
    let mut rig = Rig::new();
    let (mut beyond, mut again) = (0.0_f64, None);
    for i in 0..3000 {
        if (1000..1000 + gap).contains(&i) {
            without(&mut rig);
            continue;
        }
        rig.net_time = Nanos(i * PERIOD.0);
        let seen = rig.cycle(Some(motion((i + 1) as f64 * DT_S)));
        seen.check();
        if i == 999 {
            assert_eq!((seen.mode, seen.position), (Mode::Follow, seen.target));
        } else if i > 999 {
            if seen.mode == Mode::Follow {
                assert_eq!(seen.position, seen.target, "after {i} cycles");
                again.get_or_insert(i - 1000 - gap);
            } else {
                assert_eq!(seen.mode, Mode::Approach, "after {i} cycles");
                assert_eq!(again, None, "fell behind again after {i} cycles");
                beyond = beyond.max(seen.position - seen.target);
            }
        }
    }
    (beyond, again.expect("catches up"))
}

/// From rest to a constant speed of 1 rad/s within half a second.
fn ramp(t: f64) -> f64 {
    if t < 0.5 { t * t } else { 0.25 + (t - 0.5) }
}

/// A quarter of the joint's acceleration at most, and 1 rad/s; at its fastest when the gap comes.
fn wave(t: f64) -> f64 {
    let (amplitude, omega) = (1.0, 1.0);
    amplitude * (1.0 - (omega * t).cos())
}

/// Brakes from 1 rad/s at a quarter of the joint's acceleration when the gap comes.
fn halt(t: f64) -> f64 {
    let after = (t - 1.0).clamp(0.0, 1.0);
    ramp(t.min(1.0)) + after - after * after / 2.0
}

#[test]
fn setpoint_gap_of_30_ms_is_caught_up() {
    let quiet = |rig: &mut Rig| rig.cycle(None).check();
    let stalled = |rig: &mut Rig| rig.sample(PERIOD, Nanos(0)).check();
    for (name, motion) in [
        ("ramp", ramp as fn(f64) -> f64),
        ("wave", wave),
        ("halt", halt),
    ] {
        let (beyond, cycles) = catch_up(motion, 30, quiet);
        assert!(beyond <= 1e-6, "{name}, no set-points: {beyond} rad beyond");
        assert!(cycles <= 200, "{name}, no set-points: {cycles} cycles");
        // A stalled thread is followed at its last speed for a while, perhaps too far.
        let (_, cycles) = catch_up(motion, 30, stalled);
        assert!(cycles <= 200, "{name}, stalled: {cycles} cycles");
    }
}

#[test]
fn setpoint_step_is_approached_without_overshoot() {
    for step in [0.0019, -0.003, 0.01, 0.019_999_9, -0.02] {
        let mut rig = Rig::new();
        let (mut fastest, mut braking) = (0.0_f64, false);
        let mut cycles = 0;
        loop {
            let seen = rig.cycle(Some(step));
            seen.check();
            cycles += 1;
            assert!(
                seen.position / step <= 1.0 + 1e-6,
                "{step}: overshoots to {}",
                seen.position
            );
            let speed = seen.velocity / step.signum();
            assert!(speed >= -1e-9, "{step}: turns back in cycle {cycles}");
            braking |= speed < fastest - 1e-6;
            assert!(
                !braking || speed <= fastest + 1e-6,
                "{step}: chatters in cycle {cycles}"
            );
            fastest = speed;
            if seen.mode == Mode::Follow {
                break;
            }
            assert!(cycles < 500, "{step}: never arrives");
        }
    }
}

#[test]
fn setpoint_new_run_may_start_nearby() {
    let mut rig = Rig::new();
    for i in 0..100 {
        rig.cycle(Some(1e-3 * f64::from(i)));
    }
    for _ in 0..500 {
        rig.cycle(None).check();
    }
    let rested = rig.cycle(None);
    assert_eq!((rested.mode, rested.velocity), (Mode::Held, 0.0));
    let near = rested.position - 0.015;
    let modes: Vec<_> = (0..300)
        .map(|_| rig.cycle(Some(near)))
        .map(|seen| seen.mode)
        .collect();
    assert_eq!((modes[0], modes[299]), (Mode::Approach, Mode::Follow));
}

#[test]
fn setpoint_clock_or_stream_step_causes_no_jump() {
    // Both are steps that the joint's speed allows.
    for (jitter, step) in [(5_000_000, 0.0), (-1_000_000, 0.0), (0, 0.0015)] {
        let mut rig = Rig::new();
        let mut modes = Vec::new();
        for i in 0..400 {
            let is_later = i >= 200;
            let jitter = Nanos(if is_later { jitter } else { 0 });
            let step = if is_later { step } else { 0.0 };
            let t = f64::from(i) * DT_S;
            let position = if t < 0.15 {
                t * t
            } else {
                0.15 * (2.0 * t - 0.15)
            };
            rig.command(rig.net_time + PERIOD, Some(position + step));
            let seen = rig.sample(PERIOD, jitter);
            seen.check();
            modes.push(seen.mode);
        }
        assert_eq!(
            (modes[199], modes[399]),
            (Mode::Follow, Mode::Follow),
            "{jitter} ns, {step} rad"
        );
        assert!(modes.contains(&Mode::Approach), "{jitter} ns, {step} rad");
    }
}

/// A driver with a cycle of four of the net's, which plays far behind: before the oldest set-point that is kept.
#[test]
fn setpoint_playback_before_history_catches_up() {
    let behind = Nanos(DELAY.0 - 5 * PERIOD.0);
    let mut rig = Rig::new();
    for i in 0..1_008 {
        let is_gap = (400..412).contains(&i);
        let t = f64::from(i + 1).min(1e3) * DT_S;
        // From rest to rest within a second, at 1 rad/s at most.
        let position = 0.5 * (t - (TAU * t).sin() / TAU);
        rig.command(rig.net_time + PERIOD, Some(position).filter(|_| !is_gap));
        if i % 4 == 3 {
            let seen = rig.sample(Nanos(PERIOD.0 * 4), behind);
            seen.check();
            let is_caught_up = seen.mode == Mode::Follow && seen.position == seen.target;
            assert!(
                is_caught_up || (400..700).contains(&i),
                "after {i}: {seen:?}"
            );
        }
    }
    assert_eq!(rig.last.0, 0.5);
}

#[test]
fn setpoint_joint_brakes_before_range_end_reaches_it() {
    for (speed, step) in [(1.89, 1), (0.3, 1), (-1.89, 4), (-0.4, 7), (-0.02, 1)] {
        let mut rig = Rig::new();
        rig.joint.rest_at(2.5_f64.copysign(speed), &rig.points);
        rig.last.0 = 2.5_f64.copysign(speed);
        let (mut wanted, mut velocity) = (rig.last.0, 0.0);
        let mut braked = 0;
        for i in 0..30_000 {
            // It streams on and on, through the end.
            velocity = (velocity + 3.0 * DT_S).min(speed.abs());
            wanted += velocity.copysign(speed) * DT_S;
            rig.command(rig.net_time + PERIOD, Some(wanted));
            if i % step == 0 {
                let seen = rig.sample(Nanos(PERIOD.0 * i64::from(step)), Nanos(0));
                seen.check();
                assert!(seen.velocity / speed >= -1e-9, "turns back: {seen:?}");
                braked += u32::from(seen.acceleration * speed < -3.5 * speed.abs());
            }
        }
        let off = (rig.last.0 - 3.0_f64.copysign(speed)).abs();
        assert!(
            off < 1e-6 && rig.last.1.abs() < 1e-3,
            "{speed}: {:?}",
            rig.last
        );
        // At its acceleration, not earlier and more gently than need be.
        let ideal = speed.abs() / ACCELERATION_MAX / DT_S / f64::from(step);
        assert!(
            f64::from(braked) > 0.6 * ideal - 3.0,
            "{speed}: {braked}, not {ideal}"
        );
    }
}

#[test]
fn setpoint_joint_beyond_range_stays_or_returns() {
    let mut joint = in_mode(Mode::Held, 0.0);
    joint.rest_at(3.01, &JointSetPoints::default());
    // It is moved back only by set-points that lead back.
    for (wanted, expected) in [(3.02, 3.01), (3.0, 3.0), (2.995, 2.995)] {
        let mut last = joint.motion().0;
        for _ in 0..200 {
            let position = joint.sample(&stream(&[wanted]), true, Nanos(0), DT_S);
            assert!(position <= last && position <= 3.01, "{wanted}: {position}");
            last = position;
        }
        assert!((last - expected).abs() < 1e-6, "{wanted}: {last}");
    }
}

/// What happens to a stream of set-points in the next so many cycles.
#[derive(Clone, Copy, Debug)]
enum Phase {
    /// The motion changes to this speed with this acceleration, rad/s and rad/s².
    Move {
        speed: f64,
        acceleration: f64,
        cycles: u16,
    },
    /// The motion jumps by this distance, rad.
    Jump(f64),
    /// The motion turns back at its speed.
    Flip,
    /// The motion goes on, but no set-points come.
    Gap(u16),
    /// The net thread stalls and then skips the cycles it missed.
    Stall(u16),
    /// The net ends, and the next begins at this distance from where the joint has come to rest.
    Restart(f64),
    /// The robot loses so many datagrams.
    Loss(u8),
}

fn phase() -> impl Strategy<Value = Phase> {
    let motion =
        (-2.2..2.2, 0.5..8.0, 1..400_u16).prop_map(|(speed, acceleration, cycles)| Phase::Move {
            speed,
            acceleration,
            cycles,
        });
    prop_oneof![
        6 => motion,
        1 => prop_oneof![-0.3..0.3, -0.01..0.01].prop_map(Phase::Jump),
        1 => Just(Phase::Flip),
        2 => (1..60_u16).prop_map(Phase::Gap),
        2 => (1..60_u16).prop_map(Phase::Stall),
        1 => prop_oneof![-0.03..0.03, Just(0.0)].prop_map(Phase::Restart),
        1 => (1..40_u8).prop_map(Phase::Loss),
    ]
}

/// Motions end here, so that a joint that brakes from full speed stays in its range.
const NEAR: f64 = 2.3;
/// Motions go to the very end of the range.
const FULL: f64 = LIMITS.position_max;

/// A running stream.
struct Play {
    rig: Rig,
    position: f64,
    speed: f64,
    /// Where motions come to rest, rad.
    range: f64,
    /// How far the robot's clock is off its grid, ns, by turns.
    jitter: Vec<i64>,
    samples: usize,
    /// Where the joint was when it was refused or its set-points ended, and how fast.
    left: Option<(f64, f64)>,
    modes: [u32; 4],
}

impl Play {
    fn sample(&mut self, periods: i64) {
        self.samples += 1;
        let jitter = Nanos(self.jitter[self.samples % self.jitter.len()]);
        let before = self.rig.last;
        let seen = self.rig.sample(Nanos(PERIOD.0 * periods), jitter);
        seen.check();
        if seen.mode == Mode::Follow {
            let off = (seen.position - seen.target.clamp(-3.0, 3.0)).abs();
            // A clock that wanders does not make it accelerate beyond its limit.
            let speed = seen.velocity.abs().max(before.1.abs());
            let wander = 0.01 * speed * seen.dt_s;
            assert!(off <= ARRIVED_RAD + wander, "{seen:?} does not follow");
        }
        self.modes[seen.mode as usize] += 1;
        if matches!(seen.mode, Mode::Held | Mode::Refused) {
            let (position, velocity) = *self.left.get_or_insert(before);
            let distance = (seen.position - position) * velocity.signum();
            let stop = velocity * velocity / (2.0 * ACCELERATION_MAX);
            assert!(
                (-1e-9..=stop + 1e-9).contains(&distance),
                "{seen:?}: {distance} rad, not {stop}"
            );
        } else {
            self.left = None;
        }
    }

    fn cycle(&mut self, commanded: bool, sampled: bool) {
        let time = self.rig.net_time + PERIOD;
        let position = self.position;
        self.rig.command(time, commanded.then_some(position));
        if sampled {
            self.sample(1);
        }
    }

    fn advance(&mut self, wanted: f64, acceleration: f64) {
        let change = acceleration * DT_S;
        let wanted = wanted.clamp(self.speed - change, self.speed + change);
        let end = self.position + wanted * (DT_S + wanted.abs() / (2.0 * ACCELERATION_MAX));
        self.speed = if end.abs() >= self.range {
            // It must brake now to come to rest before the end.
            let loss = ACCELERATION_MAX * DT_S;
            (self.speed.abs() - loss).max(0.0).copysign(self.speed)
        } else {
            wanted
        };
        self.position = (self.position + self.speed * DT_S).clamp(-self.range, self.range);
    }

    fn run(&mut self, phase: Phase) {
        match phase {
            Phase::Move {
                speed,
                acceleration,
                cycles,
            } => {
                for _ in 0..cycles {
                    self.advance(speed, acceleration);
                    self.cycle(true, true);
                }
            }
            Phase::Jump(by) => {
                self.position = (self.position + by).clamp(-self.range, self.range);
            }
            Phase::Flip => self.speed = -self.speed,
            Phase::Gap(cycles) => {
                for _ in 0..cycles {
                    self.advance(self.speed, 0.0);
                    self.cycle(false, true);
                }
            }
            Phase::Stall(cycles) => {
                for _ in 0..cycles {
                    self.sample(1);
                }
                self.rig.net_time += Nanos(PERIOD.0 * i64::from(cycles));
            }
            Phase::Restart(distance) => {
                for _ in 0..600 {
                    self.cycle(false, true);
                }
                assert_eq!((self.rig.joint.mode(), self.rig.last.1), (Mode::Held, 0.0));
                self.position = self.rig.last.0 + distance;
                self.speed = 0.0;
                // The joint may have braked beyond the end of the stream's range.
                self.range = self.range.max(self.position.abs());
            }
            Phase::Loss(datagrams) => {
                for _ in 0..datagrams {
                    self.advance(self.speed, 0.0);
                    self.cycle(true, false);
                }
                self.sample(i64::from(datagrams));
            }
        }
    }
}

fn play(phases: &[Phase], range: f64, jitter: Vec<i64>) -> Play {
    let mut play = Play {
        rig: Rig::new(),
        position: 0.0,
        speed: 0.0,
        range,
        jitter,
        samples: 0,
        left: None,
        modes: [0; 4],
    };
    for phase in phases {
        play.run(*phase);
    }
    play
}

fn jitters() -> impl Strategy<Value = Vec<i64>> {
    prop_oneof![
        Just(vec![0]),
        prop::collection::vec(-3_000..3_000_i64, 7),
        prop::collection::vec(-300_000..300_000_i64, 7),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn setpoint_any_stream_stays_within_limits(
        phases in prop::collection::vec(phase(), 1..12),
        jitter in jitters(),
    ) {
        // Wilder ones are approached for ever.
        let is_calm = jitter.iter().all(|off| off.abs() <= 3_000);
        let mut played = play(&phases, NEAR, jitter);
        // Whatever happened: when set-points end, the joint rests, and a new run is followed.
        played.run(Phase::Restart(0.0));
        played.run(Phase::Move { speed: 0.5, acceleration: 1.0, cycles: 20 });
        let (mode, behind) = (played.rig.joint.mode(), played.position - played.rig.last.0);
        prop_assert!(matches!(mode, Mode::Follow | Mode::Approach), "{:?}", mode);
        prop_assert!(behind.abs() < 1e-4, "{} rad", behind);
        played.run(Phase::Move { speed: 0.5, acceleration: 1.0, cycles: 200 });
        prop_assert!(!is_calm || played.rig.joint.mode() == Mode::Follow);
    }

    /// Also when set-points stop coming in mid-motion, right before its end.
    #[test]
    fn setpoint_any_stream_stays_in_range(
        phases in prop::collection::vec(phase(), 1..20),
        jitter in jitters(),
    ) {
        let mut played = play(&phases, FULL, jitter);
        played.run(Phase::Move { speed: 1.9, acceleration: 4.0, cycles: 2_000 });
        played.run(Phase::Stall(1_000));
    }

    #[test]
    fn setpoint_refused_joint_rests_until_stream_ends(
        phases in prop::collection::vec(phase(), 1..6),
        jitter in jitters(),
    ) {
        let mut played = play(&phases, NEAR, jitter);
        played.run(Phase::Restart(0.0));
        played.run(Phase::Jump(if played.position > 0.0 { -0.1 } else { 0.1 }));
        played.cycle(true, true);
        prop_assert_eq!(played.rig.joint.mode(), Mode::Refused);
        let rested = played.rig.last.0;
        for phase in phases {
            if !matches!(phase, Phase::Gap(_) | Phase::Restart(_)) {
                played.run(phase);
            }
        }
        prop_assert_eq!((played.rig.joint.mode(), played.rig.last), (Mode::Refused, (rested, 0.0)));
        played.run(Phase::Restart(0.0));
        prop_assert_eq!((played.rig.joint.mode(), played.rig.last), (Mode::Held, (rested, 0.0)));
    }

    #[test]
    fn setpoint_smooth_motion_is_followed_from_first_cycle(
        speeds in prop::collection::vec((-1.89..1.89, 0.1..4.0, 1..500_u16), 1..10),
    ) {
        let moves = speeds
            .into_iter()
            .map(|(speed, acceleration, cycles)| Phase::Move { speed, acceleration, cycles });
        // A motion begins where the joint is.
        let begin = Phase::Move { speed: 0.0, acceleration: 1.0, cycles: 1 };
        let phases: Vec<_> = std::iter::once(begin).chain(moves).collect();
        let played = play(&phases, NEAR, vec![0]);
        prop_assert_eq!(played.modes[Mode::Follow as usize] as usize, played.samples);
    }
}
