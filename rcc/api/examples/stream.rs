//! A goal that a program streams at 30 Hz, on a circle: how far the flange is behind it, as a table and a picture. One net
//! follows all the while; each goal takes effect in the cycle after it arrives.
//! `cargo run -p takt-api --features embedded --example stream -- [DIRECTORY]`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

mod chart;

use std::error::Error;
use std::f64::consts::TAU;
use std::path::Path;
use std::time::{Duration, Instant};

use takt_api::{Cell, Outcome, Pose};

/// Goals in a second.
const RATE: u32 = 30;
/// Goals of a turn.
const GOALS: u32 = 75;
/// Radius of the circle, m.
const RADIUS: f64 = 0.05;

/// One turn.
pub(crate) struct Turn {
    /// Mean distance from the goal when the next one is due, m.
    pub(crate) mean: f64,
    /// The largest one, m.
    pub(crate) most: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    run(&chart::directory()).map(drop)
}

/// Streams two turns, prints the table and draws the paths.
pub(crate) fn run(directory: &Path) -> Result<(Vec<Turn>, Outcome), Box<dyn Error>> {
    let cell = Cell::emulated("two_lwr")?;
    let robot = cell.arm("left")?;
    robot.ptp([0.0, 0.6, 0.0, -1.2, 0.0, 0.9, 0.0]).run()?;
    let start = robot.pose()?;
    let stream = robot.stream_poses().begin()?;
    let mut turns = Vec::new();
    let mut paths = [Vec::new(), Vec::new()];
    println!("turn  goals  mean behind / mm  most behind / mm");
    for number in 1..=2 {
        let mut behind = Vec::new();
        let began = Instant::now();
        for step in 0..GOALS {
            let angle = TAU * f64::from(step) / f64::from(GOALS);
            let (y, z) = (RADIUS * angle.sin(), RADIUS * (1.0 - angle.cos()));
            let goal = Pose::xyz(0.0, y, z) * start;
            stream.send(goal)?;
            let due = began + Duration::from_secs(1) * (step + 1) / RATE;
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            let ([x, y, z], [a, b, c]) = (robot.pose()?.position(), goal.position());
            behind.push((x - a).hypot(y - b).hypot(z - c));
            for (path, point) in paths.iter_mut().zip([[b, c], [y, z]]) {
                path.push(point);
            }
        }
        let mean = behind.iter().sum::<f64>() / f64::from(GOALS);
        let most = behind.iter().copied().fold(0.0, f64::max);
        let turn = Turn { mean, most };
        let [a, b] = [turn.mean, turn.most].map(|distance| distance * 1e3);
        println!("{number:4}  {GOALS:5}  {a:16.1}  {b:16.1}");
        turns.push(turn);
    }
    stream.cancel();
    let outcome = stream.wait()?;
    println!("the stream ended: {outcome:?}");
    let [goals, flange] = paths;
    let curves = [("goals", goals), ("flange", flange)];
    let title = "Goals at 30 Hz, and the flange, in the plane y, z";
    chart::draw(&directory.join("stream.svg"), title, &curves)?;
    Ok((turns, outcome))
}
