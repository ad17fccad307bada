//! `Motion::*`: motions with bounded velocity, acceleration and jerk. Their paths are fixed at load
//! time; progress along a path is a jerk-limited profile, so that the speed can be overridden and
//! the motion stopped without leaving the path. Not here: blending of two motions, and joint limits
//! along a Cartesian path.

mod cartesian;
mod limits;
mod path;
mod planner;
mod profile;
mod ptp;
mod runner;
#[cfg(test)]
mod tests;
mod track;

use takt_net::Definition;

use limits::{
    ACCELERATION, JERK, VELOCITY, is_sensible, joint_bounds, joint_positions, limit,
    with_joint_limits,
};

pub(crate) fn table() -> Vec<Definition> {
    vec![
        ptp::definition(),
        cartesian::lin(),
        cartesian::circ(),
        track::definition(),
    ]
}
