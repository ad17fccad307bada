//! Mobile bases.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use takt_api as api;

use crate::activity::Activity;
use crate::error;
use crate::expression::Number;
use crate::moving::MovingFrame;
use crate::owned::Owned;
use crate::pose;
use crate::wait::seconds;

/// A mobile base of a cell.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Base(Owned<api::Base>);

impl Base {
    pub(crate) fn new(base: api::Base) -> Self {
        Self(Owned::new(base))
    }
}

#[pymethods]
impl Base {
    /// Its name in the cell.
    #[getter]
    fn name(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.0.get(py)?.name().to_owned())
    }

    /// Its largest speed, m/s, and rotational speed, rad/s.
    #[getter]
    fn limits(&self, py: Python<'_>) -> PyResult<(f64, f64)> {
        Ok(self.0.get(py)?.limits())
    }

    /// The same base, slower.
    fn with_speed(&self, py: Python<'_>, factor: f64) -> PyResult<Self> {
        Ok(Self::new(self.0.get(py)?.clone().with_speed(factor)))
    }

    /// Moves straight to a pose in the frame in which the base started.
    #[pyo3(signature = (pose, **options))]
    fn go_to(
        &self,
        pose: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = pose.py();
        let motion = self.0.get(py)?.go_to(pose::read(pose)?);
        Activity::without_blend(py, motion, options)
    }

    /// Moves at a velocity in its own frame for a time (s), and brakes to rest.
    #[pyo3(signature = (velocity, duration, **options))]
    fn drive(
        &self,
        py: Python<'_>,
        velocity: [f64; 3],
        duration: f64,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let duration = seconds(py, "duration", duration)?;
        let motion = self.0.get(py)?.drive(velocity, duration);
        Activity::without_blend(py, motion, options)
    }

    /// Itself as a frame that moves.
    fn centre(&self, py: Python<'_>) -> PyResult<MovingFrame> {
        let base = self.0.get(py)?;
        let frame = py.detach(|| base.centre());
        frame
            .map(MovingFrame)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// The measured pose in the frame in which the base started.
    fn pose(&self, py: Python<'_>) -> PyResult<pose::Pose> {
        let base = self.0.get(py)?;
        let measured = py.detach(|| base.pose());
        measured
            .map(pose::Pose)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// The measured angle of a wheel since the start, rad.
    fn wheel(&self, py: Python<'_>, wheel: usize) -> PyResult<Number> {
        Ok(Number(self.0.get(py)?.wheel(wheel)))
    }

    /// Requests that what the base does end, and everything that waits for it.
    fn cancel(&self, py: Python<'_>) -> PyResult<()> {
        let base = self.0.get(py)?;
        py.detach(|| base.cancel());
        Ok(())
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Base('{}')", self.name(py)?))
    }
}
