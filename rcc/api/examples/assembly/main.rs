//! Two arms assemble a workpiece: the program in `program.rs` with its station, with and without blending. A table of its steps.
//! `cargo run -p takt-api --features embedded --example assembly`

#![expect(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "an example shows what it does"
)]

#[allow(dead_code, reason = "here no machine supervises the program")]
#[path = "program.rs"]
mod program;

use std::time::Duration;

use program::{Done, Order, Progress};
use takt_api::Cell;

fn main() -> Done {
    // Where the host stalls, the emulated arms stand still together.
    takt_api::simulate_time(1.0)?;
    // Each in a cell of its own: the boxes are on the platform again.
    let run = |is_stopping| {
        let order = Order {
            is_stopping,
            ..Order::default()
        };
        program::run(&Cell::emulated("assembly")?, order, &print)
    };
    let (blended, stopping) = (run(false)?, run(true)?);
    println!("step                   blended   stopping");
    for (step, other) in blended.iter().zip(&stopping) {
        let [with, without] = [step, other].map(|step| step.duration.as_secs_f64());
        println!("{:20} {with:7.2} s  {without:7.2} s", step.name);
    }
    let [with, without] = [blended, stopping].map(|steps| {
        let durations = steps.iter().map(|step| step.duration);
        durations.sum::<Duration>().as_secs_f64()
    });
    println!(
        "cycle {with:.1} s, {:.0} % of {without:.1} s without blending",
        100.0 * with / without
    );
    Ok(())
}

fn print(progress: Progress<'_>) {
    match progress {
        Progress::Begins(name) => eprintln!("{name}"),
        Progress::Ended(step) => {
            eprintln!("{:20} {:5.1} s", step.name, step.duration.as_secs_f64());
        }
        Progress::Note(text) => eprintln!("note: {text}"),
    }
}
