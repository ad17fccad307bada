//! Grippers.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use takt_api as api;

use crate::activity::Activity;
use crate::error;
use crate::expression::{Condition, Number};
use crate::owned::Owned;
use crate::wait::seconds;

/// A gripper of a cell.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Gripper(Owned<api::Gripper>);

impl Gripper {
    pub(crate) fn new(gripper: api::Gripper) -> Self {
        Self(Owned::new(gripper))
    }
}

#[pymethods]
impl Gripper {
    /// Its name in the cell.
    #[getter]
    fn name(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.0.get(py)?.name().to_owned())
    }

    /// Its device type.
    #[getter]
    fn kind(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.0.get(py)?.kind().to_owned())
    }

    /// The largest width, m; `None` if only the gripper itself knows it.
    #[getter]
    fn width_max(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        Ok(self.0.get(py)?.width_max())
    }

    /// The same gripper, slower.
    fn with_speed(&self, py: Python<'_>, factor: f64) -> PyResult<Self> {
        Ok(Self::new(self.0.get(py)?.clone().with_speed(factor)))
    }

    /// The same gripper with another time-out of its commands, s.
    fn with_timeout(&self, py: Python<'_>, timeout: f64) -> PyResult<Self> {
        let timeout = seconds(py, "timeout", timeout)?;
        Ok(Self::new(self.0.get(py)?.clone().with_timeout(timeout)))
    }

    /// Opens it wide.
    #[pyo3(signature = (**options))]
    fn open(&self, py: Python<'_>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Activity> {
        Activity::without_blend(py, self.0.get(py)?.open(), options)
    }

    /// Closes it without a part.
    #[pyo3(signature = (**options))]
    fn close(&self, py: Python<'_>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Activity> {
        Activity::without_blend(py, self.0.get(py)?.close(), options)
    }

    /// Moves the fingers to a width, m.
    #[pyo3(signature = (width, **options))]
    fn move_to(
        &self,
        py: Python<'_>,
        width: f64,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        Activity::without_blend(py, self.0.get(py)?.move_to(width), options)
    }

    /// Grips a part of a width, m, with at most a force, N.
    #[pyo3(signature = (width, force, **options))]
    fn grasp(
        &self,
        py: Python<'_>,
        width: f64,
        force: f64,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        Activity::without_blend(py, self.0.get(py)?.grasp(width, force), options)
    }

    /// The measured width, m.
    #[getter]
    fn width(&self, py: Python<'_>) -> PyResult<Number> {
        Ok(Number(self.0.get(py)?.width()))
    }

    /// The measured gripping force, N.
    #[getter]
    fn force(&self, py: Python<'_>) -> PyResult<Number> {
        let force = self.0.get(py)?.force();
        force
            .map(Number)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// Whether it holds a part.
    #[getter]
    fn holds(&self, py: Python<'_>) -> PyResult<Condition> {
        let holds = self.0.get(py)?.holds();
        holds
            .map(Condition)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// Requests that what the gripper does end, and everything that waits for it.
    fn cancel(&self, py: Python<'_>) -> PyResult<()> {
        let gripper = self.0.get(py)?;
        py.detach(|| gripper.cancel());
        Ok(())
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Gripper('{}')", self.name(py)?))
    }
}
