//! Activities that were described and not begun, alone and together.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use takt_api as api;

use crate::compose::{Composite, Event, Next, begin, end, queue};
use crate::error;
use crate::explain::Explanation;
use crate::expression::Condition;
use crate::handle::Handle;
use crate::keywords::Options;
use crate::outcome::Outcome;
use crate::owned::Owned;
use crate::place::Place;
use crate::plan::Plan;
use crate::prepared::Prepared;

/// An activity that was described and not begun.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Activity {
    activity: Owned<api::Activity>,
    place: Option<Place>,
}

impl Activity {
    /// A motion, which another one may blend with.
    pub(crate) fn motion(
        py: Python<'_>,
        activity: api::Activity,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        Ok(Self::new(py, activity, Options::of_motion(options)?))
    }

    /// Any other activity.
    pub(crate) fn without_blend(
        py: Python<'_>,
        activity: api::Activity,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        Ok(Self::new(py, activity, Options::without_blend(options)?))
    }

    fn new(py: Python<'_>, mut activity: api::Activity, options: Options) -> Self {
        if let Some(speed) = options.speed {
            activity = activity.speed(speed);
        }
        if let Some(blend) = options.blend {
            activity = activity.blend(blend);
        }
        for (name, condition) in options.until {
            activity = activity.until(&name, condition);
        }
        if options.now {
            activity = activity.now();
        }
        let place = Place::caller(py);
        let activity = Owned::new(activity);
        Self { activity, place }
    }

    /// A copy of the activity.
    pub(crate) fn activity(&self, py: Python<'_>) -> PyResult<api::Activity> {
        Ok(self.activity.get(py)?.clone())
    }

    fn composite(&self, composite: api::Composite) -> Composite {
        Composite::new(composite, self.place.clone())
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
        Ok(self.composite(self.activity(py)?.then(next.composite(py)?)))
    }

    /// Lets `next` begin at an event of this activity, decided by the controller.
    fn on(&self, py: Python<'_>, event: &Bound<'_, Event>, next: Next<'_>) -> PyResult<Composite> {
        let event = event.get().0.clone();
        Ok(self.composite(self.activity(py)?.on(event, next.composite(py)?)))
    }

    /// Lets it begin also if what it follows fails or is cancelled.
    fn after_failure(&self, py: Python<'_>) -> PyResult<Composite> {
        Ok(self.composite(self.activity(py)?.after_failure()))
    }

    /// Begins it without a check of its path beforehand.
    fn unchecked(&self, py: Python<'_>) -> PyResult<Self> {
        self.with(py, |activity| Ok(activity.unchecked()))
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
        queue(
            py,
            self.activity.get(py)?.clone().into(),
            self.place.clone(),
        )
    }

    /// Begins it and waits until it has ended.
    fn run(&self, py: Python<'_>) -> PyResult<Outcome> {
        end(py, &self.begin(py)?)
    }

    /// Plans it from where the device is: nothing is loaded, nothing moves.
    fn plan(&self, py: Python<'_>) -> PyResult<Plan> {
        let activity = self.activity.get(py)?;
        let plan = py.detach(|| activity.plan());
        plan.map(Plan)
            .map_err(|error| error::raise(py, &error, self.place.as_ref()))
    }

    /// Plans, writes and loads it, to begin it later with one request.
    fn prepare(&self, py: Python<'_>) -> PyResult<Prepared> {
        Prepared::new(
            py,
            self.activity.get(py)?.clone().into(),
            self.place.clone(),
        )
    }

    /// What it becomes if it is begun now.
    fn explain(&self, py: Python<'_>) -> PyResult<Explanation> {
        let activity = self.activity.get(py)?;
        let explained = py.detach(|| activity.explain());
        explained
            .map(Explanation)
            .map_err(|error| error::raise(py, &error, self.place.as_ref()))
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
