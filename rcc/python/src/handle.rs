//! Handles of activities that were begun.

use std::ops::Deref;
use std::sync::Arc;

use pyo3::prelude::*;
use takt_api as api;

use crate::dispatch::{CALLBACKS, TASKS};
use crate::error;
use crate::outcome::Outcome;
use crate::owned::Owned;
use crate::place::Place;
use crate::wait::{seconds, wait};

/// What was begun, by what can be sent to it.
#[derive(Debug)]
pub(crate) enum Begun {
    Activity(api::Handle),
    Twist(api::LiveHandle<api::Twist>),
    JointVelocities(api::LiveHandle<api::JointVelocities>),
    JointGoal(api::LiveHandle<api::JointGoal>),
    Pose(api::LiveHandle<api::Pose>),
}

impl Deref for Begun {
    type Target = api::Handle;

    fn deref(&self) -> &api::Handle {
        match self {
            Self::Activity(handle) => handle,
            Self::Twist(handle) => handle,
            Self::JointVelocities(handle) => handle,
            Self::JointGoal(handle) => handle,
            Self::Pose(handle) => handle,
        }
    }
}

/// An activity that was begun, or several that began together.
#[pyclass(frozen, subclass, module = "takt")]
#[derive(Debug)]
pub(crate) struct Handle {
    handle: Owned<Arc<Begun>>,
    place: Option<Place>,
}

impl Handle {
    pub(crate) fn new(begun: Begun, place: Option<Place>) -> Self {
        let handle = Owned::new(Arc::new(begun));
        Self { handle, place }
    }

    pub(crate) fn begun(&self, py: Python<'_>) -> PyResult<&Begun> {
        Ok(self.handle.get(py)?)
    }

    /// Waits until it runs. A signal cancels it, since the program never gets its handle.
    pub(crate) fn wait_for_begin(&self, py: Python<'_>) -> PyResult<()> {
        let handle = self.handle.get(py)?;
        let begun = wait(py, None, |slice| handle.wait_for_begin(slice));
        if begun.is_err() {
            py.detach(|| handle.cancel());
        }
        begun?
            .unwrap_or(Ok(()))
            .map_err(|error| error::raise(py, &error, self.place.as_ref()))
    }

    fn result(
        &self,
        py: Python<'_>,
        outcome: Result<api::Outcome, api::Error>,
    ) -> PyResult<Outcome> {
        let raise = |error| error::raise(py, &error, self.place.as_ref());
        outcome.map(Outcome::from).map_err(raise)
    }
}

#[pymethods]
impl Handle {
    /// Waits until it has ended; `timeout` in s.
    #[pyo3(signature = (timeout=None))]
    pub(crate) fn wait(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Outcome> {
        let handle = self.handle.get(py)?;
        let limit = timeout
            .map(|timeout| seconds(py, "timeout", timeout))
            .transpose()?;
        let outcome = wait(py, limit, |slice| handle.wait_for(slice))?;
        let late = || error::timeout(py, timeout.unwrap_or_default(), self.place.as_ref());
        self.result(py, outcome.ok_or_else(late)?)
    }

    /// Waits until it has ended, also if it maintains its goal; `timeout` in s.
    #[pyo3(signature = (timeout=None))]
    fn wait_to_end(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Outcome> {
        let handle = self.handle.get(py)?;
        let limit = timeout
            .map(|timeout| seconds(py, "timeout", timeout))
            .transpose()?;
        let outcome = wait(py, limit, |slice| handle.wait_to_end_for(slice))?;
        let late = || error::timeout(py, timeout.unwrap_or_default(), self.place.as_ref());
        self.result(py, outcome.ok_or_else(late)?)
    }

    /// Requests that it end: it brakes on its path.
    pub(crate) fn cancel(&self, py: Python<'_>) -> PyResult<()> {
        let handle = self.handle.get(py)?;
        py.detach(|| handle.cancel());
        Ok(())
    }

    /// Part of the path that it has completed, 0 to 1.
    fn progress(&self, py: Python<'_>) -> PyResult<f64> {
        let handle = self.handle.get(py)?;
        Ok(py.detach(|| handle.progress()))
    }

    /// The outcome, if it has ended.
    fn outcome(&self, py: Python<'_>) -> PyResult<Option<Outcome>> {
        let handle = self.handle.get(py)?;
        let outcome = py.detach(|| handle.outcome());
        outcome.map(|outcome| self.result(py, outcome)).transpose()
    }

    /// Calls `callback` with this handle when it has ended.
    fn on_end(slf: Bound<'_, Self>, callback: Bound<'_, PyAny>) -> PyResult<()> {
        let py = slf.py();
        let partial = py.import("functools")?.getattr("partial")?;
        let bound = partial.call1((callback, &slf))?;
        let handle = Arc::clone(slf.get().handle.get(py)?);
        Ok(CALLBACKS.on_end(handle, bound.unbind())?)
    }

    /// Calls `callback` without arguments, soon and in another thread, when it has ended.
    fn _wake(&self, py: Python<'_>, callback: Py<PyAny>) -> PyResult<()> {
        let handle = Arc::clone(self.handle.get(py)?);
        Ok(TASKS.on_end(handle, callback)?)
    }

    pub(crate) fn __await__<'py>(slf: Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let task = slf.py().import("takt._tasks")?;
        task.call_method1("wait", (&slf,))?
            .call_method0("__await__")
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let handle = self.handle.get(py)?;
        let (outcome, progress) = py.detach(|| (handle.outcome(), handle.progress()));
        Ok(match outcome {
            None => format!("Handle(progress={progress:.2})"),
            Some(Ok(outcome)) => format!("Handle({})", Outcome::from(outcome).__repr__()),
            Some(Err(error)) => format!("Handle({error})"),
        })
    }
}
