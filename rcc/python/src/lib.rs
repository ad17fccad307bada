#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]

mod activity;
mod arm;
mod arrays;
mod base;
mod cell;
mod compose;
mod control;
mod coupled;
mod dispatch;
mod error;
mod explain;
mod expression;
#[cfg(feature = "fleet")]
mod fleet;
mod frame;
mod gripper;
mod handle;
mod io;
mod keywords;
mod listener;
mod live;
mod moving;
mod outcome;
mod owned;
mod place;
mod plan;
mod pose;
mod prepared;
mod wait;

/// Native part of the package `takt`.
#[pyo3::pymodule(name = "_takt")]
mod native {
    #[pymodule_export]
    use super::activity::Activity;
    #[pymodule_export]
    use super::arm::{Arm, Force, JointLimits};
    #[pymodule_export]
    use super::base::Base;
    #[pymodule_export]
    use super::cell::{Cell, connect};
    #[cfg(feature = "embedded")]
    #[pymodule_export]
    use super::cell::{embed, emulate, simulate_time};
    #[pymodule_export]
    use super::compose::{Composite, Event, Waiting, either, together, when};
    #[pymodule_export]
    use super::control::Control;
    #[pymodule_export]
    use super::coupled::{Coupled, coupled};
    #[pymodule_export]
    use super::explain::{Cost, Explanation};
    #[pymodule_export]
    use super::expression::{Condition, Number};
    #[cfg(feature = "fleet")]
    #[pymodule_export]
    use super::fleet::{Fleet, fleet};
    #[pymodule_export]
    use super::frame::{Direction, Frame, Goal};
    #[pymodule_export]
    use super::gripper::Gripper;
    #[pymodule_export]
    use super::handle::Handle;
    #[pymodule_export]
    use super::io::{Io, IoState};
    #[pymodule_export]
    use super::listener::Listener;
    #[pymodule_export]
    use super::live::{Live, LiveHandle, Twist};
    #[pymodule_export]
    use super::moving::MovingFrame;
    #[pymodule_export]
    use super::outcome::Outcome;
    #[pymodule_export]
    use super::plan::Plan;
    #[pymodule_export]
    use super::pose::{Pose, deg};
    #[pymodule_export]
    use super::prepared::Prepared;
}
