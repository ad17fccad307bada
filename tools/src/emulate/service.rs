//! A thread that serves an emulated device until it is stopped.

use std::sync::atomic::Ordering;

use anyhow::Context as _;
use takt_rt::thread::{Stoppable, ThreadConfig};

/// An emulated device in a thread of its own.
pub(crate) struct Service<T>(Stoppable<anyhow::Result<T>>);

impl<T: Send + 'static> Service<T> {
    /// Serves it in turns; a turn waits briefly for input.
    pub(crate) fn start(
        name: &str,
        mut served: T,
        mut turn: impl FnMut(&mut T) -> anyhow::Result<()> + Send + 'static,
    ) -> anyhow::Result<Self> {
        // Above drivers: the real device has a processor of its own.
        let config = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new(name)
        };
        let thread = Stoppable::spawn(config, move |stop| {
            while !stop.load(Ordering::Relaxed) {
                turn(&mut served)?;
            }
            Ok(served)
        });
        thread
            .map(Self)
            .with_context(|| format!("cannot start thread {name}"))
    }

    /// An error if it ended by itself.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        anyhow::ensure!(!self.0.is_finished(), "the emulated device ended by itself");
        Ok(())
    }

    /// Ends the thread and returns the device.
    pub(crate) fn stop(self) -> anyhow::Result<T> {
        match self.0.stop() {
            Ok(served) => served,
            Err(_) => anyhow::bail!("the emulated device ended by a panic"),
        }
    }
}
