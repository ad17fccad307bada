//! What the threads of a member share, and what a program offers to them: [`Cell`]. It starts no thread.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::Value;
use takt_core::Nanos;
use takt_core::tai::Tai;
use zenoh::Wait as _;
use zenoh::query::{ConsolidationMode, Query, QueryTarget};

use crate::command::{Admission, Boot, LossPolicy, Lost};
use crate::keys::CellKeys;
use crate::session::SessionError;

/// Period of telemetry, and of the search for another cell of the same name.
pub const TELEMETRY_PERIOD: Duration = Duration::from_secs(1);

/// Most topics of telemetry of a cell; the others are left out, and the log says so.
pub const TOPICS_MAX: usize = 1024;

/// Lines of the log that late joiners get.
pub const LOG_LINES_KEPT: usize = 256;

/// Queries that wait for a thread; more are refused.
pub(super) const QUEUE: usize = 64;

/// Why a query that finds no place is refused.
pub(super) const TOO_MANY: &str =
    "too many queries wait\nhint: send it again later, and fewer at a time";

/// How long another cell of the same name has for its answer.
const CLASH_TIMEOUT: Duration = Duration::from_millis(500);

/// A topic of telemetry: the rest of its key behind `takt/<cell>/`, and its value now.
pub type Topic = (String, Value);

/// What a controller offers to a fleet. Its functions are called in threads of the member, never in real-time ones. All but
/// [`Self::execute`] must return within a fraction of the life of a nonce.
pub trait Cell: Send + Sync + 'static {
    /// Now on the monotonic clock of the controller.
    fn now(&self) -> Nanos;
    /// What the cell is: version, devices, periods. The member adds its name and the boot id.
    fn info(&self) -> serde_json::Map<String, Value>;
    /// All topics; what has changed since the last call is published.
    fn telemetry(&self) -> Vec<Topic>;
    /// Names of the devices that answer: each has a liveliness token.
    fn devices(&self) -> Vec<String>;
    /// Names of the devices with joints that can be published.
    fn arms(&self) -> Vec<String> {
        Vec::new()
    }
    /// Samples of the joints of these devices since the last call, each a batch. Others are not subscribed to any more.
    fn joints(&self, devices: &[String]) -> Vec<(String, Value)> {
        let _ = devices;
        Vec::new()
    }
    /// Lines of the log from this number on, and the number of the line after them. The first call is with 0.
    fn log(&self, from: u64) -> (Vec<String>, u64);
    /// The resource of this path, such as `nets`.
    ///
    /// # Errors
    /// Why there is none, for people.
    fn resource(&self, path: &str) -> Result<Value, String>;
    /// A session was opened by this client. When it is lost, its nets end as the policy states.
    fn opened(&self, session: u32, client: &str, on_loss: LossPolicy);
    /// Executes a DirectIO line and returns its reply lines, in a thread of the session. It may take long: the session may meanwhile be
    /// lost or closed.
    fn execute(&self, session: u32, line: &str) -> Vec<String>;
    /// Lines that a session was notified of by its subscriptions, in their order, and not yet with a reply; it waits at most so long for the
    /// first. Once this was called, no reply has such lines any more. Called in a thread of the session.
    ///
    /// # Errors
    /// Why the session is notified of nothing any more.
    fn notifications(&self, session: u32, wait: Duration) -> Result<Vec<String>, String> {
        let _ = (session, wait);
        Err("this cell notifies of nothing".to_owned())
    }
    /// A session was closed by its client.
    fn closed(&self, session: u32);
    /// A session was lost: its nets end as it demands.
    fn lost(&self, lost: Lost);
    /// What the cells of one host have in common, as they share its clock; empty if that is not known.
    fn clock_id(&self) -> String {
        String::new()
    }
    /// TAI of the host.
    fn tai(&self) -> Tai {
        Tai::default()
    }
    /// Keeps what these nets need until they begin, in a thread of its own.
    ///
    /// # Errors
    /// Why they cannot be prepared, for people.
    fn prepare_start(&self, nets: &[String]) -> Result<Box<dyn Held>, String> {
        let _ = nets;
        Err("this cell takes part in no coordinated start".to_owned())
    }
}

/// How far nets are that were prepared for a start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HeldState {
    /// Their resources are kept.
    Waiting,
    /// They began in this cycle; instants are those of the controller's `CLOCK_MONOTONIC`.
    Running {
        /// Number of the cycle in its thread.
        cycle: u64,
        /// Its nominal begin.
        begin: Nanos,
        /// When the thread woke for it.
        woken: Nanos,
        /// How they ended: by themselves, or why not; `None` while they run.
        end: Option<Result<(), String>>,
    },
    /// They do not begin.
    Failed(String),
}

/// Nets whose resources a cell keeps for a start. Dropping it before they begin releases them; its functions return soon.
pub trait Held: Send {
    /// Period of the nets.
    fn period(&self) -> Nanos;
    /// Lets them begin in the cycle nearest to this instant of `CLOCK_MONOTONIC`.
    fn begin_at(&mut self, at: Nanos);
    /// How far they are.
    fn state(&mut self) -> HeldState;
    /// A partner of the start is lost while they run.
    fn lose_partner(&mut self, policy: LossPolicy);
}

/// What the threads share.
pub(super) struct Shared {
    pub(super) keys: CellKeys,
    pub(super) boot: Boot,
    pub(super) cell: Arc<dyn Cell>,
    pub(super) admission: Mutex<Admission>,
    pub(super) session: zenoh::Session,
    /// Endpoints to which it connects.
    pub(super) connect: Vec<String>,
    pub(super) ends: AtomicBool,
    pub(super) clashes: AtomicBool,
}

impl Shared {
    pub(super) fn ends(&self) -> bool {
        self.ends.load(Ordering::Acquire)
    }

    pub(super) fn admission(&self) -> MutexGuard<'_, Admission> {
        self.admission
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn info(&self) -> String {
        let mut info = self.cell.info();
        info.insert("cell".to_owned(), self.keys.cell().as_str().into());
        info.insert("boot".to_owned(), self.boot.to_string().into());
        info.insert("clock".to_owned(), self.cell.clock_id().into());
        Value::Object(info).to_string()
    }

    /// Whether another controller answers at the key of this cell.
    pub(super) fn finds_clash(&self) -> Result<bool, SessionError> {
        let get = self.session.get(self.keys.info());
        let get = get.allowed_destination(zenoh::sample::Locality::Remote);
        // All answers have the same key: each counts.
        let get = get
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None);
        let replies = get.timeout(CLASH_TIMEOUT).wait();
        let replies =
            replies.map_err(SessionError::of("cannot look for a cell of the same name"))?;
        let mut clashes = false;
        while let Ok(reply) = replies.recv() {
            let value = reply
                .result()
                .ok()
                .map(|sample| sample.payload().to_bytes());
            let info = value.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
            // Through a router the own answer may come back.
            clashes |= info.is_some_and(|info| info["boot"] != self.boot.to_string());
        }
        Ok(clashes)
    }
}

/// Passes queries to these keys to a queue.
pub(super) fn answer<T: Send + 'static>(
    shared: &Arc<Shared>,
    keys: &[String],
    queue: &SyncSender<T>,
    event: fn(Query) -> T,
) -> Result<(), SessionError> {
    for key in keys {
        let queue = queue.clone();
        let take = move |query: Query| {
            // The query shares its reply channel with its clone.
            match queue.try_send(event(query.clone())) {
                Ok(()) => {}
                Err(TrySendError::Full(_)) => refuse(&query, TOO_MANY),
                Err(TrySendError::Disconnected(_)) => refuse(&query, "the cell leaves the fleet"),
            }
        };
        let queryable = shared.session.declare_queryable(key).callback(take);
        queryable
            .background()
            .wait()
            .map_err(SessionError::of("cannot answer queries"))?;
    }
    Ok(())
}

/// Replies that a query was refused; a client that has gone meanwhile does not get it.
pub(super) fn refuse(query: &Query, why: &str) {
    if let Err(error) = query.reply_err(why).wait() {
        tracing::debug!("no client takes a refusal any more: {error}");
    }
}

/// Sends a reply.
pub(super) fn reply(query: &Query, key: &str, text: String) {
    if let Err(error) = query.reply(key, text).express(true).wait() {
        tracing::debug!("no client takes a reply any more: {error}");
    }
}
