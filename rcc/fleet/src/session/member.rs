//! A cell as a member of a fleet: its liveliness tokens, its telemetry, its resources, its commands and its part in coordinated starts, in
//! five threads of its own, one for each session of commands and one for each start while it is prepared. It knows no controller: what it
//! publishes and executes comes from a [`Cell`].
//!
//! Callbacks of zenoh only pass queries to bounded queues, since zenoh reads the link in the thread that calls back. A full queue refuses
//! the query at once. The instant of a command is that at which it leaves the queue, so that one that waited too long is refused. A
//! command that takes long delays neither the keep-alive of its session nor other sessions.

mod commands;
mod publish;
mod reach;
mod starts;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use serde_json::Value;
use takt_core::Nanos;
use takt_core::tai::Tai;
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{ConsolidationMode, Query, QueryTarget};

use super::{SessionError, open};
use crate::command::{Admission, Boot, Limits, LossPolicy, Lost, random};
use crate::config::{FleetSettings, of_cell};
use crate::keys::{CellKeys, CellName};
use commands::Event;

/// Period of telemetry, and of the search for another cell of the same name.
pub const TELEMETRY_PERIOD: Duration = Duration::from_secs(1);

/// Most topics of telemetry of a cell; the others are left out, and the log says so.
pub const TOPICS_MAX: usize = 1024;

/// Lines of the log that late joiners get.
pub const LOG_LINES_KEPT: usize = 256;

/// Queries that wait for a thread; more are refused.
const QUEUE: usize = 64;

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

/// Why a cell does not join.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JoinError {
    /// The session cannot be opened or a key not declared.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Another controller answers with this name.
    #[error(
        "another controller of this fleet has the name `{0}`\nhint: set another fleet.cell in one of the two cell files"
    )]
    Clash(CellName),
    /// The host has no thread left.
    #[error("cannot start a thread of the fleet: {0}")]
    Thread(#[from] std::io::Error),
}

/// What the threads share.
struct Shared {
    keys: CellKeys,
    boot: Boot,
    cell: Arc<dyn Cell>,
    admission: Mutex<Admission>,
    session: zenoh::Session,
    /// Endpoints to which it connects.
    connect: Vec<String>,
    ends: AtomicBool,
    clashes: AtomicBool,
}

impl Shared {
    fn ends(&self) -> bool {
        self.ends.load(Ordering::Acquire)
    }

    fn admission(&self) -> MutexGuard<'_, Admission> {
        self.admission
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn info(&self) -> String {
        let mut info = self.cell.info();
        info.insert("cell".to_owned(), self.keys.cell().as_str().into());
        info.insert("boot".to_owned(), self.boot.to_string().into());
        info.insert("clock".to_owned(), self.cell.clock_id().into());
        Value::Object(info).to_string()
    }

    /// Whether another controller answers at the key of this cell.
    fn finds_clash(&self) -> Result<bool, SessionError> {
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

/// A cell in a fleet. Dropping it leaves: sessions of clients are lost by their policies.
pub struct Member {
    shared: Arc<Shared>,
    token: Option<LivelinessToken>,
    threads: Vec<JoinHandle<()>>,
}

impl std::fmt::Debug for Member {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Member")
            .field("cell", self.shared.keys.cell())
            .finish_non_exhaustive()
    }
}

impl Member {
    /// Joins. No other member needs to be there: links are made when others come.
    ///
    /// # Errors
    /// If an address cannot be bound, or another controller that is reachable has the same name.
    pub fn join(
        name: &CellName,
        settings: &FleetSettings,
        limits: Limits,
        cell: Arc<dyn Cell>,
    ) -> Result<Self, JoinError> {
        let session = open(&of_cell(name, settings))?;
        let (keys, boot) = (CellKeys::new(name.clone()), Boot(random()()));
        let command_keys = (keys.cmd_session(), keys.cmd_directio());
        let shared = Arc::new(Shared {
            keys,
            boot,
            admission: Mutex::new(Admission::new(command_keys, boot, limits, random())),
            cell,
            session,
            connect: settings.connect.clone(),
            ends: AtomicBool::new(false),
            clashes: AtomicBool::new(false),
        });
        if shared.finds_clash()? {
            return Err(JoinError::Clash(name.clone()));
        }
        let mut member = Self {
            shared: Arc::clone(&shared),
            token: None,
            threads: Vec::new(),
        };
        let keys = &shared.keys;
        let (reads, from_reads) = sync_channel(QUEUE);
        answer(
            &shared,
            &[keys.info(), keys.of("resource/**")],
            &reads,
            |it| it,
        )?;
        let (commands, from_commands) = sync_channel(QUEUE);
        let own = [keys.cmd_session(), keys.cmd_directio()];
        answer(&shared, &own, &commands, Event::Query)?;
        member.spawn("fleet-read", move |shared| {
            publish::answer(&shared, &from_reads);
        })?;
        member.spawn("fleet-cmd", move |shared| {
            commands::serve(&shared, (commands, from_commands));
        })?;
        let starts = starts::listen(&shared)?;
        member.spawn("fleet-start", move |shared| starts::serve(&shared, starts))?;
        member.spawn("fleet-pub", |shared| publish::publish(&shared))?;
        if settings.joints_hz > 0 {
            member.spawn("fleet-joints", |shared| publish::publish_joints(&shared))?;
        }
        // At last: who sees it can query.
        let token = shared.session.liveliness().declare_token(keys.alive());
        member.token = Some(
            token
                .wait()
                .map_err(SessionError::of("cannot declare the cell alive"))?,
        );
        Ok(member)
    }

    /// This run of the controller, as its clients name it.
    #[must_use]
    pub fn boot(&self) -> Boot {
        self.shared.boot
    }

    /// Whether another controller with the name of this one was there at the last search.
    #[must_use]
    pub fn clashes(&self) -> bool {
        self.shared.clashes.load(Ordering::Acquire)
    }

    fn spawn(
        &mut self,
        name: &str,
        run: impl FnOnce(Arc<Shared>) + Send + 'static,
    ) -> Result<(), std::io::Error> {
        let shared = Arc::clone(&self.shared);
        let thread = std::thread::Builder::new().name(name.to_owned());
        self.threads.push(thread.spawn(move || run(shared))?);
        Ok(())
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        self.token = None;
        self.shared.ends.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            if thread.join().is_err() {
                tracing::error!("a thread of the fleet has panicked");
            }
        }
        if let Err(why) = self.shared.session.close().wait() {
            tracing::warn!("the session of the fleet did not close in order: {why}");
        }
    }
}

/// Passes queries to these keys to a queue.
fn answer<T: Send + 'static>(
    shared: &Arc<Shared>,
    keys: &[String],
    queue: &SyncSender<T>,
    event: fn(Query) -> T,
) -> Result<(), SessionError> {
    for key in keys {
        let queue = queue.clone();
        let take = move |query: Query| {
            // The query shares its reply channel with its clone.
            if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) =
                queue.try_send(event(query.clone()))
            {
                refuse(
                    &query,
                    "too many queries wait\nhint: send it again later, and fewer at a time",
                );
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
fn refuse(query: &Query, why: &str) {
    if let Err(error) = query.reply_err(why).wait() {
        tracing::debug!("no client takes a refusal any more: {error}");
    }
}

/// Sends a reply.
fn reply(query: &Query, key: &str, text: String) {
    if let Err(error) = query.reply(key, text).express(true).wait() {
        tracing::debug!("no client takes a reply any more: {error}");
    }
}

#[cfg(test)]
mod tests;
