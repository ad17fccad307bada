//! Messages of coordinated starts, as JSON. Instants in TAI are nanoseconds since 1970; spans are nanoseconds. Nothing here decides.

use serde::{Deserialize, Serialize};

use super::PARTNERS_MAX;
use crate::command::{self, Boot, Nonce, Txn};

/// Query to `takt/<cell>/start/prepare`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prepare {
    /// The coordinated start.
    pub txn: Txn,
    /// The run of the controller that it is meant for.
    pub boot: Boot,
    /// Names of all cells, this one included; 2 to 16, all different.
    pub partners: Vec<String>,
    /// The session of commands at this cell by whose permission nets are prepared; its policy applies when a partner is lost.
    pub session: u32,
    /// A nonce of that session.
    pub nonce: Nonce,
    /// The nets of this cell that begin, such as `rpinet0`; 1 to 16.
    pub nets: Vec<String>,
    /// The clock that all partners have in common, if they run on one host: its quality does not matter then.
    #[serde(default)]
    pub clock: Option<String>,
}

/// Reply to [`Prepare`]: resources are kept for two seconds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ready {
    /// The coordinated start.
    pub txn: Txn,
    /// Permission of this participant for one commit.
    pub nonce: Nonce,
    /// Period of the net thread, ns, above 0; the start is a multiple of it.
    pub period_ns: i64,
    /// Time that the participant needs before a start, ns.
    pub lead_ns: i64,
    /// By how much its TAI may be wrong, ns.
    pub uncertainty_ns: i64,
    /// TAI minus UTC on this host, s; a start needs the same on all.
    pub tai_utc_s: i32,
    /// TAI of this host at this reply, ns: the start is chosen from those of the participants, not from the initiator's clock.
    pub tai_ns: i64,
}

/// Query to `takt/<cell>/start/commit`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Commit {
    /// The coordinated start.
    pub txn: Txn,
    /// The run of the controller that it is meant for.
    pub boot: Boot,
    /// Instant of the start, TAI, ns.
    pub start_tai_ns: i64,
    /// Permissions of all participants, in the order of the partners.
    pub nonces: Vec<Nonce>,
}

/// Query to `takt/<cell>/start/abort`. It releases what has not begun; a net that runs is cancelled as any other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Abort {
    /// The coordinated start.
    pub txn: Txn,
    /// The run of the controller that it is meant for.
    pub boot: Boot,
}

/// Publication on `takt/<cell>/start/<txn>/armed`. It permits, and never commands.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Armed {
    /// The coordinated start.
    pub txn: Txn,
    /// The cell that is armed.
    pub cell: String,
    /// Instant of the start, TAI, ns.
    pub start_tai_ns: i64,
    /// Permissions of all participants, in the order of the partners.
    pub nonces: Vec<Nonce>,
}

/// Publication on `takt/<cell>/start/<txn>/beat` of a participant whose net runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Beat {
    /// The coordinated start.
    pub txn: Txn,
    /// The cell whose net runs.
    pub cell: String,
    /// The permission that it gave for this start.
    pub nonce: Nonce,
    /// Its nets have ended by themselves: it is silent from now on, and not lost.
    #[serde(default)]
    pub over: bool,
}

/// Reply to a query of coordinated starts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "result", rename_all = "lowercase")]
pub enum StartReply {
    /// To a prepare.
    Ready(Ready),
    /// To a commit.
    Armed(Armed),
    /// To an abort: whether something was released.
    Aborted {
        /// Whether there was a start that had not begun.
        released: bool,
    },
    /// To a query of `takt/<cell>/start/status`: the starts of this run that are not over, and the last ones that are.
    Status {
        /// In the order in which they were prepared.
        starts: Vec<Status>,
    },
    /// Nothing was changed.
    Refused {
        /// Why, for programs.
        reason: Refusal,
        /// Why and what to do, for people.
        text: String,
    },
}

/// How far a coordinated start is at one cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Resources are kept.
    Prepared,
    /// It has committed, and waits for the arms of all.
    Committed,
    /// All are armed: its nets begin at the instant.
    Begins,
    /// Its nets run.
    Running,
    /// Its nets have ended by themselves.
    Over,
    /// Its nets did not begin, or ended otherwise.
    Failed,
}

/// A coordinated start at one cell.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// The coordinated start.
    pub txn: Txn,
    /// How far it is.
    pub stage: Stage,
    /// Why it failed, with a hint.
    pub why: Option<String>,
    /// Its nets.
    pub nets: Vec<String>,
    /// Instant of the start, TAI, ns, once it has committed.
    pub start_tai_ns: Option<i64>,
    /// The cycle in which its nets began.
    pub began: Option<Began>,
    /// Partners that it has lost.
    pub lost: Vec<String>,
}

/// The cycle in which nets began, as the net thread measured it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Began {
    /// Number of the cycle in its thread.
    pub cycle: u64,
    /// Its nominal begin, TAI, ns: set-points refer to it.
    pub begin_tai_ns: i64,
    /// When the thread woke for it, TAI, ns.
    pub woken_tai_ns: i64,
    /// Period of the nets, ns.
    pub period_ns: i64,
}

/// Why a message was refused. It has changed nothing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "code", rename_all = "snake_case")]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum Refusal {
    /// Meant for another run of the controller.
    #[error(
        "the controller was restarted since: its boot id is another\nhint: prepare the start again"
    )]
    OtherBoot,
    /// The list of partners is none.
    #[error("a coordinated start has 2 to {PARTNERS_MAX} different cells, {cell} among them")]
    Partners { cell: String },
    /// The message has not the documented form.
    #[error("cannot read the message: {why}")]
    Malformed { why: String },
    /// The query is not for exactly the own key.
    #[error(
        "the key expression is not exactly {own}\nhint: send one query to the key of each cell"
    )]
    OtherKey { own: String },
    /// The session gives no permission.
    #[error("{cell}: {why}")]
    Session { cell: String, why: command::Refusal },
    /// The nets cannot be prepared.
    #[error("{cell}: {why}")]
    Nets { cell: String, why: String },
    /// The same start is being prepared.
    #[error("{cell} is preparing this start\nhint: wait for its reply")]
    Busy { cell: String },
    /// The partners do not run on one host.
    #[error(
        "{cell} runs on another host than its partners are said to, or in another clock\nhint: prepare the start again"
    )]
    OtherClock { cell: String },
    /// Too many at a time.
    #[error(
        "{cell} already takes part in {bound} coordinated starts\nhint: wait until one has ended"
    )]
    TooMany { cell: String, bound: usize },
    /// The host's clock is not good enough.
    #[error("the clock of {cell} is not fit for a coordinated start: {why}")]
    Clock { cell: String, why: String },
    /// The clock may be wrong by more than a quarter of a period.
    #[error(
        "the clock of {cell} may be wrong by {uncertainty_ns} ns, more than a quarter of its period\nhint: use PTP with hardware time stamps (ptp4l, phc2sys), or nets of a longer period; `takt fleet doctor` shows all clocks"
    )]
    Uncertain { cell: String, uncertainty_ns: i64 },
    /// The start was prepared differently, or is committed.
    #[error("this start is already prepared in another way, or committed")]
    Prepared,
    /// There is no such start (any more).
    #[error("{cell} has not prepared this start, or has released it\nhint: prepare it again")]
    Unknown { cell: String },
    /// Not the permissions that were given for this start.
    #[error("the permission is not that of {cell} for this start\nhint: prepare it again")]
    Nonce { cell: String },
    /// The commit came too late for its start.
    #[error("the commit reached {cell} {late_ns} ns too late")]
    Late { cell: String, late_ns: i64 },
    /// The start is too far ahead.
    #[error(
        "the start is {ahead_ns} ns ahead, more than {cell} accepts\nhint: compare the clocks: takt fleet doctor"
    )]
    Ahead { cell: String, ahead_ns: i64 },
    /// The start is not at the beginning of a cycle.
    #[error("the start is no multiple of the period of {cell}, {period_ns} ns")]
    Grid { cell: String, period_ns: i64 },
}
