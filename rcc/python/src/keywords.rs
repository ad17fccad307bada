//! Keyword arguments that many functions share. Unknown ones and those of another type raise `TypeError`, as if they stood
//! in the signature.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};

use crate::expression::Condition;

/// The keyword arguments of a call.
pub(crate) struct Keywords<'a, 'py>(Option<&'a Bound<'py, PyDict>>);

impl<'a, 'py> Keywords<'a, 'py> {
    /// Checks that there are no others than the `known` ones.
    pub(crate) fn of(given: Option<&'a Bound<'py, PyDict>>, known: &[&str]) -> PyResult<Self> {
        for name in given.into_iter().flat_map(|given| given.keys()) {
            let name = name.extract::<String>()?;
            if !known.contains(&name.as_str()) {
                let known = known.join(", ");
                let text =
                    format!("there is no keyword argument '{name}'\nhint: there are {known}");
                return Err(PyTypeError::new_err(text));
            }
        }
        Ok(Self(given))
    }

    /// The value of an argument; `None` if it is left out or `None`.
    pub(crate) fn get<T>(&self, name: &str) -> PyResult<Option<T>>
    where
        T: for<'b> FromPyObject<'b, 'py, Error: Into<PyErr>>,
    {
        let value = self.0.map(|given| given.get_item(name)).transpose()?;
        let value = value.flatten().filter(|value| !value.is_none());
        let read = |value: Bound<'py, PyAny>| {
            value.extract::<T>().map_err(|error| {
                let error: PyErr = error.into();
                let text = format!("argument '{name}': {}", error.value(value.py()));
                PyTypeError::new_err(text)
            })
        };
        value.map(read).transpose()
    }
}

/// What activities accept beside their goal.
#[derive(Default)]
pub(crate) struct Options {
    pub(crate) speed: Option<f64>,
    pub(crate) blend: Option<f64>,
    /// In their order: of several that hold, the first decides.
    pub(crate) until: Vec<(String, takt_api::Condition)>,
    pub(crate) now: bool,
}

impl Options {
    /// The options of a motion, which another one may blend with.
    pub(crate) fn of_motion(keywords: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::read(&Keywords::of(
            keywords,
            &["speed", "blend", "until", "now"],
        )?)
    }

    /// The options of any other activity.
    pub(crate) fn without_blend(keywords: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::read(&Keywords::of(keywords, &["speed", "until", "now"])?)
    }

    fn read(keywords: &Keywords<'_, '_>) -> PyResult<Self> {
        let until = keywords.get::<Bound<'_, PyAny>>("until")?;
        Ok(Self {
            speed: keywords.get("speed")?,
            blend: keywords.get("blend")?,
            until: until.map_or_else(|| Ok(Vec::new()), |until| conditions(&until))?,
            now: keywords.get("now")?.unwrap_or(false),
        })
    }
}

/// Conditions by name.
fn conditions(until: &Bound<'_, PyAny>) -> PyResult<Vec<(String, takt_api::Condition)>> {
    let not_named = || {
        let text = "until is a dict of conditions by name: {\"touch\": abs(arm.force.z) > 5}";
        PyTypeError::new_err(text)
    };
    let until = until.cast::<PyMapping>().map_err(|_| not_named())?;
    let one = |item: Bound<'_, PyAny>| {
        let (name, condition) = item.extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>()?;
        let name = name.extract::<String>().map_err(|_| not_named())?;
        let Ok(condition) = condition.cast::<Condition>() else {
            let kind = condition.get_type();
            let text = format!("until[\"{name}\"] is a {}, not a Condition", kind.name()?);
            return Err(PyTypeError::new_err(text));
        };
        Ok((name, condition.get().0.clone()))
    };
    until.items()?.iter().map(one).collect()
}
