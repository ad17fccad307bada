//! A frame that moves: the right arm keeps 10 cm beside the flange of the left one, which draws an arc. A table of how far
//! it is behind, and a picture of both paths.
//! `cargo run -p takt-api --features embedded --example follow -- [DIRECTORY]`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

mod chart;

use std::error::Error;
use std::path::Path;

use takt_api::{Cell, Outcome, Pose};

const BENT: [f64; 7] = [0.0, 0.6, 0.0, -1.2, 0.0, 0.9, 0.0];

/// A motion of the left arm.
pub(crate) struct Step {
    pub(crate) outcome: Outcome,
    /// The largest distance of the right arm from where it should be, m.
    pub(crate) most: f64,
    /// The one at the end.
    pub(crate) last: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    run(&chart::directory()).map(drop)
}

/// Follows two motions, prints the table and draws the paths.
pub(crate) fn run(directory: &Path) -> Result<(Vec<Step>, Outcome), Box<dyn Error>> {
    let cell = Cell::emulated("two_lwr")?;
    // Both bases are at the origin of the world.
    let [left, right] = [cell.arm("left")?, cell.arm("right")?];
    let [left, right] = [left, right].map(|arm| arm.with_base(Pose::IDENTITY));
    takt_api::together([left.ptp(BENT), right.ptp(BENT)]).run()?;
    let start = left.pose()?;
    let beside = Pose::xyz(0.0, 0.1, 0.0);
    let follow = right.follow(&left.centre().pose(beside)).begin()?;
    println!("the right arm has come to its frame: {:?}", follow.wait()?);
    let side = Pose::xyz(0.0, 0.15, 0.0) * start;
    let over = Pose::xyz(0.0, 0.075, 0.075) * start;
    let motions = [("arc", left.circ(over, side)), ("line", left.lin(start))];
    let mut steps = Vec::new();
    let mut paths = [Vec::new(), Vec::new()];
    println!("motion  outcome    most behind / mm  at rest / mm");
    for (name, motion) in motions {
        let motion = motion.begin()?;
        let mut behind = Vec::new();
        let mut rested = 0;
        while rested < 20 {
            let (goal, at) = (left.pose()? * beside, right.pose()?);
            let [x, y, z] = (goal.inverse() * at).position();
            behind.push(x.hypot(y).hypot(z));
            for (path, pose) in paths.iter_mut().zip([goal, at]) {
                let [_, y, z] = pose.position();
                path.push([y, z]);
            }
            rested += usize::from(motion.outcome().is_some());
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        let step = Step {
            outcome: motion.wait()?,
            most: behind.iter().copied().fold(0.0, f64::max),
            last: behind.last().copied().unwrap_or_default(),
        };
        let text = format!("{:?}", step.outcome);
        let [most, last] = [step.most, step.last].map(|distance| distance * 1e3);
        println!("{name:6}  {text:9}  {most:16.1}  {last:12.2}");
        steps.push(step);
    }
    right.cancel();
    let outcome = follow.wait_to_end()?;
    println!("following ended: {outcome:?}");
    let [goals, flange] = paths;
    let curves = [("frame", goals), ("right flange", flange)];
    let title = "The frame and the right flange, in the plane y, z";
    chart::draw(&directory.join("follow.svg"), title, &curves)?;
    cell.close()?;
    Ok((steps, outcome))
}
