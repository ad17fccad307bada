//! The stage by itself: any targets, speeds, cycles and resets, differentiated here; what is passed on as it is; and what
//! is counted, once per onset.

#![expect(
    clippy::float_cmp,
    reason = "what is compared so must be equal to the bit"
)]

use proptest::prelude::*;

use super::*;

const LIMITS: JointLimits = JointLimits {
    position_min: -1.0,
    position_max: 2.0,
    velocity_max: 1.5,
    acceleration_max: 4.0,
};
const DT_S: f64 = 1e-3;

/// What a driver may do with a stage in a cycle.
#[derive(Clone, Copy, Debug)]
enum Step {
    Track(f64, f64),
    Ahead(f64),
    Drive(f64),
    Brake,
    RestAt(f64),
}

fn value(most: f64) -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -most..most,
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 0.0]),
    ]
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        6 => (value(3.0), value(4.0)).prop_map(|(target, speed)| Step::Track(target, speed)),
        6 => (-0.01..0.01).prop_map(Step::Ahead),
        2 => value(10.0).prop_map(Step::Drive),
        2 => Just(Step::Brake),
        1 => (-1.0..2.0).prop_map(Step::RestAt),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn last_stage_any_commands_leave_within_limits(
        steps in prop::collection::vec((step(), 1..60_u8, 250e-6..50e-3), 1..40),
    ) {
        let mut stage = LastStage::new(LIMITS);
        let mut last = (0.0, 0.0);
        for (step, times, dt_s) in steps {
            for _ in 0..times {
                let position = match step {
                    Step::Track(target, speed) => stage.track(target, speed, dt_s),
                    Step::Ahead(by) => stage.track(last.0 + by, by / dt_s, dt_s),
                    Step::Drive(velocity) => stage.drive(velocity, dt_s),
                    Step::Brake => stage.brake(dt_s),
                    Step::RestAt(at) => {
                        stage.rest_at(at);
                        last = (at, 0.0);
                        at
                    }
                };
                let speed = (position - last.0) / dt_s;
                let acceleration = (speed - last.1) / dt_s;
                let slack = 1e-14 / (dt_s * dt_s) + 4e-6;
                prop_assert!((-1.0..=2.0).contains(&position), "out of range: {}", position);
                prop_assert!(speed.abs() <= 1.5 * (1.0 + 1e-9), "too fast: {}", speed);
                prop_assert!(acceleration.abs() <= 4.0 + slack, "{:?}: {}", step, acceleration);
                last = (position, speed);
            }
        }
        // It can always stop, and does so within its limits.
        let (mut steps, from) = (0, stage.motion());
        while stage.motion().1.abs() > 0.0 {
            stage.brake(DT_S);
            steps += 1;
            prop_assert!(steps <= 377);
        }
        let stop = from.1 * from.1 / 2.0 / 4.0;
        prop_assert!((stage.motion().0 - from.0).abs() <= stop + 1e-9);
    }

    #[test]
    fn base_last_stage_any_velocities_leave_within_limits(
        steps in prop::collection::vec(
            (prop::option::of((value(3.0), value(3.0), value(3.0))), 1..40_u8, 1e-3..0.3), 1..30),
    ) {
        let limits = PlanarLimits { velocity: [0.8, 1.2], acceleration: [1.0, 1.5] };
        // Wheels that turn for the sum of all.
        let effort = |[x, y, turn]: Twist3| x.abs() + y.abs() + 0.4 * turn.abs();
        let reach = |twist| 1.0 / effort(twist).max(1.0);
        let mut stage = PlanarStage::new(limits);
        let mut last = [0.0; 3];
        for (wanted, times, dt_s) in steps {
            for _ in 0..times {
                let now = stage.step(wanted.map(|(x, y, turn)| [x, y, turn]), reach, dt_s);
                let change: Twist3 = std::array::from_fn(|i| (now[i] - last[i]) / dt_s);
                prop_assert!(now[0].hypot(now[1]) <= 0.8 + 1e-9 && now[2].abs() <= 1.2 + 1e-9, "{:?}", now);
                prop_assert!(change[0].hypot(change[1]) <= 1.0 + 1e-9, "{:?}", change);
                prop_assert!(change[2].abs() <= 1.5 + 1e-9, "{:?}", change);
                prop_assert!(effort(now) <= 1.0 + 1e-9, "{:?}", now);
                last = now;
            }
        }
        for _ in 0..1000 {
            stage.step(None, reach, DT_S);
        }
        prop_assert!(stage.rests());
    }
}

/// A motion within the limits, by its times.
fn motion(t: f64) -> f64 {
    0.5 * (1.0 - (2.5 * t).cos())
}

#[test]
fn last_stage_motion_within_limits_passes_unchanged() {
    let mut stage = LastStage::new(LIMITS);
    for i in 1..5_000 {
        let t = f64::from(i) * DT_S;
        let (target, speed) = (motion(t), 1.25 * (2.5 * t).sin());
        assert_eq!(stage.track(target, speed, DT_S), target, "{i}");
    }
    assert_eq!(*stage.limited(), Limited::default());
}

#[test]
fn last_stage_step_is_reported_once_with_figures() {
    let mut stage = LastStage::new(LIMITS);
    for _ in 0..1000 {
        stage.track(0.5, 0.0, DT_S);
    }
    assert_eq!(stage.motion().0, 0.5, "it arrives");
    let limited = *stage.limited();
    assert_eq!(limited.onsets, 1);
    assert!((300..900).contains(&limited.cycles), "{limited:?}");
    let text = limited.last.unwrap().text(Unit::Angle);
    assert_eq!(
        text,
        "velocity 500.0000 rad/s commanded, limit 1.5000 rad/s"
    );
    stage.track(0.501, 0.0, DT_S);
    assert_eq!(stage.limited().onsets, 2, "again");
    let text = stage.limited().last.unwrap().text(Unit::Angle);
    assert_eq!(
        text,
        "acceleration 1000.0000 rad/s² commanded, limit 4.0000 rad/s²"
    );
}

#[test]
fn last_stage_target_beyond_range_reported_end_reached() {
    let mut stage = LastStage::new(LIMITS);
    stage.rest_at(1.9);
    for _ in 0..2000 {
        stage.track(2.5, 1.0, DT_S);
    }
    assert_eq!(stage.motion(), (2.0, 0.0, 0.0));
    let limited = stage.limited();
    assert_eq!((limited.onsets, limited.cycles), (1, 2000));
    let text = limited.last.unwrap().text(Unit::Angle);
    assert_eq!(text, "position 2.5000 rad commanded, limit 2.0000 rad");
}

#[test]
fn last_stage_nearby_first_target_is_not_reported() {
    let mut stage = LastStage::new(LIMITS);
    stage.begin_quietly(0.02);
    for _ in 0..500 {
        stage.track(0.015, 0.0, DT_S);
    }
    assert_eq!((stage.motion().0, stage.limited().onsets), (0.015, 0));
    assert!(stage.limited().cycles > 10);
    // The next one is.
    stage.track(0.03, 0.0, DT_S);
    assert_eq!(stage.limited().onsets, 1);
}

#[test]
fn last_stage_nan_brakes_and_is_reported() {
    let mut stage = LastStage::moving(LIMITS, 0.0, 1.0);
    for _ in 0..300 {
        stage.track(f64::NAN, 0.0, DT_S);
    }
    assert_eq!(stage.motion().1, 0.0);
    assert!((stage.motion().0 - 0.125).abs() < 1e-3, "{stage:?}");
    assert_eq!(stage.limited().onsets, 1);
    assert_eq!(
        stage.limited().last.unwrap().text(Unit::Angle),
        "the command is not a finite number"
    );
}

#[test]
fn last_stage_overspeed_joint_stops_at_range_end() {
    let mut stage = LastStage::moving(LIMITS, 1.9, 1.5);
    let mut last = (1.9, 1.5);
    for _ in 0..500 {
        let position = stage.track(5.0, 1.5, DT_S);
        let speed = (position - last.0) / DT_S;
        let is_at_end = position == 2.0;
        assert!(
            is_at_end || (last.1 - speed - 4e-3).abs() < 1e-9,
            "{position}"
        );
        last = (position, speed);
    }
    assert_eq!(last, (2.0, 0.0));
}

#[test]
fn last_stage_steer_changes_speed_within_limits() {
    let mut stage = LastStage::new(LIMITS);
    let mut last = 0.0;
    // Measured positions jump about the end of its range, and targets vary wildly.
    for i in 0..4000_u32 {
        let at = 2.0 + 0.05 * f64::from(i % 7) - 0.15 - if i < 2000 { 1.0 } else { 0.0 };
        let target = [9.0, -9.0, f64::NAN, 1.0][usize::try_from(i / 500).unwrap() % 4];
        let speed = stage.steer(at, target, DT_S);
        assert!((speed - last).abs() <= 4.0 * DT_S * (1.0 + 1e-9) && speed.abs() <= 1.5);
        last = speed;
    }
}

#[test]
fn base_last_stage_overspeed_keeps_direction_is_reported() {
    let limits = PlanarLimits {
        velocity: [0.5, 1.0],
        acceleration: [1.0, 2.0],
    };
    let mut stage = PlanarStage::new(limits);
    for _ in 0..1000 {
        stage.step(Some([0.6, 0.8, 0.5]), |_| 1.0, DT_S);
    }
    let [x, y, turn] = stage.velocity();
    assert!((x - 0.3).abs() < 1e-9 && (y - 0.4).abs() < 1e-9 && (turn - 0.25).abs() < 1e-9);
    let [floor, turning] = stage.limited();
    assert_eq!((floor.onsets, turning.onsets), (1, 1));
    let text = floor.last.unwrap().text(Unit::Length);
    assert_eq!(text, "velocity 1.0000 m/s commanded, limit 0.5000 m/s");
    for _ in 0..1000 {
        stage.step(None, |_| 1.0, DT_S);
    }
    assert!(stage.rests());
}
