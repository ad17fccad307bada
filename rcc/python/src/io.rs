//! Inputs and outputs of a device.

use pyo3::prelude::*;
use takt_api as api;

use crate::activity::Activity;
use crate::error;
use crate::expression::{Condition, Number};
use crate::owned::Owned;
use crate::wait::seconds;

/// Digital and analogue inputs and outputs of a device.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Io(Owned<api::Io>);

impl Io {
    pub(crate) fn new(io: api::Io) -> Self {
        Self(Owned::new(io))
    }

    fn port<T>(
        &self,
        py: Python<'_>,
        find: impl FnOnce(&api::Io) -> Result<T, api::Error>,
    ) -> PyResult<T> {
        find(self.0.get(py)?).map_err(|error| error::raise_here(py, &error))
    }
}

/// States of inputs and outputs, by ports; `None` where the device does not know one.
#[pyclass(frozen, get_all, eq, module = "takt")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct IoState {
    /// Digital inputs.
    digital_inputs: Vec<Option<bool>>,
    /// Digital outputs.
    digital_outputs: Vec<Option<bool>>,
    /// Analogue inputs, in the unit of the device.
    analogue_inputs: Vec<Option<f64>>,
    /// Analogue outputs, in the unit of the device.
    analogue_outputs: Vec<Option<f64>>,
}

#[pymethods]
impl Io {
    /// The name of the device.
    #[getter]
    fn name(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.0.get(py)?.name().to_owned())
    }

    /// Its device type.
    #[getter]
    fn kind(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.0.get(py)?.kind().to_owned())
    }

    /// The present states of all inputs and outputs.
    fn state(&self, py: Python<'_>) -> PyResult<IoState> {
        let io = self.0.get(py)?;
        let state = py.detach(|| io.state());
        let state = state.map_err(|error| error::raise_here(py, &error))?;
        Ok(IoState {
            digital_inputs: state.digital_inputs,
            digital_outputs: state.digital_outputs,
            analogue_inputs: state.analogue_inputs,
            analogue_outputs: state.analogue_outputs,
        })
    }

    /// A digital input.
    fn input(&self, py: Python<'_>, port: u32) -> PyResult<Condition> {
        self.port(py, |io| io.input(port)).map(Condition)
    }

    /// An analogue input, in the unit of the device.
    fn analogue_input(&self, py: Python<'_>, port: u32) -> PyResult<Number> {
        self.port(py, |io| io.analogue_input(port)).map(Number)
    }

    /// The present state of a digital output.
    fn output(&self, py: Python<'_>, port: u32) -> PyResult<Condition> {
        self.port(py, |io| io.output(port)).map(Condition)
    }

    /// The present value of an analogue output, in the unit of the device.
    fn analogue_output(&self, py: Python<'_>, port: u32) -> PyResult<Number> {
        self.port(py, |io| io.analogue_output(port)).map(Number)
    }

    /// Sets a digital output.
    fn set(&self, py: Python<'_>, port: u32, state: bool) -> PyResult<Activity> {
        let set = self.0.get(py)?.set(port, state);
        Activity::without_blend(py, set, None)
    }

    /// Sets a digital output for a time (s), and then to the contrary.
    fn pulse(&self, py: Python<'_>, port: u32, state: bool, duration: f64) -> PyResult<Activity> {
        let duration = seconds(py, "duration", duration)?;
        let pulse = self.0.get(py)?.pulse(port, state, duration);
        Activity::without_blend(py, pulse, None)
    }

    /// Sets an analogue output, in the unit of the device.
    fn set_analogue(&self, py: Python<'_>, port: u32, value: f64) -> PyResult<Activity> {
        let set = self.0.get(py)?.set_analogue(port, value);
        Activity::without_blend(py, set, None)
    }
}
