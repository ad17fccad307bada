#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]

mod activity;
mod arm;
mod arrays;
mod cell;
mod dispatch;
mod error;
mod expression;
mod handle;
mod outcome;
mod owned;
mod place;
mod pose;
mod wait;

/// Native part of the package `takt`.
#[pyo3::pymodule(name = "_takt")]
mod native {
    #[pymodule_export]
    use super::activity::{Activity, Composite, either, together};
    #[pymodule_export]
    use super::arm::{Arm, Force, JointLimits};
    #[cfg(feature = "embedded")]
    #[pymodule_export]
    use super::cell::emulate;
    #[pymodule_export]
    use super::cell::{Cell, connect};
    #[pymodule_export]
    use super::expression::{Condition, Number};
    #[pymodule_export]
    use super::handle::Handle;
    #[pymodule_export]
    use super::outcome::Outcome;
    #[pymodule_export]
    use super::pose::{Pose, deg};
}
