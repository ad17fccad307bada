//! Activities that follow what a program sends while they run: jogging and streamed goals.

use pyo3::PyClassInitializer;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};
use takt_api as api;

use crate::arrays::array;
use crate::error;
use crate::explain::Explanation;
use crate::expression::Condition;
use crate::handle::{Begun, Handle};
use crate::keywords::Options;
use crate::owned::Owned;
use crate::place::Place;
use crate::pose;

/// An activity that follows set-points, described and not begun.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Live {
    live: Owned<Described>,
    place: Option<Place>,
}

/// By what is sent.
#[derive(Clone, Debug)]
pub(crate) enum Described {
    Twist(api::Live<api::Twist>),
    JointVelocities(api::Live<api::JointVelocities>),
    JointGoal(api::Live<api::JointGoal>),
    Pose(api::Live<api::Pose>),
}

/// Evaluates an expression over the activity of each kind, and names its kind again.
macro_rules! same_kind {
    ($described:expr, $enum:ident, $live:ident => $result:expr) => {
        match $described {
            Described::Twist($live) => $enum::Twist($result),
            Described::JointVelocities($live) => $enum::JointVelocities($result),
            Described::JointGoal($live) => $enum::JointGoal($result),
            Described::Pose($live) => $enum::Pose($result),
        }
    };
}

impl Described {
    fn speed(self, factor: f64) -> Self {
        same_kind!(self, Self, live => live.speed(factor))
    }

    fn until(self, name: &str, condition: &api::Condition) -> Self {
        same_kind!(self, Self, live => live.until(name, condition.clone()))
    }

    fn now(self) -> Self {
        same_kind!(self, Self, live => live.now())
    }

    fn queue(self) -> Result<Begun, api::Error> {
        Ok(same_kind!(self, Begun, live => live.queue()?))
    }

    fn explain(&self) -> Result<api::Explanation, api::Error> {
        match self {
            Self::Twist(live) => live.explain(),
            Self::JointVelocities(live) => live.explain(),
            Self::JointGoal(live) => live.explain(),
            Self::Pose(live) => live.explain(),
        }
    }
}

impl Live {
    pub(crate) fn new(
        py: Python<'_>,
        mut live: Described,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let options = Options::without_blend(options)?;
        if let Some(speed) = options.speed {
            live = live.speed(speed);
        }
        for (name, condition) in options.until {
            live = live.until(&name, &condition);
        }
        if options.now {
            live = live.now();
        }
        let (live, place) = (Owned::new(live), Place::caller(py));
        Ok(Self { live, place })
    }

    fn with(&self, py: Python<'_>, change: impl FnOnce(Described) -> Described) -> PyResult<Self> {
        let live = Owned::new(change(self.live.get(py)?.clone()));
        let place = self.place.clone();
        Ok(Self { live, place })
    }

    fn handle(&self, py: Python<'_>) -> PyResult<Handle> {
        let live = self.live.get(py)?.clone();
        let begun = py.detach(|| live.queue());
        let begun = begun.map_err(|error| error::raise(py, &error, self.place.as_ref()))?;
        Ok(Handle::new(begun, self.place.clone()))
    }
}

#[pymethods]
impl Live {
    /// Multiplies its speed by `factor`, above 0 to 1.
    fn speed(&self, py: Python<'_>, factor: f64) -> PyResult<Self> {
        self.with(py, |live| live.speed(factor))
    }

    /// Stops it when the condition holds; the outcome names it.
    fn until(
        &self,
        py: Python<'_>,
        name: &str,
        condition: &Bound<'_, Condition>,
    ) -> PyResult<Self> {
        let condition = &condition.get().0;
        self.with(py, |live| live.until(name, condition))
    }

    /// Lets it begin in the next cycle, in place of what the arm does.
    fn now(&self, py: Python<'_>) -> PyResult<Self> {
        self.with(py, Described::now)
    }

    /// Begins it, and returns when it runs.
    fn begin(&self, py: Python<'_>) -> PyResult<Py<LiveHandle>> {
        let handle = self.handle(py)?;
        handle.wait_for_begin(py)?;
        LiveHandle::new(py, handle)
    }

    /// Lets it begin after what the arm does, and returns at once.
    fn queue(&self, py: Python<'_>) -> PyResult<Py<LiveHandle>> {
        LiveHandle::new(py, self.handle(py)?)
    }

    /// What it becomes if it is begun now.
    fn explain(&self, py: Python<'_>) -> PyResult<Explanation> {
        let live = self.live.get(py)?;
        let explained = py.detach(|| live.explain());
        explained
            .map(Explanation)
            .map_err(|error| error::raise(py, &error, self.place.as_ref()))
    }

    /// For annotations such as `Live[Twist]`.
    #[classmethod]
    fn __class_getitem__(class: &Bound<'_, PyType>, _of: &Bound<'_, PyAny>) -> Py<PyType> {
        class.clone().unbind()
    }
}

/// An activity that follows what the program sends, and was begun.
#[pyclass(frozen, extends = Handle, module = "takt")]
#[derive(Debug)]
pub(crate) struct LiveHandle;

impl LiveHandle {
    fn new(py: Python<'_>, handle: Handle) -> PyResult<Py<Self>> {
        Py::new(py, PyClassInitializer::from(handle).add_subclass(Self))
    }
}

#[pymethods]
impl LiveHandle {
    /// Sends a set-point.
    fn send(slf: &Bound<'_, Self>, set_point: &Bound<'_, PyAny>) -> PyResult<()> {
        let py = slf.py();
        let begun = slf.as_super().get().begun(py)?;
        let sent = match begun {
            Begun::Activity(_) => return Err(error::invalid(py, "nothing can be sent to it")),
            Begun::Twist(handle) => {
                let twist = Twist::read(set_point)?;
                py.detach(|| handle.send(twist))
            }
            Begun::JointVelocities(handle) => {
                let velocities = set_point.extract::<Vec<f64>>()?;
                py.detach(|| handle.send(velocities))
            }
            Begun::JointGoal(handle) => {
                let goal = set_point.extract::<Vec<f64>>()?;
                py.detach(|| handle.send(goal))
            }
            Begun::Pose(handle) => {
                let pose = pose::read(set_point)?;
                py.detach(|| handle.send(pose))
            }
        };
        sent.map_err(|error| error::raise_here(py, &error))
    }

    const fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// Cancels it and waits for rest. An exception of the program goes first.
    fn __exit__(
        slf: &Bound<'_, Self>,
        kind: &Bound<'_, PyAny>,
        value: &Bound<'_, PyAny>,
        _traceback: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let py = slf.py();
        let handle = slf.as_super().get();
        handle.cancel(py)?;
        match handle.wait(py, None) {
            Err(error) if !error::is_of_package(&error, py) => Err(error),
            // What ended the activity has reached the program by `send`.
            Err(_) if error::is_of_package(&PyErr::from_value(value.clone()), py) => Ok(()),
            Err(error) if !kind.is_none() => {
                error.write_unraisable(py, None);
                Ok(())
            }
            ended => ended.map(drop),
        }
    }

    /// For annotations such as `LiveHandle[Twist]`.
    #[classmethod]
    fn __class_getitem__(class: &Bound<'_, PyType>, _of: &Bound<'_, PyAny>) -> Py<PyType> {
        class.clone().unbind()
    }
}

/// Velocity of a motion centre, in the axes of the base of its arm.
#[pyclass(frozen, eq, module = "takt")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Twist(api::Twist);

impl Twist {
    /// Reads a twist, or six numbers.
    fn read(value: &Bound<'_, PyAny>) -> PyResult<api::Twist> {
        if let Ok(twist) = value.cast::<Self>() {
            return Ok(twist.get().0);
        }
        let [x, y, z, a, b, c] = value.extract::<[f64; 6]>()?;
        Ok(api::Twist::xyz(x, y, z).turning(a, b, c))
    }
}

#[pymethods]
impl Twist {
    /// A velocity without rotation, m/s.
    #[staticmethod]
    const fn xyz(x: f64, y: f64, z: f64) -> Self {
        Self(api::Twist::xyz(x, y, z))
    }

    /// The same with a rotational velocity about x, y and z, rad/s.
    const fn turning(&self, x: f64, y: f64, z: f64) -> Self {
        Self(self.0.turning(x, y, z))
    }

    /// Velocity, m/s: array of 3.
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.velocity.to_vec())
    }

    /// Rotational velocity about x, y and z, rad/s: array of 3.
    #[getter]
    fn rotation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.rotation.to_vec())
    }

    fn __repr__(&self) -> String {
        let ([x, y, z], [a, b, c]) = (self.0.velocity, self.0.rotation);
        format!("Twist.xyz({x}, {y}, {z}).turning({a}, {b}, {c})")
    }
}
