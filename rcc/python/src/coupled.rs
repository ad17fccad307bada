//! Objects that several arms hold.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use takt_api as api;

use crate::activity::{Activity, Options};
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
    #[pyo3(signature = (*, velocity=None, acceleration=None, jerk=None, rot_velocity=None, rot_acceleration=None, rot_jerk=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn with_limits(
        &self,
        py: Python<'_>,
        velocity: Option<f64>,
        acceleration: Option<f64>,
        jerk: Option<f64>,
        rot_velocity: Option<f64>,
        rot_acceleration: Option<f64>,
        rot_jerk: Option<f64>,
    ) -> PyResult<Self> {
        let limits = limits(
            py,
            [velocity, acceleration, jerk],
            [rot_velocity, rot_acceleration, rot_jerk],
        )?;
        let limited = self.0.get(py)?.clone().with_limits(limits);
        Ok(Self(Owned::new(limited)))
    }

    /// A motion of the object along a straight line to a pose in the world.
    #[pyo3(signature = (to, *, speed=None, blend=None, until=None, now=false))]
    fn lin(
        &self,
        to: &Bound<'_, PyAny>,
        speed: Option<f64>,
        blend: Option<f64>,
        until: Option<&Bound<'_, PyDict>>,
        now: bool,
    ) -> PyResult<Activity> {
        let py = to.py();
        let options = Options {
            speed,
            blend,
            until,
            now,
        };
        Activity::new(py, self.0.get(py)?.lin(pose::read(to)?), &options)
    }

    /// A motion of the object along the arc through `via` to `to`, both in the world.
    #[pyo3(signature = (via, to, *, speed=None, blend=None, until=None, now=false))]
    fn circ(
        &self,
        via: &Bound<'_, PyAny>,
        to: &Bound<'_, PyAny>,
        speed: Option<f64>,
        blend: Option<f64>,
        until: Option<&Bound<'_, PyDict>>,
        now: bool,
    ) -> PyResult<Activity> {
        let py = to.py();
        let options = Options {
            speed,
            blend,
            until,
            now,
        };
        Activity::new(
            py,
            self.0.get(py)?.circ(pose::read(via)?, pose::read(to)?),
            &options,
        )
    }

    /// A motion of the object along a smooth curve through 1 to 63 poses in the world.
    #[pyo3(signature = (through, *, speed=None, blend=None, until=None, now=false))]
    fn spline(
        &self,
        through: &Bound<'_, PyAny>,
        speed: Option<f64>,
        blend: Option<f64>,
        until: Option<&Bound<'_, PyDict>>,
        now: bool,
    ) -> PyResult<Activity> {
        let py = through.py();
        let options = Options {
            speed,
            blend,
            until,
            now,
        };
        Activity::new(
            py,
            self.0.get(py)?.spline(pose::read_all(through)?),
            &options,
        )
    }
}
