//! What can be wrong with a slave, on command. Faults of cables are the segment's.

use crate::{AlState, AlStatusCode};

/// Faults of a slave; those with a number are counted down as they happen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlaveFaults {
    /// A state that is refused, with its code, whatever else holds.
    pub refused: Option<(AlState, AlStatusCode)>,
    /// The firmware hangs: AL control, mailbox and process data are not served. The controller
    /// goes on to answer, so that working counters stay right.
    pub hung: bool,
    /// So many answers of the mailbox are never sent.
    pub lose_answers: u32,
    /// So many answers of the mailbox are sent twice, with the same counter.
    pub repeat_answers: u32,
    /// The last message of the mailbox is not repeated when the master asks for it: its repeat bit is never
    /// acknowledged.
    pub no_repeat: bool,
    /// So many requests are answered by a mailbox error with this code.
    pub mailbox_errors: Option<(u32, u16)>,
    /// So many logical writes are not taken once it shows OP: its firmware switches the SyncManager on late.
    pub late_outputs: u32,
    /// The firmware holds the SII: commands of the master are refused.
    pub sii_held: bool,
}

/// Counts a fault down; returns whether it happens.
pub(super) const fn happens(left: &mut u32) -> bool {
    let some = *left > 0;
    *left = left.saturating_sub(1);
    some
}
