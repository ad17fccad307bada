//! The cells of a fleet, by their names.

use std::path::PathBuf;
use std::sync::Arc;

use pyo3::prelude::*;
use takt_api as api;

use crate::cell::Cell;
use crate::error;
use crate::owned::Owned;
use crate::wait::call;

/// A connection to a fleet.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Fleet {
    fleet: Owned<Arc<api::Fleet>>,
}

/// Connects to a fleet.
#[pyfunction]
#[pyo3(signature = (*endpoints, ca=None, certificate=None, key=None))]
pub(crate) fn fleet(
    py: Python<'_>,
    endpoints: Vec<String>,
    ca: Option<PathBuf>,
    certificate: Option<PathBuf>,
    key: Option<PathBuf>,
) -> PyResult<Fleet> {
    let tls = match (ca, certificate, key) {
        (None, None, None) => None,
        (Some(ca), Some(certificate), Some(key)) => Some(api::TlsFiles {
            ca,
            certificate,
            key,
        }),
        _ => return Err(error::invalid(py, "give ca, certificate and key together")),
    };
    let connect = move || {
        let endpoints = endpoints.iter().map(String::as_str);
        match tls {
            Some(tls) => api::Fleet::connect_with(endpoints, tls),
            None => api::Fleet::connect(endpoints),
        }
    };
    let fleet = call(py, connect)?.map_err(|error| error::raise_here(py, &error))?;
    Ok(Fleet {
        fleet: Owned::new(Arc::new(fleet)),
    })
}

#[pymethods]
impl Fleet {
    /// Names of the cells that are alive and can be reached.
    fn cells(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        let fleet = Arc::clone(self.fleet.get(py)?);
        call(py, move || fleet.cells())?.map_err(|error| error::raise_here(py, &error))
    }

    /// Connects to a cell by its name.
    fn __getitem__(&self, py: Python<'_>, name: String) -> PyResult<Cell> {
        let fleet = Arc::clone(self.fleet.get(py)?);
        Cell::opened(py, call(py, move || fleet.cell(&name))?)
    }
}
