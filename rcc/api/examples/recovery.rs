//! Errors and recovery: what cannot be done is an error with its values, the arm is at rest, and the program goes on.
//! `cargo run -p takt-api --features embedded --example recovery -- [DIRECTORY]`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use std::fmt::Write as _;
use std::path::PathBuf;

use takt_api::{Activity, Arm, Cell, Error, ErrorKind, Outcome, Pose, deg, either};

/// What went wrong, and how the program went on.
pub(crate) struct Attempt {
    name: &'static str,
    /// The error.
    pub(crate) error: Error,
    /// How far the flange is from where it began, m, when the error is known.
    pub(crate) moved: f64,
    /// How the motion back to the start ended.
    pub(crate) recovered: Outcome,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let directory = std::env::args_os()
        .nth(1)
        .map_or_else(std::env::temp_dir, PathBuf::from);
    let attempts = run()?;
    let mut table = "attempt                  error        moved     recovered\n".to_owned();
    for Attempt {
        name,
        error,
        moved,
        recovered,
    } in &attempts
    {
        let moved = moved * 1e3;
        writeln!(
            table,
            "{name:24} {:12} {moved:5.1} mm  {recovered:?}",
            kind(error)
        )?;
    }
    for Attempt { name, error, .. } in &attempts {
        writeln!(table, "\n{name}:\n{error}")?;
    }
    print!("{table}");
    let path = directory.join("recovery.txt");
    std::fs::write(&path, table).map_err(|error| format!("{}: {error}", path.display()))?;
    println!("\ntable: {}", path.display());
    Ok(())
}

/// Tries what cannot be done, and goes on after each attempt.
pub(crate) fn run() -> Result<Vec<Attempt>, Error> {
    let cell = Cell::emulated("two_lwr")?;
    let robot = cell.arm("left")?;
    let bent = [0.0, 30.0, 0.0, -70.0, 0.0, 45.0, 0.0].map(deg);
    robot.ptp(bent).run()?;
    let start = robot.pose()?;
    let far = Pose::xyz(1.0, 0.0, 0.0) * start;
    let mut turned = bent;
    turned[0] = deg(200.0);
    let attempts = [
        ("six joints of seven", robot.ptp(&bent[..6])),
        ("a joint beyond its range", robot.ptp(turned)),
        ("one metre further", robot.lin(far)),
        ("the same, unchecked", robot.lin(far).unchecked()),
        ("four times as fast", robot.ptp([0.0; 7]).speed(4.0)),
    ];
    let mut done = Vec::new();
    for (name, attempt) in attempts {
        let Err(error) = attempt.run() else {
            return Err(ErrorKind::Invalid(format!("{name}: it was possible")).into());
        };
        let moved = (start.inverse() * robot.pose()?).position();
        let moved = moved.iter().map(|part| part * part).sum::<f64>().sqrt();
        let recovered = recover(&robot, robot.lin(far), &bent)?;
        done.push(Attempt {
            name,
            error,
            moved,
            recovered,
        });
    }
    Ok(done)
}

/// The first of two motions that is possible: the arm goes back to `home`.
fn recover(robot: &Arm, impossible: Activity, home: &[f64]) -> Result<Outcome, Error> {
    either([impossible, robot.ptp(home)]).run()
}

/// Programs match errors, and have their values: a place, a joint, a limit.
fn kind(error: &Error) -> String {
    if let ErrorKind::Limit { value, max, .. } = &error.kind {
        return format!("{value:.1} > {max:.1}");
    }
    if let ErrorKind::Unreachable { progress, .. } = &error.kind {
        return format!("at {progress:.0} %");
    }
    "invalid".to_owned()
}
