//! Messages of coordinated starts, as JSON. Instants in TAI are nanoseconds since 1970; spans are nanoseconds. Nothing here decides.

use serde::{Deserialize, Serialize};

use super::PARTNERS_MAX;
use crate::command::{Boot, Nonce, Txn};

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

/// Publication of a participant whose net runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Beat {
    /// The coordinated start.
    pub txn: Txn,
    /// The cell whose net runs.
    pub cell: String,
    /// The permission that it gave for this start.
    pub nonce: Nonce,
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
        "the clock of {cell} may be wrong by {uncertainty_ns} ns, more than a quarter of its period\nhint: takt doctor"
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
        "the start is {ahead_ns} ns ahead, more than {cell} accepts\nhint: compare the clocks: takt doctor"
    )]
    Ahead { cell: String, ahead_ns: i64 },
    /// The start is not at the beginning of a cycle.
    #[error("the start is no multiple of the period of {cell}, {period_ns} ns")]
    Grid { cell: String, period_ns: i64 },
}
