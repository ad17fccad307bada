//! Coordinated starts: nets of several controllers begin at one instant of TAI. No I/O and no clock; loading nets, keeping their
//! resources and handing them to net threads is the caller's part.
//!
//! ```text
//! initiator                         each participant
//!   prepare  ───────────────────▶   load, prove the cost, keep resources and budget        (1) Participant::prepare
//!   ◀─────────────────── ready(nonce, period, lead, uncertainty)   kept for 2 s of the own clock
//!   any refused, or silent for 500 ms: abort to all                                         (2) Initiator::poll
//!   commit(T, nonces of all) ────▶  accepted until T - 100 ms                               (3) Participant::commit
//!                                   armed(T, nonces of all) ──▶ every participant           (4) Participant::armed
//!                      T - 20 ms:   all are armed: hand the net over with T; else release   (5) Participant::poll
//!                              T:   the net begins in the cycle nearest to T; no message is needed
//!                                   running: silence of a partner for 100 ms: partner lost  (6) Participant::poll
//! ```
//!
//! What is promised: no cell begins without the arms of all; none begins at another instant than T because a message was late, early,
//! repeated or of an earlier run; a participant that begins alone, since the last arm reached only some, learns so within 100 ms.
//! No protocol promises that all begin or none when the network fails in the last moment (the problem of the two generals).

use std::time::Duration;

use takt_core::Nanos;

mod initiator;
mod message;
mod participant;

pub use initiator::{Goal, Initiator, Member, Outcome};
pub use message::{
    Abort, Armed, Beat, Began, Commit, Prepare, Ready, Refusal, Stage, StartReply, Status,
};
pub use participant::{Output, Participant, Readiness, ReleaseCause};

/// Cells of one coordinated start, at most.
pub const PARTNERS_MAX: usize = 16;
/// Coordinated starts in which one cell takes part at a time, at most.
pub const TRANSACTIONS_MAX: usize = 8;
/// How long a participant keeps resources without a commit.
pub const RESERVATION: Nanos = Nanos::from_millis(2_000);
/// How long the initiator waits for replies.
pub const REPLY_TIMEOUT: Nanos = Nanos::from_millis(500);
/// The start is at least this far ahead when it is chosen.
pub const LEAD_MIN: Nanos = Nanos::from_millis(300);
/// The start is at most this far ahead when a participant commits.
pub const AHEAD_MAX: Nanos = Nanos::from_millis(10_000);
/// A commit is accepted until this long before the start.
pub const GUARD: Nanos = Nanos::from_millis(100);
/// All arms must have arrived this long before the start.
pub const DECISION: Nanos = Nanos::from_millis(20);
/// A net is handed over at least this long before its start; a host that stalled for longer releases.
pub const HANDOVER_MIN: Nanos = Nanos::from_millis(5);
/// A running partner that is silent for so long is lost.
pub const SILENCE: Nanos = Nanos::from_millis(100);
/// How long a participant whose nets have ended by themselves says so.
pub const OVER: Nanos = Nanos::from_millis(500);
/// Nets of one cell that begin at one instant, at most.
pub const NETS_MAX: usize = 16;
/// How often running participants publish that they run.
pub const BEAT_EVERY: Duration = Duration::from_millis(20);

#[cfg(test)]
mod simulator;
#[cfg(test)]
mod tests;
