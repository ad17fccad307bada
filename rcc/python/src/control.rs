//! Control modes of arms.

use pyo3::prelude::*;
use takt_api as api;

/// How an arm is controlled.
#[pyclass(frozen, eq, module = "takt")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Control(pub(crate) api::Control);

#[pymethods]
impl Control {
    /// The arm follows positions, whatever pushes it.
    #[staticmethod]
    const fn position() -> Self {
        Self(api::Control::position())
    }

    /// Springs at the joints.
    #[staticmethod]
    fn joints(stiffness: Vec<f64>, damping: Vec<f64>) -> Self {
        Self(api::Control::joints(stiffness, damping))
    }

    /// Springs at the tool.
    #[staticmethod]
    const fn cartesian(stiffness: [f64; 6], damping: [f64; 6]) -> Self {
        Self(api::Control::cartesian(stiffness, damping))
    }
}
