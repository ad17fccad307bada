//! The contents of a recording: frames that did not return, working counters, states, error counters and clocks, as far
//! as its master read them. `stat` and `dc` derive the findings.

mod clocks;
mod cycle;
#[cfg(test)]
mod patterns;
mod report;
mod slave;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

use takt_ethercat::master::FrameCounters;
use takt_ethercat::{Address, Command, Datagram, Frame, register};

use super::directions::{Direction, RETURN_MAX, Sender, directions, sender, shape};
use super::frames::{Capture, Taken, datagrams};
use super::trips::{Trip, Trips};
use cycle::Cycle;
use slave::RecordedSlave;

pub(super) use clocks::dc;
pub(super) use report::stat;

/// A datagram of process data, by command number, logical address and length.
type Group = (u8, u32, u16);

/// The working counters of a group over time.
#[derive(Clone, Debug, Default)]
struct CounterSeries {
    /// Each with the time of its frame.
    counters: Vec<(Duration, u16)>,
}

impl CounterSeries {
    /// The most frequent counter: that of steady operation.
    fn expected(&self) -> u16 {
        let mut counts: BTreeMap<u16, usize> = BTreeMap::new();
        for (_, counter) in &self.counters {
            *counts.entry(*counter).or_default() += 1;
        }
        let most = counts
            .into_iter()
            .max_by_key(|(counter, count)| (*count, *counter));
        most.map_or(0, |(counter, _)| counter)
    }

    /// Times of unexpected counters, from the first expected one until the segment was brought down, if it was.
    fn misses(&self, down: Option<Duration>) -> Vec<Duration> {
        let expected = self.expected();
        let good = |(_, counter): &&(Duration, u16)| *counter == expected;
        let first = self.counters.iter().find(good).map(|(at, _)| *at);
        let last = self.counters.iter().rev().find(good).map(|(at, _)| *at);
        let end = down.filter(|down| last.is_none_or(|last| *down > last));
        let inside =
            |at: Duration| first.is_some_and(|first| at >= first) && end.is_none_or(|end| at < end);
        let missed = self
            .counters
            .iter()
            .filter(|(at, counter)| inside(*at) && *counter != expected);
        missed.map(|(at, _)| *at).collect()
    }
}

/// Answers to frames that were not recorded.
#[derive(Clone, Copy, Debug, Default)]
struct Unmatched {
    /// Broadcasts of senders without other recorded frames: their search for slaves.
    searches: u64,
    /// Of senders without outgoing frames in the recording.
    answers: u64,
    /// At the start: their frames were sent before.
    early: u64,
}

/// The evaluated contents of a recording.
#[derive(Debug, Default)]
pub(super) struct Recording {
    name: String,
    begin: Duration,
    end: Duration,
    frames: FrameCounters,
    /// Frames under way at the end of the recording.
    open: u64,
    unmatched: Unmatched,
    broken: u64,
    /// Notes on how the recording was made.
    notes: Vec<String>,
    /// Frames with a wrong checksum at the probe.
    corrupt: u64,
    /// The usual time from one cyclic frame to the next.
    cycle: Option<Duration>,
    trips: Vec<Trip>,
    groups: BTreeMap<Group, CounterSeries>,
    slaves: BTreeMap<u16, RecordedSlave>,
    /// Time of the last broadcast state request.
    down: Option<Duration>,
    /// Largest number of slaves that answered a broadcast.
    answering: u16,
    clock: clocks::Reference,
}

/// State while a recording is read.
#[derive(Debug, Default)]
struct Pass {
    trips: Trips,
    cycle: Cycle,
    /// Senders with outgoing frames in the recording.
    senders: BTreeSet<Sender>,
}

impl Recording {
    /// Reads a file.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        Self::of(&path.display().to_string(), &Capture::read(path)?)
    }

    /// Evaluates a recording.
    pub(super) fn of(name: &str, capture: &Capture) -> anyhow::Result<Self> {
        let frames = &capture.frames;
        let (Some(first), Some(last)) = (frames.first(), frames.iter().map(|it| it.at).max())
        else {
            capture.check(name)?;
            anyhow::bail!(
                "{name}: no EtherCAT frames: the recording is cut off before the first\nhint: check for a full disk and record again"
            );
        };
        let mut all = Self {
            name: name.to_owned(),
            begin: first.at,
            end: last.max(first.at),
            notes: capture.notes(),
            corrupt: capture.corrupt,
            ..Self::default()
        };
        let ways = directions(frames);
        let outgoing = frames
            .iter()
            .zip(&ways)
            .filter(|(_, way)| **way == Direction::Out);
        let mut pass = Pass {
            senders: outgoing.map(|(taken, _)| sender(taken)).collect(),
            ..Pass::default()
        };
        for (taken, way) in frames.iter().zip(ways) {
            match taken.frame() {
                Ok(frame) => all.take(&mut pass, taken, way, &frame),
                Err(_) => all.broken += 1,
            }
        }
        all.finish(pass);
        Ok(all)
    }

    fn take(&mut self, pass: &mut Pass, taken: &Taken, way: Direction, frame: &Frame<'_>) {
        let (at, shape) = (taken.at, shape(frame));
        match way {
            Direction::Out => {
                self.frames.sent += 1;
                let is_cyclic = pass.cycle.take(at, frame);
                pass.trips.sent(shape, at, is_cyclic);
                self.sent(at, frame);
            }
            Direction::Back => {
                if !pass.trips.answered(&shape, at) {
                    let is_known = pass.senders.contains(&sender(taken));
                    self.unmatched(at, is_known, frame);
                }
                self.returned(at, frame);
            }
        }
    }

    /// An answer without a recorded outgoing frame.
    fn unmatched(&mut self, at: Duration, is_known: bool, frame: &Frame<'_>) {
        let is_broadcast = |datagram: Datagram<'_>| {
            matches!(
                datagram.header.command,
                Command::Bwr | Command::Brd | Command::Brw
            )
        };
        let is_early = at.saturating_sub(self.begin) < RETURN_MAX;
        if !is_known && datagrams(frame).flatten().all(is_broadcast) {
            self.unmatched.searches += 1;
        } else if !is_known {
            self.unmatched.answers += 1;
        } else if is_early {
            self.unmatched.early += 1;
        } else {
            self.frames.foreign += 1;
        }
    }

    fn sent(&mut self, at: Duration, frame: &Frame<'_>) {
        for datagram in datagrams(frame).flatten() {
            if let (
                Command::Bwr,
                Address::Device {
                    ado: register::AL_CONTROL,
                    ..
                },
            ) = (datagram.header.command, datagram.header.address)
            {
                self.down = Some(at);
                for slave in self.slaves.values_mut() {
                    slave.take_control(datagram.data);
                }
            }
        }
    }

    fn returned(&mut self, at: Duration, frame: &Frame<'_>) {
        self.frames.answered += 1;
        for datagram in datagrams(frame).flatten() {
            let header = datagram.header;
            let counter = datagram.working_counter.raw();
            match (header.command, header.address) {
                (Command::Lrw | Command::Lrd | Command::Lwr, Address::Logical(address)) => {
                    let group = (u8::from(header.command), address, header.len);
                    let series = self.groups.entry(group).or_default();
                    series.counters.push((at, counter));
                }
                (Command::Brd, Address::Device { .. }) => {
                    self.answering = self.answering.max(counter);
                }
                (
                    Command::Apwr,
                    Address::Device {
                        adp,
                        ado: register::STATION_ADDRESS,
                    },
                ) => {
                    self.addressed(adp, counter, datagram.data);
                }
                (
                    Command::Armw,
                    Address::Device {
                        adp,
                        ado: register::DC_SYSTEM_TIME,
                    },
                ) => {
                    // Each slave increments the address, which returns as the number of slaves less the position.
                    let position = (self.answering > 0).then(|| self.answering.wrapping_sub(adp));
                    let source = clocks::Source::Position(position);
                    self.clock.take(at, source, counter, datagram.data);
                }
                (Command::Fprd | Command::Fpwr | Command::Frmw, Address::Device { adp, ado }) => {
                    if header.command == Command::Frmw && ado == register::DC_SYSTEM_TIME {
                        let source = clocks::Source::Station(adp);
                        self.clock.take(at, source, counter, datagram.data);
                    }
                    let slave = self.slaves.entry(adp).or_default();
                    slave.take(at, header.command, ado, counter, datagram.data);
                }
                _ => {}
            }
        }
    }

    /// A slave got its station address. Each slave that the frame passes increments the position.
    fn addressed(&mut self, adp: u16, counter: u16, data: &[u8]) {
        let Some(station) = data.first_chunk().map(|two| u16::from_le_bytes(*two)) else {
            return;
        };
        if counter == 1 {
            let passed = self.answering.max(1);
            let slave = self.slaves.entry(station).or_default();
            slave.position = Some(passed.wrapping_sub(adp));
        }
    }

    /// Completes the figures. Frames under way at the end are not lost, unless they are overdue.
    fn finish(&mut self, pass: Pass) {
        let outcome = pass.trips.finish(self.end);
        (self.frames.lost, self.open) = (outcome.lost, outcome.open);
        self.trips = outcome.trips;
        self.cycle = pass.cycle.finish(&self.trips);
        if let Some(cycle) = self.cycle {
            let is_late = |trip: &&Trip| trip.is_cyclic && trip.took > cycle;
            let late = self.trips.iter().filter(is_late).count();
            self.frames.stale = u64::try_from(late).unwrap_or(u64::MAX);
        }
        // Addresses that never answered are no slaves.
        self.slaves
            .retain(|_, slave| slave.answered > 0 || slave.position.is_some());
        for slave in self.slaves.values_mut() {
            slave.finish();
        }
    }

    /// Answers to frames of other senders, if both directions were recorded.
    const fn foreign(&self) -> u64 {
        let unmatched = if self.frames.sent == 0 {
            0
        } else {
            self.unmatched.answers
        };
        self.frames.foreign + unmatched
    }

    /// The number of slaves, as far as the recording shows.
    fn slave_count(&self) -> usize {
        self.slaves.len().max(self.answering.into())
    }

    /// Stations in the order of their positions, if the recording shows them, else in the order of their addresses.
    fn ring(&self) -> Vec<(u16, &RecordedSlave)> {
        let mut all: Vec<(u16, &RecordedSlave)> = self
            .slaves
            .iter()
            .map(|(station, slave)| (*station, slave))
            .collect();
        if all.iter().all(|(_, slave)| slave.position.is_some()) {
            all.sort_by_key(|(_, slave)| slave.position);
        }
        all
    }
}
