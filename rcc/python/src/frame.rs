//! Frames of a cell, and poses in them.

use pyo3::prelude::*;
use takt_api as api;

use crate::error;
use crate::pose::{self, Pose};

/// A named frame of a cell.
#[pyclass(frozen, eq, module = "takt")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame(pub(crate) api::Frame);

#[pymethods]
impl Frame {
    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        self.0.name()
    }

    /// The frame in which it is placed in the end.
    #[getter]
    fn root(&self) -> &str {
        self.0.root()
    }

    /// A pose in this frame, as a goal.
    fn pose(&self, pose: &Bound<'_, PyAny>) -> PyResult<Goal> {
        Ok(Goal(self.0.pose(pose::read(pose)?)))
    }

    /// A direction along the axes of this frame.
    fn direction(&self, direction: [f64; 3]) -> Direction {
        Direction(self.0.direction(direction))
    }

    /// Its pose in another frame.
    fn within(&self, py: Python<'_>, other: &Bound<'_, Self>) -> PyResult<Pose> {
        let pose = self.0.within(&other.get().0);
        pose.map(Pose)
            .map_err(|error| error::raise_here(py, &error))
    }

    fn __repr__(&self) -> String {
        format!("Frame('{}', in '{}')", self.0.name(), self.0.root())
    }
}

/// A pose in a frame.
#[pyclass(frozen, eq, module = "takt")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Goal(pub(crate) api::Goal);

/// Reads a goal, or whatever stands for a pose.
pub(crate) fn goal(value: &Bound<'_, PyAny>) -> PyResult<api::Goal> {
    if let Ok(goal) = value.cast::<Goal>() {
        return Ok(goal.get().0.clone());
    }
    pose::read(value).map(Into::into)
}

/// Reads several of them.
pub(crate) fn goals(value: &Bound<'_, PyAny>) -> PyResult<Vec<api::Goal>> {
    value.try_iter()?.map(|value| goal(&value?)).collect()
}

/// The direction of a force.
#[pyclass(frozen, eq, module = "takt")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Direction(pub(crate) api::Direction);

#[pymethods]
impl Direction {
    /// A direction along the axes of the motion centre, with which it turns.
    #[staticmethod]
    const fn of_centre(direction: [f64; 3]) -> Self {
        Self(api::Direction::of_centre(direction))
    }
}

/// Reads a direction, or three coordinates in the base of the arm.
pub(crate) fn direction(value: &Bound<'_, PyAny>) -> PyResult<api::Direction> {
    if let Ok(direction) = value.cast::<Direction>() {
        return Ok(direction.get().0.clone());
    }
    Ok(value.extract::<[f64; 3]>()?.into())
}
