//! Device primitives, one file per interface. They access only the image; drivers are
//! in the module `device`.

mod cartesian_position;
mod io;
mod lwr;
mod order;
mod robot_arm;
mod robot_base;
mod youbot;

use takt_net::Definition;

/// All definitions of this crate.
pub(crate) fn all() -> Vec<Definition> {
    let mut all = robot_arm::table();
    all.extend(robot_base::table());
    all.extend(cartesian_position::table());
    all.extend(io::table());
    all.extend(lwr::table());
    all.extend(youbot::table());
    all
}

/// Values of `outError` that primitives set themselves; drivers have others.
mod error {
    /// Another primitive of the net commands the same in this cycle.
    pub(super) const CONCURRENT: i32 = -1;
    /// The value is out of range.
    pub(super) const RANGE: i32 = 1;
    /// The value is not a number.
    pub(super) const INVALID: i32 = 2;
}

/// The first of these errors that is set: concurrent access, the device's own, the value's.
const fn first_error(concurrent: bool, device: i32, value: i32) -> i32 {
    match (concurrent, device) {
        (true, _) => error::CONCURRENT,
        (false, 0) => value,
        (false, device) => device,
    }
}
