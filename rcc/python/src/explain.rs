//! What activities become.

use pyo3::prelude::*;
use takt_api as api;

use crate::plan::Plan;

/// What an activity becomes if it is begun.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Explanation(pub(crate) api::Explanation);

/// Worst-case cost of a net.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Cost(api::Cost);

#[pymethods]
impl Explanation {
    /// The text of its net.
    #[getter]
    fn net(&self) -> &str {
        &self.0.net
    }

    /// What it follows, what it permits, and what ends it.
    #[getter]
    fn rules(&self) -> Vec<String> {
        self.0.rules.clone()
    }

    /// What it costs in each cycle.
    #[getter]
    const fn cost(&self) -> Cost {
        Cost(self.0.cost)
    }

    /// Its course, if that is known before it runs.
    #[getter]
    fn plan(&self) -> Option<Plan> {
        self.0.plan.clone().map(Plan)
    }

    /// Its plan as a picture, an SVG file.
    fn svg(&self) -> Option<String> {
        self.0.svg()
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        format!("Explanation({})", self.0.cost)
    }
}

#[pymethods]
impl Cost {
    /// Longest time that its evaluation takes in one cycle, s.
    #[getter]
    fn cycle(&self) -> f64 {
        self.0.cycle.as_secs_f64()
    }

    /// Its period, s.
    #[getter]
    fn period(&self) -> f64 {
        self.0.period.as_secs_f64()
    }

    /// Time of a period that all nets of its thread may take together, s.
    #[getter]
    fn budget(&self) -> f64 {
        self.0.budget.as_secs_f64()
    }

    /// Number of its primitives.
    #[getter]
    const fn primitives(&self) -> u32 {
        self.0.primitives
    }

    /// Part of the period that it takes, above 0.
    #[getter]
    fn share(&self) -> f64 {
        self.0.share()
    }

    fn __repr__(&self) -> String {
        format!("Cost({})", self.0)
    }
}
