//! Activities that are loaded beforehand and begun later.

use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;
use takt_api as api;

use crate::compose::end;
use crate::error;
use crate::handle::{Begun, Handle};
use crate::outcome::Outcome;
use crate::owned::Owned;
use crate::place::Place;

/// An activity, or several that begin in one call, loaded and not begun.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Prepared {
    /// `None` once it was begun or discarded.
    prepared: Owned<Mutex<Option<api::Prepared>>>,
    place: Option<Place>,
}

impl Prepared {
    pub(crate) fn new(
        py: Python<'_>,
        composite: api::Composite,
        place: Option<Place>,
    ) -> PyResult<Self> {
        let prepared = py.detach(|| composite.prepare());
        let prepared = prepared.map_err(|error| error::raise(py, &error, place.as_ref()))?;
        let prepared = Owned::new(Mutex::new(Some(prepared)));
        Ok(Self { prepared, place })
    }

    fn take(&self, py: Python<'_>) -> PyResult<Option<api::Prepared>> {
        let prepared = self.prepared.get(py)?;
        let taken = prepared
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        Ok(taken)
    }
}

#[pymethods]
impl Prepared {
    /// Begins it, and returns when it runs.
    fn begin(&self, py: Python<'_>) -> PyResult<Handle> {
        let handle = self.queue(py)?;
        handle.wait_for_begin(py)?;
        Ok(handle)
    }

    /// Lets it begin after what its devices do, and returns at once.
    fn queue(&self, py: Python<'_>) -> PyResult<Handle> {
        let used = "it was begun or discarded before\nhint: prepare the activity again";
        let prepared = self.take(py)?.ok_or_else(|| error::invalid(py, used))?;
        let handle = py.detach(|| prepared.queue());
        let handle = handle.map_err(|error| error::raise(py, &error, self.place.as_ref()))?;
        Ok(Handle::new(Begun::Activity(handle), self.place.clone()))
    }

    /// Begins it and waits until it has ended.
    fn run(&self, py: Python<'_>) -> PyResult<Outcome> {
        end(py, &self.begin(py)?)
    }

    /// Unloads it, unless it was begun.
    fn discard(&self, py: Python<'_>) -> PyResult<()> {
        let prepared = self.take(py)?;
        py.detach(|| drop(prepared));
        Ok(())
    }

    const fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// Discards it, unless it was begun.
    fn __exit__(
        &self,
        py: Python<'_>,
        _kind: &Bound<'_, PyAny>,
        _value: &Bound<'_, PyAny>,
        _traceback: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        self.discard(py)
    }

    fn __await__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Handle::__await__(Bound::new(py, self.queue(py)?)?)
    }
}
