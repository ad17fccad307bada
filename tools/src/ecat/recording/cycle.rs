//! The cycle of a recorded master, if it has one: frames that a timer sends. Frames that are sent as soon as the previous
//! one returns, as masters do to set clocks, are no cycle, however regular they are.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_ethercat::{Address, Command, Frame, register};

use crate::ecat::frames::datagrams;
use crate::ecat::trips::Trip;

/// Smallest number of periods of a cycle.
const STEPS_MIN: usize = 10;

/// A cyclic datagram: process data by command and logical address, or the clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum CyclicDatagram {
    Clock,
    ProcessData(u8, u32),
}

/// Times at which cyclic datagrams were sent.
#[derive(Debug, Default)]
pub(super) struct Cycle {
    sent: BTreeMap<CyclicDatagram, Vec<Duration>>,
}

impl Cycle {
    /// Adds an outgoing frame; whether it may be cyclic.
    pub(super) fn take(&mut self, at: Duration, frame: &Frame<'_>) -> bool {
        let mut is_cyclic = false;
        for datagram in datagrams(frame).flatten() {
            let header = datagram.header;
            let kind = match (header.command, header.address) {
                (Command::Lrw | Command::Lrd | Command::Lwr, Address::Logical(address)) => {
                    CyclicDatagram::ProcessData(header.command.into(), address)
                }
                (Command::Frmw | Command::Armw, Address::Device { ado, .. })
                    if ado == register::DC_SYSTEM_TIME =>
                {
                    CyclicDatagram::Clock
                }
                _ => continue,
            };
            self.sent.entry(kind).or_default().push(at);
            is_cyclic = true;
        }
        is_cyclic
    }

    /// The median period, of process data if there is any, else of the clock.
    pub(super) fn finish(self, trips: &[Trip]) -> Option<Duration> {
        let most = |(kind, sent): &(CyclicDatagram, Vec<Duration>)| {
            (*kind != CyclicDatagram::Clock, sent.len())
        };
        let (_, sent) = self.sent.into_iter().max_by_key(most)?;
        let steps = sent.iter().zip(sent.iter().skip(1));
        let mut steps: Vec<Duration> = steps.map(|(one, next)| next.saturating_sub(*one)).collect();
        if steps.len() < STEPS_MIN {
            return None;
        }
        let cycle = median(&mut steps).filter(|cycle| !cycle.is_zero())?;
        let is_near = |step: &&Duration| **step > cycle / 2 && **step < cycle * 3 / 2;
        let is_regular = steps.iter().filter(is_near).count() * 2 >= steps.len();
        let mut trips: Vec<Duration> = trips
            .iter()
            .filter(|trip| trip.is_cyclic)
            .map(|trip| trip.took)
            .collect();
        // Each is sent when the previous one returns: no timer sets this period.
        let follows_answers = median(&mut trips).is_some_and(|trip| trip * 5 >= cycle * 4);
        (is_regular && !follows_answers).then_some(cycle)
    }
}

fn median(times: &mut [Duration]) -> Option<Duration> {
    times.sort_unstable();
    times.get(times.len() / 2).copied()
}
