//! Objects that several arms hold.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use takt_api as api;

use crate::activity::Activity;
use crate::arm::{Arm, limits};
use crate::error;
use crate::owned::Owned;
use crate::pose;

/// An object that two or more arms hold.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Coupled(Owned<api::Coupled>);

/// Couples arms that hold an object: each arm keeps its flange where it is now in the object.
#[pyfunction]
pub(crate) fn coupled(object: &Bound<'_, PyAny>, arms: Vec<Bound<'_, Arm>>) -> PyResult<Coupled> {
    let py = object.py();
    let object = pose::read(object)?;
    let arms = arms.iter().map(|arm| arm.get().arm(py));
    // They hold the connection.
    let arms = Owned::new(arms.collect::<PyResult<Vec<_>>>()?);
    let held = arms.get(py)?;
    let coupled = py.detach(|| api::coupled(object, held));
    let coupled = coupled.map_err(|error| error::raise_here(py, &error))?;
    Ok(Coupled(Owned::new(coupled)))
}

#[pymethods]
impl Coupled {
    /// The same object, slower.
    fn with_speed(&self, py: Python<'_>, factor: f64) -> PyResult<Self> {
        let slower = self.0.get(py)?.clone().with_speed(factor);
        Ok(Self(Owned::new(slower)))
    }

    /// The same object with these limits on its motions.
    #[pyo3(signature = (**limits))]
    fn with_limits(&self, py: Python<'_>, limits: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let limits = self::limits(py, limits)?;
        let limited = self.0.get(py)?.clone().with_limits(limits);
        Ok(Self(Owned::new(limited)))
    }

    /// A motion of the object along a straight line to a pose in the world.
    #[pyo3(signature = (to, **options))]
    fn lin(
        &self,
        to: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = to.py();
        Activity::motion(py, self.0.get(py)?.lin(pose::read(to)?), options)
    }

    /// A motion of the object along the arc through `via` to `to`, both in the world.
    #[pyo3(signature = (via, to, **options))]
    fn circ(
        &self,
        via: &Bound<'_, PyAny>,
        to: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = to.py();
        Activity::motion(
            py,
            self.0.get(py)?.circ(pose::read(via)?, pose::read(to)?),
            options,
        )
    }

    /// A motion of the object along a smooth curve through 1 to 63 poses in the world.
    #[pyo3(signature = (through, **options))]
    fn spline(
        &self,
        through: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = through.py();
        Activity::motion(
            py,
            self.0.get(py)?.spline(pose::read_all(through)?),
            options,
        )
    }
}
