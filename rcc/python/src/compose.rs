//! Several activities that are begun in one call, and events that start them.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use takt_api as api;

use crate::activity::Activity;
use crate::error;
use crate::expression::Condition;
use crate::handle::{Begun, Handle};
use crate::outcome::Outcome;
use crate::owned::Owned;
use crate::place::Place;
use crate::prepared::Prepared;

/// Several activities that are begun in one call.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Composite {
    composite: Owned<api::Composite>,
    place: Option<Place>,
}

impl Composite {
    pub(crate) fn new(composite: api::Composite, place: Option<Place>) -> Self {
        let composite = Owned::new(composite);
        Self { composite, place }
    }

    fn with(
        &self,
        py: Python<'_>,
        change: impl FnOnce(api::Composite) -> PyResult<api::Composite>,
    ) -> PyResult<Self> {
        let composite = change(self.composite.get(py)?.clone())?;
        Ok(Self::new(composite, self.place.clone()))
    }
}

/// What may start another activity.
#[pyclass(frozen, eq, module = "takt")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Event(pub(crate) api::Event);

#[pymethods]
impl Event {
    #[classattr]
    #[pyo3(name = "Completed")]
    const COMPLETED: Self = Self(api::Event::Completed);
    #[classattr]
    #[pyo3(name = "Cancelled")]
    const CANCELLED: Self = Self(api::Event::Cancelled);
    #[classattr]
    #[pyo3(name = "Failed")]
    const FAILED: Self = Self(api::Event::Failed);

    /// The condition of this name stopped it, and it is at rest.
    #[staticmethod]
    #[expect(non_snake_case, reason = "the name of the variant in Rust")]
    const fn Stopped(name: String) -> Self {
        Self(api::Event::Stopped(name))
    }

    /// It has completed this part of its path, 0 to below 1.
    #[staticmethod]
    #[expect(non_snake_case, reason = "the name of the variant in Rust")]
    const fn Progress(progress: f64) -> Self {
        Self(api::Event::Progress(progress))
    }

    fn __repr__(&self) -> String {
        match &self.0 {
            api::Event::Stopped(name) => format!("Event.Stopped('{name}')"),
            api::Event::Progress(progress) => format!("Event.Progress({progress})"),
            plain @ (api::Event::Completed | api::Event::Cancelled | api::Event::Failed) => {
                format!("Event.{plain:?}")
            }
        }
    }
}

/// A condition that is to start an activity.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Waiting {
    waiting: api::compose::Waiting,
    place: Option<Place>,
}

/// Waits for a condition, without a device.
#[pyfunction]
pub(crate) fn when(condition: &Bound<'_, Condition>) -> Waiting {
    Waiting {
        waiting: api::when(condition.get().0.clone()),
        place: Place::caller(condition.py()),
    }
}

#[pymethods]
impl Waiting {
    /// Begins `next` once the condition holds.
    fn start(&self, py: Python<'_>, next: Next<'_>) -> PyResult<Composite> {
        let composite = self.waiting.clone().start(next.composite(py)?);
        Ok(Composite::new(composite, self.place.clone()))
    }

    /// Begins `yes` if the condition holds in the first cycle, else `no`.
    fn choose(&self, py: Python<'_>, yes: Next<'_>, no: Next<'_>) -> PyResult<Composite> {
        let (yes, no) = (yes.composite(py)?, no.composite(py)?);
        let composite = self.waiting.clone().choose(yes, no);
        Ok(Composite::new(composite, self.place.clone()))
    }
}

/// What may follow another activity.
#[derive(FromPyObject)]
pub(crate) enum Next<'py> {
    Activity(Bound<'py, Activity>),
    Composite(Bound<'py, Composite>),
}

impl Next<'_> {
    pub(crate) fn composite(&self, py: Python<'_>) -> PyResult<api::Composite> {
        Ok(match self {
            Self::Activity(next) => next.get().activity(py)?.into(),
            Self::Composite(next) => next.get().composite.get(py)?.clone(),
        })
    }
}

/// Combines activities of different devices to one that begins in the same cycle on all of them.
#[pyfunction]
#[pyo3(signature = (*activities))]
pub(crate) fn together(activities: &Bound<'_, PyTuple>) -> PyResult<Composite> {
    let all = api::together(list(activities)?);
    Ok(Composite::new(all, Place::caller(activities.py())))
}

/// The first of several activities that is possible.
#[pyfunction]
#[pyo3(signature = (*activities))]
pub(crate) fn either(activities: &Bound<'_, PyTuple>) -> PyResult<Composite> {
    let all = api::either(list(activities)?);
    Ok(Composite::new(all, Place::caller(activities.py())))
}

fn list(activities: &Bound<'_, PyTuple>) -> PyResult<Vec<api::Activity>> {
    let py = activities.py();
    let one = |activity: Bound<'_, PyAny>| {
        let Ok(activity) = activity.cast::<Activity>() else {
            let kind = activity.get_type();
            let text = format!("{} is no activity, such as arm.lin(pose)", kind.name()?);
            return Err(PyTypeError::new_err(text));
        };
        activity.get().activity(py)
    };
    activities.iter().map(one).collect()
}

#[pymethods]
impl Composite {
    /// The same, followed by `next`.
    fn then(&self, py: Python<'_>, next: Next<'_>) -> PyResult<Self> {
        self.with(py, |composite| Ok(composite.then(next.composite(py)?)))
    }

    /// The same; `next` begins at an event of the last activity, decided by the controller.
    fn on(&self, py: Python<'_>, event: &Bound<'_, Event>, next: Next<'_>) -> PyResult<Self> {
        let event = event.get().0.clone();
        self.with(py, |composite| Ok(composite.on(event, next.composite(py)?)))
    }

    /// The same; what begins first begins also if what its devices do before fails or is cancelled.
    fn after_failure(&self, py: Python<'_>) -> PyResult<Self> {
        self.with(py, |composite| Ok(composite.after_failure()))
    }

    /// Plans, writes and loads them, to begin them later with one request for each part.
    fn prepare(&self, py: Python<'_>) -> PyResult<Prepared> {
        Prepared::new(py, self.composite.get(py)?.clone(), self.place.clone())
    }

    /// Begins them, and returns when they run.
    fn begin(&self, py: Python<'_>) -> PyResult<Handle> {
        begin(py, self.composite.get(py)?.clone(), self.place.clone())
    }

    /// The same, but does not wait until they run.
    fn queue(&self, py: Python<'_>) -> PyResult<Handle> {
        queue(py, self.composite.get(py)?.clone(), self.place.clone())
    }

    /// Begins them and waits until all have ended.
    fn run(&self, py: Python<'_>) -> PyResult<Outcome> {
        end(py, &self.begin(py)?)
    }

    fn __await__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Handle::__await__(Bound::new(py, self.queue(py)?)?)
    }
}

pub(crate) fn queue(
    py: Python<'_>,
    composite: api::Composite,
    place: Option<Place>,
) -> PyResult<Handle> {
    let handle = py.detach(|| composite.queue());
    let handle = handle.map_err(|error| error::raise(py, &error, place.as_ref()))?;
    Ok(Handle::new(Begun::Activity(handle), place))
}

/// Begins, and waits until it runs.
pub(crate) fn begin(
    py: Python<'_>,
    composite: api::Composite,
    place: Option<Place>,
) -> PyResult<Handle> {
    let handle = queue(py, composite, place)?;
    handle.wait_for_begin(py)?;
    Ok(handle)
}

/// Waits for the end; a signal cancels the activity, since no handle of it is left.
pub(crate) fn end(py: Python<'_>, handle: &Handle) -> PyResult<Outcome> {
    handle.wait(py, None).inspect_err(|_| {
        // Fails only in a forked process, which has begun nothing.
        let _ = handle.cancel(py);
    })
}
