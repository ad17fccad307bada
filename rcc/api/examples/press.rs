//! A force: the arm touches a table, presses on it with 20 N, and stops when the table vanishes. A table of the steps, and a
//! picture of the force and the height over time.
//! `cargo run -p takt-api --features embedded --example press -- [DIRECTORY]`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

mod chart;

use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

use takt_api::{Arm, Cell, Handle, Outcome, Pose};

/// The flange points down, 4 cm above the table.
const ABOVE: [f64; 7] = [0.0, 0.6, 0.0, -1.3, 0.0, 1.2416, 0.0];
/// Force, N.
const FORCE: f64 = 20.0;
/// How long it is held, s.
const HELD_S: f64 = 1.0;
/// Time between two readings.
const EVERY: Duration = Duration::from_millis(10);

/// A step of the program.
pub(crate) struct Step {
    pub(crate) outcome: Outcome,
    /// Force on the table at its end, N.
    pub(crate) force: f64,
    /// Height of the flange at its end, m.
    pub(crate) height: f64,
}

/// Readings over time as a picture has them: a decimetre is a second, and 10 N.
#[derive(Default)]
struct Readings {
    force: Vec<[f64; 2]>,
    height: Vec<[f64; 2]>,
}

impl Readings {
    /// Reads until the activity has ended, or for some time.
    fn during(
        &mut self,
        (cell, arm): (&Cell, &Arm),
        began: Instant,
        is_over: impl Fn() -> bool,
    ) -> Result<(), Box<dyn Error>> {
        while !is_over() {
            let time = began.elapsed().as_secs_f64() / 10.0;
            let force = cell.value(&arm.force().z())?.unwrap_or_default();
            self.force.push([time, force / 100.0]);
            self.height.push([time, arm.pose()?.position()[2]]);
            std::thread::sleep(EVERY);
        }
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    run(&chart::directory()).map(drop)
}

/// Touches, presses and stops; prints the table and draws the force.
pub(crate) fn run(directory: &Path) -> Result<Vec<Step>, Box<dyn Error>> {
    let cell = Cell::emulated("lwr_table")?;
    let arm = cell.arm("arm")?;
    let table = cell.frame("table")?;
    let floor = cell.io("arm")?;
    arm.ptp(ABOVE).run()?;
    let mut steps = Vec::new();
    println!("step      outcome              force / N  height / m");
    let mut note = |name: &str, outcome: Outcome| -> Result<(), Box<dyn Error>> {
        let step = Step {
            outcome,
            force: cell.value(&arm.force().z())?.unwrap_or_default(),
            height: arm.pose()?.position()[2],
        };
        let text = format!("{:?}", step.outcome);
        let (force, height) = (step.force, step.height);
        println!("{name:8}  {text:19}  {force:9.1}  {height:10.4}");
        steps.push(step);
        Ok(())
    };
    let here = arm.pose()?;
    let near = Pose::xyz(0.0, 0.0, 0.42 - here.position()[2]) * here;
    note("approach", arm.lin(near).run()?)?;
    let force = || arm.force().z();
    let vanished = force().under(2.0).after(force().over(10.0));
    let press = arm.press(table.direction([0.0, 0.0, -1.0]), FORCE);
    let press: Handle = press.until("vanished", vanished).begin()?;
    let (began, mut readings) = (Instant::now(), Readings::default());
    readings.during((&cell, &arm), began, || press.outcome().is_some())?;
    note("press", press.wait()?)?;
    let held = began.elapsed().as_secs_f64() + HELD_S;
    readings.during((&cell, &arm), began, || {
        began.elapsed().as_secs_f64() > held
    })?;
    note("hold", press.wait()?)?;
    // The digital output 0 takes the emulated table away.
    floor.set(0, true).run()?;
    note("vanish", press.wait_to_end()?)?;
    let end = began.elapsed().as_secs_f64() + 0.3;
    readings.during((&cell, &arm), began, || began.elapsed().as_secs_f64() > end)?;
    note("rest", arm.ptp(ABOVE).run()?)?;
    let curves = [
        ("force, 0.1 m: 10 N", readings.force),
        ("height", readings.height),
    ];
    let title = "Force and height over time, 0.1 m: 1 s";
    chart::draw(&directory.join("press.svg"), title, &curves)?;
    cell.close()?;
    Ok(steps)
}
