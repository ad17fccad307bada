//! Injectable faults of a slave. Cable faults are in the segment.

use crate::{AlState, AlStatusCode};

/// Faults of a slave; those with a number are counted down as they happen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlaveFaults {
    /// A state that is always refused, with its code.
    pub refused: Option<(AlState, AlStatusCode)>,
    /// The firmware hangs: AL control, mailbox and process data are not served. The controller still answers, so that
    /// working counters stay correct.
    pub hung: bool,
    /// Number of mailbox answers that are never sent.
    pub lose_answers: u32,
    /// Number of mailbox answers that are sent twice, with the same counter.
    pub repeat_answers: u32,
    /// Repeat requests of the master are never acknowledged.
    pub no_repeat: bool,
    /// Number of requests answered by a mailbox error, and its code.
    pub mailbox_errors: Option<(u32, u16)>,
    /// Number of logical writes ignored after it shows OP: its firmware enables the SyncManager late.
    pub late_outputs: u32,
    /// The firmware owns the SII: commands of the master are refused.
    pub sii_held: bool,
    /// Number of write commands that its EEPROM acknowledges, and number of those after them that it does not.
    pub refuse_sii_writes: (u32, u32),
}

/// Counts a fault down; returns whether it happens.
pub(super) const fn happens(left: &mut u32) -> bool {
    let some = *left > 0;
    *left = left.saturating_sub(1);
    some
}

impl SlaveFaults {
    /// Whether the EEPROM does not acknowledge this write command.
    pub(super) const fn refuses_sii_write(&mut self) -> bool {
        let (acknowledged, refused) = &mut self.refuse_sii_writes;
        !happens(acknowledged) && happens(refused)
    }
}
