//! Values that hold the connection, for as long as Python refers to them. Dropping one can wait for the controller, so
//! a thread without the interpreter's lock drops them. In a process that was forked they are neither used nor dropped:
//! the connection is the parent's, and its end would stop the parent's robots.

use std::any::Any;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Mutex, PoisonError};

use pyo3::prelude::*;

use crate::error;

/// A value of the process that made it.
#[derive(Debug)]
pub(crate) struct Owned<T: Send + 'static> {
    value: Option<T>,
    process: u32,
}

impl<T: Send + 'static> Owned<T> {
    pub(crate) fn new(value: T) -> Self {
        Self {
            value: Some(value),
            process: std::process::id(),
        }
    }

    /// The value, unless this process is a fork of the one that made it.
    pub(crate) fn get(&self, py: Python<'_>) -> PyResult<&T> {
        let is_here = self.process == std::process::id();
        self.value
            .as_ref()
            .filter(|_| is_here)
            .ok_or_else(|| error::forked(py))
    }
}

impl<T: Send + 'static> Drop for Owned<T> {
    fn drop(&mut self) {
        let Some(value) = self.value.take() else {
            return;
        };
        if self.process == std::process::id() {
            drop_elsewhere(Box::new(value));
        } else {
            std::mem::forget(value);
        }
    }
}

type Dropped = Box<dyn Any + Send>;

/// The thread that drops values, by its process.
static DROPPER: Mutex<Option<(u32, Sender<Dropped>)>> = Mutex::new(None);

fn drop_elsewhere(value: Dropped) {
    let mut dropper = DROPPER.lock().unwrap_or_else(PoisonError::into_inner);
    let here = std::process::id();
    if dropper.as_ref().is_none_or(|(process, _)| *process != here) {
        let (sender, receiver) = channel::<Dropped>();
        let work = move || receiver.into_iter().for_each(drop);
        let thread = std::thread::Builder::new().name("takt-drop".to_owned());
        // Without a thread the value is dropped with the channel, here.
        let started = thread.spawn(work).is_ok();
        *dropper = started.then_some((here, sender));
    }
    if let Some((_, sender)) = &*dropper {
        // The receiver lives as long as its process.
        let _ = sender.send(value);
    }
}
