//! The primitives of devices, a file for each interface. They see the image only; drivers are
//! elsewhere.

mod robot_arm;

use takt_net::Definition;

/// All definitions of this crate.
pub(crate) fn all() -> Vec<Definition> {
    robot_arm::table()
}
