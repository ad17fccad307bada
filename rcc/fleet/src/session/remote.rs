//! The other end of a command session: opens one at a cell, keeps it alive in a thread of its own, sends commands once and in order. It
//! knows no command.
//!
//! All instants are those of the controller's clock, repeated from its replies: no clock of two hosts is compared.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use zenoh::Wait as _;
use zenoh::query::ConsolidationMode;

use super::SessionError;
use super::observer::Fleet;
use crate::command::{
    Boot, CommandRequest, LossPolicy, Nonce, OpenId, Refusal, Reply, SessionRequest, random,
    to_json,
};
use crate::keys::{CellKeys, CellName};

/// How long a cell may take to answer a request about a session.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3);

/// Keep-alives within the life of a nonce.
const RENEWALS: u32 = 4;

/// Pause before a command whose execution goes on is asked for again.
const BUSY_PAUSE: Duration = Duration::from_millis(20);

/// How long a cell may take to answer what a session was notified of, its own wait included.
const NOTIFIED_TIMEOUT: Duration = Duration::from_millis(800);

/// How long a cell may be silent before its session counts as lost: longer than its nonces live.
pub const SILENCE_MAX: Duration = Duration::from_secs(2);

/// Why a command was not executed, or it is unknown whether it was.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum RemoteError {
    #[error(transparent)]
    Session(#[from] SessionError),
    #[error(
        "no answer from {cell} (timeout {waited:?})\nhint: `takt fleet list` shows which cells are alive; one that is alive and does not \
         answer gives this link no right to command: see [[fleet.allow]] of its cell file"
    )]
    NoAnswer { cell: String, waited: Duration },
    #[error(
        "no answer from {cell} to command {seq} within {waited:?}; it may have been executed\nhint: read the cell's state before the \
         command is sent again"
    )]
    Unknown {
        cell: String,
        seq: u64,
        waited: Duration,
    },
    #[error("{cell} refuses: {text}")]
    Refused {
        cell: String,
        reason: Refusal,
        text: String,
    },
    #[error("{cell}: {text}")]
    Answer { cell: String, text: String },
    #[error(
        "the session at {cell} is lost: nothing arrived from it for {waited:?}\nhint: the controller ends what the session began; connect \
         again; `takt fleet list` shows which cells are alive"
    )]
    Lost { cell: String, waited: Duration },
    #[error("cannot start the thread that keeps the session alive: {0}")]
    Thread(#[from] std::io::Error),
}

/// An open session of commands. Dropping it closes it.
pub struct Remote {
    link: Arc<Link>,
    seq: u64,
    keeper: Option<JoinHandle<()>>,
}

impl std::fmt::Debug for Remote {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Remote")
            .field("cell", self.link.keys.cell())
            .field("session", &self.link.number)
            .finish_non_exhaustive()
    }
}

/// What the keeper and commands share.
struct Link {
    session: zenoh::Session,
    keys: CellKeys,
    boot: Boot,
    number: u32,
    /// Most bytes of a query; longer ones are lost on the way.
    message_bytes_max: usize,
    granted: Mutex<Granted>,
    ends: AtomicBool,
}

/// The newest permission of the controller.
#[derive(Clone, Copy)]
struct Granted {
    nonce: Nonce,
    expires_ns: i64,
}

impl Remote {
    /// Opens a session at a cell. `client` is its name for people, `on_loss` what happens to its nets when it is lost.
    ///
    /// # Errors
    /// If the cell does not answer or refuses.
    pub fn open(
        fleet: &Fleet,
        cell: &CellName,
        client: &str,
        on_loss: LossPolicy,
    ) -> Result<Self, RemoteError> {
        let session = fleet.session().clone();
        let keys = CellKeys::new(cell.clone());
        let key = keys.cmd_session();
        let ask = |request: &SessionRequest| {
            ask(&session, cell, &key, &to_json(request), ANSWER_TIMEOUT)?.ok_or_else(|| {
                RemoteError::NoAnswer {
                    cell: cell.to_string(),
                    waited: ANSWER_TIMEOUT,
                }
            })
        };
        let hello = ask(&SessionRequest::Hello {})?;
        let Reply::Hello {
            boot,
            nonce_life_ns: life_ns,
            message_bytes_max,
            ..
        } = hello
        else {
            return Err(refused(cell, hello));
        };
        let open = SessionRequest::Open {
            boot,
            open: OpenId(random()()),
            client: client.to_owned(),
            on_loss,
        };
        let reply = ask(&open)?;
        let Reply::Granted {
            session: number,
            nonce,
            expires_ns,
            ..
        } = reply
        else {
            return Err(refused(cell, reply));
        };
        let granted = Granted { nonce, expires_ns };
        let link = Arc::new(Link {
            session,
            keys,
            boot,
            number,
            message_bytes_max,
            granted: Mutex::new(granted),
            ends: AtomicBool::new(false),
        });
        let life = Duration::from_nanos(u64::try_from(life_ns).unwrap_or(0));
        let pause = (life / RENEWALS).max(Duration::from_millis(1));
        let kept = Arc::clone(&link);
        let keeper = std::thread::Builder::new().name("fleet-keep".to_owned());
        let keeper = keeper.spawn(move || kept.keep_alive(pause))?;
        Ok(Self {
            link,
            seq: 0,
            keeper: Some(keeper),
        })
    }

    /// The run of the controller.
    #[must_use]
    pub fn boot(&self) -> Boot {
        self.link.boot
    }

    /// The cell.
    #[must_use]
    pub fn cell(&self) -> &CellName {
        self.link.keys.cell()
    }

    /// The session, and the newest nonce by which it permits something.
    #[must_use]
    pub fn permission(&self) -> (u32, Nonce) {
        (self.link.number, self.link.granted().nonce)
    }

    /// What the session is notified of, for one thread that fetches it.
    #[must_use]
    pub fn notifications(&self) -> Notifications {
        Notifications {
            link: Arc::clone(&self.link),
            from: 0,
        }
    }

    /// Executes one DirectIO line and returns its reply lines, and how many more the cell left out because they were too long.
    ///
    /// # Errors
    /// If the cell refuses it, or does not answer in time.
    pub fn execute(
        &mut self,
        line: &str,
        timeout: Duration,
    ) -> Result<(Vec<String>, usize), RemoteError> {
        let link = &self.link;
        let cell = link.keys.cell();
        let (seq, until) = (self.seq.saturating_add(1), Instant::now() + timeout);
        let key = link.keys.cmd_directio();
        loop {
            let granted = link.granted();
            let request = CommandRequest {
                boot: link.boot,
                session: link.number,
                seq,
                nonce: granted.nonce,
                not_after_ns: granted.expires_ns,
                line: line.to_owned(),
            };
            let request = to_json(&request);
            let (found, bound) = (request.len(), link.message_bytes_max);
            if found > bound {
                let reason = Refusal::TooLong { found, bound };
                let (cell, text) = (cell.to_string(), reason.to_string());
                return Err(RemoteError::Refused { cell, reason, text });
            }
            let left = until.saturating_duration_since(Instant::now());
            let waited = timeout;
            if left.is_zero() {
                let cell = cell.to_string();
                return Err(RemoteError::Unknown { cell, seq, waited });
            }
            match ask(&link.session, cell, &key, &request, left)? {
                Some(Reply::Done { lines, omitted, .. }) => {
                    self.seq = seq;
                    return Ok((lines, omitted));
                }
                // It is being executed; or it came too late for its nonce, and there is a newer one.
                Some(Reply::Refused {
                    reason: Refusal::Busy { .. } | Refusal::Late { .. },
                    ..
                }) => std::thread::sleep(BUSY_PAUSE.min(left)),
                Some(other) => return Err(refused(cell, other)),
                // A cell that is away has no answer at once.
                None => std::thread::sleep(BUSY_PAUSE.min(left)),
            }
        }
    }
}

/// What a session is notified of by its subscriptions, in its order, without a gap.
pub struct Notifications {
    link: Arc<Link>,
    /// Number of the next line.
    from: u64,
}

impl std::fmt::Debug for Notifications {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Notifications")
            .field("cell", self.link.keys.cell())
            .field("from", &self.from)
            .finish_non_exhaustive()
    }
}

impl Notifications {
    /// The next lines. None after about a fifth of a second in which there were none.
    ///
    /// # Errors
    /// If the session is closed or lost, the cell does not answer for [`SILENCE_MAX`], or lines are missing.
    pub fn wait(&mut self) -> Result<Vec<String>, RemoteError> {
        let link = &self.link;
        let (cell, key) = (link.keys.cell(), link.keys.cmd_session());
        let begin = Instant::now();
        loop {
            let request = SessionRequest::Notified {
                boot: link.boot,
                session: link.number,
                nonce: link.granted().nonce,
                from: self.from,
            };
            let waited = begin.elapsed();
            if waited > SILENCE_MAX {
                let cell = cell.to_string();
                return Err(RemoteError::Lost { cell, waited });
            }
            match ask(
                &link.session,
                cell,
                &key,
                &to_json(&request),
                NOTIFIED_TIMEOUT,
            )? {
                Some(Reply::Notified { first, lines, .. }) => {
                    if !lines.is_empty() && first != self.from {
                        let text = format!("notification {} is missing", self.from);
                        let cell = cell.to_string();
                        return Err(RemoteError::Answer { cell, text });
                    }
                    self.from = self.from.saturating_add(lines.len() as u64);
                    return Ok(lines);
                }
                // There is a newer nonce, or will be soon.
                Some(Reply::Refused {
                    reason: Refusal::Late { .. } | Refusal::UnknownNonce { .. },
                    ..
                })
                | None => std::thread::sleep(BUSY_PAUSE),
                Some(other) => return Err(refused(cell, other)),
            }
        }
    }
}

impl Drop for Remote {
    fn drop(&mut self) {
        self.link.ends.store(true, Ordering::Release);
        if let Some(keeper) = self.keeper.take() {
            keeper.thread().unpark();
            // It only sends keep-alives: its panic is no reason for another.
            let _ = keeper.join();
        }
        let link = &self.link;
        let close = SessionRequest::Close {
            boot: link.boot,
            session: link.number,
            nonce: link.granted().nonce,
        };
        // If the cell does not answer, the session is lost there by itself.
        let cell = link.keys.cell();
        let key = link.keys.cmd_session();
        let _ = ask(&link.session, cell, &key, &to_json(&close), ANSWER_TIMEOUT);
    }
}

impl Link {
    fn granted(&self) -> Granted {
        *self.granted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Body of the keeper.
    fn keep_alive(&self, pause: Duration) {
        let key = self.keys.cmd_session();
        while !self.ends.load(Ordering::Acquire) {
            let renew = SessionRequest::Renew {
                boot: self.boot,
                session: self.number,
                nonce: self.granted().nonce,
            };
            let answer = ask(
                &self.session,
                self.keys.cell(),
                &key,
                &to_json(&renew),
                ANSWER_TIMEOUT,
            );
            match answer {
                Ok(Some(Reply::Granted {
                    nonce, expires_ns, ..
                })) => {
                    let mut granted = self.granted.lock().unwrap_or_else(PoisonError::into_inner);
                    *granted = Granted { nonce, expires_ns };
                }
                // The session is lost: the next command reports it.
                Ok(Some(_)) => return,
                Ok(None) | Err(_) => {}
            }
            std::thread::park_timeout(pause);
        }
    }
}

fn refused(cell: &CellName, reply: Reply) -> RemoteError {
    let cell = cell.to_string();
    if let Reply::Refused { reason, text, .. } = reply {
        return RemoteError::Refused { cell, reason, text };
    }
    RemoteError::Answer {
        cell,
        text: format!("an answer to another request: {}", to_json(&reply)),
    }
}

/// Sends a request; `None` if there is no answer in time.
fn ask(
    session: &zenoh::Session,
    cell: &CellName,
    key: &str,
    request: &str,
    timeout: Duration,
) -> Result<Option<Reply>, RemoteError> {
    // The one reply is taken as it comes, not held back until the cell has declared that it was the last.
    let get = session.get(key).payload(request).timeout(timeout);
    let get = get.consolidation(ConsolidationMode::None).express(true);
    let replies = get.wait();
    let replies = replies.map_err(SessionError::of("cannot send a request"))?;
    let Some(reply) = replies.recv().ok() else {
        return Ok(None);
    };
    let text = match reply.result() {
        Ok(sample) => sample.payload().to_bytes(),
        Err(error) => {
            let text = error.payload().to_bytes();
            if *text == *b"Timeout" {
                return Ok(None);
            }
            text
        }
    };
    serde_json::from_slice(&text).map(Some).map_err(|_| {
        let text = String::from_utf8_lossy(&text).into_owned();
        let cell = cell.to_string();
        RemoteError::Answer { cell, text }
    })
}
