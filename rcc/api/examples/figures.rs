//! Figures of the API in one run, beside the round trip of a request: preparing a motion, beginning it, and cancelling it
//! while another thread plans.
//! `cargo run --release -p takt-api --features embedded --example figures -- [RUNS]`

#![expect(clippy::print_stdout, reason = "a table is all that it makes")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_api::{Arm, Cell, Error, ErrorKind, Pose, deg};

const BENT: [f64; 7] = [0.0, 30.0, 0.0, -70.0, 0.0, 45.0, 0.0];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let runs = std::env::args()
        .nth(1)
        .map_or(Ok(200), |runs| runs.parse())?;
    run(runs).map_err(Into::into)
}

/// Measures everything `runs` times, at least once, and prints the table.
pub(crate) fn run(runs: usize) -> Result<(), Error> {
    let cell = Cell::emulated("two_lwr")?;
    let (left, right) = (cell.arm("left")?, cell.arm("right")?);
    left.ptp(BENT.map(deg)).run()?;
    right.ptp(BENT.map(deg)).run()?;

    let trip = Figure::of(runs, |_| timed(|| cell.arms()))?;
    let prepare = Figure::of(runs, |number| {
        let mut handle = None;
        let time = timed(|| {
            left.ptp(near(number))
                .queue()
                .map(|begun| handle = Some(begun))
        })?;
        handle.map_or(Ok(()), |handle| handle.wait().map(drop))?;
        Ok(time)
    })?;
    let begin = Figure::of(runs, |number| first_set_point(&left, near(number)))?;
    let cancel = Figure::of(runs, |number| cancelled(&left, number))?;
    let beside = beside_plans(&right, || {
        Figure::of(runs, |number| cancelled(&left, number))
    })?;

    let period_ms = left.description().period.as_secs_f64() * 1e3;
    println!("period of the arm: {period_ms:.1} ms; {runs} runs");
    println!("                                    p50         p99         p50 / round trip");
    for (name, figure) in [
        ("round trip of a request", &trip),
        ("preparing a PTP", &prepare),
        ("begin to the first set-point", &begin),
        ("cancel", &cancel),
        ("cancel while another thread plans", &beside),
    ] {
        let [p50, p99] = [figure.p50, figure.p99].map(|time| time.as_secs_f64() * 1e3);
        let ratio = figure.p50.as_secs_f64() / trip.p50.as_secs_f64();
        println!("{name:33} {p50:8.3} ms {p99:8.3} ms {ratio:10.2}");
    }
    Ok(())
}

/// Durations of one kind.
struct Figure {
    p50: Duration,
    p99: Duration,
}

impl Figure {
    fn of(runs: usize, measure: impl Fn(usize) -> Result<Duration, Error>) -> Result<Self, Error> {
        let mut times = (0..runs.max(1))
            .map(measure)
            .collect::<Result<Vec<_>, _>>()?;
        times.sort_unstable();
        let part = |percent: usize| {
            let at = (times.len() - 1) * percent / 100;
            times.get(at).copied().unwrap_or_default()
        };
        Ok(Self {
            p50: part(50),
            p99: part(99),
        })
    }
}

fn timed<T>(call: impl FnOnce() -> Result<T, Error>) -> Result<Duration, Error> {
    let begin = Instant::now();
    call()?;
    Ok(begin.elapsed())
}

/// One of two goals that are next to each other.
fn near(number: usize) -> [f64; 7] {
    let mut goal = BENT.map(deg);
    let [first, ..] = &mut goal;
    *first += if number.is_multiple_of(2) { 0.005 } else { 0.0 };
    goal
}

/// From the call to the first reading of another commanded position: it includes one round trip.
fn first_set_point(arm: &Arm, goal: [f64; 7]) -> Result<Duration, Error> {
    let rest = arm.commanded()?;
    let begin = Instant::now();
    let handle = arm.ptp(goal).begin()?;
    while arm.commanded()? == rest && handle.outcome().is_none() {}
    let time = begin.elapsed();
    handle.wait()?;
    Ok(time)
}

/// The time of the call that cancels a motion.
fn cancelled(arm: &Arm, number: usize) -> Result<Duration, Error> {
    let mut goal = BENT.map(deg);
    let [first, ..] = &mut goal;
    *first += if number.is_multiple_of(2) { 0.5 } else { -0.5 };
    let handle = arm.ptp(goal).begin()?;
    let time = timed(|| {
        handle.cancel();
        Ok(())
    })?;
    handle.wait()?;
    Ok(time)
}

/// Measures while another thread plans lines of an arm.
fn beside_plans(
    arm: &Arm,
    measure: impl FnOnce() -> Result<Figure, Error>,
) -> Result<Figure, Error> {
    let goal = Pose::xyz(0.0, 0.1, 0.0) * arm.pose()?;
    let is_done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let planner = scope.spawn(|| {
            while !is_done.load(Ordering::Relaxed) {
                arm.lin(goal).plan()?;
            }
            Ok::<(), Error>(())
        });
        let figure = measure();
        is_done.store(true, Ordering::Relaxed);
        let planned = planner.join();
        planned.unwrap_or_else(|_| {
            Err(ErrorKind::Invalid("the planner panicked".to_owned()).into())
        })?;
        figure
    })
}
