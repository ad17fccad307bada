//! Device primitives, one file per interface. They access only the image; drivers are
//! in the module `device`.

mod cartesian_position;
mod count;
mod error;
mod homing;
mod io;
mod lwr;
mod order;
mod robot_arm;
mod robot_base;
mod schunk_wsg;
mod youbot;

use count::count;
use error::first_error;
use takt_net::Definition;

/// All definitions of this crate.
pub(crate) fn all() -> Vec<Definition> {
    let mut all = robot_arm::table();
    all.extend(robot_base::table());
    all.extend(cartesian_position::table());
    all.extend(io::table());
    all.extend(homing::table());
    all.extend(lwr::table());
    all.extend(schunk_wsg::table());
    all.extend(youbot::table());
    all
}
