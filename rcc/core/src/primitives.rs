//! Device primitives, one file per interface. They access only the image; drivers are
//! in the module `device`.

mod cartesian_position;
mod error;
mod io;
mod lwr;
mod order;
mod robot_arm;
mod robot_base;
mod schunk_wsg;
mod youbot;

use error::first_error;
use takt_net::Definition;
use takt_net::set_points::{SetPointCounters, Withheld};

/// All definitions of this crate.
pub(crate) fn all() -> Vec<Definition> {
    let mut all = robot_arm::table();
    all.extend(robot_base::table());
    all.extend(cartesian_position::table());
    all.extend(io::table());
    all.extend(lwr::table());
    all.extend(schunk_wsg::table());
    all.extend(youbot::table());
    all
}

/// Counts what becomes of a set-point: the value that is to be reported, whether another primitive commands the same, the
/// device's error, and the value's. What a device with an error rejects is counted by its driver.
fn count(
    counters: &SetPointCounters,
    value: Option<f64>,
    concurrent: bool,
    device: i32,
    illegal: i32,
) {
    let why = match (value, concurrent, device, illegal) {
        (None, ..) => Withheld::Null,
        (Some(_), true, ..) => Withheld::Concurrent,
        (Some(_), false, 0, 0) => return counters.note_given(),
        (Some(_), false, 0, error::RANGE) => Withheld::Range,
        (Some(_), false, 0, _) => Withheld::NoNumber,
        (Some(_), false, ..) => return,
    };
    counters.note_withheld(why, value.unwrap_or(0.0));
}
