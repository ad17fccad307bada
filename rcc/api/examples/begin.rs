//! Measures `begin`: for each line that it reads, it begins a motion of an arm in place of the last one and prints how long
//! that took, us. Programs in other languages compare theirs, motion by motion.
//!
//! ```console
//! $ cargo run -p takt-api --example begin -- 127.0.0.1:8081 left
//! ```

use std::error::Error;
use std::io::{BufRead as _, Write as _};
use std::time::Instant;

use takt_api::Cell;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut argument = || arguments.next().ok_or("usage: begin ADDRESS ARM");
    let (address, name) = (argument()?, argument()?);
    let cell = Cell::connect(&address)?;
    let arm = cell.arm(&name)?;
    let goals = [0.1, -0.1].map(|first| [first, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0]);
    let mut goals = goals.into_iter().cycle();
    let mut out = std::io::stdout();
    for line in std::io::stdin().lock().lines() {
        line?;
        let Some(goal) = goals.next() else { break };
        let started = Instant::now();
        let handle = arm.ptp(goal).speed(0.2).now().begin()?;
        let us = started.elapsed().as_micros();
        writeln!(out, "{us}")?;
        out.flush()?;
        drop(handle);
    }
    cell.close()?;
    Ok(())
}
