//! Plans of motions, as arrays.

use std::cell::RefCell;
use std::time::Duration;

use pyo3::prelude::*;
use takt_api as api;

use crate::arrays::array;
use crate::pose::Pose;
use crate::wait::seconds;

/// The motion of an arm, planned before anything is loaded.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Plan(pub(crate) api::Plan);

#[pymethods]
impl Plan {
    /// Name of the arm.
    #[getter]
    fn device(&self) -> &str {
        self.0.device()
    }

    /// The plans of the other arms that move with this one.
    #[getter]
    fn partners(&self) -> Vec<Self> {
        self.0.partners().iter().cloned().map(Self).collect()
    }

    /// Time from the start to rest at the goal, s.
    #[getter]
    fn duration(&self) -> f64 {
        self.0.duration().as_secs_f64()
    }

    /// Completed part of the path at a time (s) after the start, 0 to 1.
    fn progress(&self, py: Python<'_>, time: f64) -> PyResult<f64> {
        Ok(self.0.progress(seconds(py, "time", time)?))
    }

    /// Positions of the joints at a time (s) after the start, rad.
    fn positions<'py>(&self, py: Python<'py>, time: f64) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.positions(seconds(py, "time", time)?))
    }

    /// Velocities of the joints at a time (s) after the start, rad/s.
    fn velocities<'py>(&self, py: Python<'py>, time: f64) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.velocities(seconds(py, "time", time)?))
    }

    /// The pose of the flange at a time (s) after the start; `None` without a known model of the kinematics.
    fn pose(&self, py: Python<'_>, time: f64) -> PyResult<Option<Pose>> {
        Ok(self.0.pose(seconds(py, "time", time)?).map(Pose))
    }

    /// The first time (s) at which a condition over progress and joint positions holds.
    fn first(&self, condition: &Bound<'_, PyAny>) -> PyResult<Option<f64>> {
        let py = condition.py();
        let raised = RefCell::new(None);
        let holds = |progress: f64, joints: &[f64]| {
            let holds = array(py, joints.to_vec())
                .and_then(|joints| condition.call1((progress, joints)))
                .and_then(|holds| holds.is_truthy());
            // What it raises ends the search, and reaches the caller.
            holds.unwrap_or_else(|error| {
                raised.replace(Some(error));
                true
            })
        };
        let first = self.0.first(holds);
        raised
            .take()
            .map_or_else(|| Ok(first.map(|time: Duration| time.as_secs_f64())), Err)
    }

    /// A picture of joint positions and velocities over time, an SVG file.
    fn svg(&self) -> String {
        self.0.svg()
    }

    /// The joint positions at the goal, rad.
    fn end<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.end())
    }

    /// The motion by cycles of the net: times (s), progress (0 to 1), joint positions (rad).
    fn cycles<'py>(&self, py: Python<'py>) -> PyResult<[Bound<'py, PyAny>; 3]> {
        let (mut times, mut parts, mut joints) = (Vec::new(), Vec::new(), Vec::new());
        for (time, progress, positions) in self.0.cycles() {
            times.push(time.as_secs_f64());
            parts.push(progress);
            joints.push(positions);
        }
        Ok([array(py, times)?, array(py, parts)?, array(py, joints)?])
    }

    fn __repr__(&self) -> String {
        let (device, seconds) = (self.0.device(), self.0.duration().as_secs_f64());
        format!("Plan('{device}', {seconds:.3} s)")
    }
}
