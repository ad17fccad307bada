//! Monitoring of a running slave, one small datagram per turn: error counters of its ports, its mailbox, its clock. Its
//! state is in the census of every cycle. Reactions are not decided here.

use super::datagram::{Answer, Request};
use crate::SyncManager;
use crate::register;

/// Errors since the start, added up beyond the 255 that the registers hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    /// Invalid frames by port (0300h): received frames with errors.
    pub invalid: [u64; 4],
    /// Receive errors by port (0301h): invalid symbols.
    pub receive: [u64; 4],
    /// Forwarded errors by port (0308h): frames that were already marked as invalid.
    pub forwarded: [u64; 4],
    /// Errors of the processing unit (030Ch): non-EtherCAT frames.
    pub processing: u64,
    /// PDI errors (030Dh).
    pub controller: u64,
    /// Lost links by port (0310h): unplugged, cable cut, neighbour without power.
    pub lost_links: [u64; 4],
}

/// Length of 0300h to 0313h, bytes.
const BLOCK: usize = 20;
/// Count at which a register is cleared, before it saturates at 255.
const CLEAR_AT: u8 = 128;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Counters,
    Clear,
    Mailbox,
    Clock,
}

/// An observation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Found {
    pub(super) mailbox_full: bool,
    pub(super) difference_ns: Option<i32>,
}

/// The monitoring of a slave.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watch {
    turn: u8,
    waiting: Option<Kind>,
    /// The registers as last read; `None` before the first reading, which may contain old errors.
    last: Option<[u8; BLOCK]>,
    clear: bool,
    counters: PortCounters,
}

impl Watch {
    pub(super) const fn counters(&self) -> &PortCounters {
        &self.counters
    }

    /// The next check; a mailbox that is `busy` is checked every other time.
    pub(super) fn request(
        &mut self,
        mailbox: bool,
        busy: bool,
        clock: bool,
    ) -> Option<Request<'static>> {
        let between = if busy { Kind::Mailbox } else { Kind::Counters };
        let order = [Kind::Counters, Kind::Mailbox, Kind::Clock, between];
        let turns = if busy { 4 } else { 3 };
        let kind = loop {
            let kind = order[usize::from(self.turn % turns)];
            self.turn = (self.turn + 1) % turns;
            match kind {
                Kind::Counters | Kind::Clear => {
                    break if self.clear {
                        Kind::Clear
                    } else {
                        Kind::Counters
                    };
                }
                Kind::Mailbox if mailbox => break kind,
                Kind::Clock if clock => break kind,
                Kind::Mailbox | Kind::Clock => {}
            }
        };
        self.waiting = Some(kind);
        Some(match kind {
            Kind::Counters => Request::read(register::ERROR_COUNTERS, 20),
            Kind::Clear => Request::write(register::ERROR_COUNTERS, &[0; BLOCK]),
            Kind::Mailbox => Request::read(register::SYNC_MANAGER + 8, 8),
            Kind::Clock => Request::read(register::DC_DIFFERENCE, 4),
        })
    }

    pub(super) fn answer(&mut self, answer: Answer<'_>) -> Found {
        let mut found = Found::default();
        let (Some(kind), Answer::Data { counter: 1.., data }) = (self.waiting.take(), answer)
        else {
            return found;
        };
        match kind {
            Kind::Counters => {
                if let Some(block) = data.first_chunk() {
                    self.count(*block);
                }
            }
            Kind::Clear => (self.clear, self.last) = (false, Some([0; BLOCK])),
            Kind::Mailbox => {
                let sm = data
                    .first_chunk()
                    .map(SyncManager::decode)
                    .unwrap_or_default();
                found.mailbox_full = sm.is_enabled() && sm.is_full();
            }
            Kind::Clock => found.difference_ns = data.first_chunk().map(|four| difference(*four)),
        }
        found
    }

    fn count(&mut self, block: [u8; BLOCK]) {
        let last = self.last.replace(block);
        self.clear = block.iter().any(|register| *register >= CLEAR_AT);
        let Some(last) = last else {
            return;
        };
        // Registers that decreased were cleared by another master meanwhile.
        let gained = |at: usize| {
            let (new, old) = (
                block.get(at).copied().unwrap_or(0),
                last.get(at).copied().unwrap_or(0),
            );
            u64::from(if new >= old { new - old } else { new })
        };
        for port in 0..4 {
            self.counters.invalid[port] += gained(2 * port);
            self.counters.receive[port] += gained(2 * port + 1);
            self.counters.forwarded[port] += gained(8 + port);
            self.counters.lost_links[port] += gained(16 + port);
        }
        self.counters.processing += gained(12);
        self.counters.controller += gained(13);
    }
}

/// Register 092Ch: magnitude, and bit 31 set when the slave is ahead.
pub(super) fn difference(bytes: [u8; 4]) -> i32 {
    let raw = u32::from_le_bytes(bytes);
    let size = (raw & 0x7FFF_FFFF).cast_signed();
    if raw & 0x8000_0000 == 0 { -size } else { size }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(watch: &mut Watch, block: [u8; BLOCK]) {
        assert!(watch.request(false, false, false).is_some());
        watch.answer(Answer::Data {
            counter: 1,
            data: &block,
        });
    }

    #[test]
    fn error_counters_exceed_255_and_ignore_old_errors() {
        let mut watch = Watch::default();
        let block = |invalid, lost| {
            let mut block = [0; BLOCK];
            (block[2], block[17]) = (invalid, lost);
            block
        };
        read(&mut watch, block(100, 3));
        read(&mut watch, block(130, 3));
        assert_eq!(
            (watch.counters.invalid[1], watch.counters.lost_links[1]),
            (30, 0)
        );
        let cleared = matches!(
            watch.request(false, false, false),
            Some(Request::Write { at: 0x0300, .. })
        );
        assert!(cleared);
        watch.answer(Answer::Data {
            counter: 1,
            data: &[0; BLOCK],
        });
        read(&mut watch, block(255, 1));
        assert_eq!(
            (watch.counters.invalid[1], watch.counters.lost_links[1]),
            (285, 1)
        );
    }

    #[test]
    fn watch_alternates_between_available_checks() {
        let registers = |mailbox, clock| {
            let mut watch = Watch::default();
            let at: Vec<u16> = (0..4)
                .map(|_| match watch.request(mailbox, false, clock) {
                    Some(Request::Read { at, .. }) => at,
                    Some(Request::Write { .. }) | None => 0,
                })
                .collect();
            at
        };
        assert_eq!(registers(true, true), [0x0300, 0x0808, 0x092C, 0x0300]);
        assert_eq!(registers(false, true), [0x0300, 0x092C, 0x0300, 0x092C]);
        assert_eq!(registers(false, false), [0x0300; 4]);
    }

    #[test]
    fn differences_have_their_sign_in_front() {
        assert_eq!(difference([5, 0, 0, 0x80]), 5);
        assert_eq!(difference([5, 0, 0, 0]), -5);
    }
}
