//! A program that is no cell, in a fleet: which cells are alive, what they are, their resources and telemetry. It commands nothing;
//! [`remote`](super::remote) does.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use serde_json::Value;
use zenoh::Wait as _;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::{Sample, SampleKind};
use zenoh_ext::{
    AdvancedSubscriber, AdvancedSubscriberBuilderExt as _, HistoryConfig, RecoveryConfig,
};

use super::{SessionError, open};
use crate::config::{Observer, ObserverError, of_observer};
use crate::keys::{ALL_ALIVE, CellKeys, CellName, cell_of_alive, parts};

/// Most samples that wait to be taken; later ones are counted as missed.
const SAMPLES_MAX: usize = 4096;

/// What zenoh answers in place of those that did not answer in time.
const TIMEOUT_TEXT: &[u8] = b"Timeout";

/// Why a program does not reach a fleet, or gets no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum FleetError {
    #[error(transparent)]
    Observer(#[from] ObserverError),
    #[error(
        "no cell or router answers at {endpoints}: {source}\nhint: start the controller with [fleet] in its cell file, and name one of \
         its `listen` by --connect; with tls/…, check that both certificates are of one authority"
    )]
    Unreachable {
        endpoints: String,
        source: SessionError,
    },
    #[error(transparent)]
    Session(#[from] SessionError),
    #[error(
        "no answer from {cell} (timeout {waited:?})\nhint: `takt fleet list` shows which cells are alive; one that is alive and does not \
         answer gives no right to this link: see [[fleet.allow]] of its cell file"
    )]
    NoAnswer { cell: String, waited: Duration },
    #[error("{cell}: {why}")]
    Refused { cell: String, why: String },
    #[error("{cell} answers with something else than JSON: {why}")]
    NotJson { cell: String, why: String },
}

/// An answer to a query.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// The cell, by the key of the answer; `None` for refusals, which have no key.
    pub cell: Option<String>,
    /// The value, or why there is none.
    pub result: Result<Value, String>,
    /// From the query to this answer.
    pub after: Duration,
}

/// A connection to a fleet; it listens nowhere.
pub struct Fleet {
    session: zenoh::Session,
}

impl std::fmt::Debug for Fleet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Fleet").finish_non_exhaustive()
    }
}

impl Fleet {
    /// Connects to cells or routers.
    ///
    /// # Errors
    /// If an endpoint is refused, or none answers within [`CONNECT_TIMEOUT`](crate::config::CONNECT_TIMEOUT).
    pub fn connect(observer: &Observer) -> Result<Self, FleetError> {
        let entries = of_observer(observer)?;
        let session = open(&entries).map_err(|source| FleetError::Unreachable {
            endpoints: observer.connect.join(", "),
            source,
        })?;
        Ok(Self { session })
    }

    /// In the session of a member.
    pub(super) const fn of(session: zenoh::Session) -> Self {
        Self { session }
    }

    /// The zenoh session.
    #[must_use]
    pub const fn session(&self) -> &zenoh::Session {
        &self.session
    }

    /// The cells that are alive.
    ///
    /// # Errors
    /// If zenoh refuses the query.
    pub fn alive(&self, timeout: Duration) -> Result<BTreeSet<String>, FleetError> {
        let tokens = self.session.liveliness().get(ALL_ALIVE).timeout(timeout);
        let tokens = tokens
            .wait()
            .map_err(SessionError::of("cannot query which cells are alive"))?;
        let names = std::iter::from_fn(|| tokens.recv().ok()).filter_map(|reply| {
            let sample = reply.into_result().ok()?;
            cell_of_alive(sample.key_expr().as_str()).map(str::to_owned)
        });
        Ok(names.collect())
    }

    /// Queries a key, of one cell or of all, and waits until all have answered or the timeout is over.
    ///
    /// # Errors
    /// If zenoh refuses the query.
    pub fn ask(&self, key: &str, timeout: Duration) -> Result<Vec<Answer>, FleetError> {
        Ok(self.answers(key, timeout)?.collect())
    }

    /// The answers as they come.
    fn answers(
        &self,
        key: &str,
        timeout: Duration,
    ) -> Result<impl Iterator<Item = Answer> + use<>, FleetError> {
        let begin = Instant::now();
        // Two cells of one name have one key: both answers are of interest.
        let get = self.session.get(key).target(QueryTarget::All);
        let get = get.consolidation(ConsolidationMode::None).timeout(timeout);
        let get = get.express(true);
        let replies = get.wait().map_err(SessionError::of("cannot query"))?;
        let replies = std::iter::from_fn(move || replies.recv().ok());
        let answers = replies.filter_map(move |reply| {
            let (cell, result) = match reply.result() {
                Ok(sample) => {
                    let cell = parts(sample.key_expr().as_str()).map(|(cell, _)| cell.to_owned());
                    let value = serde_json::from_slice(&sample.payload().to_bytes());
                    (cell, value.map_err(|why| format!("no JSON: {why}")))
                }
                Err(error) => {
                    let text = error.payload().to_bytes();
                    if *text == *TIMEOUT_TEXT {
                        return None;
                    }
                    (None, Err(String::from_utf8_lossy(&text).into_owned()))
                }
            };
            let after = begin.elapsed();
            Some(Answer {
                cell,
                result,
                after,
            })
        });
        Ok(answers)
    }

    /// A resource of one cell, such as `nets`.
    ///
    /// # Errors
    /// If the cell does not answer in time, or refuses.
    pub fn resource(
        &self,
        cell: &CellName,
        path: &str,
        timeout: Duration,
    ) -> Result<Value, FleetError> {
        let key = CellKeys::new(cell.clone()).resource(path);
        let answer = self.answers(&key, timeout)?.next();
        let cell = cell.to_string();
        match answer.map(|answer| answer.result) {
            Some(Ok(value)) => Ok(value),
            Some(Err(why)) => Err(FleetError::Refused { cell, why }),
            None => Err(FleetError::NoAnswer {
                cell,
                waited: timeout,
            }),
        }
    }

    /// Subscribes to telemetry and to liveliness tokens: the newest values first, then all as they come.
    ///
    /// # Errors
    /// If the key expression is none.
    pub fn watch(&self, key: &str) -> Result<Watch, FleetError> {
        let failed = SessionError::of("cannot subscribe");
        let (sender, seen) = sync_channel(SAMPLES_MAX);
        let missed = Arc::new(AtomicU64::new(0));
        let (to, overflow) = (sender.clone(), Arc::clone(&missed));
        let samples = self
            .session
            .declare_subscriber(key)
            .callback(move |sample| send(&to, &overflow, of_sample(&sample)))
            .history(HistoryConfig::default().detect_late_publishers())
            .recovery(RecoveryConfig::default().heartbeat())
            .wait()
            .map_err(&failed)?;
        let counter = Arc::clone(&missed);
        let misses = samples.sample_miss_listener().callback(move |miss| {
            counter.fetch_add(u64::from(miss.nb()), Ordering::Relaxed);
        });
        misses.background().wait().map_err(&failed)?;
        let overflow = Arc::clone(&missed);
        let tokens = self
            .session
            .liveliness()
            .declare_subscriber(key)
            .history(true)
            .callback(move |sample| send(&sender, &overflow, of_token(&sample)))
            .wait()
            .map_err(&failed)?;
        Ok(Watch {
            seen,
            missed,
            _samples: samples,
            _tokens: tokens,
        })
    }
}

/// What a subscription shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Seen {
    /// A value.
    Value {
        /// Its key.
        key: String,
        /// The value as it was sent, JSON from cells.
        text: String,
    },
    /// What the token stands for is alive.
    Alive {
        /// Key of the token.
        key: String,
    },
    /// It is not alive any more: it ended, or no link leads to it.
    Lost {
        /// Key of the token.
        key: String,
    },
}

/// A subscription.
pub struct Watch {
    seen: Receiver<Seen>,
    missed: Arc<AtomicU64>,
    _samples: AdvancedSubscriber<()>,
    _tokens: zenoh::pubsub::Subscriber<()>,
}

impl std::fmt::Debug for Watch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Watch")
            .field("missed", &self.missed())
            .finish_non_exhaustive()
    }
}

impl Watch {
    /// The next that is seen; `None` after the timeout.
    #[must_use]
    pub fn next(&self, timeout: Duration) -> Option<Seen> {
        self.seen.recv_timeout(timeout).ok()
    }

    /// Number of samples that were sent and did not arrive, or came faster than they were taken.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }
}

/// Never blocks: zenoh reads the link in this thread.
fn send(to: &SyncSender<Seen>, missed: &AtomicU64, seen: Seen) {
    if to.try_send(seen).is_err() {
        missed.fetch_add(1, Ordering::Relaxed);
    }
}

fn of_sample(sample: &Sample) -> Seen {
    Seen::Value {
        key: sample.key_expr().to_string(),
        text: String::from_utf8_lossy(&sample.payload().to_bytes()).into_owned(),
    }
}

fn of_token(sample: &Sample) -> Seen {
    let key = sample.key_expr().to_string();
    match sample.kind() {
        SampleKind::Put => Seen::Alive { key },
        SampleKind::Delete => Seen::Lost { key },
    }
}
