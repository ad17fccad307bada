//! The first program: one emulated arm moves, and nothing else is needed.
//! `cargo run -p takt-api --features embedded --example first`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use takt_api::{Cell, Error, deg};

/// Moves one arm.
pub(crate) fn main() -> Result<(), Error> {
    let cell = Cell::emulated("two_lwr")?;
    let left = cell.arm("left")?;
    let goal = [0.0, 30.0, 0.0, -70.0, 0.0, 45.0, 0.0].map(deg);
    let outcome = left.ptp(goal).speed(0.5).run()?;
    println!("{outcome:?} at {:.3?} rad", left.commanded()?);
    Ok(())
}
