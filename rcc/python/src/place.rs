//! The line of the program that called: errors name it, also those that are found long after the call.

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyString;

/// A line of a Python file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) file: String,
    pub(crate) line: u32,
}

impl Place {
    /// The innermost line that is not of this package; `None` in a thread without Python code.
    pub(crate) fn caller(py: Python<'_>) -> Option<Self> {
        static GET_FRAME: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
        static PACKAGE: PyOnceLock<String> = PyOnceLock::new();
        let get_frame = GET_FRAME
            .get_or_try_init(py, || {
                Ok::<_, PyErr>(py.import("sys")?.getattr("_getframe")?.unbind())
            })
            .ok()?;
        let package = PACKAGE
            .get_or_try_init(py, || {
                let paths = py.import("takt")?.getattr("__path__")?;
                paths.get_item(0)?.extract::<String>()
            })
            .ok()?;
        let mut frame = get_frame.bind(py).call0().ok()?;
        loop {
            let code = frame.getattr("f_code").ok()?;
            let file = code.getattr("co_filename").ok()?;
            let file = file.cast::<PyString>().ok()?.to_string();
            if !file.starts_with(package.as_str()) {
                let line = frame.getattr("f_lineno").ok()?.extract().ok()?;
                return Some(Self { file, line });
            }
            frame = frame.getattr("f_back").ok().filter(|f| !f.is_none())?;
        }
    }
}
