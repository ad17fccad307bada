//! Cost of the last stage of a driver per joint and cycle, compared with the minimum of any driver: a clamp to range
//! and velocity. Once with targets that it passes on, once with targets that it limits in every cycle. Judges no figure.
//! `cargo bench -p takt-core --bench last_stage [-- [--json]]`.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::hint::black_box;
use std::time::Instant;

use serde_json::json;
use takt_core::device::last_stage::LastStage;
use takt_net::JointLimits;

const JOINTS: usize = 7;
const CYCLES: u32 = 20_000;
const ROUNDS: usize = 21;
const DT_S: f64 = 0.001;

const LIMITS: JointLimits = JointLimits {
    position_min: -2.9,
    position_max: 2.9,
    velocity_max: 1.9,
    acceleration_max: 4.0,
};

/// Nanoseconds per joint and cycle of one round.
fn timed(mut cycle: impl FnMut(f64)) -> f64 {
    let begin = Instant::now();
    for number in 0..CYCLES {
        cycle(f64::from(number) * DT_S);
    }
    begin.elapsed().as_secs_f64() * 1e9 / f64::from(CYCLES)
}

/// Position and velocity of a target at a time.
type Target = fn(f64) -> (f64, f64);

fn clamped(target: Target) -> f64 {
    let mut positions = [0.0_f64; JOINTS];
    let nanos = timed(|time| {
        let (position, _) = black_box(target(time));
        for last in &mut positions {
            let most = LIMITS.velocity_max * DT_S;
            let within = position.clamp(LIMITS.position_min, LIMITS.position_max);
            *last = within.clamp(*last - most, *last + most);
        }
        black_box(&positions);
    });
    nanos / 7.0
}

fn staged(target: Target) -> f64 {
    let mut stages: [LastStage; JOINTS] = std::array::from_fn(|_| {
        let (position, velocity) = target(0.0);
        LastStage::moving(LIMITS, position, velocity)
    });
    let mut positions = [0.0_f64; JOINTS];
    let nanos = timed(|time| {
        let (position, velocity) = black_box(target(time + DT_S));
        for (last, stage) in positions.iter_mut().zip(&mut stages) {
            *last = stage.track(position, velocity, DT_S);
        }
        black_box(&positions);
    });
    nanos / 7.0
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() {
    let targets: [(&str, Target); 2] = [
        ("passed", |time| (0.5 * time.sin(), 0.5 * time.cos())),
        ("limited", |time| {
            ((20.0 * time).sin(), 20.0 * (20.0 * time).cos())
        }),
    ];
    let mut members = serde_json::Map::new();
    for (name, target) in targets {
        let rounds: Vec<_> = (0..ROUNDS)
            .map(|_| (clamped(target), staged(target)))
            .collect();
        let bare = median(rounds.iter().map(|round| round.0).collect());
        let stage = median(rounds.iter().map(|round| round.1).collect());
        println!(
            "{name:<8} {stage:6.2} ns per joint and cycle, a clamp {bare:6.2} ns, ratio {:.1}",
            stage / bare
        );
        members.insert(
            name.to_owned(),
            json!({ "stage_ns": stage, "clamp_ns": bare, "ratio": stage / bare }),
        );
    }
    if std::env::args().any(|argument| argument == "--json") {
        println!("{}", json!({ "last_stage": members }));
    }
}
