//! The first program of the README and that of the tutorial, as they stand there, on emulated arms.

#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::wildcard_enum_match_arm,
    reason = "a test, and programs as a reader writes them"
)]

use takt_api::{Cell, Error, Outcome, Pose, deg, together};
use takt_tests::steady;

fn program(cell: &Cell) -> Result<(), Error> {
    let (left, right) = (cell.arm("left")?, cell.arm("right")?);

    left.ptp([0.0, deg(30.0), 0.0, deg(-70.0), 0.0, deg(45.0), 0.0])
        .speed(0.3)
        .run()?;
    let a = left.pose()?; // of the flange, in the base of the arm
    let (c, e) = (Pose::xyz(0.0, 0.1, -0.1) * a, Pose::xyz(0.0, 0.2, 0.0) * a);
    for _ in 0..3 {
        let _ = left.lin(c).blend(0.8).begin()?; // returns when it runs: one motion ahead
        let _ = left.lin(e).blend(0.8).begin()?;
    }
    left.finish()?;

    let touch = left.force().z().abs().over(5.0);
    match left.lin(a).speed(0.5).until("touch", touch).run()? {
        Outcome::Stopped(by) => println!("stopped by {by}"),
        other => println!("{other:?}"),
    }
    together([left.ptp([0.0; 7]), right.ptp([0.0; 7])]).run()?;
    Ok(())
}

fn tutorial() -> Result<(), Error> {
    let cell = Cell::emulated("two_lwr")?;
    let left = cell.arm("left")?;
    let bent = [0.0, 30.0, 0.0, -70.0, 0.0, 45.0, 0.0].map(deg);
    println!("{:?}", left.ptp(bent).speed(0.5).run()?);
    let start = left.pose()?;
    let side = Pose::xyz(0.0, 0.1, 0.0) * start;
    let _ = left.lin(side).blend(0.8).begin()?;
    left.lin(start).run()?;
    let turned = left.joint(0).over(0.2);
    let outcome = left.ptp([1.0, bent[1], 0.0, bent[3], 0.0, bent[5], 0.0]);
    println!("{:?}", outcome.until("turned", turned).run()?);
    cell.close()
}

/// A program without what formatting adds.
fn plain(text: &str) -> String {
    let text: String = text.split_whitespace().collect();
    text.replace(",]", "]").replace(",)", ")")
}

/// Checks that a document has a program of this file: the lines of its first block after one that contains `before`.
fn compare(document: &str, language: &str, before: &str) {
    let (_, block) = document.split_once(&format!("```{language}\n")).unwrap();
    let (block, _) = block.split_once("```").unwrap();
    let lines = block.lines().filter(|line| !line.starts_with("# "));
    let shown = lines.skip_while(|line| !line.contains(before)).skip(1);
    let shown = plain(&shown.collect::<Vec<_>>().join("\n"));
    assert!(shown.len() > 300, "{shown}");
    let run = plain(include_str!("readme.rs"));
    assert!(run.contains(&shown), "{shown}\n{run}");
}

#[test]
fn readme_program_is_the_one_that_runs() {
    compare(include_str!("../README.md"), "no_run", "Cell::connect");
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        program(&cell).unwrap();
        cell.close().unwrap();
    });
}

#[test]
fn tutorial_program_is_the_one_that_runs() {
    compare(include_str!("../../../docs/tutorial.md"), "rust", "fn main");
    steady(|| tutorial().unwrap());
}
