//! The cell of a controller.

use std::sync::atomic::{AtomicBool, Ordering};

use pyo3::prelude::*;
use takt_api as api;

use crate::arm::Arm;
use crate::base::Base;
use crate::error;
use crate::expression::{Condition, Number};
use crate::frame::Frame;
use crate::gripper::Gripper;
use crate::io::Io;
use crate::listener::Listener;
use crate::owned::Owned;
use crate::wait::call;

/// The controller of a cell.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Cell {
    cell: Owned<api::Cell>,
    is_closed: AtomicBool,
}

/// Connects to a controller.
#[pyfunction]
#[pyo3(signature = (address=None, token=None))]
pub(crate) fn connect(
    py: Python<'_>,
    address: Option<String>,
    token: Option<&str>,
) -> PyResult<Cell> {
    let token = token.map(api::Token::new).transpose();
    let token = token.map_err(|cause| error::invalid(py, cause.to_string()))?;
    let connect = move || match address {
        Some(address) => api::Cell::connect_with(&address, token.as_ref()),
        None => api::Cell::connect_here(token.as_ref()),
    };
    Cell::opened(py, call(py, connect)?)
}

/// Starts a controller with emulated robots inside of the program.
#[cfg(feature = "embedded")]
#[pyfunction]
pub(crate) fn emulate(py: Python<'_>, name: String) -> PyResult<Cell> {
    Cell::opened(py, call(py, move || api::Cell::emulated(&name))?)
}

/// Lets emulated cells of the program run in a time that waits for late threads.
#[cfg(feature = "embedded")]
#[pyfunction]
#[pyo3(signature = (real_time_factor=1.0))]
pub(crate) fn simulate_time(py: Python<'_>, real_time_factor: f64) -> PyResult<()> {
    call(py, move || api::simulate_time(real_time_factor))?
        .map_err(|error| error::raise_here(py, &error))
}

/// Starts the controller of a cell file inside of the program.
#[cfg(feature = "embedded")]
#[pyfunction]
pub(crate) fn embed(py: Python<'_>, path: std::path::PathBuf) -> PyResult<Cell> {
    Cell::opened(py, call(py, move || api::Cell::embedded(path))?)
}

impl Cell {
    pub(crate) fn opened(py: Python<'_>, cell: Result<api::Cell, api::Error>) -> PyResult<Self> {
        let cell = cell.map_err(|error| error::raise_here(py, &error))?;
        Ok(Self {
            cell: Owned::new(cell),
            is_closed: AtomicBool::new(false),
        })
    }

    fn open(&self, py: Python<'_>) -> PyResult<&api::Cell> {
        if self.is_closed.load(Ordering::Relaxed) {
            return Err(error::invalid(py, "the cell is closed"));
        }
        self.cell.get(py)
    }
}

#[pymethods]
impl Cell {
    /// An arm by its name.
    fn arm(&self, py: Python<'_>, name: &str) -> PyResult<Arm> {
        let cell = self.open(py)?;
        let arm = py.detach(|| cell.arm(name));
        arm.map(Arm::new)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// Inputs and outputs of a device.
    fn io(&self, py: Python<'_>, device: &str) -> PyResult<Io> {
        let cell = self.open(py)?;
        let io = py.detach(|| cell.io(device));
        io.map(Io::new)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// A gripper by its name.
    fn gripper(&self, py: Python<'_>, name: &str) -> PyResult<Gripper> {
        let cell = self.open(py)?;
        let gripper = py.detach(|| cell.gripper(name));
        gripper
            .map(Gripper::new)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// A mobile base by its name.
    fn base(&self, py: Python<'_>, name: &str) -> PyResult<Base> {
        let cell = self.open(py)?;
        let base = py.detach(|| cell.base(name));
        base.map(Base::new)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// A frame of the cell by its name.
    fn frame(&self, py: Python<'_>, name: &str) -> PyResult<Frame> {
        let cell = self.open(py)?;
        let frame = py.detach(|| cell.frame(name));
        frame
            .map(Frame)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// All frames of the cell, by their names.
    fn frames(&self, py: Python<'_>) -> PyResult<Vec<Frame>> {
        let cell = self.open(py)?;
        let frames = py.detach(|| cell.frames());
        let frames = frames.map_err(|error| error::raise_here(py, &error))?;
        Ok(frames.into_iter().map(Frame).collect())
    }

    /// All arms.
    fn arms(&self, py: Python<'_>) -> PyResult<Vec<Arm>> {
        let cell = self.open(py)?;
        let arms = py.detach(|| cell.arms());
        let arms = arms.map_err(|error| error::raise_here(py, &error))?;
        Ok(arms.into_iter().map(Arm::new).collect())
    }

    /// All devices with inputs or outputs.
    fn ios(&self, py: Python<'_>) -> PyResult<Vec<Io>> {
        let cell = self.open(py)?;
        let ios = py.detach(|| cell.ios());
        let ios = ios.map_err(|error| error::raise_here(py, &error))?;
        Ok(ios.into_iter().map(Io::new).collect())
    }

    /// All grippers.
    fn grippers(&self, py: Python<'_>) -> PyResult<Vec<Gripper>> {
        let cell = self.open(py)?;
        let grippers = py.detach(|| cell.grippers());
        let grippers = grippers.map_err(|error| error::raise_here(py, &error))?;
        Ok(grippers.into_iter().map(Gripper::new).collect())
    }

    /// Sets the speed of all activities of this program, also of those that run.
    fn set_override(&self, py: Python<'_>, factor: f64) -> PyResult<()> {
        let cell = self.open(py)?;
        let set = py.detach(|| cell.set_override(factor));
        set.map_err(|error| error::raise_here(py, &error))
    }

    /// The speed that `set_override` has set, 0 to 1.
    fn override_factor(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.open(py)?.override_factor())
    }

    /// The present value of a number; `None` if a device does not know it.
    fn value(&self, py: Python<'_>, number: &Bound<'_, Number>) -> PyResult<Option<f64>> {
        let (cell, number) = (self.open(py)?, number.get().0.clone());
        let value = py.detach(|| cell.value(&number));
        value.map_err(|error| error::raise_here(py, &error))
    }

    /// Whether a condition holds at present.
    fn holds(&self, py: Python<'_>, condition: &Bound<'_, Condition>) -> PyResult<bool> {
        let (cell, condition) = (self.open(py)?, condition.get().0.clone());
        let holds = py.detach(|| cell.holds(&condition));
        holds.map_err(|error| error::raise_here(py, &error))
    }

    /// Calls `callback` with the value of a number or a condition, then at each change.
    fn on_change(
        &self,
        py: Python<'_>,
        expression: &Bound<'_, PyAny>,
        callback: Py<PyAny>,
    ) -> PyResult<Listener> {
        Listener::start(py, self.open(py)?, expression, callback)
    }

    /// Where other programs reach the controller in this program; `None` if it runs elsewhere.
    #[cfg(feature = "embedded")]
    fn embedded_address(&self, py: Python<'_>) -> PyResult<Option<String>> {
        let address = self.open(py)?.embedded_address();
        Ok(address.map(|address| address.to_string()))
    }

    /// Stops everything that this program began, from any thread, and waits until it is at rest.
    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        let cell = self.open(py)?.clone();
        call(py, move || cell.stop())?.map_err(|error| error::raise_here(py, &error))
    }

    /// Cancels everything that this program began, waits until it is at rest, and ends the session.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let cell = self.cell.get(py)?.clone();
        if self.is_closed.swap(true, Ordering::Relaxed) {
            return Ok(());
        }
        call(py, move || cell.close())?.map_err(|error| error::raise_here(py, &error))
    }

    const fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// Closes it. An exception of the program goes first; that closing failed too is then reported beside it.
    fn __exit__(
        &self,
        py: Python<'_>,
        kind: &Bound<'_, PyAny>,
        _value: &Bound<'_, PyAny>,
        _traceback: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        match self.close(py) {
            Err(error) if !kind.is_none() => error.write_unraisable(py, None),
            closed => closed?,
        }
        Ok(())
    }

    fn __repr__(&self) -> &'static str {
        if self.is_closed.load(Ordering::Relaxed) {
            "Cell(closed)"
        } else {
            "Cell()"
        }
    }
}
