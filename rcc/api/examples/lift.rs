//! Two arms lift a box. They reach it together, and hold it from then on as one: the arms keep their grasp on the whole
//! path, also if they must brake.
//! `cargo run -p takt-api --features embedded --example lift -- [DIRECTORY]`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

mod chart;

use std::error::Error;
use std::path::Path;
use std::time::Duration;

use takt_api::{Arm, Cell, Outcome, Plan, Pose, coupled, deg, together};

/// How far the arms are from the box before they reach it, m.
const GAP: f64 = 0.04;

/// A motion of the box.
pub(crate) struct Step {
    name: &'static str,
    duration: Duration,
    /// How it ended.
    pub(crate) outcome: Outcome,
    /// Largest deviation of the grasp along the planned path, m.
    pub(crate) planned: f64,
    /// Deviation of the grasp afterwards, m.
    pub(crate) rested: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    run(&chart::directory()).map(drop)
}

/// Lifts the box and puts it back, prints the table and draws the paths.
pub(crate) fn run(directory: &Path) -> Result<Vec<Step>, Box<dyn Error>> {
    let cell = Cell::emulated("two_lwr")?;
    let arms = [
        cell.arm("left")?
            .with_base(Pose::xyz(0.0, 0.3, 0.0).abc(-0.2, 0.0, 0.0)),
        cell.arm("right")?
            .with_base(Pose::xyz(0.0, -0.3, 0.0).abc(0.2, 0.0, 0.0)),
    ];
    let bent = [0.0, 34.0, 0.0, -63.0, 0.0, 40.0, 0.0].map(deg);
    together(arms.each_ref().map(|arm| arm.ptp(bent))).run()?;

    // From both sides to the box, beginning in one cycle.
    let [left, right] = &arms;
    let reach = [(left, -GAP), (right, GAP)].map(|(arm, y)| side(arm, y));
    let reach = reach.into_iter().collect::<Result<Vec<_>, _>>()?;
    together(reach).run()?;

    // Measured positions follow the set-points some cycles later.
    std::thread::sleep(Duration::from_millis(100));
    let grasp = grasp(&arms)?;
    let [x, y, z] = middle(&arms)?;
    let table = Pose::xyz(x, y, z);
    let held = coupled(table, &arms)?.with_speed(0.4);
    let above = Pose::xyz(0.0, 0.0, 0.1) * table;
    let aside = Pose::xyz(0.05, 0.0, 0.0) * above * Pose::IDENTITY.abc(0.1, 0.0, 0.0);

    let mut steps = Vec::new();
    let mut paths = [Vec::new(), Vec::new()];
    let motions = [
        ("lift", above),
        ("carry", aside),
        ("return", above),
        ("put down", table),
    ];
    for (name, goal) in motions {
        let motion = held.lin(goal);
        let plan = motion.plan()?;
        let planned = follow(&plan, &arms, &grasp, &mut paths);
        let outcome = motion.run()?;
        let rested = deviation(&self::grasp(&arms)?, &grasp);
        steps.push(Step {
            name,
            duration: plan.duration(),
            outcome,
            planned,
            rested,
        });
    }
    together([side(left, GAP)?, side(right, -GAP)?]).run()?;

    println!("box         planned  outcome      grasp on the path  afterwards");
    for Step {
        name,
        duration,
        outcome,
        planned,
        rested,
    } in &steps
    {
        let (duration, outcome) = (duration.as_secs_f64(), format!("{outcome:?}"));
        let [planned, rested] = [planned, rested].map(|deviation| deviation * 1e3);
        println!("{name:10} {duration:6.2} s  {outcome:11}  {planned:13.4} mm  {rested:7.4} mm");
    }
    let [left, right] = paths;
    let curves = [("left flange", left), ("right flange", right)];
    chart::draw(
        &directory.join("lift.svg"),
        "Flanges of both arms in the plane y, z",
        &curves,
    )?;
    Ok(steps)
}

/// A motion along y of the world, m.
fn side(arm: &Arm, y: f64) -> Result<takt_api::Activity, takt_api::Error> {
    let base = arm.base();
    Ok(arm.lin(base.inverse() * Pose::xyz(0.0, y, 0.0) * base * arm.pose()?))
}

/// The flange of the right arm in that of the left arm, both at rest.
fn grasp([left, right]: &[Arm; 2]) -> Result<Pose, takt_api::Error> {
    let (left, right) = (left.base() * left.pose()?, right.base() * right.pose()?);
    Ok(left.inverse() * right)
}

/// The place in the middle of both flanges, m in the world.
fn middle([left, right]: &[Arm; 2]) -> Result<[f64; 3], takt_api::Error> {
    let (left, right) = (left.base() * left.pose()?, right.base() * right.pose()?);
    let ([a, b, c], [d, e, f]) = (left.position(), right.position());
    Ok([(a + d) / 2.0, (b + e) / 2.0, (c + f) / 2.0])
}

fn deviation(grasp: &Pose, of: &Pose) -> f64 {
    let [x, y, z] = (of.inverse() * *grasp).position();
    x.hypot(y).hypot(z)
}

/// Appends the planned paths of both flanges, and returns the largest deviation of the grasp on them, m.
fn follow(
    plan: &Plan,
    [left, right]: &[Arm; 2],
    grasp: &Pose,
    paths: &mut [Vec<[f64; 2]>; 2],
) -> f64 {
    let mut largest = 0.0_f64;
    let step = Duration::from_millis(20);
    let times = (0..)
        .map(|number| step * number)
        .take_while(|time| *time < plan.duration() + step);
    for time in times {
        let partner = plan.partners().first().and_then(|plan| plan.pose(time));
        let (Some(first), Some(second)) = (plan.pose(time), partner) else {
            return f64::INFINITY;
        };
        let flanges = [left.base() * first, right.base() * second];
        for (path, flange) in paths.iter_mut().zip(&flanges) {
            let [_, y, z] = flange.position();
            path.push([y, z]);
        }
        let [first, second] = flanges;
        largest = largest.max(deviation(&(first.inverse() * second), grasp));
    }
    largest
}
