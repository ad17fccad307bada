//! Every state with every event.

use super::sim::Bench;
use crate::{
    Nanos,
    servo::{STRIKES, SampleOutcome, Servo, State, WINDOW},
};

const STATES: [State; 5] = [
    State::Unlocked,
    State::Jump,
    State::Locked,
    State::Stable,
    State::Holdover,
];

/// What can happen.
#[derive(Debug, Clone, Copy)]
enum Event {
    Good,
    Outlier,
    SmallStep,
    LargeStep,
    SecondStep,
    Rubbish,
    Silence,
    LongSilence,
    TimeBack,
}

fn in_state(state: State) -> Bench {
    let mut bench = match state {
        State::Unlocked => Bench::usual(),
        State::Jump | State::Locked => {
            let mut bench = Bench::usual();
            while bench.servo.state() != state || bench.servo.phase_samples < 20 {
                bench.sample(0.0);
            }
            bench
        }
        State::Stable | State::Holdover => Bench::stable(),
    };
    if state == State::Holdover {
        silence(&mut bench, 20);
    }
    assert_eq!(bench.servo.state(), state);
    bench
}

/// Locked with a full memory, as after a small step.
fn locked_for_long() -> Bench {
    let mut bench = in_state(State::Stable);
    bench.servo.state = State::Locked;
    bench.servo.smooth_ns = 20e3;
    bench
}

fn silence(bench: &mut Bench, periods: usize) {
    (0..periods).for_each(|_| bench.lose());
    bench.servo.handle_time(bench.now);
}

fn samples(bench: &mut Bench, count: usize) {
    bench.run(count, || 0.0);
}

fn happen(bench: &mut Bench, event: Event) {
    match event {
        Event::Good => samples(bench, 1),
        Event::Outlier => bench.run(1, || 5e6),
        Event::SmallStep => {
            bench.step(Nanos::from_micros(700));
            samples(bench, WINDOW);
        }
        Event::LargeStep => {
            bench.step(Nanos::from_millis(7));
            samples(bench, WINDOW);
        }
        Event::SecondStep => {
            happen(bench, Event::SmallStep);
            happen(bench, Event::SmallStep);
        }
        Event::Rubbish => {
            for i in 0..usize::from(STRIKES) * WINDOW {
                bench.sample(if i % 2 == 0 { 50e6 } else { -50e6 });
            }
        }
        Event::Silence => silence(bench, 20),
        Event::LongSilence => silence(bench, 1_000_000),
        Event::TimeBack => {
            bench.now = Nanos(-1_000_000_000);
            samples(bench, WINDOW);
        }
    }
}

/// One row per event, one column per state in the order of `STATES`.
#[test]
fn servo_state_table() {
    use State::{Holdover, Jump, Locked, Stable, Unlocked};
    let table = [
        (Event::Good, [Jump, Jump, Locked, Stable, Locked]),
        (Event::Outlier, [Jump, Jump, Locked, Stable, Holdover]),
        (Event::SmallStep, [Jump, Jump, Jump, Locked, Locked]),
        (Event::LargeStep, [Jump, Jump, Jump, Jump, Jump]),
        (Event::SecondStep, [Jump, Jump, Jump, Jump, Jump]),
        (Event::Rubbish, [Unlocked, Jump, Jump, Jump, Jump]),
        (
            Event::Silence,
            [Unlocked, Unlocked, Holdover, Holdover, Holdover],
        ),
        (Event::LongSilence, [Unlocked; 5]),
        (Event::TimeBack, [Jump; 5]),
    ];
    for (event, expected) in table {
        for (state, expected) in STATES.into_iter().zip(expected) {
            let mut bench = in_state(state);
            happen(&mut bench, event);
            assert_eq!(bench.servo.state(), expected, "{event:?} while {state}");
        }
    }
}

// Locked has two faces: with a short memory a step casts doubt on all, with a full one it does not.

#[test]
fn servo_small_step_after_long_lock_is_slewed() {
    let mut bench = locked_for_long();
    happen(&mut bench, Event::SmallStep);
    assert_eq!(bench.servo.state(), State::Locked);
    assert!(bench.servo.lag_ns > 0.0);
    happen(&mut bench, Event::LargeStep);
    assert_eq!(bench.servo.state(), State::Jump);
}

// Transitions that take time.

#[test]
fn servo_first_sample_to_stable() {
    let mut bench = Bench::usual();
    let mut seen = vec![bench.servo.state()];
    for _ in 0..1_000 {
        bench.sample(0.0);
        if seen.last() != Some(&bench.servo.state()) {
            seen.push(bench.servo.state());
        }
    }
    assert_eq!(
        seen,
        [State::Unlocked, State::Jump, State::Locked, State::Stable]
    );
}

#[test]
fn servo_excessive_noise_never_locks() {
    let mut bench = Bench::usual();
    for i in 0..5_000 {
        bench.sample(if i % 2 == 0 { 450e3 } else { -450e3 });
        assert!(!bench.servo.state().is_followed(), "sample {i}");
    }
}

#[test]
fn servo_one_sided_errors_end_stable() {
    let mut bench = in_state(State::Stable);
    let mut seen = Vec::new();
    for _ in 0..1_000 {
        bench.sample(90e3);
        seen.push(bench.servo.state());
    }
    assert!(seen.contains(&State::Locked), "transition 6");
    bench.run(3_000, || 0.0);
    assert_eq!(bench.servo.state(), State::Stable, "transition 5");
}

#[test]
fn servo_invalid_first_samples_return_to_unlocked() {
    let mut bench = Bench::usual();
    let outcomes: Vec<_> = (0..WINDOW)
        .map(|i| bench.sample(if i % 2 == 0 { 0.0 } else { 9e6 }).outcome)
        .collect();
    assert_eq!(outcomes[0], SampleOutcome::Restarted);
    assert_eq!(outcomes[WINDOW - 1], SampleOutcome::Outlier);
    assert_eq!(bench.servo.state(), State::Unlocked, "transition 2");
}

#[test]
fn servo_first_line_has_offset_and_rate() {
    let mut bench = Bench::usual();
    assert_eq!(bench.sample(0.0).outcome, SampleOutcome::Restarted);
    assert!(
        bench.error_ns().abs() < 1.0,
        "the first sample sets the phase"
    );
    samples(&mut bench, WINDOW - 1);
    let ppb = bench.servo.estimate().frequency_ppb;
    assert!(
        (ppb - 100_000.0).abs() < 200.0,
        "the first window the rate: {ppb} ppb"
    );
}

#[test]
fn servo_without_samples_has_no_clock() {
    let mut servo = Servo::new(&crate::servo::ServoConfig::new(
        std::time::Duration::from_millis(1),
    ));
    servo.handle_time(Nanos::MAX);
    assert_eq!(servo.state(), State::Unlocked);
    assert!(!servo.estimate().is_valid_at(Nanos::ZERO));
}
