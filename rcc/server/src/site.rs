//! State shared by all connections of one server: the controller, the gate, the sessions, the log and the counters.
//! It serves no connection itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use takt_core::{Controller, OnLoss};
use tokio::time::Instant;

use crate::access::Gate;
use crate::access::origin::Origins;
use crate::host_program::HostProgram;
use crate::log::{LineLimit, LogBook};
use crate::sessions::Sessions;

/// State shared by all connections of one server. Clones share it.
#[derive(Clone, Debug)]
pub(crate) struct Site {
    pub(crate) controller: Controller,
    pub(crate) gate: Arc<Gate>,
    /// Page origins and host names that are accepted.
    pub(crate) origins: Arc<Origins>,
    /// What happens to sessions of a lost client by default; `None`: depends on the client.
    pub(crate) on_loss: Option<OnLoss>,
    pub(crate) sessions: Sessions,
    pub(crate) log: LogBook,
    pub(crate) counters: Arc<Counters>,
    pub(crate) limits: Arc<Limits>,
    /// Origin of all times.
    pub(crate) begin: Instant,
    pub(crate) stop: Option<Arc<StopPort>>,
    /// The program that runs the server, if it adds something.
    pub(crate) program: Option<Arc<dyn HostProgram>>,
}

/// The port of the stop channel and the key that permits its use by the page, which only admitted clients get.
#[derive(Clone)]
pub struct StopPort {
    pub(crate) port: u16,
    pub(crate) key: String,
}

impl StopPort {
    /// A stop channel at this port of this host, with this key.
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
            program: None,
        }
    }

    /// The same, with the stop channel that the page may use.
    pub(crate) fn with_stop(mut self, stop: Option<StopPort>) -> Self {
        self.stop = stop.map(Arc::new);
        self
    }

    /// Time since the server started.
    pub(crate) fn now(&self) -> Duration {
        self.begin.elapsed()
    }

    /// Logs a line that a client caused, within the rate limit of its kind.
    pub(crate) fn warn(&self, kind: impl Fn(&Limits) -> &LineLimit, line: &str) {
        match kind(&self.limits).admit(self.now()) {
            None => {}
            Some(0) => tracing::warn!("{line}"),
            Some(more) => tracing::warn!("{line} ({more} earlier lines of this kind suppressed)"),
        }
    }

    /// Logs how many lines were suppressed, for kinds whose window is over.
    pub(crate) fn flush_log(&self) {
        let limits = &self.limits;
        for (subject, limit) in [
            ("connections without a slot", &limits.slots),
            ("failed connections", &limits.failures),
            ("rejected clients", &limits.denials),
            ("scopes that lose samples", &limits.scopes),
            ("meshes that cannot be drawn", &limits.meshes),
        ] {
            if let Some(more) = limit.flush(self.now()) {
                tracing::warn!("{more} lines about {subject} suppressed");
            }
        }
    }
}

/// Rate limits of the log, by kind of line.
#[derive(Debug, Default)]
pub(crate) struct Limits {
    /// Connections that are rejected or evicted, or cannot be accepted.
    pub(crate) slots: LineLimit,
    /// Connections that end with an error.
    pub(crate) failures: LineLimit,
    /// Tokens, hosts, origins and first lines that are rejected.
    pub(crate) denials: LineLimit,
    /// Clients of the scope that lose samples.
    pub(crate) scopes: LineLimit,
    /// Meshes that cannot be drawn.
    pub(crate) meshes: LineLimit,
}

/// Counters of one server.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    /// Open connections.
    pub(crate) clients: AtomicU64,
    /// Connections accepted so far.
    pub(crate) connections: AtomicU64,
    /// Connections rejected because all slots were in use, or evicted in favour of others.
    pub(crate) refused: AtomicU64,
    /// HTTP requests.
    pub(crate) requests: AtomicU64,
    /// DirectIO messages received.
    pub(crate) received: AtomicU64,
    /// DirectIO messages sent.
    pub(crate) sent: AtomicU64,
    /// Tokens that were missing, wrong or sent too often; pages, hosts and first lines that were rejected.
    pub(crate) denied: AtomicU64,
    /// Messages that slow clients of live data lost.
    pub(crate) live_dropped: AtomicU64,
    /// Rows that were overwritten before they were read for live data.
    pub(crate) live_lost: AtomicU64,
    /// Datagrams of samples that could not be sent.
    pub(crate) datagrams_failed: AtomicU64,
    /// Samples that are missing in datagrams.
    pub(crate) datagrams_lost: AtomicU64,
    /// Samples that clients of the scope lost.
    pub(crate) scope_lost: AtomicU64,
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
