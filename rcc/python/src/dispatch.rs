//! Calls into Python when an activity ends: one thread wakes tasks of asyncio, another calls the program's callbacks, so
//! that a callback that sleeps delays only other callbacks. No lock of the API is held in a call.

use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Wake, Waker};

use pyo3::prelude::*;

use crate::handle::Begun;

/// A callback that waits for the end of an activity.
struct Pending {
    handle: Arc<Begun>,
    callback: Mutex<Option<Py<PyAny>>>,
    ready: Sender<Arc<Self>>,
}

impl Wake for Pending {
    fn wake(self: Arc<Self>) {
        let ready = self.ready.clone();
        // The receiver lives as long as its process.
        let _ = ready.send(self);
    }
}

/// A thread that calls Python, by the process that it belongs to.
pub(crate) struct Dispatcher {
    name: &'static str,
    thread: Mutex<Option<(u32, Sender<Arc<Pending>>)>>,
}

/// Wakes tasks of asyncio.
pub(crate) static TASKS: Dispatcher = Dispatcher::new("takt-tasks");
/// Calls the program's callbacks.
pub(crate) static CALLBACKS: Dispatcher = Dispatcher::new("takt-callbacks");

impl Dispatcher {
    const fn new(name: &'static str) -> Self {
        let thread = Mutex::new(None);
        Self { name, thread }
    }

    /// Lets the thread call `callback` once, without arguments, when the activity has ended.
    pub(crate) fn on_end(&self, handle: Arc<Begun>, callback: Py<PyAny>) -> std::io::Result<()> {
        let ready = self.sender()?;
        let pending = Arc::new(Pending {
            handle,
            callback: Mutex::new(Some(callback)),
            ready,
        });
        pending.wake();
        Ok(())
    }

    fn sender(&self) -> std::io::Result<Sender<Arc<Pending>>> {
        let mut thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        let here = std::process::id();
        if let Some((process, sender)) = &*thread
            && *process == here
        {
            return Ok(sender.clone());
        }
        let (sender, receiver) = channel::<Arc<Pending>>();
        let work = move || receiver.into_iter().for_each(|pending| check(&pending));
        std::thread::Builder::new()
            .name(self.name.to_owned())
            .spawn(work)?;
        *thread = Some((here, sender.clone()));
        Ok(sender)
    }
}

/// Calls the callback if the activity has ended; else it is woken again.
fn check(pending: &Arc<Pending>) {
    let waker = Waker::from(Arc::clone(pending));
    let context = Context::from_waker(&waker);
    if pending.handle.poll_outcome(&context).is_pending() {
        return;
    }
    let callback = pending
        .callback
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .take();
    let Some(callback) = callback else {
        return;
    };
    // Without an interpreter there is no callback to call.
    Python::try_attach(|py| {
        if let Err(error) = callback.call0(py) {
            error.write_unraisable(py, Some(callback.bind(py)));
        }
    });
}
