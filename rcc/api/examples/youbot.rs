//! A KUKA youBot drives to a place, grips there and comes back; the arm bends while the base drives, in one call. The robot
//! searches its stops first, which takes seconds.
//! `cargo run -p takt-api --features embedded --example youbot`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use std::time::Duration;

use takt_api::{Cell, Composite, Error, Outcome, Pose, together};

const CANDLE: [f64; 5] = [0.0; 5];
const BENT: [f64; 5] = [0.0, 0.9, 0.6, 0.7, 0.0];

/// A step.
pub(crate) struct Step {
    /// How it ended.
    pub(crate) outcome: Outcome,
    /// Where the base is then, m from where it began.
    pub(crate) at: [f64; 2],
    /// How far the fingers are apart then, m.
    pub(crate) width: f64,
}

fn main() -> Result<(), Error> {
    run().map(drop)
}

/// Drives, grips and comes back, and prints the table.
pub(crate) fn run() -> Result<Vec<Step>, Error> {
    let cell = Cell::emulated("factory")?;
    let (base, arm, hand) = (cell.base("base")?, cell.arm("arm")?, cell.gripper("hand")?);
    let home = base.pose()?;
    let there = home * Pose::xyz(0.3, 0.1, 0.0).abc(0.4, 0.0, 0.0);
    let back = Duration::from_millis(500);
    let motions: [(&str, Composite); 6] = [
        (
            "drive and bend",
            together([base.go_to(there), arm.ptp(BENT), hand.open()]),
        ),
        ("grip", hand.move_to(0.005).into()),
        ("lift", arm.ptp(CANDLE).speed(0.5).into()),
        ("back off", base.drive([-0.1, 0.0, 0.0], back).into()),
        ("drive home", base.go_to(home).into()),
        ("release", hand.open().into()),
    ];
    let mut steps = Vec::new();
    println!("step            outcome        x / m   y / m  fingers / mm");
    for (name, motion) in motions {
        let outcome = motion.run()?;
        let [x, y, _] = (home.inverse() * base.pose()?).position();
        let step = Step {
            outcome,
            at: [x, y],
            width: cell.value(&hand.width())?.unwrap_or(f64::NAN),
        };
        let (ended, fingers) = (format!("{:?}", step.outcome), step.width * 1e3);
        let [x, y] = step.at;
        println!("{name:14}  {ended:11}  {x:7.3} {y:7.3}  {fingers:12.1}");
        steps.push(step);
    }
    Ok(steps)
}
