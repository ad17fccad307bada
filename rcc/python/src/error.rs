//! Errors of the API as exceptions of `takt.Error`'s tree. Texts are those of the API; the classes are Python, since the
//! stable interface of the interpreter cannot derive from its exceptions before 3.12.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use takt_api::{Error, ErrorKind};

use crate::place::Place;

/// The exception for an error, with the line of the program that began what failed.
pub(crate) fn raise(py: Python<'_>, error: &Error, place: Option<&Place>) -> PyErr {
    of_kind(py, &error.kind, place)
}

fn of_kind(py: Python<'_>, kind: &ErrorKind, place: Option<&Place>) -> PyErr {
    instance(py, kind, place).map_or_else(|failed| failed, PyErr::from_value)
}

/// The same for an error that concerns the line that is being executed.
pub(crate) fn raise_here(py: Python<'_>, error: &Error) -> PyErr {
    raise(py, error, Place::caller(py).as_ref())
}

/// An argument that is out of its bounds.
pub(crate) fn invalid(py: Python<'_>, text: impl Into<String>) -> PyErr {
    of_kind(
        py,
        &ErrorKind::Invalid(text.into()),
        Place::caller(py).as_ref(),
    )
}

/// The use of a connection in a process that does not have it.
pub(crate) fn forked(py: Python<'_>) -> PyErr {
    invalid(
        py,
        "the connection belongs to the process before the fork\nhint: connect in the process that moves robots",
    )
}

/// Whether an exception is one of this package.
pub(crate) fn is_of_package(error: &PyErr, py: Python<'_>) -> bool {
    let class = py
        .import("takt._errors")
        .and_then(|errors| errors.getattr("Error"));
    class.is_ok_and(|class| error.is_instance(py, &class))
}

/// The end of a timeout.
pub(crate) fn timeout(py: Python<'_>, seconds: f64, place: Option<&Place>) -> PyErr {
    let text = format!(
        "the activity has not ended after {seconds} s and goes on\nhint: `cancel()` ends it"
    );
    let attributes = PyDict::new(py);
    make(py, "Timeout", &text, &attributes, place).map_or_else(|failed| failed, PyErr::from_value)
}

#[expect(
    clippy::too_many_lines,
    reason = "a table of errors and their attributes"
)]
fn instance<'py>(
    py: Python<'py>,
    error: &ErrorKind,
    place: Option<&Place>,
) -> PyResult<Bound<'py, PyAny>> {
    let attributes = PyDict::new(py);
    let class = match error {
        ErrorKind::Connection(_) => "Connection",
        ErrorKind::Lost(_) => "Lost",
        ErrorKind::Invalid(_) => "Invalid",
        ErrorKind::Limit {
            joint,
            value,
            min,
            max,
        } => {
            attributes.set_item("joint", joint)?;
            attributes.set_item("value", value)?;
            attributes.set_item("min", min)?;
            attributes.set_item("max", max)?;
            "Limit"
        }
        ErrorKind::NoDevice { name, .. } => {
            attributes.set_item("name", name)?;
            "NoDevice"
        }
        ErrorKind::NotConnected { frames } => {
            attributes.set_item("frames", frames.to_vec())?;
            "NotConnected"
        }
        ErrorKind::NoPort { device, port, .. } => {
            attributes.set_item("device", device)?;
            attributes.set_item("port", port)?;
            "NoPort"
        }
        ErrorKind::Rejected(faults) => {
            attributes.set_item("faults", faults.clone())?;
            "Rejected"
        }
        ErrorKind::Refused(_) => "Refused",
        ErrorKind::Conflict {
            device,
            joint,
            holder,
        } => {
            attributes.set_item("device", device)?;
            attributes.set_item("joint", joint)?;
            attributes.set_item("holder", holder)?;
            "Conflict"
        }
        ErrorKind::Unreachable {
            device, progress, ..
        } => {
            attributes.set_item("device", device)?;
            attributes.set_item("progress", progress / 100.0)?;
            "Unreachable"
        }
        ErrorKind::DeviceFailed { device, cause, .. } => {
            attributes.set_item("device", device)?;
            attributes.set_item("cause", cause)?;
            "DeviceFailed"
        }
        ErrorKind::Version { address, reason } => {
            attributes.set_item("address", address)?;
            attributes.set_item("reason", reason)?;
            "Version"
        }
        ErrorKind::TooFast {
            device,
            joint,
            progress,
            velocity,
            limit,
            speed,
        } => {
            attributes.set_item("device", device)?;
            attributes.set_item("joint", joint)?;
            attributes.set_item("progress", progress / 100.0)?;
            attributes.set_item("velocity", velocity)?;
            attributes.set_item("limit", limit)?;
            attributes.set_item("speed", speed)?;
            "TooFast"
        }
        ErrorKind::Stale { device, cause } => {
            attributes.set_item("device", device)?;
            attributes.set_item("cause", cause)?;
            "Stale"
        }
        ErrorKind::Callback(_) => "Callback",
        ErrorKind::Unplanned { device, cause } => {
            attributes.set_item("device", device)?;
            attributes.set_item("cause", cause)?;
            "Unplanned"
        }
        ErrorKind::Unsupported {
            device,
            wanted,
            cause,
        } => {
            attributes.set_item("device", device)?;
            attributes.set_item("wanted", wanted)?;
            attributes.set_item("cause", cause)?;
            "Unsupported"
        }
        ErrorKind::ForceNotReached {
            device,
            force,
            travel,
        } => {
            attributes.set_item("device", device)?;
            attributes.set_item("force", force)?;
            attributes.set_item("travel", travel)?;
            "ForceNotReached"
        }
        ErrorKind::ContactLost { device } => {
            attributes.set_item("device", device)?;
            "ContactLost"
        }
        ErrorKind::ForceExceeded { device, limit } => {
            attributes.set_item("device", device)?;
            attributes.set_item("limit", limit)?;
            "ForceExceeded"
        }
        ErrorKind::Deviation {
            device,
            place,
            joint,
            deviation,
        } => {
            attributes.set_item("device", device)?;
            attributes.set_item("place", place)?;
            attributes.set_item("joint", joint)?;
            attributes.set_item("deviation", deviation)?;
            "Deviation"
        }
        ErrorKind::PredecessorFailed(before) => {
            attributes.set_item("error", instance(py, before, None)?)?;
            "PredecessorFailed"
        }
        ErrorKind::Ended { device, reason, .. } => {
            attributes.set_item("device", device)?;
            attributes.set_item("reason", reason)?;
            "Ended"
        }
        // A kind that this package does not know yet keeps its text.
        _ => "Error",
    };
    make(py, class, &error.to_string(), &attributes, place)
}

fn make<'py>(
    py: Python<'py>,
    class: &str,
    text: &str,
    attributes: &Bound<'py, PyDict>,
    place: Option<&Place>,
) -> PyResult<Bound<'py, PyAny>> {
    if let Some(Place { file, line }) = place {
        attributes.set_item("filename", file)?;
        attributes.set_item("lineno", line)?;
    }
    let class = py.import("takt._errors")?.getattr(class)?;
    class.call((text,), Some(attributes))
}
