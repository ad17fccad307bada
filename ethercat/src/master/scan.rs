//! The start of a segment: counts the slaves, gives each an address, identifies them, compares them with the
//! configuration, determines the topology, and lays out the process image. From then on each slave has its own state
//! machine.
//!
//! ```text
//!        1 three equal counts       2 all still there   3 all addressed      4 all known, as expected
//! Count ----------------------> Quiet ----------> Address ----------> Identify ----------> Latch
//!   ^                             | not all there    |                   | 5 they differ      |
//!   +-----------------------------+------------------+                   v                    v
//!                                                                     Refused              Process -> Running
//! ```

use super::exchange::{Batch, Owner};
use crate::register;
use crate::{Address, Command};

/// Phase of the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Counting slaves.
    Count,
    /// Bringing all slaves to INIT.
    Quiet,
    /// Setting station addresses.
    Address,
    /// Reading the identities.
    Identify,
    /// The slaves differ from the configuration; see the differences.
    Refused,
    /// Latching receive times.
    Latch,
    /// Reading and configuring process data.
    Process,
    /// The process image is exchanged (with a goal of PRE-OP: the segment is watched).
    Running,
}

/// The address of the slave at the first position.
pub(super) const STATION_FIRST: u16 = 0x1001;
/// Number of equal counts that are accepted.
const ALIKE: u8 = 3;
/// Addresses set in one frame.
const ADDRESSES: u16 = 48;

/// Result of the answers of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scanned {
    /// Continue.
    On,
    /// All slaves have an address.
    Addressed,
    /// Receive times are latched.
    Latched,
}

/// The start.
#[derive(Debug)]
pub(super) struct Scan {
    pub(super) phase: Phase,
    count: u16,
    alike: u8,
    /// INIT was requested; next, all slaves are checked for presence.
    init_requested: bool,
    /// Number of slaves that have an address.
    addressed: u16,
    /// The last slave of a whole ring of two ports. Its loop is closed while receive times are latched: in a whole ring
    /// no frame returns to its port, and delays could not be measured.
    tail: Option<u16>,
    latch: Latch,
    /// Position at which the ring was open at the last count.
    pub(super) split: Option<u16>,
}

/// Phase of the latching.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Latch {
    Close,
    Now,
    Open,
}

/// Loop control: port 1 closed; all automatic.
const CLOSED: u8 = 0x0C;
const AUTOMATIC: u8 = 0x00;

impl Scan {
    pub(super) const fn new() -> Self {
        Self {
            phase: Phase::Count,
            count: 0,
            alike: 0,
            init_requested: false,
            addressed: 0,
            tail: None,
            latch: Latch::Now,
            split: None,
        }
    }

    /// Number of slaves.
    pub(super) const fn count(&self) -> u16 {
        self.count
    }

    /// All slaves are known; receive times follow. `tail` is the last slave of a whole ring.
    pub(super) const fn begin_latch(&mut self, tail: Option<u16>) {
        self.phase = Phase::Latch;
        self.tail = tail;
        self.latch = if tail.is_some() {
            Latch::Close
        } else {
            Latch::Now
        };
    }

    /// The position address of a slave: each slave adds one as the datagram passes.
    pub(super) const fn position(position: u16, ado: u16) -> Address {
        Address::Device {
            adp: position.wrapping_neg(),
            ado,
        }
    }

    pub(super) fn send(&self, batch: &mut Batch<'_>) {
        let mut push =
            |command, address, data: &[u8]| batch.push(Owner::Scan, command, address, data);
        match self.phase {
            Phase::Quiet if !self.init_requested => {
                push(
                    Command::Bwr,
                    Self::position(0, register::AL_CONTROL),
                    &[0x11, 0],
                );
            }
            Phase::Count | Phase::Quiet => {
                push(Command::Brd, Self::position(0, register::INFORMATION), &[0]);
            }
            Phase::Address => {
                let end = self.count.min(self.addressed.saturating_add(ADDRESSES));
                for position in self.addressed..end {
                    let station = (STATION_FIRST + position).to_le_bytes();
                    push(
                        Command::Apwr,
                        Self::position(position, register::STATION_ADDRESS),
                        &station,
                    );
                }
            }
            Phase::Latch => {
                let tail = Self::position(self.tail.unwrap_or(0), register::LOOP_CONTROL);
                let all = Self::position(0, register::DC_RECEIVE_TIMES);
                match self.latch {
                    Latch::Close => push(Command::Apwr, tail, &[CLOSED]),
                    Latch::Now => push(Command::Bwr, all, &[0; 4]),
                    Latch::Open => push(Command::Apwr, tail, &[AUTOMATIC]),
                };
            }
            Phase::Identify | Phase::Refused | Phase::Process | Phase::Running => {}
        }
    }

    /// Handles the answer to a datagram of [`Self::send`].
    pub(super) fn handle(&mut self, counter: u16) -> Scanned {
        match self.phase {
            Phase::Count => self.counted(counter),
            // Firmware that has not read AL control yet accepts no other request. The slave's own state machine repeats
            // the request and reports a failure; the scan does not wait.
            Phase::Quiet if !self.init_requested => self.init_requested = true,
            Phase::Quiet if counter == self.count => {
                (self.phase, self.addressed) = (Phase::Address, 0);
            }
            Phase::Address if counter == 1 => {
                self.addressed += 1;
                if self.addressed == self.count {
                    self.phase = Phase::Identify;
                    return Scanned::Addressed;
                }
            }
            // The number of slaves changed meanwhile.
            Phase::Quiet | Phase::Address => *self = Self::new(),
            Phase::Latch => return self.latched(counter),
            Phase::Identify | Phase::Refused | Phase::Process | Phase::Running => {}
        }
        Scanned::On
    }

    const fn latched(&mut self, counter: u16) -> Scanned {
        self.latch = match (self.latch, self.tail) {
            (Latch::Close, _) => Latch::Now,
            (Latch::Now, Some(_)) => Latch::Open,
            (Latch::Now, None) => return Scanned::Latched,
            (Latch::Open, _) if counter == 1 => return Scanned::Latched,
            // The loop must be opened again.
            (Latch::Open, _) => Latch::Open,
        };
        Scanned::On
    }

    const fn counted(&mut self, counter: u16) {
        let same = counter == self.count && counter > 0;
        self.alike = if same { self.alike + 1 } else { 1 };
        self.count = counter;
        if self.alike >= ALIKE && counter as usize <= crate::config::SLAVES_MAX {
            self.phase = Phase::Quiet;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(phase: Phase, count: u16) -> Scan {
        Scan {
            phase,
            count,
            ..Scan::new()
        }
    }

    #[test]
    fn slave_count_is_accepted_once_stable() {
        let mut scan = Scan::new();
        let counts = [0, 0, 0, 2, 3, 3, 3];
        let phases: Vec<_> = counts
            .iter()
            .map(|count| {
                scan.handle(*count);
                scan.phase
            })
            .collect();
        assert_eq!(phases[5..], [Phase::Count, Phase::Quiet]);
        assert_eq!(scan.count(), 3);
    }

    #[test]
    fn whole_ring_is_opened_while_times_are_latched() {
        let mut scan = at(Phase::Identify, 3);
        scan.begin_latch(Some(2));
        assert_eq!((scan.handle(1), scan.latch), (Scanned::On, Latch::Now));
        assert_eq!((scan.handle(3), scan.latch), (Scanned::On, Latch::Open));
        assert_eq!(
            (scan.handle(0), scan.latch),
            (Scanned::On, Latch::Open),
            "tried again"
        );
        assert_eq!(scan.handle(1), Scanned::Latched);
    }

    #[test]
    fn slow_firmware_does_not_delay_the_scan() {
        let mut scan = at(Phase::Quiet, 3);
        assert_eq!((scan.handle(2), scan.phase), (Scanned::On, Phase::Quiet));
        assert_eq!((scan.handle(3), scan.phase), (Scanned::On, Phase::Address));
    }

    #[test]
    fn slave_count_change_restarts_the_scan() {
        for phase in [Phase::Quiet, Phase::Address] {
            let mut scan = at(phase, 3);
            scan.init_requested = true;
            assert_eq!(scan.handle(2), Scanned::On);
            assert_eq!(scan.phase, Phase::Count);
        }
        let mut scan = at(Phase::Address, 2);
        assert_eq!(
            (scan.handle(1), scan.handle(1)),
            (Scanned::On, Scanned::Addressed)
        );
        assert_eq!(scan.phase, Phase::Identify);
        assert_eq!(
            at(Phase::Latch, 2).handle(0),
            Scanned::Latched,
            "no clocks at all"
        );
        for phase in [
            Phase::Identify,
            Phase::Refused,
            Phase::Process,
            Phase::Running,
        ] {
            let mut scan = at(phase, 2);
            assert_eq!((scan.handle(9), scan.phase), (Scanned::On, phase));
        }
    }
}
