//! Listeners: Python is called when a number or a condition changes.

use std::panic::resume_unwind;
use std::sync::{Mutex, PoisonError};

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use takt_api as api;

use crate::error;
use crate::expression::{Condition, Number};
use crate::owned::Owned;
use crate::place::Place;

/// Calls of the program at each change of a number or a condition.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Listener {
    listener: Owned<Mutex<State>>,
    place: Option<Place>,
}

/// What is left of it once it is closed.
#[derive(Debug)]
enum State {
    Open(api::Listener),
    Closed {
        missed: u64,
        error: Option<api::Error>,
    },
}

impl State {
    fn missed(&self) -> u64 {
        match self {
            Self::Open(listener) => listener.missed(),
            Self::Closed { missed, .. } => *missed,
        }
    }

    fn error(&self) -> Option<api::Error> {
        match self {
            Self::Open(listener) => listener.error(),
            Self::Closed { error, .. } => error.clone(),
        }
    }
}

/// Calls Python with a value. What it raises is reported, and ends the listener.
fn call<'py, T: IntoPyObject<'py>>(py: Python<'py>, callback: &Py<PyAny>, value: T) {
    let Err(raised) = callback.bind(py).call1((value,)) else {
        return;
    };
    let text = raised.to_string();
    raised.write_unraisable(py, Some(callback.bind(py)));
    // Without the message of a panic: it is reported already.
    resume_unwind(Box::new(text));
}

impl Listener {
    /// Begins to listen.
    pub(crate) fn start(
        py: Python<'_>,
        cell: &api::Cell,
        expression: &Bound<'_, PyAny>,
        callback: Py<PyAny>,
    ) -> PyResult<Self> {
        let place = Place::caller(py);
        if !callback.bind(py).is_callable() {
            let kind = callback.bind(py).get_type();
            let text = format!("{} cannot be called", kind.name()?);
            return Err(PyTypeError::new_err(text));
        }
        // Without an interpreter there is no callback to call.
        let listener = if let Ok(number) = expression.cast::<Number>() {
            let number = number.get().0.clone();
            let calls = move |value: Option<f64>| {
                Python::try_attach(|py| call(py, &callback, value));
            };
            py.detach(|| cell.on_change(&number, calls))
        } else if let Ok(condition) = expression.cast::<Condition>() {
            let condition = condition.get().0.clone();
            let calls = move |value: bool| {
                Python::try_attach(|py| call(py, &callback, value));
            };
            py.detach(|| cell.on_change(&condition, calls))
        } else {
            let kind = expression.get_type();
            let text = format!("{} is no number or condition of a cell", kind.name()?);
            return Err(PyTypeError::new_err(text));
        };
        let listener = listener.map_err(|error| error::raise(py, &error, place.as_ref()))?;
        let listener = Owned::new(Mutex::new(State::Open(listener)));
        Ok(Self { listener, place })
    }

    fn with<T: Send>(
        &self,
        py: Python<'_>,
        of: impl FnOnce(&mut State) -> T + Send,
    ) -> PyResult<T> {
        let state = self.listener.get(py)?;
        Ok(py.detach(|| of(&mut state.lock().unwrap_or_else(PoisonError::into_inner))))
    }
}

#[pymethods]
impl Listener {
    /// How many values were replaced by later ones before the callback was called with them.
    #[getter]
    fn missed(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |state| state.missed())
    }

    /// Why it has ended by itself, as an exception.
    #[getter]
    fn error(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let error = self.with(py, |state| state.error())?;
        let raised = error.map(|error| error::raise(py, &error, self.place.as_ref()));
        Ok(raised.map(|raised| raised.into_value(py).into_any()))
    }

    /// Ends it; the call in progress is completed.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |state| {
            let (missed, error) = (state.missed(), state.error());
            *state = State::Closed { missed, error };
        })
    }

    const fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// Closes it.
    fn __exit__(
        &self,
        py: Python<'_>,
        _kind: &Bound<'_, PyAny>,
        _value: &Bound<'_, PyAny>,
        _traceback: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        self.close(py)
    }
}
