//! `Motion::*`: motions with bounded velocity, acceleration and jerk. Their paths are fixed at load
//! time; progress along a path is a jerk-limited profile, so that the speed can be overridden and
//! the motion stopped without leaving the path. A motion that begins in motion comes onto its path
//! from any state. Not here: joint limits along a Cartesian path in a cycle; plans check them.

mod bounds;
mod cartesian;
mod coast;
mod course;
mod frame_path;
mod lead;
mod limits;
pub mod live;
mod path;
pub mod plan;
mod planner;
mod profile;
mod ptp;
mod runner;
mod spline;
#[cfg(test)]
mod tests;
mod track;
pub mod trajectory;

use takt_net::Definition;

use limits::{
    ACCELERATION, JERK, VELOCITY, is_sensible, joint_bounds, joint_positions, limit, slowed, speed,
    with_joint_limits, with_speed,
};

pub(crate) fn table() -> Vec<Definition> {
    vec![
        ptp::definition(),
        cartesian::lin(),
        cartesian::circ(),
        cartesian::spline(),
        track::definition(),
        trajectory::definition(),
        coast::definition(),
    ]
}
