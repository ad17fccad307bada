//! Signals that ask a command to stop, for commands without an event loop.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use anyhow::Context as _;
use tokio::signal::unix::{SignalKind, signal};

/// A request to stop: SIGINT (Ctrl-C) or SIGTERM.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stop(Arc<AtomicU32>);

impl Stop {
    /// Handles both signals from now on.
    pub(crate) fn listen() -> anyhow::Result<Self> {
        let stop = Self::default();
        let flag = stop.clone();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let mut terminate = {
            let _inside = runtime.enter();
            signal(SignalKind::terminate()).context("cannot listen for signals")?
        };
        let mut interrupt = {
            let _inside = runtime.enter();
            signal(SignalKind::interrupt()).context("cannot listen for signals")?
        };
        std::thread::spawn(move || {
            runtime.block_on(async {
                loop {
                    tokio::select! {
                        _ = interrupt.recv() => {}
                        _ = terminate.recv() => {}
                    }
                    flag.0.fetch_add(1, Ordering::Relaxed);
                }
            });
        });
        Ok(stop)
    }

    pub(crate) fn is_requested(&self) -> bool {
        self.requests() > 0
    }

    /// Requests it as a signal does.
    #[cfg(feature = "fleet")]
    pub(crate) fn request(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of requests so far.
    pub(crate) fn requests(&self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }
}
