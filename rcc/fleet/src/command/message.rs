//! Messages of the command keys, as JSON in UTF-8. Fields ending in `_ns` are nanoseconds of the controller's own
//! `CLOCK_MONOTONIC`; a client only adds to such an instant or repeats it, and never compares it with its own clock.
//! Unknown fields are refused. Nothing here decides.

use serde::{Deserialize, Serialize};

use super::id::{Boot, Nonce, OpenId};

/// Most bytes of a client's name.
pub const NAME_BYTES_MAX: usize = 64;

/// What happens to the nets of a session when it is lost: when no keep-alive arrived in time, or partners of a
/// coordinated start are lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LossPolicy {
    /// They continue and end by themselves.
    Continue,
    /// They are cancelled; those that still run after the grace period are aborted.
    #[default]
    Cancel,
    /// They are aborted at once; the drivers brake at their limits.
    Stop,
}

/// Query to `takt/<cell>/cmd/session`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "op", rename_all = "lowercase", deny_unknown_fields)]
pub enum SessionRequest {
    /// Asks for the boot id and the bounds. It changes nothing.
    Hello {},
    /// Opens a session.
    Open {
        /// The run of the controller that it is meant for.
        boot: Boot,
        /// The client's number of this opening.
        open: OpenId,
        /// Name of the client for people; 1 to 64 bytes without control characters.
        client: String,
        /// What happens to its nets when it is lost.
        #[serde(default)]
        on_loss: LossPolicy,
    },
    /// Keeps a session alive and grants the next nonce.
    Renew {
        /// The run of the controller that it is meant for.
        boot: Boot,
        /// The session.
        session: u32,
        /// The newest nonce that the client knows.
        nonce: Nonce,
    },
    /// Asks for what the controller notified the session of. The reply waits a while for the first line. It grants nothing and executes
    /// nothing.
    Notified {
        /// The run of the controller that it is meant for.
        boot: Boot,
        /// The session.
        session: u32,
        /// A nonce of the session.
        nonce: Nonce,
        /// Number of the first line that the client does not have; earlier ones are not kept any longer. The first is 0.
        from: u64,
    },
    /// Closes a session; its nets end as the controller ends those of a closed session.
    Close {
        /// The run of the controller that it is meant for.
        boot: Boot,
        /// The session.
        session: u32,
        /// A nonce of the session.
        nonce: Nonce,
    },
}

/// Query to `takt/<cell>/cmd/directio`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandRequest {
    /// The run of the controller that it is meant for.
    pub boot: Boot,
    /// The session.
    pub session: u32,
    /// One more than that of the last command executed in this session; the first is 1.
    pub seq: u64,
    /// A nonce of the session.
    pub nonce: Nonce,
    /// Not to be executed later than this, nanoseconds of the controller's `CLOCK_MONOTONIC`. Its nonce bounds it too.
    pub not_after_ns: i64,
    /// One DirectIO command.
    pub line: String,
}

/// Reply to a query of either key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "result", rename_all = "lowercase")]
pub enum Reply {
    /// The run of the controller and the bounds.
    Hello {
        /// The run of the controller.
        boot: Boot,
        /// Instant of this reply, ns.
        now_ns: i64,
        /// How long a nonce is valid, ns.
        nonce_life_ns: i64,
        /// Most sessions at a time.
        sessions_max: usize,
        /// Most bytes of a query.
        message_bytes_max: usize,
        /// Most bytes of the lines of a reply.
        reply_bytes_max: usize,
    },
    /// A session and its newest nonce.
    Granted {
        /// The run of the controller.
        boot: Boot,
        /// The session.
        session: u32,
        /// For the next commands.
        nonce: Nonce,
        /// Instant at which it was granted, ns.
        now_ns: i64,
        /// Until when the nonce, and with it the session, is valid, ns.
        expires_ns: i64,
    },
    /// The session is closed.
    Closed {
        /// The session.
        session: u32,
    },
    /// The command was executed, once; a repeated query receives this reply again.
    Done {
        /// The session.
        session: u32,
        /// The command.
        seq: u64,
        /// Reply lines of DirectIO.
        lines: Vec<String>,
        /// Lines omitted at the end, because the reply would exceed its bound.
        omitted: usize,
    },
    /// Lines that the session was notified of, by its subscriptions.
    Notified {
        /// The session.
        session: u32,
        /// Number of the first line.
        first: u64,
        /// The lines; none if nothing happened for a while.
        lines: Vec<String>,
    },
    /// Nothing was changed.
    Refused {
        /// The run of the controller.
        boot: Boot,
        /// Instant of the refusal, ns.
        now_ns: i64,
        /// Why, for programs.
        reason: Refusal,
        /// Why and what to do, for people.
        text: String,
    },
}

/// Why a query was refused. It has changed nothing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "code", rename_all = "snake_case")]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum Refusal {
    /// A wildcard reaches several cells; a command is for one.
    #[error("the key expression has a wildcard\nhint: send one query to the key of each cell")]
    Wildcard,
    /// Another key, or selector parameters behind it.
    #[error("the key expression is not exactly {own}\nhint: query this key without parameters")]
    OtherKey { own: String },
    /// The message exceeds its bound.
    #[error("the message has {found} bytes; at most {bound} are accepted")]
    TooLong { found: usize, bound: usize },
    /// The message has not the documented form.
    #[error("cannot read the message: {why}")]
    Malformed { why: String },
    /// Meant for another run of the controller.
    #[error("the controller was restarted since: its boot id is another\nhint: open a new session")]
    OtherBoot,
    /// There is no such session (any more).
    #[error(
        "no session {session}: it was closed, or lost because no keep-alive arrived in time\nhint: open a new session"
    )]
    NoSession { session: u32 },
    /// The nonce is not one of the two newest of the session.
    #[error("the nonce is none of session {session}\nhint: use that of the last keep-alive")]
    UnknownNonce { session: u32 },
    /// The query was taken from the queue after its nonce had expired, or after its own `not_after_ns`.
    #[error("the query is {late_ns} ns late\nhint: send it again with a new nonce")]
    Late { late_ns: i64 },
    /// The command, or another of that number, was executed before the last one.
    #[error("command {seq} is over; the next is {next}")]
    OldSequence { seq: u64, next: u64 },
    /// Commands before this one have not arrived.
    #[error("command {next} has not arrived; it comes before {seq}")]
    SequenceGap { seq: u64, next: u64 },
    /// The number of the last command with another content.
    #[error("command {seq} was executed with another content; the next is {next}")]
    SequenceReused { seq: u64, next: u64 },
    /// The session's last command is not finished.
    #[error("command {seq} of this session is not finished\nhint: send the query again later")]
    Busy { seq: u64 },
    /// The opening was answered before, and its session used since.
    #[error("this opening was answered before\nhint: choose another number for a new session")]
    OpenRepeated,
    /// All sessions are in use.
    #[error("too many sessions: at most {bound}\nhint: close one, or wait until one expires")]
    TooManySessions { bound: usize },
    /// The client's name is empty, too long or has control characters.
    #[error("a client name has 1 to {bound} bytes without control characters")]
    BadName { bound: usize },
}

/// A message as JSON.
#[must_use]
pub fn to_json<M: Serialize>(message: &M) -> String {
    // Of numbers, texts and lists only: writing them to memory cannot fail.
    serde_json::to_string(message).unwrap_or_default()
}
