//! Arrays of numpy. Values are copied in and out; nothing is borrowed.

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;

/// The numpy array of a list, or of a list of lists.
pub(crate) fn array<'py>(
    py: Python<'py>,
    values: impl IntoPyObject<'py>,
) -> PyResult<Bound<'py, PyAny>> {
    static ARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let array = ARRAY.get_or_try_init(py, || {
        Ok::<_, PyErr>(py.import("numpy")?.getattr("array")?.unbind())
    })?;
    array.bind(py).call1((values, "float64"))
}
