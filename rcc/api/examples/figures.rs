//! Figures of the API in one run, beside the round trip of the smallest request: preparing a motion, beginning what was
//! prepared, and cancelling and stopping while another thread plans.
//! `cargo run --release -p takt-api --features embedded --example figures -- [RUNS]`

#![expect(clippy::print_stdout, reason = "a table is all that it makes")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_api::{Arm, Cell, Error, ErrorKind, Pose, deg};
use takt_client::{Client, Value};

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

    let address = cell.embedded_address();
    let client = Client::connect(&address.map_or_else(String::new, |it| it.to_string()))?;
    let nothing = || Value::map_of::<String, Value>([]);
    let trip = Figure::of(runs, |_| timed(|| Ok(client.call("snc", [nothing()])?)))?;
    let prepare = Figure::of(runs, |number| {
        let mut prepared = None;
        let motion = left.ptp(near(number));
        let time = timed(|| motion.prepare().map(|it| prepared = Some(it)))?;
        prepared.map_or(Ok(()), |it| it.run().map(drop))?;
        Ok(time)
    })?;
    let runs_at = Figure::of(runs, |number| {
        begun(&left, near(number), |begin, _| Ok(begin.elapsed()))
    })?;
    let begin = Figure::of(runs, |number| {
        let rest = left.commanded()?;
        begun(&left, near(number), |begin, is_over| {
            while left.commanded()? == rest && !is_over() {}
            Ok(begin.elapsed())
        })
    })?;
    let cancel = Figure::of(runs, |number| cancelled(&left, number))?;
    let beside = beside_plans(&right, || {
        Figure::of(runs, |number| cancelled(&left, number))
    })?;
    let stop = beside_plans(&right, || {
        Figure::of(runs, |_| {
            let held = left.hold().begin()?;
            let time = timed(|| cell.stop())?;
            held.wait()?;
            Ok(time)
        })
    })?;

    let period_ms = left.description().period.as_secs_f64() * 1e3;
    println!("period of the arm: {period_ms:.1} ms; {runs} runs");
    println!(
        "                                     p50         p99         p50 / round trip  periods beyond it"
    );
    for (name, figure) in [
        ("round trip of an empty request", &trip),
        ("preparing a PTP", &prepare),
        ("prepared: begin until it runs", &runs_at),
        ("prepared: begin to a read set-point", &begin),
        ("cancel", &cancel),
        ("cancel while another thread plans", &beside),
        ("stop while another thread plans", &stop),
    ] {
        let [p50, p99] = [figure.p50, figure.p99].map(|time| time.as_secs_f64() * 1e3);
        let trip_ms = trip.p50.as_secs_f64() * 1e3;
        let (ratio, beyond) = (p50 / trip_ms, (p50 - trip_ms) / period_ms);
        println!("{name:35} {p50:8.3} ms {p99:8.3} ms {ratio:10.2} {beyond:15.2}");
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

/// Prepares a motion, begins it, and measures from the call of `begin` on; `measure` also learns whether the motion has ended.
/// When `begin` returns, the net has run: its first set-point was before that.
fn begun(
    arm: &Arm,
    goal: [f64; 7],
    measure: impl FnOnce(Instant, &dyn Fn() -> bool) -> Result<Duration, Error>,
) -> Result<Duration, Error> {
    let prepared = arm.ptp(goal).prepare()?;
    let begin = Instant::now();
    let handle = prepared.begin()?;
    let time = measure(begin, &|| handle.outcome().is_some())?;
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
