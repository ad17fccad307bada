//! Blocking calls without the interpreter's lock, which signals interrupt.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use pyo3::prelude::*;

use crate::error;

/// How often a waiting thread checks for signals, such as that of Ctrl-C.
const SLICE: Duration = Duration::from_millis(20);

/// Longest timeout, s; more is as good as none.
const TIMEOUT_MAX: f64 = 1e9;

/// Waits by `poll`, which waits at most for the time that it is passed, until it has a result or `timeout` is over.
pub(crate) fn wait<T: Send>(
    py: Python<'_>,
    timeout: Option<Duration>,
    poll: impl Fn(Duration) -> Option<T> + Sync,
) -> PyResult<Option<T>> {
    let until = timeout.map(|timeout| Instant::now() + timeout);
    loop {
        let left = until.map(|until| until.saturating_duration_since(Instant::now()));
        let slice = left.map_or(SLICE, |left| left.min(SLICE));
        let found = py.detach(|| poll(slice));
        if found.is_some() || left.is_some_and(|left| left.is_zero()) {
            return Ok(found);
        }
        py.check_signals()?;
    }
}

/// Waits for a call that cannot be interrupted, in a thread of its own. After a signal the call goes on without its caller.
pub(crate) fn call<T: Send + 'static>(
    py: Python<'_>,
    call: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    let (sender, receiver) = channel();
    let work = move || {
        // The caller may have been interrupted.
        let _ = sender.send(call());
    };
    let thread = std::thread::Builder::new().name("takt-call".to_owned());
    thread.spawn(work)?;
    let receiver = std::sync::Mutex::new(receiver);
    let result = wait(py, None, |slice| {
        let receiver = receiver.lock().ok()?;
        match receiver.recv_timeout(slice) {
            Ok(value) => Some(Some(value)),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => Some(None),
        }
    })?;
    let ended = || error::invalid(py, "the thread of the call ended without a result");
    result.flatten().ok_or_else(ended)
}

/// A time in seconds as Python passes it.
pub(crate) fn seconds(py: Python<'_>, name: &str, value: f64) -> PyResult<Duration> {
    if value.is_nan() || value < 0.0 {
        let text = format!("{name} is {value} s; it is at least 0");
        return Err(error::invalid(py, text));
    }
    Ok(Duration::from_secs_f64(value.min(TIMEOUT_MAX)))
}
