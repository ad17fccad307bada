//! The cycle of a recorded master, if it has one: frames that a clock sends. Frames of which each is sent as soon as the one before
//! came back, as masters do that set clocks, are no cycle however regular they look.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_ethercat::{Address, Command, Frame, register};

use crate::ecat::frames::datagrams;
use crate::ecat::trips::Trip;

/// Fewer steps make no cycle.
const STEPS_MIN: usize = 10;

/// What a master sends each cycle: process data by command and logical address, or the clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Beat {
    Clock,
    ProcessData(u8, u32),
}

/// When cyclic frames went out.
#[derive(Debug, Default)]
pub(super) struct Cycle {
    sent: BTreeMap<Beat, Vec<Duration>>,
}

impl Cycle {
    /// A frame went out; whether it may be a cyclic one.
    pub(super) fn take(&mut self, at: Duration, frame: &Frame<'_>) -> bool {
        let mut is_cyclic = false;
        for datagram in datagrams(frame).flatten() {
            let header = datagram.header;
            let beat = match (header.command, header.address) {
                (Command::Lrw | Command::Lrd | Command::Lwr, Address::Logical(address)) => {
                    Beat::ProcessData(header.command.into(), address)
                }
                (Command::Frmw | Command::Armw, Address::Device { ado, .. })
                    if ado == register::DC_SYSTEM_TIME =>
                {
                    Beat::Clock
                }
                _ => continue,
            };
            self.sent.entry(beat).or_default().push(at);
            is_cyclic = true;
        }
        is_cyclic
    }

    /// The usual time from one to the next. Process data tell before the clock does.
    pub(super) fn judged(self, trips: &[Trip]) -> Option<Duration> {
        let most = |(beat, sent): &(Beat, Vec<Duration>)| (*beat != Beat::Clock, sent.len());
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
        // Sent when the one before is back: the wire beats, no clock.
        let is_driven = median(&mut trips).is_some_and(|trip| trip * 5 >= cycle * 4);
        (is_regular && !is_driven).then_some(cycle)
    }
}

fn median(times: &mut [Duration]) -> Option<Duration> {
    times.sort_unstable();
    times.get(times.len() / 2).copied()
}
