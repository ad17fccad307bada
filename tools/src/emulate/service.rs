//! A thread that serves an emulated device until it is stopped.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use takt_rt::thread::{Thread, ThreadConfig};

/// An emulated device in a thread of its own.
pub(crate) struct Service<T> {
    thread: Thread<anyhow::Result<T>>,
    stop: Arc<AtomicBool>,
}

impl<T: Send + 'static> Service<T> {
    /// Serves it in turns; a turn waits briefly for input.
    pub(crate) fn start(
        name: &str,
        mut served: T,
        mut turn: impl FnMut(&mut T) -> anyhow::Result<()> + Send + 'static,
    ) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        // Above drivers: the real device has a processor of its own.
        let config = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new(name)
        };
        let thread = takt_rt::thread::spawn(config, move || {
            while !stopping.load(Ordering::Relaxed) {
                turn(&mut served)?;
            }
            Ok(served)
        })
        .with_context(|| format!("cannot start thread {name}"))?;
        Ok(Self { thread, stop })
    }

    /// An error if it ended by itself.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        anyhow::ensure!(
            !self.thread.is_finished(),
            "the emulated device ended by itself"
        );
        Ok(())
    }

    /// Ends the thread and returns the device.
    pub(crate) fn stop(self) -> anyhow::Result<T> {
        self.stop.store(true, Ordering::Relaxed);
        match self.thread.join() {
            Ok(served) => served,
            Err(_) => anyhow::bail!("the emulated device ended by a panic"),
        }
    }
}
