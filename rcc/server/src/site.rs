//! What all connections of one server share: the controller, the gate, the sessions, the log, and counters of
//! what goes on. It serves nobody itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use takt_core::{Controller, OnLoss};
use tokio::time::Instant;

use crate::access::Gate;
use crate::access::origin::Origins;
use crate::log::{LineLimit, LogBook};
use crate::sessions::Sessions;

/// What all connections of one server share. Clones are the same site.
#[derive(Clone, Debug)]
pub(crate) struct Site {
    pub(crate) controller: Controller,
    pub(crate) gate: Arc<Gate>,
    /// Pages and names of this host that are accepted.
    pub(crate) origins: Arc<Origins>,
    /// What becomes of sessions that do not say otherwise; `None`: as their client needs it.
    pub(crate) on_loss: Option<OnLoss>,
    pub(crate) sessions: Sessions,
    pub(crate) log: LogBook,
    pub(crate) counters: Arc<Counters>,
    pub(crate) limits: Arc<Limits>,
    /// What all times count from.
    pub(crate) begin: Instant,
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
    pub(crate) fn new(controller: Controller, gate: Gate, log: LogBook) -> Self {
        Self {
            controller,
            gate: Arc::new(gate),
            origins: Arc::default(),
            on_loss: None,
            sessions: Sessions::default(),
            log,
            counters: Arc::default(),
            limits: Arc::default(),
            begin: Instant::now(),
            stop: None,
        }
    }

    /// The same, with the stop channel that the page may use.
    pub(crate) fn with_stop(mut self, stop: Option<StopPort>) -> Self {
        self.stop = stop.map(Arc::new);
        self
    }

    /// Time since the server began.
    pub(crate) fn now(&self) -> Duration {
        self.begin.elapsed()
    }

    /// Logs what a client caused, as long as there are not too many such lines.
    pub(crate) fn warn(&self, kind: impl Fn(&Limits) -> &LineLimit, line: &str) {
        match kind(&self.limits).admit(self.now()) {
            None => {}
            Some(0) => tracing::warn!("{line}"),
            Some(more) => tracing::warn!("{line} ({more} such lines before were not logged)"),
        }
    }

    /// Logs how many lines were left out, of kinds that have become quiet.
    pub(crate) fn flush_log(&self) {
        let limits = &self.limits;
        for (what, limit) in [
            ("connections without a place", &limits.places),
            ("connections that failed", &limits.failures),
            ("refused clients", &limits.denials),
        ] {
            if let Some(more) = limit.flush(self.now()) {
                tracing::warn!("{more} lines about {what} were not logged");
            }
        }
    }
}

/// Limits of lines in the log, by what they are about.
#[derive(Debug, Default)]
pub(crate) struct Limits {
    /// Connections that are refused or displaced, or cannot be accepted.
    pub(crate) places: LineLimit,
    /// Connections that end by an error.
    pub(crate) failures: LineLimit,
    /// Tokens, hosts, origins and first lines that are refused.
    pub(crate) denials: LineLimit,
}

/// What goes on at a server.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    /// Connections there are.
    pub(crate) clients: AtomicU64,
    /// Connections that were taken so far.
    pub(crate) connections: AtomicU64,
    /// Connections for which there was no room, or that had to leave for others.
    pub(crate) refused: AtomicU64,
    /// Requests over HTTP.
    pub(crate) requests: AtomicU64,
    /// DirectIO messages that came.
    pub(crate) received: AtomicU64,
    /// DirectIO messages that were sent.
    pub(crate) sent: AtomicU64,
    /// Tokens that were missing or wrong, or came too often; pages, hosts and first lines that were refused.
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
