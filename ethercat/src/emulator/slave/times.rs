//! Processing times of a slave's firmware and EEPROM. Each duration is drawn pseudo-randomly, with the same sequence in
//! each run: constant times would hide waits that a master must handle.

use takt_link::Random;

/// Range of a duration, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// The shortest.
    pub least: u64,
    /// The longest.
    pub most: u64,
}

impl Span {
    /// From a range in microseconds.
    pub const fn micros(least: u64, most: u64) -> Self {
        Self {
            least: 1000 * least,
            most: 1000 * most,
        }
    }

    /// A constant duration, ns.
    pub const fn exactly(ns: u64) -> Self {
        Self {
            least: ns,
            most: ns,
        }
    }

    /// A duration from the range, ns.
    pub(super) const fn draw(self, random: &mut Random) -> u64 {
        let width = self.most.saturating_sub(self.least).saturating_add(1);
        self.least + random.next() % width
    }

    const fn scaled(self, factor: u64) -> Self {
        Self {
            least: self.least.saturating_mul(factor),
            most: self.most.saturating_mul(factor),
        }
    }
}

/// The times of a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// Until the firmware reads AL control, which cannot be written again before; `None` for a controller that accepts
    /// each write.
    pub al_read: Option<Span>,
    /// From AL control to INIT or PRE-OP.
    pub to_pre_op: Span,
    /// From AL control to SAFE-OP.
    pub to_safe_op: Span,
    /// From AL control to OP.
    pub to_op: Span,
    /// From a request in the mailbox to its answer.
    pub mailbox: Span,
    /// Busy time of the SII interface for a read.
    pub sii_read: Span,
    /// Busy time for a write.
    pub sii_write: Span,
    /// Storing time of the EEPROM after a write, while the interface refuses commands with "no acknowledge".
    pub sii_store: Span,
}

impl Default for Times {
    /// 0.1 ms for states, none for mailboxes, 20 us for SII reads and 2 ms for SII writes.
    fn default() -> Self {
        let state = Span::exactly(100_000);
        Self {
            al_read: None,
            to_pre_op: state,
            to_safe_op: state,
            to_op: state,
            mailbox: Span::default(),
            sii_read: Span::exactly(20_000),
            sii_write: Span::exactly(2_000_000),
            sii_store: Span::default(),
        }
    }
}

impl Times {
    /// All times multiplied by a factor.
    #[must_use]
    pub fn scaled(self, factor: u64) -> Self {
        Self {
            al_read: self.al_read.map(|span| span.scaled(factor)),
            to_pre_op: self.to_pre_op.scaled(factor),
            to_safe_op: self.to_safe_op.scaled(factor),
            to_op: self.to_op.scaled(factor),
            mailbox: self.mailbox.scaled(factor),
            sii_read: self.sii_read.scaled(factor),
            sii_write: self.sii_write.scaled(factor),
            sii_store: self.sii_store.scaled(factor),
        }
    }
}
