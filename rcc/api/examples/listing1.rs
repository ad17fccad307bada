//! Blending: an arm moves along a hexagon, with and without blending. A motion that blends is taken over on its way by the
//! next one, so that the arm rounds the corner and does not stop there.
//! `cargo run -p takt-api --features embedded --example listing1 -- [DIRECTORY]`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

mod chart;

use std::error::Error;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_api::{Activity, Arm, Cell, Handle, Outcome, Pose, deg};

const ROUNDS: usize = 2;

/// Some rounds of the hexagon.
pub(crate) struct Trace {
    /// How the motions ended, in order.
    pub(crate) outcomes: Vec<Outcome>,
    /// Smallest distance to the goal of each motion, m.
    pub(crate) misses: Vec<f64>,
    duration: Duration,
    /// Positions of the flange, m.
    path: Vec<[f64; 3]>,
}

fn main() -> Result<(), Box<dyn Error>> {
    run(&chart::directory()).map(drop)
}

/// Runs both traces, prints the table and draws the paths; returns the trace with blending and the one without.
pub(crate) fn run(directory: &Path) -> Result<[Trace; 2], Box<dyn Error>> {
    let cell = Cell::emulated("two_lwr")?;
    let robot = cell.arm("left")?;
    robot
        .ptp([0.0, 30.0, 0.0, -70.0, 0.0, 45.0, 0.0].map(deg))
        .run()?;
    let a = robot.pose()?;
    let corner = |y: f64, z: f64| Pose::xyz(0.0, y, z) * a;
    let corners = [
        ("B", corner(0.06, -0.1)),
        ("C", corner(0.18, -0.1)),
        ("D", corner(0.24, 0.0)),
        ("E", corner(0.18, 0.1)),
        ("F", corner(0.06, 0.1)),
        ("A", a),
    ];

    let blended = trace(&robot, &corners, |motion| motion.blend(0.8))?;
    let stopping = trace(&robot, &corners, |motion| motion)?;

    println!("            with blending         without");
    println!("motion      outcome      off      outcome      off");
    for (number, (with, without)) in blended.rows().zip(stopping.rows()).enumerate() {
        let name = corners
            .get(number % corners.len())
            .map_or("", |corner| corner.0);
        println!("{:2} to {name}     {with}   {without}", number + 1);
    }
    let [with, without] = [&blended, &stopping].map(|trace| trace.duration.as_secs_f64());
    println!(
        "duration    {with:.2} s               {without:.2} s: {:.0} %",
        100.0 * with / without
    );

    let plane = |trace: &Trace| trace.path.iter().map(|[_, y, z]| [*y, *z]).collect();
    let curves = [
        ("without", plane(&stopping)),
        ("with blending", plane(&blended)),
    ];
    chart::draw(
        &directory.join("listing1.svg"),
        "The hexagon A to F in the plane y, z",
        &curves,
    )?;
    Ok([blended, stopping])
}

/// A moment, and where the flange was then, m.
type Sample = (Instant, [f64; 3]);

/// Moves along the hexagon, and records where the flange is meanwhile.
fn trace(
    robot: &Arm,
    corners: &[(&str, Pose)],
    blend: impl Fn(Activity) -> Activity,
) -> Result<Trace, Box<dyn Error>> {
    let is_done = AtomicBool::new(false);
    let begin = Instant::now();
    let (motions, samples) = std::thread::scope(|scope| {
        let recorder = scope.spawn(|| record(robot, &is_done));
        let motions = rounds(robot, corners, blend);
        is_done.store(true, Ordering::Relaxed);
        (motions, recorder.join())
    });
    let duration = begin.elapsed();
    let (motions, samples) = (motions?, samples.map_err(|_| "the recorder failed")??);

    let handles = motions.iter().map(|(_, handle)| handle);
    let outcomes = handles.map(Handle::wait).collect::<Result<_, _>>()?;
    let goals = corners.iter().map(|(_, goal)| goal.position());
    // The corner lies between the begin of a motion and that of the second one after it.
    let ends = motions.iter().skip(2).map(|(begun, _)| Some(*begun));
    let spans = motions.iter().zip(ends.chain([None, None]));
    let misses = spans.zip(goals.cycle()).map(|(((begun, _), end), goal)| {
        let is_in = |at: Instant| at >= *begun && end.is_none_or(|end| at < end);
        let near = samples.iter().filter(|(at, _)| is_in(*at));
        near.map(|(_, place)| distance(place, &goal))
            .fold(f64::INFINITY, f64::min)
    });
    let misses = misses.collect();
    let path = samples.iter().map(|(_, place)| *place).collect();
    Ok(Trace {
        outcomes,
        misses,
        duration,
        path,
    })
}

/// Listing 1: the program is one motion ahead of the arm, since `begin` returns when the motion runs.
fn rounds(
    robot: &Arm,
    corners: &[(&str, Pose)],
    blend: impl Fn(Activity) -> Activity,
) -> Result<Vec<(Instant, Handle)>, takt_api::Error> {
    let mut motions = Vec::new();
    for _ in 0..ROUNDS {
        for (_, corner) in corners {
            let handle = blend(robot.lin(*corner)).begin()?;
            motions.push((Instant::now(), handle));
        }
    }
    robot.finish()?;
    Ok(motions)
}

fn record(robot: &Arm, is_done: &AtomicBool) -> Result<Vec<Sample>, takt_api::Error> {
    let mut samples = Vec::new();
    while !is_done.load(Ordering::Relaxed) {
        let place = robot.pose()?.position();
        samples.push((Instant::now(), place));
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(samples)
}

fn distance(from: &[f64; 3], to: &[f64; 3]) -> f64 {
    let parts = from.iter().zip(to);
    let squares = parts.map(|(from, to)| (from - to).powi(2));
    squares.sum::<f64>().sqrt()
}

impl Trace {
    fn rows(&self) -> impl Iterator<Item = String> {
        let rows = self.outcomes.iter().zip(&self.misses);
        rows.map(|(outcome, miss)| format!("{:9}  {:5.1} mm", format!("{outcome:?}"), miss * 1e3))
    }
}
