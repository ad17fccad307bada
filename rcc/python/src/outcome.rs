//! How activities end.

use pyo3::prelude::*;
use takt_api::Outcome as Native;

/// How an activity ended.
#[pyclass(frozen, eq, hash, module = "takt", from_py_object)]
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Outcome {
    /// `completed`, `cancelled`, `maintaining`, `skipped`, `taken_over` or `stopped`.
    #[pyo3(get)]
    kind: &'static str,
    /// The name of the condition that stopped it, else `None`.
    #[pyo3(get)]
    name: Option<String>,
}

impl Outcome {
    const fn plain(kind: &'static str) -> Self {
        Self { kind, name: None }
    }
}

impl From<Native> for Outcome {
    fn from(outcome: Native) -> Self {
        match outcome {
            Native::Completed => Self::plain("completed"),
            Native::Cancelled => Self::plain("cancelled"),
            Native::Maintaining => Self::plain("maintaining"),
            Native::Skipped => Self::plain("skipped"),
            Native::TakenOver => Self::plain("taken_over"),
            Native::Stopped(name) => Self::Stopped(name),
        }
    }
}

#[pymethods]
impl Outcome {
    #[classattr]
    #[pyo3(name = "Completed")]
    const COMPLETED: Self = Self::plain("completed");
    #[classattr]
    #[pyo3(name = "Cancelled")]
    const CANCELLED: Self = Self::plain("cancelled");
    #[classattr]
    #[pyo3(name = "Maintaining")]
    const MAINTAINING: Self = Self::plain("maintaining");
    #[classattr]
    #[pyo3(name = "Skipped")]
    const SKIPPED: Self = Self::plain("skipped");
    #[classattr]
    #[pyo3(name = "TakenOver")]
    const TAKEN_OVER: Self = Self::plain("taken_over");
    #[classattr]
    #[expect(non_upper_case_globals, reason = "the name is that of Python")]
    const __match_args__: (&'static str, &'static str) = ("kind", "name");

    /// The condition of this name stopped it.
    #[staticmethod]
    #[expect(non_snake_case, reason = "the name of the variant in Rust")]
    fn Stopped(name: String) -> Self {
        let (kind, name) = ("stopped", Some(name));
        Self { kind, name }
    }

    /// Whether the condition of this name stopped the activity.
    fn is_stopped_by(&self, name: &str) -> bool {
        self.name.as_deref() == Some(name)
    }

    pub(crate) fn __repr__(&self) -> String {
        match (self.kind, &self.name) {
            ("completed", _) => "Outcome.Completed".to_owned(),
            ("cancelled", _) => "Outcome.Cancelled".to_owned(),
            ("maintaining", _) => "Outcome.Maintaining".to_owned(),
            ("skipped", _) => "Outcome.Skipped".to_owned(),
            ("taken_over", _) => "Outcome.TakenOver".to_owned(),
            (_, name) => format!("Outcome.Stopped('{}')", name.as_deref().unwrap_or_default()),
        }
    }
}
