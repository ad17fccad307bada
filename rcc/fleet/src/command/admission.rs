//! The machine that admits: all sessions of one controller. It executes no command.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;

use serde::de::DeserializeOwned;
use takt_core::Nanos;

use super::id::{Boot, Entropy, Nonce};
use super::message::{CommandRequest, LossPolicy, NAME_BYTES_MAX, Refusal, Reply, SessionRequest};
use super::session::{Session, Step};

/// Bounds of an admission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Most sessions at a time, those included whose loss was not taken yet.
    pub sessions: usize,
    /// How long a nonce is valid.
    pub nonce_life: Nanos,
    /// Most bytes of a query.
    pub message_bytes: usize,
    /// Most bytes of the lines of a reply.
    pub reply_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            sessions: 32,
            nonce_life: Nanos::from_millis(500),
            message_bytes: 1 << 20,
            reply_bytes: 256 << 10,
        }
    }
}

/// A query as it was taken from the queue.
#[derive(Clone, Copy, Debug)]
pub struct Query<'a> {
    /// Key expression of the sender, not of the queryable.
    pub key: &'a str,
    /// Parameters behind the key expression.
    pub parameters: &'a str,
    /// The message.
    pub payload: &'a [u8],
}

/// What the caller does with a query.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Sends this reply.
    Reply(Reply),
    /// A session was opened: sends this reply.
    Opened {
        /// The session.
        session: u32,
        /// Name of the client.
        client: String,
        /// What happens to its nets when it is lost.
        on_loss: LossPolicy,
        /// To be sent.
        reply: Reply,
    },
    /// A session was closed: ends its nets as those of a closed session, sends this reply.
    Closed {
        /// The session.
        session: u32,
        /// To be sent.
        reply: Reply,
    },
    /// Sends [`Reply::Notified`] with the lines from this number on, when there are any.
    Notify {
        /// The session.
        session: u32,
        /// Number of the first line.
        from: u64,
    },
    /// Executes a command, passes its lines to [`Admission::finish`] and sends the reply that this returns.
    Execute {
        /// The session.
        session: u32,
        /// Number of the command.
        seq: u64,
        /// The DirectIO command.
        line: String,
        /// If it has not begun by this instant, it must not begin: [`Admission::finish`] with a line that says so.
        until: Nanos,
    },
}

/// A session that was lost. The caller applies the consequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost {
    /// The session.
    pub session: u32,
    /// What happens to its nets.
    pub on_loss: LossPolicy,
}

/// Checks that a query is for exactly this key.
///
/// # Errors
/// If it has a wildcard, is for another key or has parameters.
pub fn check_key(query: &Query<'_>, own: &str) -> Result<(), Refusal> {
    if query.key.contains(['*', '$']) {
        return Err(Refusal::Wildcard);
    }
    if query.key != own || !query.parameters.is_empty() {
        let own = own.to_owned();
        return Err(Refusal::OtherKey { own });
    }
    Ok(())
}

/// The sessions of one controller. See the [module](super) for why each check is there.
pub struct Admission {
    session_key: String,
    command_key: String,
    boot: Boot,
    limits: Limits,
    entropy: Entropy,
    sessions: BTreeMap<u32, Session>,
    last_session: u32,
    lost: VecDeque<Lost>,
}

impl fmt::Debug for Admission {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Admission")
            .field("sessions", &self.sessions.keys())
            .finish_non_exhaustive()
    }
}

impl Admission {
    /// No sessions yet. The keys are those of the queryables `cmd/session` and `cmd/directio` of this cell.
    #[must_use]
    pub fn new(
        (session_key, command_key): (String, String),
        boot: Boot,
        limits: Limits,
        entropy: Entropy,
    ) -> Self {
        Self {
            session_key,
            command_key,
            boot,
            limits,
            entropy,
            sessions: BTreeMap::new(),
            last_session: 0,
            lost: VecDeque::new(),
        }
    }

    /// This run of the controller.
    #[must_use]
    pub const fn boot(&self) -> Boot {
        self.boot
    }

    /// Its bounds.
    #[must_use]
    pub const fn limits(&self) -> Limits {
        self.limits
    }

    /// Number of open sessions.
    #[must_use]
    pub fn open(&self) -> usize {
        self.sessions.len()
    }

    /// Handles a query to the session key, taken from its queue at `now` on the controller's `CLOCK_MONOTONIC`.
    pub fn handle_session(&mut self, query: &Query<'_>, now: Nanos) -> Answer {
        self.expire(now);
        let request = self.read(query, &self.session_key);
        let answer = request.and_then(|request| self.session(request, now));
        answer.unwrap_or_else(|why| self.refuse(why, now))
    }

    /// Handles a query to the command key, taken from its queue at `now`.
    pub fn handle_query(&mut self, query: &Query<'_>, now: Nanos) -> Answer {
        self.expire(now);
        let request = self.read(query, &self.command_key);
        let answer = request.and_then(|request| self.command(request, now));
        answer.unwrap_or_else(|why| self.refuse(why, now))
    }

    /// Keeps the reply of a command that was executed and returns it; `None` if its session has ended meanwhile.
    pub fn finish(&mut self, session: u32, seq: u64, mut lines: Vec<String>) -> Option<Reply> {
        let all = lines.len();
        let mut bytes = 0_usize;
        let fits = lines.iter().take_while(|line| {
            bytes = bytes.saturating_add(line.len());
            bytes <= self.limits.reply_bytes
        });
        let kept = fits.count();
        lines.truncate(kept);
        let reply = Reply::Done {
            session,
            seq,
            lines,
            omitted: all - kept,
        };
        let open = self.sessions.get_mut(&session)?;
        open.finish(seq, &reply).then_some(reply)
    }

    /// A session that was lost by `now`; to be called until `None`.
    pub fn poll(&mut self, now: Nanos) -> Option<Lost> {
        self.expire(now);
        self.lost.pop_front()
    }

    /// When [`Self::poll`] has something to return unless a keep-alive arrives before.
    #[must_use]
    pub fn deadline(&self) -> Option<Nanos> {
        self.sessions.values().map(Session::expires).min()
    }

    /// Whether a nonce of a session permits something at `now`, until when; for other keys that require a session.
    ///
    /// # Errors
    /// With the reason if it does not.
    pub fn check(
        &mut self,
        boot: Boot,
        session: u32,
        nonce: Nonce,
        now: Nanos,
    ) -> Result<Nanos, Refusal> {
        self.expire(now);
        self.find(boot, session)?.permits(nonce, now)
    }

    /// What happens to the nets of a session when it, or a partner of its coordinated start, is lost; `None` if there is no such session.
    pub fn on_loss(&mut self, session: u32, now: Nanos) -> Option<LossPolicy> {
        self.expire(now);
        self.sessions.get(&session).map(|session| session.on_loss)
    }

    /// Reads a query for one of the own keys.
    fn read<M: DeserializeOwned>(&self, query: &Query<'_>, own: &str) -> Result<M, Refusal> {
        check_key(query, own)?;
        let (found, bound) = (query.payload.len(), self.limits.message_bytes);
        if found > bound {
            return Err(Refusal::TooLong { found, bound });
        }
        let message = serde_json::from_slice(query.payload);
        message.map_err(|error| Refusal::Malformed {
            why: error.to_string(),
        })
    }

    fn session(&mut self, request: SessionRequest, now: Nanos) -> Result<Answer, Refusal> {
        let time = (now, self.limits.nonce_life);
        match request {
            SessionRequest::Hello {} => Ok(Answer::Reply(Reply::Hello {
                boot: self.boot,
                now_ns: now.0,
                nonce_life_ns: self.limits.nonce_life.0,
                sessions_max: self.limits.sessions,
                message_bytes_max: self.limits.message_bytes,
                reply_bytes_max: self.limits.reply_bytes,
            })),
            SessionRequest::Open {
                boot,
                open,
                client,
                on_loss,
            } => {
                self.check_boot(boot)?;
                if let Some(known) = self.sessions.values().find(|s| s.open == open) {
                    let repeated = known.is_fresh().then(|| self.granted(known));
                    return repeated.map(Answer::Reply).ok_or(Refusal::OpenRepeated);
                }
                let session = self.admit(&client)?;
                let nonce = Nonce((self.entropy)());
                let opened = Session::new(session, open, on_loss, nonce, time);
                let reply = self.granted(&opened);
                self.sessions.insert(session, opened);
                Ok(Answer::Opened {
                    session,
                    client,
                    on_loss,
                    reply,
                })
            }
            SessionRequest::Renew {
                boot,
                session,
                nonce,
            } => {
                self.find(boot, session)?;
                let entropy = &mut self.entropy;
                let renewed = self.sessions.get_mut(&session);
                let renewed = renewed.ok_or(Refusal::NoSession { session })?;
                renewed.renew(nonce, time, || Nonce(entropy()))?;
                let renewed = self.find(boot, session)?;
                Ok(Answer::Reply(self.granted(renewed)))
            }
            SessionRequest::Notified {
                boot,
                session,
                nonce,
                from,
            } => {
                self.find(boot, session)?.permits(nonce, now)?;
                Ok(Answer::Notify { session, from })
            }
            SessionRequest::Close {
                boot,
                session,
                nonce,
            } => {
                self.find(boot, session)?.permits(nonce, now)?;
                self.sessions.remove(&session);
                let reply = Reply::Closed { session };
                Ok(Answer::Closed { session, reply })
            }
        }
    }

    /// The number of a new session, if there may be one.
    fn admit(&mut self, client: &str) -> Result<u32, Refusal> {
        let bound = NAME_BYTES_MAX;
        if client.is_empty() || client.len() > bound || client.chars().any(char::is_control) {
            return Err(Refusal::BadName { bound });
        }
        let bound = self.limits.sessions;
        if self.sessions.len() + self.lost.len() >= bound {
            return Err(Refusal::TooManySessions { bound });
        }
        // Numbers are never given twice.
        let next = self.last_session.checked_add(1);
        self.last_session = next.ok_or(Refusal::TooManySessions { bound })?;
        Ok(self.last_session)
    }

    fn command(&mut self, request: CommandRequest, now: Nanos) -> Result<Answer, Refusal> {
        let CommandRequest {
            boot,
            session,
            seq,
            nonce,
            not_after_ns,
            line,
        } = request;
        self.find(boot, session)?;
        let open = self.sessions.get_mut(&session);
        let open = open.ok_or(Refusal::NoSession { session })?;
        match open.command(seq, nonce, &line, (now, Nanos(not_after_ns)))? {
            Step::Repeat(reply) => Ok(Answer::Reply(reply)),
            Step::Execute { until } => Ok(Answer::Execute {
                session,
                seq,
                line,
                until,
            }),
        }
    }

    fn check_boot(&self, boot: Boot) -> Result<(), Refusal> {
        if boot == self.boot {
            Ok(())
        } else {
            Err(Refusal::OtherBoot)
        }
    }

    fn find(&self, boot: Boot, session: u32) -> Result<&Session, Refusal> {
        self.check_boot(boot)?;
        let open = self.sessions.get(&session);
        open.ok_or(Refusal::NoSession { session })
    }

    fn granted(&self, session: &Session) -> Reply {
        let (nonce, now, expires) = session.granted();
        Reply::Granted {
            boot: self.boot,
            session: session.number,
            nonce,
            now_ns: now.0,
            expires_ns: expires.0,
        }
    }

    fn refuse(&self, reason: Refusal, now: Nanos) -> Answer {
        Answer::Reply(Reply::Refused {
            boot: self.boot,
            now_ns: now.0,
            text: reason.to_string(),
            reason,
        })
    }

    /// Sessions whose newest nonce has expired are lost.
    fn expire(&mut self, now: Nanos) {
        let lost = &mut self.lost;
        self.sessions.retain(|number, session| {
            let is_lost = now > session.expires();
            if is_lost {
                lost.push_back(Lost {
                    session: *number,
                    on_loss: session.on_loss,
                });
            }
            !is_lost
        });
    }
}
