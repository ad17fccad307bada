//! Activities that were described and not begun, alone and together.

use std::sync::Arc;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use takt_api as api;

use crate::error;
use crate::expression::Condition;
use crate::handle::Handle;
use crate::outcome::Outcome;
use crate::owned::Owned;
use crate::place::Place;
use crate::wait::wait;

/// An activity that was described and not begun.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Activity {
    activity: Owned<api::Activity>,
    place: Option<Place>,
}

/// What every activity accepts beside its goal.
#[derive(Default)]
pub(crate) struct Options<'a, 'py> {
    pub(crate) speed: Option<f64>,
    pub(crate) blend: Option<f64>,
    pub(crate) until: Option<&'a Bound<'py, PyDict>>,
    pub(crate) now: bool,
}

impl Activity {
    pub(crate) fn new(
        py: Python<'_>,
        mut activity: api::Activity,
        options: &Options<'_, '_>,
    ) -> PyResult<Self> {
        if let Some(speed) = options.speed {
            activity = activity.speed(speed);
        }
        if let Some(blend) = options.blend {
            activity = activity.blend(blend);
        }
        if let Some(until) = options.until {
            activity = add_conditions(activity, until)?;
        }
        if options.now {
            activity = activity.now();
        }
        let place = Place::caller(py);
        let activity = Owned::new(activity);
        Ok(Self { activity, place })
    }

    fn with(
        &self,
        py: Python<'_>,
        change: impl FnOnce(api::Activity) -> PyResult<api::Activity>,
    ) -> PyResult<Self> {
        let activity = Owned::new(change(self.activity.get(py)?.clone())?);
        let place = self.place.clone();
        Ok(Self { activity, place })
    }
}

/// Adds the conditions in their order: of several that hold, the first decides.
fn add_conditions(activity: api::Activity, until: &Bound<'_, PyDict>) -> PyResult<api::Activity> {
    until
        .iter()
        .try_fold(activity, |activity, (name, condition)| {
            let Ok(name) = name.extract::<String>() else {
                let text =
                    "until is a dict of conditions by name: {\"touch\": abs(arm.force.z) > 5}";
                return Err(PyTypeError::new_err(text));
            };
            let Ok(condition) = condition.cast::<Condition>() else {
                let text = format!(
                    "until[\"{name}\"] is a {}, not a Condition",
                    condition.get_type().name()?
                );
                return Err(PyTypeError::new_err(text));
            };
            Ok(activity.until(&name, condition.get().0.clone()))
        })
}

#[pymethods]
impl Activity {
    /// Multiplies its speed by `factor`, above 0 to 1.
    fn speed(&self, py: Python<'_>, factor: f64) -> PyResult<Self> {
        self.with(py, |activity| Ok(activity.speed(factor)))
    }

    /// Lets a successor take over from this part of the path on, 0 to below 1.
    fn blend(&self, py: Python<'_>, progress: f64) -> PyResult<Self> {
        self.with(py, |activity| Ok(activity.blend(progress)))
    }

    /// Stops the motion on its path when the condition holds; the outcome names it.
    fn until(
        &self,
        py: Python<'_>,
        name: &str,
        condition: &Bound<'_, Condition>,
    ) -> PyResult<Self> {
        let condition = condition.get().0.clone();
        self.with(py, |activity| Ok(activity.until(name, condition)))
    }

    /// Lets it begin in the next cycle, in place of what the arm does.
    fn now(&self, py: Python<'_>) -> PyResult<Self> {
        self.with(py, |activity| Ok(activity.now()))
    }

    /// Lets `next` follow: both are loaded and scheduled before the first one begins.
    fn then(&self, py: Python<'_>, next: Next<'_>) -> PyResult<Composite> {
        let first = self.activity.get(py)?.clone();
        let composite = Owned::new(first.then(next.composite(py)?));
        let place = self.place.clone();
        Ok(Composite { composite, place })
    }

    /// Begins it, and returns when it runs.
    fn begin(&self, py: Python<'_>) -> PyResult<Handle> {
        begin(
            py,
            self.activity.get(py)?.clone().into(),
            self.place.clone(),
        )
    }

    /// Lets it begin after what the arm does, and returns at once.
    fn queue(&self, py: Python<'_>) -> PyResult<Handle> {
        let handle = queue(
            py,
            self.activity.get(py)?.clone().into(),
            self.place.as_ref(),
        )?;
        Ok(Handle::new(handle, self.place.clone()))
    }

    /// Begins it and waits until it has ended.
    fn run(&self, py: Python<'_>) -> PyResult<Outcome> {
        end(py, &self.begin(py)?)
    }

    /// The text of the net that it becomes.
    fn explain(&self, py: Python<'_>) -> PyResult<String> {
        let activity = self.activity.get(py)?;
        let text = py.detach(|| activity.explain());
        text.map_err(|error| error::raise(py, &error, self.place.as_ref()))
    }

    fn __await__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Handle::__await__(Bound::new(py, self.queue(py)?)?)
    }

    fn __repr__(&self) -> String {
        let place = self.place.as_ref();
        place.map_or_else(
            || "Activity()".to_owned(),
            |Place { file, line }| format!("Activity({file}:{line})"),
        )
    }
}

/// Several activities that are begun in one call.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Composite {
    composite: Owned<api::Composite>,
    place: Option<Place>,
}

/// What may follow another activity.
#[derive(FromPyObject)]
enum Next<'py> {
    Activity(Bound<'py, Activity>),
    Composite(Bound<'py, Composite>),
}

impl Next<'_> {
    fn composite(&self, py: Python<'_>) -> PyResult<api::Composite> {
        Ok(match self {
            Self::Activity(next) => next.get().activity.get(py)?.clone().into(),
            Self::Composite(next) => next.get().composite.get(py)?.clone(),
        })
    }
}

/// Combines activities of different devices to one that begins in the same cycle on all of them.
#[pyfunction]
#[pyo3(signature = (*activities))]
pub(crate) fn together(activities: &Bound<'_, PyTuple>) -> PyResult<Composite> {
    Ok(Composite {
        composite: Owned::new(api::together(list(activities)?)),
        place: Place::caller(activities.py()),
    })
}

/// The first of several activities that is possible.
#[pyfunction]
#[pyo3(signature = (*activities))]
pub(crate) fn either(activities: &Bound<'_, PyTuple>) -> PyResult<Composite> {
    Ok(Composite {
        composite: Owned::new(api::either(list(activities)?)),
        place: Place::caller(activities.py()),
    })
}

fn list(activities: &Bound<'_, PyTuple>) -> PyResult<Vec<api::Activity>> {
    let py = activities.py();
    let one = |activity: Bound<'_, PyAny>| {
        let Ok(activity) = activity.cast::<Activity>() else {
            let kind = activity.get_type();
            let text = format!("{} is no activity, such as arm.lin(pose)", kind.name()?);
            return Err(PyTypeError::new_err(text));
        };
        Ok(activity.get().activity.get(py)?.clone())
    };
    activities.iter().map(one).collect()
}

#[pymethods]
impl Composite {
    /// The same, followed by `next`.
    fn then(&self, py: Python<'_>, next: Next<'_>) -> PyResult<Self> {
        let composite = self.composite.get(py)?.clone().then(next.composite(py)?);
        let (composite, place) = (Owned::new(composite), self.place.clone());
        Ok(Self { composite, place })
    }

    /// Begins them, and returns when they run.
    fn begin(&self, py: Python<'_>) -> PyResult<Handle> {
        begin(py, self.composite.get(py)?.clone(), self.place.clone())
    }

    /// The same, but does not wait until they run.
    fn queue(&self, py: Python<'_>) -> PyResult<Handle> {
        let handle = queue(py, self.composite.get(py)?.clone(), self.place.as_ref())?;
        Ok(Handle::new(handle, self.place.clone()))
    }

    /// Begins them and waits until all have ended.
    fn run(&self, py: Python<'_>) -> PyResult<Outcome> {
        end(py, &self.begin(py)?)
    }

    fn __await__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Handle::__await__(Bound::new(py, self.queue(py)?)?)
    }
}

fn queue(
    py: Python<'_>,
    composite: api::Composite,
    place: Option<&Place>,
) -> PyResult<Arc<api::Handle>> {
    let handle = py.detach(|| composite.queue());
    let handle = handle.map_err(|error| error::raise(py, &error, place))?;
    Ok(Arc::new(handle))
}

/// Begins; a signal while it waits for its turn cancels it, since the program never gets its handle.
fn begin(py: Python<'_>, composite: api::Composite, place: Option<Place>) -> PyResult<Handle> {
    let handle = queue(py, composite, place.as_ref())?;
    let begun = wait(py, None, |slice| handle.wait_for_begin(slice));
    if begun.is_err() {
        py.detach(|| handle.cancel());
    }
    if let Some(Err(error)) = begun? {
        return Err(error::raise(py, &error, place.as_ref()));
    }
    Ok(Handle::new(handle, place))
}

/// Waits for the end; a signal cancels the activity, since no handle of it is left.
fn end(py: Python<'_>, handle: &Handle) -> PyResult<Outcome> {
    handle.wait(py, None).inspect_err(|_| {
        // Fails only in a forked process, which has begun nothing.
        let _ = handle.cancel(py);
    })
}
