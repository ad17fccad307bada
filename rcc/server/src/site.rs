//! What all connections of one server share: the controller, the gate, the log, and counters of what
//! goes on. It serves nobody itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use takt_core::{Controller, OnLoss};

use crate::access::{Gate, Token};
use crate::log::LogBook;

/// What all connections of one server share. Clones are the same site.
#[derive(Clone, Debug)]
pub(crate) struct Site {
    pub(crate) controller: Controller,
    pub(crate) gate: Arc<Gate>,
    /// What becomes of sessions that do not say otherwise.
    pub(crate) on_loss: OnLoss,
    pub(crate) log: LogBook,
    pub(crate) counters: Arc<Counters>,
    pub(crate) stop: Option<Arc<StopPort>>,
}

/// The port of the stop channel and the key by which the page, which only admitted clients get, may use it.
#[derive(Clone)]
pub struct StopPort {
    pub(crate) port: u16,
    pub(crate) key: String,
}

impl StopPort {
    /// A channel at that port of this host, with that key.
    #[must_use]
    pub fn new(port: u16, key: &str) -> Self {
        let key = key.to_owned();
        Self { port, key }
    }
}

impl std::fmt::Debug for StopPort {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "StopPort({})", self.port)
    }
}

impl Site {
    pub(crate) fn new(
        controller: Controller,
        token: Option<Token>,
        on_loss: OnLoss,
        log: LogBook,
    ) -> Self {
        Self {
            controller,
            gate: Arc::new(Gate::new(token)),
            on_loss,
            log,
            counters: Arc::default(),
            stop: None,
        }
    }

    /// The same, with the stop channel that the page may use.
    pub(crate) fn with_stop(mut self, stop: Option<StopPort>) -> Self {
        self.stop = stop.map(Arc::new);
        self
    }
}

/// What goes on at a server.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    /// Connections there are.
    pub(crate) clients: AtomicU64,
    /// Connections that were taken so far.
    pub(crate) connections: AtomicU64,
    /// Connections for which there was no room.
    pub(crate) refused: AtomicU64,
    /// Requests over HTTP.
    pub(crate) requests: AtomicU64,
    /// DirectIO messages that came.
    pub(crate) received: AtomicU64,
    /// DirectIO messages that were sent.
    pub(crate) sent: AtomicU64,
    /// Tokens that were missing or wrong, or came too often.
    pub(crate) denied: AtomicU64,
}

impl Counters {
    /// Adds to one of the counters.
    pub(crate) fn add(counter: &AtomicU64, amount: u64) {
        counter.fetch_add(amount, Ordering::Relaxed);
    }

    /// Reads one of the counters.
    pub(crate) fn read(counter: &AtomicU64) -> u64 {
        counter.load(Ordering::Relaxed)
    }
}
